"""The published form of compare.json, for scripts that read or check it."""

from __future__ import annotations

import json
from pathlib import Path

_FILE = Path(__file__).parent / "compare.schema.json"


def compare_schema() -> dict:
    """The JSON schema (draft 2020-12) of the compare.json that this version writes.

    >>> compare_schema()["properties"]["format"]["const"]
    'hydrotwin-compare/1'
    """
    return json.loads(_FILE.read_text(encoding="utf-8"))
