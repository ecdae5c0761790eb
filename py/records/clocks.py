"""The time axis of a recording: which column it is, what its numbers or stamps count, repairs that a person asks for.

Nothing is repaired unasked. What cannot be decided is asked for by the option that decides it.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrotwin.models.language.errors import DataError, UnitError, nearest
from hydrotwin.models.language.units import compatible, parse_unit

from .columns import UNSEEN, Column, rounding_of
from .decimal_sign import exact_from_first
from .stamps import has_date, is_minutes, is_stamp, nanoseconds

_NAMES = (
    "time|t|zeit|temps|tiempo|tempo|tout|xvalue|timestamps?|timestamp|zeitstempel|datetime|dateandtime|datumuhrzeit|"
    "datumzeit|uhrzeit|elapsedtime|relativetime|relativezeit|messzeit|abstime|reltime|localtime|utc|utctime|epoch|times"
)
_NAMED = re.compile(rf"(?:{_NAMES})")
_BEGINS = re.compile(r"(?:time|zeit|timestamp|zeitstempel|uhrzeit|temps)\b")
TIME_OF_DAY, IN_AN_HOUR = "time of day", "minutes and seconds"
PERIODS = {TIME_OF_DAY: 86_400.0, IN_AN_HOUR: 3_600.0}  # s: as what a clock is told that begins anew after it
_MILLISECONDS = re.compile(r"ms|msec|millis|milliseconds?|millisekunden?")
_DATE_NAMES = re.compile(r"(?:date|datum|tag|day|fecha)")
# what a number without a unit counts that is as large as the years 2010 to 2035 in it:
# (least, most, seconds of one, unit, words)
_EPOCHS = (
    (1.26e9, 2.06e9, 1.0, "s", "seconds since 1970"),
    (3.34e9, 4.14e9, 1.0, "s", "seconds since 1904"),
    (1.26e12, 2.06e12, 1e-3, "ms", "milliseconds since 1970"),
    (1.26e15, 2.06e15, 1e-6, "us", "microseconds since 1970"),
    (1.26e18, 2.06e18, 1e-9, "ns", "nanoseconds since 1970"),
    (40179, 49400, 86400.0, "d", "days as spreadsheets count them"),
    (734139, 743300, 86400.0, "d", "days as MATLAB counts them"),
)
SLOWEST = 0.5  # s: a machine is recorded faster; numbers that would mean longer steps count something else
MINUTES, HOURS = ("mm:ss", "m:s", "min:s", "min:sec"), ("hh:mm", "h:m", "h:min", "hh:mm:ss", "h:m:s", "hh:mm:ss.sss")


def time_column(columns: Sequence[Column], wanted: str | None, path: str, unnamed: str = "") -> int:
    """Index of the time column: the one that is named, or the one whose name says so; unnamed : place of one without.

    Raises `DataError` where there is none, or several that say so.
    """
    names = [c.name for c in columns]
    if wanted is not None:
        if wanted in names:
            return names.index(wanted)
        raise DataError(f"{path}: no column '{wanted}', named as its time. {nearest(wanted, names)}")
    if "time" in names:
        return names.index("time")
    said = [k for k, name in enumerate(names) if called_time(name) and _may_be_time(columns[k])]
    said = said or [k for k, n in enumerate(names) if _BEGINS.match(n.lower()) and _may_be_time(columns[k])]
    said = said or [k for k, c in enumerate(columns) if counts_time(c)]
    if len(said) == 1:
        return said[0]
    if said:
        which = ", ".join(f"'{names[k]}'" for k in said)
        raise DataError(f"{path}: {which} may each be its time. Say which is: --time '{names[said[0]]}'.")
    texts = [(c, cell) for c in columns if called_time(c.name) and c.unusable for cell in c.texts or () if cell.strip()]
    if texts:
        called, cell = texts[0]
        raise DataError(
            f"{path}: column '{called.name}' is called a time, but '{cell[:40]}' is no number and no date or time that "
            "is known here. Write seconds, 10:12:33.250 or 2021-05-04 10:12:33.250, take another column (--time NAME), "
            "or state the sampling rate: --rate 1000."
        )
    found = ", ".join(names[:8])
    which = f"--time '{unnamed}' --unit '{unnamed}=s'" if unnamed else f"--time '{names[0]}'"
    raise DataError(
        f"{path}: no column is called a time (got {found}). Say which one is: {which}, or state the sampling rate "
        "where it has none: --rate 1000."
    )


def called_time(name: str) -> bool:
    """Whether a name says that its column is a time."""
    return bool(_NAMED.fullmatch(re.sub(r"[^a-z0-9]", "", name.lower())))


def _may_be_time(column: Column) -> bool:
    """Whether a column has a unit of time, or none; and numbers or stamps."""
    if column.unit is not None and not (_has_dimension_of_time(column.unit) or holds_stamps(column)):
        return False
    return not column.unusable or holds_stamps(column)


def counts_time(column: Column) -> bool:
    """Whether a column grows, and is in a unit of time."""
    return bool(column.unit) and _has_dimension_of_time(column.unit) and _grows(column)


def _grows(column: Column) -> bool:
    known = column.values[np.isfinite(column.values)]
    return len(known) > 1 and bool((np.diff(known) > 0).all())


def _has_dimension_of_time(unit: str) -> bool:
    if unit in (*MINUTES, *HOURS):
        return True
    try:
        return compatible(unit, "s")
    except UnitError:
        return False


def holds_stamps(column: Column) -> bool:
    """Whether a column holds dates or times as text."""
    filled = next((cell for cell in column.texts or () if cell and cell.strip()), "")
    return is_stamp(filled)


def in_seconds(columns: Sequence[Column], at: int, path: str, header: str) -> tuple[Column, str]:
    """The time column ``at`` in seconds, and in words what it counts. Raises `DataError`, `UnitError`."""
    column = columns[at]
    if holds_stamps(column):
        return _of_stamps(columns, at, path)
    if column.unusable:
        raise DataError(column.unusable)
    unit, said = (column.unit, "") if column.unit else _unit_of(column.values)
    if unit is None:
        raise DataError(
            f"{path}: {header}, column '{column.name}' has no unit, and its numbers do not tell it. Write "
            f"'{column.name} [s]' in the header, or state it: --unit '{column.name}=s' (ms, min, h, d)."
        )
    try:
        known = parse_unit(unit)
    except UnitError as error:
        raise UnitError(f"{path}: {header}, column '{column.name}': {error}") from None
    if not compatible(unit, "s"):
        raise UnitError(
            f"{path}: {header}, column '{column.name}' is in {unit}. Time is in s, ms, min or h. "
            "Say which column is the time: --time NAME, or state the sampling rate: --rate 1000."
        )
    return replace(column, values=_exact(column, path) * known.factor, unit="s"), said


def _unit_of(values: np.ndarray) -> tuple[str | None, str]:
    """The unit that the size of times without one tells, and in words what they count."""
    known = values[np.isfinite(values)]
    steps = np.abs(np.diff(known))
    steps = steps[steps > 0]  # a coarse clock stands
    if not len(steps):
        return None, ""
    for least, most, one, unit, words in _EPOCHS:
        if least <= known.min() and known.max() <= most and np.median(steps) * one <= SLOWEST:
            return unit, words
    return None, ""


def _exact(column: Column, path: str) -> np.ndarray:
    """Numbers of a time, from the first one where their size would cost digits of their steps.

    Raises `DataError` where the file has lost those digits already.
    """
    values = column.values
    share = rounding_of(values)
    if share <= UNSEEN or not np.isfinite(values).any():
        return values
    if column.texts is not None:
        return exact_from_first(column.texts, ".")
    first, unit = values[np.isfinite(values)][0], column.unit or ""
    if ROUGH < share < np.inf and (values != np.round(values)).any():
        raise DataError(
            f"{path}: column '{column.name}' begins at {first:.17g} {unit}, and a number of that size is rounded to "
            f"{np.spacing(first):.2g} {unit}, {100 * share:.2g} % of a step. The steps of the recording are lost. "
            "Store time from the start of the recording, or as whole numbers, or state the sampling rate: --rate 1000."
        )
    return values - first if share < np.inf else values


ROUGH = 1e-2  # of a step: rounding of the time that makes steps uneven


def _of_stamps(columns: Sequence[Column], at: int, path: str) -> tuple[Column, str]:
    column, words = columns[at], "date and time"
    cells = list(column.texts)
    first = next(cell for cell in cells if cell.strip())
    if not has_date(first):
        words = TIME_OF_DAY
        if column.unit in MINUTES or (is_minutes(first) and column.unit not in HOURS):
            words = IN_AN_HOUR
            cells = [f"0:{cell.strip()}" if cell.strip() else "" for cell in cells]
        elif first.count(":") == 1 and not re.search(r"[.,]", first) and column.unit not in HOURS:
            raise DataError(
                f"{path}: column '{column.name}': '{first}' may be hours and minutes, or minutes and seconds. State "
                f"it: --unit '{column.name}=mm:ss' or --unit '{column.name}=hh:mm'."
            )
        date = next((c for c in columns if _DATE_NAMES.match(c.name.lower()) and holds_stamps(c)), None)
        if date is not None and date is not column:
            cells, words = [f"{d} {t}".strip() for d, t in zip(date.texts, cells, strict=True)], "date and time"
    try:
        counts, absent = nanoseconds(cells)
    except ValueError as error:
        k = int(str(error))
        raise DataError(
            f"{path}: column '{column.name}': '{cells[k]}' (value {k + 1}) is no date or time of day, as those before "
            "it are. Correct that cell."
        ) from None
    seconds = (counts - counts[np.argmin(absent)]) / 1e9
    extra = next((c for c in columns if _MILLISECONDS.fullmatch(c.name.lower()) and _is_fraction(c, counts)), None)
    if extra is not None:
        seconds, words = seconds + (extra.values - extra.values[np.argmin(absent)]) / 1e3, f"{words} and milliseconds"
    return replace(column, values=np.where(absent, np.nan, seconds), unit="s", unusable="", texts=None), words


def _is_fraction(column: Column, counts: np.ndarray) -> bool:
    """Whether a column holds the milliseconds of stamps in whole seconds."""
    values = column.values
    whole = not (counts % 10**9).any() and np.isfinite(values).all() and len(values) == len(counts)
    if not (whole and (np.diff(counts) == 0).any() and (values >= 0).all() and (values < 1000).all()):
        return False
    steps, later = np.diff(values), np.diff(counts)
    return bool((later + 1e6 * steps > 0).all() and (steps[later == 10**9] < 0).all())  # else they count from the start


def sampled_at(rate: float, count: int) -> Column:
    """The time axis of ``count`` samples at a rate [Hz]."""
    return Column("time", "s", np.arange(count) / rate)
