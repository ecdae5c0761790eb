"""Which sign is the decimal one in a text of numbers, and which one only groups thousands.

``35.491`` is 35491 in a file whose decimal sign is the comma. What no cell of a file decides is not guessed.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Iterator
from decimal import Decimal, localcontext

import numpy as np

from hydrotwin.models.language.errors import DataError

SIGNS = (".", ",")
LOOKED_AT = 2000  # cells from which a mixture of signs is told
_SPACES = " \u00a0\u202f\u2009'\u2019"  # blanks and apostrophes: they only ever group thousands
MINUS = str.maketrans(dict.fromkeys("\u2212\u2013\ufe63\uff0d", "-"))  # what word processors write for a minus
MISSING_TEXTS = {
    "", "nan", "-nan", "na", "n/a", "n.a.", "#n/a", "#nv", "null", "none", "-", "--", "---", "1.#qnan", "-1.#qnan",
    "1.#ind", "-1.#ind", "nan(ind)", "-nan(ind)", "#value!", "#wert!", "#div/0!",
}  # fmt: skip


def other_sign(decimal: str) -> str:
    """The sign that may group thousands beside a decimal sign."""
    return "," if decimal == "." else "."


def found_decimal(body: str, delimiter: str, path, first_row: int) -> str:
    """The decimal sign of the rows ``body``, from the first cell that can be read in one way only.

    Raises `DataError` where every cell with a sign may be a decimal number or one of thousands.
    """
    doubtful, seen = None, {}
    for match in itertools.islice(_cells_with_sign(body, delimiter), LOOKED_AT if delimiter == " " else 0):
        own = {sign for sign in SIGNS if sign in match[1]}
        if len(own) == 1 and _signs_of(match[1].strip(), match[2] or ""):
            seen.setdefault(own.pop(), match)
    if len(seen) == 2:  # programs that part cells by blanks group nothing
        cells = " and ".join(f"'{m[1].strip()}'" for m in seen.values())
        raise DataError(
            f"{path}: {cells} have different decimal signs, and cells parted by blanks hold no groups of thousands. "
            "Write one sign, or state which it is: --decimal ',' or --decimal '.'."
        )
    for match in _cells_with_sign(body, delimiter):
        signs = _signs_of(match[1].strip(), match[2] or "")
        if len(signs) == 1:
            return signs[0]
        doubtful = doubtful or (match if signs else None)  # a date or a version is none
    if doubtful is None:
        return "."
    if delimiter == " ":  # programs write such columns, and they group nothing
        return "," if "," in doubtful[1] else "."
    start = doubtful.start(1)
    row = first_row + body.count("\n", 0, start)
    column = 1 + body.count(delimiter, body.rfind("\n", 0, start) + 1, start)
    number = doubtful[1].strip()
    sign = "," if "," in number else "."
    raise DataError(
        f"{path}: row {row}, column {column}: '{number}' may be {number.replace(sign, '')} or "
        f"{number.replace(sign, '.')}, and no number of the file tells whether '{sign}' is its decimal sign. "
        f"State it: --decimal '{sign}' or --decimal '{other_sign(sign)}' (decimal= in Python), or write "
        f"'# decimal={sign}' or '# decimal={other_sign(sign)}' above the header."
    )


def without_groups(body: str, decimal: str) -> str | None:
    """The text with a decimal point and without groups; None where the other sign does not group thousands only."""
    group = other_sign(decimal)
    if group in body:
        g, d = re.escape(group), re.escape(decimal)
        after_decimal = "|".join(rf"{g}(?<={d}{digits}{g})" for digits in ("", r"\d", r"\d\d", r"\d\d\d"))
        improper = rf"{g}(?!\d{{3}}(?![\deE]))|{g}(?<!\d{g})|{g}(?<=\d{{4}}{g})|{g}(?<=\b0{g})|{after_decimal}"
        if re.search(improper, body):
            return None
        body = body.replace(group, "")
    return body.replace(",", ".") if decimal == "," else body


def number_in(cell: str, decimal: str) -> float | None:
    """The number in a cell, NaN for a missing one, None for text and for groups that are none."""
    text = _plain(cell, decimal)
    try:
        return None if text is None else float(text)
    except ValueError:
        return None


def exact_from_first(cells: Iterable[str], decimal: str) -> np.ndarray:
    """Numbers less the first of them, with all the digits that are written; NaN for missing ones."""
    with localcontext(prec=60):
        numbers = [Decimal(_plain(cell, decimal) or "nan") for cell in cells]
        first = next((number for number in numbers if number.is_finite()), Decimal(0))
        return np.array([float(number - first) for number in numbers])


def _plain(cell: str, decimal: str) -> str | None:
    """The cell as digits and a decimal point, "nan" for a missing value; None for groups that are none."""
    cell = cell.strip()
    if cell.lower() in MISSING_TEXTS:
        return "nan"
    cell = _FORTRAN.sub("e", cell)
    if _GROUPED[decimal].fullmatch(cell):
        cell = re.sub(f"[{other_sign(decimal)}{_SPACES}]", "", cell)
    return None if "_" in cell or other_sign(decimal) in cell else cell.replace(decimal, ".")


def _grouped(decimal: str) -> re.Pattern:
    """Groups of three behind one sign, or the Indian 12,34,567 (with commas only); then, if any, decimals."""
    group, d = other_sign(decimal), re.escape(decimal)
    threes = rf"\d{{1,3}}(?P<sign>[{group}{_SPACES}])\d{{3}}(?:(?P=sign)\d{{3}})*"
    indian = rf"\d{{1,2}}(?:{re.escape(group)}\d{{2}})+{re.escape(group)}\d{{3}}"
    groups = f"{threes}|{indian}" if group == "," else threes
    return re.compile(rf"[-+]?(?!0)(?:{groups})(?:{d}\d*(?:[eE][-+]?\d+)?)?")


_UNIT = r"(?: ?[a-zA-Z%\u00b0\u00b5/\u00b2\u00b3\u00b7]{1,12})?"
_FORTRAN = re.compile(r"(?<=[\d.,])[dD](?=[-+]?\d+$)")
_GROUPED = {decimal: _grouped(decimal) for decimal in SIGNS}


def _cells_with_sign(body: str, delimiter: str) -> Iterator[re.Match]:
    """Cells that are a number with a point or comma in it, maybe a unit: its digits and signs, its exponent."""
    ends = f'{re.escape(delimiter)}\n"' + ("\t" if delimiter == " " else "")
    digits = r"\d.," + (_SPACES if delimiter != " " else _SPACES[1:])
    number = rf"[-+]?([{digits}]*[.,][{digits}]*)([eE][-+]?\d+)?{_UNIT}"
    yield from re.finditer(rf"(?:^|[{ends}]) *{number}(?=[{ends}]|$)", body)


def _signs_of(number: str, exponent: str) -> list[str]:
    """The decimal signs under which a cell is a number."""
    return [d for d in SIGNS if number_in(number + exponent, d) is not None]
