"""The grammar of acceptance criteria: a sentence taken apart, or refused with the nearest one that is a criterion.

    [GROUP:] [OUTPUT.]METRIC < VALUE [UNIT]         also <=, >, >=, and their signs in one character
    [GROUP:] [OUTPUT.]METRIC in [LOW, HIGH] [UNIT]
    [GROUP:] [OUTPUT][.METRIC] not worse than MODEL [by SHARE]

GROUP is the name of a recording, ``tag=value``, or several of these with commas: all of them hold. Nothing is looked up
here: see `criteria_of`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

from hydrotwin.models.language.errors import DeclarationError, UnitError
from hydrotwin.models.language.quantities import NUMBER, number_of
from hydrotwin.models.language.units import parse_unit

from .rewriting import forms

EXAMPLES = "'position.rmse < 2 mm', 'position.fit > 90 %', 'position.coverage in [0.9, 0.99]'"
IN, THAN = "in", "not worse than"
SIGNS = {"<": "<", "＜": "<", ">": ">", "＞": ">", "<=": "<=", "=<": "<=", ">=": ">=", "=>": ">=", "≤": "<=",
         "≥": ">=", "≦": "<=", "≧": ">=", "⩽": "<=", "⩾": ">="}  # fmt: skip
_PERCENT = re.compile(r"%|％|(?:percent|per\s+cent|pct)\b\.?", re.IGNORECASE)
_ANY = "<>=＜＞≤≥≦≧⩽⩾"
_SIGN = rf"(?P<sign>[<>]\s*=|=\s*[<>]|[{_ANY.replace('=', '')}])"
_WHERE = r"\s*(?:(?P<group>\S(?:[\s\S]*\S)?)\s*:\s*)?"  # up to the last colon: a name or a tag may be a time, 10:12
_UNIT = rf"[^\s{_ANY},;][^{_ANY};]*?"
_BOUND = re.compile(rf"{_WHERE}(?P<what>[^{_ANY}]+?)\s*{_SIGN}\s*(?P<bound>{NUMBER})\s*(?P<unit>{_UNIT})?\s*$")
_RANGE = re.compile(
    rf"{_WHERE}(?P<what>\S.*?)\s+(?:(?i:in)|∈)\s*\[\s*(?P<low>{NUMBER})\s*(?P<each>[^\s,\]][^,\]]*?)?\s*,"
    rf"\s*(?P<high>{NUMBER})\s*(?(each)(?P=each)\s*\]|\]\s*(?P<unit>{_UNIT})?)\s*$"
)
_THAN = re.compile(
    rf"{_WHERE}(?:(?P<what>\S.*?)\s+)?not\s+worse\s+than\s+"
    rf"(?P<than>\"[^\"]+\"|'[^']+'|[^\"'\s].*?)(?:\s+by\s+(?P<by>{NUMBER})\s*(?P<percent>{_PERCENT.pattern})?)?\s*$",
    re.IGNORECASE,
)
_NO_NAME = re.compile(r"\sby(\s|$)|[,;]$|(?:%|percent)\s*\)?$", re.IGNORECASE)  # the share in other words
_NO_UNIT = re.compile(r"[\d.](?<!1)|1(?![/.]|$)")  # what begins as a number does

_TOLD = (
    (re.compile(r"\sthan\s.*\sby(\s|$)"),
     " What follows 'by' is a share: by 5 % or by 0.05; a name that holds the word stands in quotes."),
    (re.compile(r"\sin\s*\["), " Both bounds are in one unit: [1, 2] mm."),
)  # fmt: skip


@dataclass(frozen=True)
class Sentence:
    """The parts of a criterion as written.

    what : an output, a metric, or both; "" where none is named. kind : a sign of `SIGNS`, IN or THAN. numbers : the
    bound, or both. unit : "" without; percent is "%". than : the model or the file behind THAN. by : the share that is
    allowed, of 1.
    """

    text: str
    group: str
    what: str
    kind: str
    numbers: tuple[float, ...] = ()
    unit: str = ""
    than: str = ""
    by: float = 0.0


def taken_apart(text: str) -> Sentence:
    """The parts of a sentence. Raises `DeclarationError` for one that is no criterion, with the nearest that is."""
    found = _parts(text)
    if found is None or not _known(found.unit):
        _refuse(text, found)
    return found


def other_of(text: str) -> str:
    """The model, or the file of an earlier comparison, that a sentence holds against; "" where it does not.

    >>> other_of("load=2: angle not worse than 'last/compare.json' by 5 %"), other_of("fit > 90 %")
    ('last/compare.json', '')
    """
    found = _THAN.match(text)
    return found["than"].strip().strip("\"'") if found else ""


def _parts(text: str) -> Sentence | None:
    if found := _RANGE.match(text):
        numbers, unit = (number_of(found["low"]), number_of(found["high"])), found["each"] or found["unit"]
        return Sentence(text, found["group"] or "", found["what"], IN, numbers, _unit(unit))
    found = _THAN.match(text)
    if found and not set(found["what"] or "") & set(_ANY):
        return _than(text, found)
    if found := _BOUND.match(text):
        sign, numbers = SIGNS[re.sub(r"\s", "", found["sign"])], (number_of(found["bound"]),)
        return Sentence(text, found["group"] or "", found["what"], sign, numbers, _unit(found["unit"]))
    return None


def _than(text: str, found: re.Match) -> Sentence | None:
    written = found["than"]
    if written[0] not in "\"'" and _NO_NAME.search(written):
        return None  # a name that ends so, or holds the word, stands in quotes
    share = number_of(found["by"] or "0")
    if found["by"] and not found["percent"] and abs(share) > 1:
        raise DeclarationError(
            f"accept: '{text}': how much worse is a share, and {share:g} without a unit is {100 * share:g} %. Write "
            f"by {share:g} % or by {share / 100:g}, if that is meant."
        )
    by = share / 100 if found["percent"] else share
    return Sentence(text, found["group"] or "", found["what"] or "", THAN, than=other_of(text), by=by)


def _unit(unit: str | None) -> str:
    return "%" if _PERCENT.fullmatch(unit or "") else unit or ""


def _known(unit: str) -> bool:
    try:
        return parse_unit(unit) is not None and not _NO_UNIT.match(unit)
    except UnitError:
        return False


def _refuse(text: str, found: Sentence | None) -> None:
    """Raise with the nearest right sentence; return where the unit alone is wrong: of that an output tells more."""
    for form in forms(text):
        parts = [_right(one) for one in form.sentences]
        if all(parts):
            way = "Write" if len(parts) == 1 or form.either else "Write each for itself; all must hold:"
            raise DeclarationError(f"accept: '{text}' {form.why}. {way} {form.joined}.")
    if found is None or _NO_UNIT.match(found.unit):
        told = "".join(words for pattern, words in _TOLD if pattern.search(text))
        raise DeclarationError(f"accept: '{text}' is no criterion. Write for example {EXAMPLES}.{told}")


def _right(text: str) -> bool:
    try:
        found = _parts(text)
    except DeclarationError:
        return False
    return found is not None and _known(found.unit)
