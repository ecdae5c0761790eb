"""The command line as a user meets it: words in, exit code, standard output and standard error out."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import re
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from unittest import mock

import typer

from hydrotwin import cli

ROOT = Path(__file__).resolve().parents[2]
SHIPPED = ROOT / "examples"
APP, COMMANDS = cli.app, typer.main.get_command(cli.app)  # the signatures are read once


@dataclass(frozen=True)
class Answer:
    """What a command left behind."""

    code: int
    out: str
    err: str

    @property
    def said(self) -> str:
        """Everything it wrote, frames and line breaks of tables taken out."""
        return re.sub(r"[\s│╭╮╰╯─]+", " ", f"{self.out} {self.err}")


def hydrotwin(*words) -> Answer:
    """Run ``hydrotwin words...`` through `cli.main` in this process; an exception that escapes is a bug and rises."""
    out, err, code = io.StringIO(), io.StringIO(), 0
    with (
        mock.patch.object(sys, "argv", ["hydrotwin", *map(str, words)]),
        mock.patch.object(cli, "app", COMMANDS if cli.app is APP else cli.app),
        mock.patch.dict(os.environ, {"COLUMNS": "300"}),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            cli.main()
        except SystemExit as stop:
            code = stop.code or 0
    return Answer(code, out.getvalue(), err.getvalue())


def short(source: Path, target: Path, seconds: float = 4.0, edit: Callable[[str], str] | None = None) -> Path:
    """The first ``seconds`` of a shipped recording (100 Hz), its text changed by ``edit``."""
    lines = source.read_text(encoding="utf-8").splitlines(keepends=True)
    text = "".join(lines[: 2 + round(100 * seconds)])
    changed = edit(text) if edit else text
    assert changed != text or edit is None, f"{target.name}: the edit changes nothing"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(changed, encoding="utf-8")
    return target


def contents(folder: Path) -> dict[str, str]:
    """Every file below a folder with the hash of its bytes."""
    files = (p for p in sorted(folder.rglob("*")) if p.is_file() and "__pycache__" not in p.parts)
    return {str(p.relative_to(folder)): hashlib.sha256(p.read_bytes()).hexdigest() for p in files}
