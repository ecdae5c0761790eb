"""Names of variables: unique, and of the convention that is declared."""

from __future__ import annotations

import re

from .declared import Declared
from .findings import Findings, twice

_WORD = r"[A-Za-z_][A-Za-z_0-9]*"
_QUOTED = r"""'(?:[A-Za-z_0-9!#$%&()*+,\-./:;<>=?@\[\]^{}|~ ]|\\['"?\\abfnrtv])+'"""
_PART = rf"(?:{_WORD}|{_QUOTED})(?:\[\d+(?:,\d+)*\])?"
_PATH = rf"{_PART}(?:\.{_PART})*"
STRUCTURED = re.compile(rf"{_PATH}|der\({_PATH}(?:,\d+)?\)")
"""A name of the convention "structured", whole."""


def names_row(declared: Declared) -> Findings:
    """Names of variables and, in FMI 3, of their aliases."""
    found, names = Findings(), declared.names
    found.breaks("names that are not unique", twice(names))
    found.breaks("names that are empty", [str(v) for v in declared.variables if not v.name.strip()])
    if convention_of(declared) == "structured":
        strange = [n for n in names if n.strip() and not STRUCTURED.fullmatch(n)]
        found.breaks("no names of the convention 'structured' that is declared", strange)
    else:
        found.breaks("names with a line break or a tab", [repr(n) for n in names if re.search(r"[\t\r\n]", n)])
    return found


def convention_of(declared: Declared) -> str:
    """How names are formed."""
    return declared.root.get("variableNamingConvention", "flat")
