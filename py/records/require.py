"""Does a record hold what a model needs? And its inputs at every sample."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from hydrotwin.models.language.errors import DataError, UnitError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import (
    DELTA,
    compatible,
    convert,
    dimension,
    from_si,
    is_difference,
    parse_unit,
    power,
    si_unit,
    to_si,
    way_out,
)

from . import resampling
from .record import Record
from .unbroken import unknown_stretches

ALIKE = 1e-4  # of a column's range: noise parts two recordings of the same commands by more
PLACES = 50  # of the longer that are tried for the beginning of the shorter
HALF = 0.5  # of the samples: a recording that shares so many with another is a part of it, or a copy


def require(record: Record, signals: Sequence[Signal], model_name: str) -> Record:
    """The record with just the columns of ``signals``, in that order, all present and in the dimension needed.

    Raises `DataError` for a missing column, `UnitError` for one of another dimension; each names the file.
    """
    for signal in signals:
        if signal.name not in record:
            raise DataError(
                f"{record.source or record.name}: no column '{signal.name}', {model_name} needs "
                f"'{signal.name} [{signal.unit}]'. {nearest(signal.name, [*record.names, *record.refused])} "
                f"Say which column it is: --column '{signal.name}=NAME', or that it was constant: "
                f"--set '{signal.name}=0 {signal.unit}'."
            )
    record = as_needed(record, signals)
    for signal in signals:
        if not compatible(record.units[signal.name], signal.unit):
            shown = record.display_units.get(signal.name, record.units[signal.name])
            why = f" {way_out(shown, signal.unit)}" if dimension(shown) == dimension(signal.unit) else ""
            raise UnitError(
                f"{record.source or record.name}: column '{signal.name}' is in {shown}, the model needs "
                f"{signal.unit}.{why}{_scales(shown, signal)}"
            )
    return record.select([s.name for s in signals])


def without_unknown(record: Record, signals: Sequence[Signal]) -> Record:
    """The record without the columns of ``signals`` that hold no value at all: it says nothing of these."""
    unknown = {s.name for s in signals if s.name in record and not np.isfinite(record[s.name]).any()}
    return record.select([name for name in record.names if name not in unknown]) if unknown else record


def as_needed(record: Record, signals: Sequence[Signal]) -> Record:
    """The record with what its columns mean for ``signals``: 1/min, read as revolutions, is a rate where no angle is
    needed, and 5 degC of what is declared as a difference (delta_degC) is 5 K.

    Whoever takes a column by the name of a signal takes it from here. A column of another dimension stays as it is.
    Raises `UnitError` for a column that is a difference of temperatures to one and a temperature to another.
    """
    values: dict[str, np.ndarray] = {}
    units, displayed = {}, {}
    differences = {s.name for s in signals if is_difference(s.written_in)}
    for signal in (s for s in signals if s.name in record.units):
        name, own = signal.name, record.units[signal.name]
        shown = record.display_units.get(name, own)
        if _zero_of(signal.written_in) and (name in differences or is_difference(shown)):
            _refuse_both(record, signal)
        if name in values:
            continue
        if name in differences and _zero_of(shown):
            values[name], units[name] = record[name] - _zero_of(shown), own
            displayed[name] = DELTA + shown.replace("°", "deg")
        elif not compatible(own, signal.unit) and compatible(shown, signal.unit):
            counted = convert(from_si(record[name], shown), shown, signal.unit)
            values[name], units[name] = to_si(counted, signal.unit)
            displayed[name] = units[name]
    return record.with_signals(values, units, displayed) if values else record


def _refuse_both(record: Record, signal: Signal) -> None:
    zero, shown = _zero_of(signal.written_in), signal.written_in
    raise UnitError(
        f"{record.source or record.name}: '{signal.name}' is a difference of temperatures to one (delta_degC, as a "
        f"model or the recording has it), and a temperature in {shown} to another: one of both is wrong by {zero:g} K. "
        "Declare it alike, or call one otherwise."
    )


def _zero_of(unit: str) -> float:
    """Where the zero of a unit lies in SI: 273.15 of degC; 0 of others, and of none."""
    return parse_unit(unit).offset if unit else 0.0


def known_inputs(record: Record, inputs: Sequence[Signal], model_name: str) -> Record:
    """The record with its inputs known at every sample: a slower raster is held or linear in between.

    Raises `DataError` for an input with a gap that is longer than the steps of its own raster.
    """
    filled = {}
    for signal in inputs:
        if signal.name in record and not np.isfinite(record[signal.name]).all():
            filled[signal.name] = _between_own_samples(record, signal, model_name)
    return record.with_signals(filled) if filled else record


def _between_own_samples(record: Record, signal: Signal, model_name: str) -> np.ndarray:
    column, known = record[signal.name], np.isfinite(record[signal.name])
    own, values = record.time[known], column[known]
    if unknown_stretches(record.time, column).any():
        raise DataError(
            f"{record.source or record.name}: input column '{signal.name}' has gaps (got {(~known).sum()} values that "
            f"are not finite, the first at t = {record.time[np.argmin(known)]:g} s). {model_name} needs every "
            "sample of its inputs. Fill them, or take the part without (Record.window)."
        )
    if signal.held:
        return resampling.hold(own, values, record.time)
    return np.interp(record.time, own, values)


def _scales(shown: str, signal: Signal) -> str:
    """The scales that would do; the factor is for a person to say.

    Where only the angle is left out, the column may count turns (Hz does) or radians.
    """
    give = f"--scale '{signal.name}="
    lacks = power("rad", signal.unit) - power("rad", shown)
    if dimension(shown) == dimension(signal.unit) and si_unit(shown) != "1":
        if abs(lacks) != 1:
            return ""
        turns, radians = ("1 rev", "1 rad") if lacks > 0 else ("1 1/rev", "1 1/rad")
        if "Hz" in shown or "Hz" in signal.unit or (power("rad", shown) and "rad" not in shown):
            return f" Give a scale: {give}{turns}'."
        return f" Give a scale: {give}{turns}' where it counts turns, {give}{radians}' where it counts radians."
    if shown == "1":
        return (
            f" Give its unit where it has one (--unit '{signal.name}={signal.unit}', for a constant "
            f"--set '{signal.name}=VALUE {signal.unit}'), or what one of it stands for: {give}FACTOR {signal.unit}'."
        )
    if signal.unit == "K" and shown in ("C", "F"):
        return f" If it is a temperature, give its unit: --unit '{signal.name}=deg{shown}'."
    over = f"({shown})" if any(c in shown for c in "./*") else shown
    return f" Say what one of it stands for: {give}FACTOR {_divided(signal.unit, over)}'."


def _divided(unit: str, over: str) -> str:
    return f"{unit}/{over}" if unit and "/" not in unit else f"({unit})/{over}"


def require_once(records: Sequence[Record], twice: Iterable[tuple[Record, Record]] = ()) -> None:
    """DataError when two were read from files that hold the same: it would count twice, in every fit and every mean.

    twice : pairs that are the same in files of other bytes, too: `copies`.
    """
    first: dict[str, Record] = {other.digest or str(id(other)): one for one, other in twice}
    for record in records:
        same = first.setdefault(record.digest or str(id(record)), record)
        if same is not record:
            raise DataError(
                f"{record.source or record.name}: the same recording as {same.source or same.name}. It would count "
                "twice. Name each recording once."
            )


def shares_samples(record: Record, other: Record, measured: Collection[str] | None = None) -> bool:
    """Whether one is a copy of the other, or of a part of it: columns cut off, digits rounded, shorter, from time zero.

    At half of the times of the shorter or more, all columns that both have hold the same. Commands may be repeated: two
    columns move at least, and one of those that a sensor ``measured``; None for any.
    """
    if record is other or (record.digest and record.digest == other.digest):
        return True
    short, long = sorted((record, other), key=lambda r: len(r.time))
    return any(_same_at((short, long), shift, measured) for shift in (0.0, *_shifts(short, long)))


def require_unseen(
    records: Sequence[Record], validate: Sequence[Record], measured: Collection[str] | None = None
) -> None:
    """DataError when one of ``validate`` is one of ``records``, which are learned from, or a part or a copy of it.

    measured : the columns that tell, see `shares_samples`.
    """
    for record in validate:
        same = next((r for r in records if shares_samples(record, r, measured)), None)
        if same is not None:
            raise DataError(
                f"{record.source or record.name}: samples of {same.source or same.name}, which is learned from. Only "
                "an unseen recording can judge. Name another one to validate."
            )


def copies(records: Sequence[Record], measured: Collection[str] | None = None) -> list[tuple[Record, Record]]:
    """Pairs of which the second holds what the first does, sample by sample, in a file of other bytes: other line ends,
    another format, other digits. Quick for many: only those are looked through whose columns have the same means.

    measured : the columns that tell, see `shares_samples`.
    """
    same_length: dict[int, list[tuple[Record, Mapping[str, tuple[float, float]]]]] = {}
    for record in records:
        same_length.setdefault(len(record), []).append((record, _means(record)))
    return [
        (one, other)
        for some in same_length.values()
        for k, (other, told) in enumerate(some)
        for one, known in some[:k]
        if one.digest != other.digest and _alike(known, told) and shares_samples(one, other, measured)
    ]


def _means(record: Record) -> dict[str, tuple[float, float]]:
    """Mean and range of every column that is known throughout."""
    return {
        n: (float(v.mean()), float(np.ptp(v))) for n, v in record.signals.items() if len(v) and np.isfinite(v).all()
    }


def _alike(one: Mapping[str, tuple[float, float]], other: Mapping[str, tuple[float, float]]) -> bool:
    shared = [n for n in one if n in other]
    return bool(shared) and all(
        abs(one[n][0] - other[n][0]) <= _room(max(one[n][1], other[n][1]), one[n][0]) for n in shared
    )


def _room(reach: float, value: float) -> float:
    """By how much two of the same may differ, of a column that moves by ``reach``; of one that does not, by its size:
    200 psi is not to the last digit what it is in bar."""
    return ALIKE * (reach or abs(value))


def _shared(one: Record, other: Record) -> list[str]:
    """The columns that both have; one that cannot be used is none, for it need not be one that is needed."""
    there = set(other.names)
    return [name for name in one.names if name in there]


def _shifts(short: Record, long: Record) -> list[float]:
    """Times [s] by which the longer may be later, as the middle sample of the shorter says: few where it moves."""
    shared, middle = _shared(short, long), len(short.time) // 2
    same = np.ones(len(long.time), dtype=bool)
    for name in shared:
        value = short[name][middle]
        same &= np.abs(long[name] - value) <= _room(np.ptp(short[name]), value)
    return (long.time[same][:PLACES] - short.time[middle]).tolist() if shared else []


def _same_at(two: tuple[Record, Record], shift: float, measured: Collection[str] | None) -> bool:
    """Whether the shorter of two, so many seconds [s] later, holds what the longer does."""
    short, long = two
    times = short.time + shift
    near = 1e-6 * float(np.median(np.diff(times))) if len(times) > 1 else 0.0
    at = np.clip(np.searchsorted(long.time, times - near), 0, len(long.time) - 1)
    both = np.abs(long.time[at] - times) <= 2 * near
    if both.sum() < HALF * len(times):
        return False
    moving = []
    for name in _shared(short, long):
        mine, its = short[name][both], long[name][at[both]]
        low, high = np.nanmin(mine, initial=np.inf), np.nanmax(mine, initial=-np.inf)
        if np.nanmax(np.abs(mine - its), initial=0.0) > _room(max(high - low, 0.0), high):
            return False
        moving += [name] if high > low else []
    return len(moving) > 1 and (measured is None or any(name in measured for name in moving))
