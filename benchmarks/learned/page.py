"""A page in Markdown of which several programs write a section each."""

from __future__ import annotations

import re
from pathlib import Path


def put_section(page: Path, heading: str, text: str) -> None:
    """Write the section ``## heading`` of a page anew, at its end where it is new; all else stays."""
    before = page.read_text(encoding="utf-8") if page.exists() else ""
    kept = [part for part in _sections(before) if not part.startswith(f"## {heading}\n")]
    page.write_text(
        "".join([*(f"{part.rstrip()}\n\n" for part in kept), f"## {heading}\n\n{text.rstrip()}\n"]), "utf-8"
    )


def put_first(page: Path, text: str) -> None:
    """Write what stands before the first ``## heading`` of a page anew; its sections stay."""
    before = page.read_text(encoding="utf-8") if page.exists() else ""
    kept = [part for part in _sections(before) if part.startswith("## ")]
    page.write_text("\n".join([f"{text.rstrip()}\n", *(f"{part.rstrip()}\n" for part in kept)]), "utf-8")


def _sections(text: str) -> list[str]:
    return [part for part in re.split(r"(?m)^(?=## )", text) if part.strip()]
