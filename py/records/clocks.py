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
from .stamps import DAY, has_date, is_stamp, nanoseconds

REPAIRS = ("spread", "first", "last", "unwrap", "sort")
_NAMES = (
    "time|t|zeit|temps|tiempo|tempo|tout|xvalue|timestamps?|timestamp|zeitstempel|datetime|dateandtime|datumuhrzeit|"
    "datumzeit|uhrzeit|elapsedtime|relativetime|relativezeit|messzeit|abstime|reltime|localtime|utc|utctime|epoch|times"
)
_NAMED = re.compile(rf"(?:{_NAMES})")
_BEGINS = re.compile(r"(?:time|zeit|timestamp|zeitstempel|uhrzeit|temps)\b")
_DATE_NAMES = re.compile(r"(?:date|datum|tag|day|fecha)")
# what a number without a unit counts that is as large as today in it: (least, most, most of a step, unit, words)
_EPOCHS = (
    (1e9, 4.5e9, 1e6, "s", "seconds since 1970 or 1904"),
    (1e12, 4.5e12, 1e9, "ms", "milliseconds since 1970"),
    (1e15, 4.5e15, 1e12, "us", "microseconds since 1970"),
    (1e18, 4.5e18, 1e15, "ns", "nanoseconds since 1970"),
    (2e4, 8e4, 1e-2, "d", "days as spreadsheets count them"),
    (7e5, 8e5, 1e-2, "d", "days as MATLAB counts them"),
)


def time_column(columns: Sequence[Column], wanted: str | None, path: str) -> int:
    """Index of the time column: the one that is named, or the one whose name says so.

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
    said = said or [k for k, c in enumerate(columns) if c.unit and _has_dimension_of_time(c.unit) and _grows(c)]
    if len(said) == 1:
        return said[0]
    if said:
        which = ", ".join(f"'{names[k]}'" for k in said)
        raise DataError(f"{path}: {which} may each be its time. Say which is: --time '{names[said[0]]}'.")
    found = ", ".join(names[:8])
    raise DataError(
        f"{path}: no column is called a time (got {found}). Say which one is: --time '{names[0]}', or state the "
        "sampling rate where it has none: --rate 1000."
    )


def called_time(name: str) -> bool:
    """Whether a name says that its column is a time."""
    return bool(_NAMED.fullmatch(re.sub(r"[^a-z0-9]", "", name.lower())))


def _may_be_time(column: Column) -> bool:
    """Whether a column has a unit of time, or none; and numbers or stamps."""
    if column.unit is not None and not (_has_dimension_of_time(column.unit) or _holds_stamps(column)):
        return False
    return not column.unusable or _holds_stamps(column)


def _grows(column: Column) -> bool:
    known = column.values[np.isfinite(column.values)]
    return len(known) > 1 and bool((np.diff(known) > 0).all())


def _has_dimension_of_time(unit: str) -> bool:
    try:
        return compatible(unit, "s")
    except UnitError:
        return False


def _holds_stamps(column: Column) -> bool:
    filled = next((cell for cell in column.texts or () if cell and cell.strip()), "")
    return is_stamp(filled)


def in_seconds(columns: Sequence[Column], at: int, path: str, header: str) -> tuple[Column, str]:
    """The time column ``at`` in seconds, and in words what it counts. Raises `DataError`, `UnitError`."""
    column = columns[at]
    if _holds_stamps(column):
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
    steps = np.diff(known)
    if not len(steps):
        return None, ""
    for least, most, step, unit, words in _EPOCHS:
        if least <= known.min() and known.max() <= most and np.abs(steps).max() <= step:
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
    if not has_date(next(cell for cell in cells if cell.strip())):
        words = "time of day"
        date = next((c for c in columns if _DATE_NAMES.match(c.name.lower()) and _holds_stamps(c)), None)
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
    return replace(column, values=np.where(absent, np.nan, seconds), unit="s", unusable="", texts=None), words


def sampled_at(rate: float, count: int) -> Column:
    """The time axis of ``count`` samples at a rate [Hz]."""
    return Column("time", "s", np.arange(count) / rate)


def order_of(time: np.ndarray, clock: str | None) -> tuple[np.ndarray, np.ndarray]:
    """Which samples stay, by index, and their times [s], after the repair that is asked for.

    ``spread``: stamps that stand several times are spread evenly until the next one. ``first``, ``last``: of
    samples with the same stamp one stays. ``unwrap``: after a jump back the time goes on with its usual step.
    ``sort``: by time.
    """
    every = np.arange(len(time))
    if clock == "sort":
        order = np.argsort(time, kind="stable")
        return order, time[order]
    if clock in ("first", "last"):
        changes = np.flatnonzero(np.diff(time) != 0)
        kept = np.concatenate([[0], changes + 1]) if clock == "first" else np.concatenate([changes, [len(time) - 1]])
        return kept, time[kept]
    if clock == "spread":
        return every, _spread(time)
    if clock == "unwrap":
        return every, _unwrapped(time)
    return every, time


def _spread(time: np.ndarray) -> np.ndarray:
    begins = np.concatenate([[0], np.flatnonzero(np.diff(time) != 0) + 1])
    lengths = np.diff(np.concatenate([begins, [len(time)]]))
    stamps = time[begins]
    steps = np.diff(stamps)
    if not len(steps):
        return time
    usual = float(np.median(steps / lengths[:-1])) if len(steps) else 0.0
    each = np.concatenate([steps / lengths[:-1], [usual]])
    within = np.arange(len(time)) - np.repeat(begins, lengths)
    return np.repeat(stamps, lengths) + within * np.repeat(each, lengths)


def _unwrapped(time: np.ndarray) -> np.ndarray:
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    back = steps < 0
    whole_days = np.isclose(steps + DAY / 1e9, usual, atol=0.5) & back  # a time of day goes on after midnight
    steps = np.where(whole_days, steps + DAY / 1e9, np.where(back, usual, steps))
    return time[0] + np.concatenate([[0.0], np.cumsum(steps)])
