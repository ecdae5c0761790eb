"""Dates and times of day as text: which they are, and how many seconds lie between them.

Everything is counted in whole nanoseconds, so that no digit of a stamp is lost.
"""

from __future__ import annotations

import datetime
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

DAY = 86_400 * 10**9  # ns
_ZERO = datetime.date(1970, 1, 1).toordinal()
_FRACTION = r"(?:(?:[.,]|:(?=\d{3}$))(?P<f>\d{1,9})\d*)?"  # fewer digits behind a colon may be frames
_CLOCK = rf"(?P<h>\d{{1,2}}):(?P<m>\d{{2}})(?::(?P<s>\d{{2}}){_FRACTION})?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
_ZONES = {"CET": 1, "CEST": 2, "MEZ": 1, "MESZ": 2}  # hours east of Greenwich
_ZONE = rf"\s*(?:[Zz]|UTC|GMT|(?P<zone>{'|'.join(_ZONES)})|(?P<sign>[+-])(?P<zh>\d{{2}}):?(?P<zm>\d{{2}}))?"
_DATES = (
    r"(?P<y>\d{4})[-/.](?P<mo>\d{1,2})[-/.](?P<d>\d{1,2})",
    r"(?P<y>\d{4})(?P<mo>\d{2})(?P<d>\d{2})",
    r"(?P<a>\d{1,2})(?P<by>[-/.])(?P<b>\d{1,2})[-/.](?P<y>\d{4}|\d{2})",
    r"(?P<d>\d{1,2})(?:\. ?|[- ])(?P<name>[A-Za-zäÄ]{3,9})\.?[-. ](?P<y>\d{4}|\d{2})",
)
_DAY_NAME = r"(?:[A-Za-z]{2,9}[.,]{0,2} )?"
_COMPACT = r"(?P<y>\d{4})(?P<mo>\d{2})(?P<d>\d{2})[T_ ](?P<h>\d{2})(?P<m>\d{2})(?P<s>\d{2})(?:[.,](?P<f>\d{1,9})\d*)?"
_MONTHS = {
    "jan": 1, "feb": 2, "mar": 3, "mär": 3, "mrz": 3, "apr": 4, "may": 5, "mai": 5, "jun": 6, "jul": 7, "aug": 8,
    "sep": 9, "oct": 10, "okt": 10, "nov": 11, "dec": 12, "dez": 12,
}  # fmt: skip
TIME_OF_DAY = re.compile(_CLOCK)
_LONG = re.compile(r"(?:(?P<days>-?\d+) days?,? )?(?P<h>\d+):(?P<m>\d{2}):(?P<s>\d{2})(?:[.,](?P<f>\d{1,9})\d*)?")
_COMPACT_BEGINS = re.compile(r"\d{8}[T_ ]\d{6}")
_MINUTES = re.compile(r"(?P<m>\d{1,3}):(?P<s>\d{2})[.,](?P<f>\d{1,9})\d*")
_STAMPS = [re.compile(rf"{_DAY_NAME}{date}(?:[T ,;_]+{_CLOCK}{_ZONE})?") for date in _DATES]
_STAMPS.append(re.compile(_COMPACT + _ZONE))


def is_stamp(cell: str) -> bool:
    """Whether a cell holds a time of day, a date, or both.

    >>> is_stamp("10:12:33,123"), is_stamp("04.05.2021 10:12"), is_stamp("1.5"), is_stamp("3:4:1")
    (True, True, False, False)
    """
    text = cell.strip().strip('"')
    if ":" not in text and sum(text.count(c) for c in "-/.") < 2 and not _COMPACT_BEGINS.match(text):
        return False
    return any(form.fullmatch(text) for form in (TIME_OF_DAY, _LONG, _MINUTES, *_STAMPS))


def is_minutes(cell: str) -> bool:
    """Whether a stamp is minutes and seconds with a fraction: ``59:58.5``."""
    return bool(_MINUTES.fullmatch(cell.strip()))


def has_date(cell: str) -> bool:
    """Whether a stamp says the day."""
    return any(s.fullmatch(cell.strip()) for s in _STAMPS)


def nanoseconds(cells: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
    """Nanoseconds of every stamp since midnight or since 1970, int64 (n,), and where there is none, bool (n,).

    Of two readings of 04/05/2021 the one is taken under which the stamps lie closer together. Raises ValueError with
    the index of the first cell that is neither a stamp nor empty.
    """
    readings, even = [], _evenly_written(cells)
    for order in ORDERS:
        try:
            readings.append(even.read(order) if even else _read(cells, order))
        except _NotADate as error:
            if order == ORDERS[-1] and not readings:
                raise ValueError(error.args[0]) from None
    return min(readings, key=lambda found: _span(*found))


@dataclass(frozen=True, eq=False)
class _Even:
    """Stamps whose digits all stand at the same places: what they say of the day [ns] (n,), and where dates change."""

    cells: Sequence[str]
    form: re.Pattern
    of_day: np.ndarray
    begins: np.ndarray

    def read(self, order: str) -> tuple[np.ndarray, np.ndarray]:
        counts, absent = self.of_day, np.zeros(len(self.cells), dtype=bool)
        if self.form is not TIME_OF_DAY:
            days = [_day(self.form.fullmatch(self.cells[k]), order, k) for k in self.begins.tolist()]
            counts = counts + np.repeat(days, np.diff([*self.begins, len(self.cells)])) * DAY
        return counts, absent


def _evenly_written(cells: Sequence[str]) -> _Even | None:
    """The stamps that many loggers write, taken apart at once; None for any others."""
    form = next((f for f in (TIME_OF_DAY, *_STAMPS) if len(cells) and f.fullmatch(cells[0])), None)
    match = form and form.fullmatch(cells[0])
    if not match or not match["h"]:
        return None
    codes = np.array(cells).view(np.uint32).reshape(len(cells), -1) - ord("0")
    digits = np.array([c in "0123456789" for c in cells[0]])
    same = codes.shape[1] == len(digits) and (codes[:, ~digits] == codes[0, ~digits]).all()
    if not same or (codes[:, digits] > 9).any():
        return None
    changes = (codes[1:, : match.start("h")] != codes[:-1, : match.start("h")]).any(axis=1)
    return _Even(cells, form, _of_day_evenly(codes, match), np.concatenate([[0], np.flatnonzero(changes) + 1]))


def _of_day_evenly(codes: np.ndarray, match: re.Match) -> np.ndarray:
    """Nanoseconds of day of digits (n, places) at the places of a match."""

    def part(name: str) -> np.ndarray | int:
        if not match.groupdict().get(name):
            return 0
        begin, end = match.span(name)
        number = np.zeros(len(codes), dtype=np.int64)
        for k in range(begin, end):
            number = 10 * number + codes[:, k]
        return number * 10 ** (9 - end + begin) if name == "f" else number

    hour = part("h")
    if half := match.groupdict().get("half"):
        hour = hour % 12 + (12 if half[0] in "Pp" else 0)
    east = (part("zh") * 60 + part("zm")) * (-1 if match.groupdict().get("sign") == "-" else 1)
    east = east + 60 * _ZONES.get(match.groupdict().get("zone") or "", 0)
    return ((hour * 60 + part("m") - east) * 60 + part("s")) * 10**9 + part("f")


ORDERS = ("day first", "month first", "year first")  # of numbers; the last only of years of two digits


class _NotADate(Exception):
    """Index of a cell that cannot be read so."""


def _span(counts: np.ndarray, absent: np.ndarray) -> float:
    known = counts[~absent]
    return float(np.abs(np.diff(known)).sum()) if len(known) else 0.0


def _read(cells: Sequence[str], order: str) -> tuple[np.ndarray, np.ndarray]:
    counts, absent = np.zeros(len(cells), dtype=np.int64), np.zeros(len(cells), dtype=bool)
    known: dict[str, int] = {}
    form = None
    for k, cell in enumerate(cells):
        text = cell.strip()
        if not text:
            absent[k] = True
            continue
        match = form.fullmatch(text) if form else None
        if match is None:
            form = next((f for f in (TIME_OF_DAY, _LONG, _MINUTES, *_STAMPS) if f.fullmatch(text)), None)
            if form is None:
                raise _NotADate(k)
            match = form.fullmatch(text)
        of_day = _of_day(match)
        if form in (TIME_OF_DAY, _LONG, _MINUTES):
            counts[k] = of_day
            continue
        date = text[: match.start("h")] if match["h"] else text
        if date not in known:
            known[date] = _day(match, order, k)
        counts[k] = known[date] * DAY + of_day
    return counts, absent


def _of_day(match: re.Match) -> int:
    parts = match.groupdict()
    if not parts.get("h") and match.re is not _MINUTES:
        return 0
    hour = int(parts.get("h") or 0)
    if parts.get("half"):
        hour = hour % 12 + (12 if parts["half"][0] in "Pp" else 0)
    hour += 24 * int(parts.get("days") or 0)
    seconds = (hour * 60 + int(parts["m"])) * 60 + int(parts["s"] or 0)
    if parts.get("sign"):
        east = (int(parts["zh"]) * 60 + int(parts["zm"])) * 60
        seconds -= east if parts["sign"] == "+" else -east
    seconds -= _ZONES.get(parts.get("zone") or "", 0) * 3600
    return seconds * 10**9 + int((parts["f"] or "0").ljust(9, "0"))


def _day(match: re.Match, order: str, k: int) -> int:
    parts = match.groupdict()
    year = int(parts["y"]) + (2000 if len(parts["y"]) == 2 else 0)
    if parts.get("name"):
        month, day = _MONTHS.get(parts["name"].lower()[:3], 0), int(parts["d"])
    elif parts.get("a"):
        swapped = order == "month first" and parts["by"] != "."  # with points the day comes first
        first, second = int(parts["a"]), int(parts["b"])
        day, month = (second, first) if swapped else (first, second)
        if order == "year first" and len(parts["y"]) == 2:
            year, month, day = 2000 + first, second, int(parts["y"])
    else:
        month, day = int(parts["mo"]), int(parts["d"])
    try:
        return datetime.date(year, month, day).toordinal() - _ZERO
    except ValueError:
        raise _NotADate(k) from None
