"""Signals on time axes of their own, brought onto one: where every reader of a binary file ends."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import DataError, UnitError
from hydrotwin.models.language.units import compatible, convert

from .columns import Column, Table
from .headings import spelt
from .resampling import ROUNDING

MANY = 100  # elements of a sample that become columns of their own; more are a spectrum or an image


@dataclass(frozen=True, eq=False)
class Axis:
    """A time axis as the file has it: numbers in ``unit``, None where the file names none, or a type of time."""

    values: np.ndarray
    unit: str | None = "s"
    name: str = "time"


@dataclass(frozen=True, eq=False)
class Signal:
    """One signal as the file has it: any array, before it is known to be numbers.

    axis : its time, None where the file does not tell it. path : its full name, for names that occur twice.
    unusable : why it holds no numbers; "what" and "what next", without file and column.
    """

    name: str
    unit: str | None
    values: np.ndarray
    axis: Axis | None = None
    path: str = ""
    unusable: str = ""


def table_of(path: Path, signals: list[Signal], digest: str) -> Table:
    """The table of a file: its signals on the union of their times, unknown (NaN) where one has no sample.

    A signal without a time is on that of the others, where they have one. One that cannot be used says why.
    """
    if not signals:
        raise DataError(f"{path}: row 1: no signal over time. Check the file in a viewer, or export it again.")
    single = [element for s in _with_times_in_numbers(signals) for element in _elements(s)]
    axes = {(s.axis.values.tobytes(), s.axis.unit): s.axis for s in single if s.axis and not s.unusable}
    if len(axes) > 1:
        single = [_on_seconds(s) for s in single]
        known = [s.axis.values for s in single if not s.unusable]
        axis = Axis(union_of_times(known) if known else np.empty(0))
    else:
        axis = next(iter(axes.values()), next((s.axis for s in single if s.axis), None))
    length = len(axis.values) if axis else _usual_length(single)
    columns = [] if axis is None else [Column(axis.name, axis.unit, axis.values)]
    columns += [_column(path, s, axis, length) for s in _distinct(single, {c.name for c in columns})]
    assumed = ", s where the file names no unit" if any(a.unit is None for a in axes.values()) else ""
    said = f"{len(axes)} time axes{assumed} on the union of their times" if len(axes) > 1 else ""
    return Table(str(path), tuple(columns), lambda k: k + 1, digest, marks_unknown=len(axes) > 1, understood=said)


def _with_times_in_numbers(signals: list[Signal]) -> list[Signal]:
    """The same with every axis as numbers; dates and stamps count from the first one of all axes."""
    signals = [s if s.unit is None else replace(s, unit=spelt(s.unit)) for s in signals]
    axes = {id(a): a for s in signals if (a := s.axis) is not None}
    stamps = [a.values[~np.isnat(a.values)] for a in axes.values() if a.values.dtype.kind == "M"]
    first = min((s.min() for s in stamps if len(s)), default=None)
    for key, own in axes.items():
        if own.values.dtype.kind in "mM":
            axes[key] = Axis(in_seconds(own.values, first), "s", own.name)
        else:
            unit = own.unit and spelt(own.unit)
            axes[key] = replace(own, values=own.values.astype(float, copy=False), unit=unit)
    return [replace(s, axis=axes.get(id(s.axis))) for s in signals]


def in_seconds(values: np.ndarray, first: np.datetime64 | None = None) -> np.ndarray:
    """A type of time in seconds, stamps since ``first``: exact to the last bit of a nanosecond; NaN for none."""
    absent = np.isnat(values)
    if values.dtype.kind == "M":
        values = values - (values[~absent].min() if first is None and not absent.all() else first)
    counts = np.where(absent, 0, values.astype("timedelta64[ns]").astype(np.int64))
    seconds, rest = np.divmod(counts, 1_000_000_000)
    return np.where(absent, np.nan, seconds + rest / 1e9)


def union_of_times(axes: list[np.ndarray]) -> np.ndarray:
    """All instants of several growing time axes [s]; those within a rounding error of a step are one instant."""
    different = {axis.tobytes(): axis for axis in axes}
    if len(different) == 1:
        return axes[0]
    every = np.sort(np.concatenate(list(different.values())))
    return every[np.concatenate([[True], np.diff(every) > ROUNDING * _step(axes)])[: len(every)]]


def _step(axes: list[np.ndarray]) -> float:
    """The smallest median step of the axes [s]."""
    return min((float(np.median(np.diff(axis))) for axis in axes if len(axis) > 1), default=0.0)


def _elements(signal: Signal) -> list[Signal]:
    """One signal per element of a sample, ``name[0]`` or ``name[0][1]``, each as numbers or with the reason why not."""
    values = np.asarray(signal.values)
    if signal.unusable:
        return [signal]
    samples = len(signal.axis.values) if signal.axis else None
    if max(values.shape, default=1) == values.size:
        return [_in_numbers(replace(signal, values=values.reshape(-1)))]
    # MATLAB keeps time in the rows of a matrix, and in the last dimension of anything higher
    order = (0, 1) if values.ndim == 2 else (values.ndim - 1, 0)
    samples = max(values.shape) if samples is None else samples
    along = next((k for k in order if values.shape[k] == samples), None)
    shape = " x ".join(map(str, values.shape))
    if along is None:
        return [replace(signal, unusable=f"it is a {shape} array, and time has {samples} samples. {_ONE_VALUE}")]
    if values.size > MANY * values.shape[along]:
        return [replace(signal, unusable=f"every sample of it is an array ({shape} in all). {_ONE_VALUE}")]
    values = np.moveaxis(values, along, 0)
    values = values.reshape(len(values), *(n for n in values.shape[1:] if n > 1))
    at = [("".join(f"[{i}]" for i in k), values[(slice(None), *k)]) for k in np.ndindex(values.shape[1:])]
    return [_in_numbers(replace(signal, name=signal.name + i, path=signal.path + i, values=v)) for i, v in at]


_ONE_VALUE = "Save one value per sample, each element that is needed as a column of its own."


def _in_numbers(signal: Signal) -> Signal:
    """The signal as floats, None as NaN, or with the reason why it holds no numbers."""
    values = signal.values
    if values.dtype.kind in "mM":
        return replace(signal, values=in_seconds(values), unit="s")
    if values.dtype.kind in "fiub":
        return replace(signal, values=values.astype(float, copy=False))
    if values.dtype.kind == "c":
        return replace(signal, unusable="its values are complex. Save the real part, or the amount, as numbers.")
    try:
        if any(isinstance(v, str | bytes) for v in values):
            raise ValueError
        return replace(signal, values=np.array([np.nan if v is None else float(v) for v in values]))
    except (TypeError, ValueError):
        first = next((v for v in values if v is not None), None)
        return replace(signal, unusable=f"it holds no numbers (got {str(first)[:40]!r}). Store numbers.")


def _on_seconds(signal: Signal) -> Signal:
    """The signal on a growing time in seconds, or with the reason why it has none."""
    axis = signal.axis
    if signal.unusable or axis is None:
        return replace(signal, unusable=signal.unusable or "the file has no time for it. Save it with its time.")
    if axis.unit is not None and not is_time_unit(axis.unit):
        return replace(signal, unusable=f"its axis '{axis.name}' is in {axis.unit}, no time. Save it over time.")
    time = convert(axis.values, axis.unit or "s", "s")
    growing = np.diff(time) > 0
    if growing.all() and np.isfinite(time).all():
        return replace(signal, axis=Axis(time))
    k = int(np.argmin(growing))
    reason = (
        f"time must grow (got {time[k + 1]:.9g} s after {time[k]:.9g} s in row {k + 2} of its own axis; "
        f"{(~growing).sum()} such steps). Remove these samples, or export the signal anew."
    )
    return replace(signal, unusable=reason)


def is_time_unit(unit: str) -> bool:
    try:
        return compatible(unit, "s")
    except UnitError:
        return False


def _usual_length(signals: list[Signal]) -> int:
    """The length that most signals have; the larger one of two that are as frequent."""
    counts = Counter(len(s.values) for s in signals if not s.unusable)
    return max(counts, key=lambda n: (counts[n], n), default=0)


def _column(path: Path, signal: Signal, axis: Axis | None, length: int) -> Column:
    values, why = signal.values, signal.unusable
    if not why and signal.axis is not None and len(values) != len(signal.axis.values):
        why = _wrong_length(len(values), len(signal.axis.values))
    elif not why and signal.axis is None and len(values) != length:
        why = _wrong_length(len(values), length)
    if why:
        texts = [str(v) for v in values] if _are_texts(values) and len(values) == length else None
        return Column(
            signal.name, signal.unit, np.full(length, np.nan), f"{path}: column '{signal.name}': {why}", texts
        )
    if axis is None or signal.axis is None or len(values) == length:
        return Column(signal.name, signal.unit, values)
    placed = np.full(length, np.nan)
    own = signal.axis.values
    placed[np.searchsorted(axis.values, own + ROUNDING * _step([own]), side="right") - 1] = values
    return Column(signal.name, signal.unit, placed)


def _are_texts(values: np.ndarray) -> bool:
    return values.dtype.kind == "O" and any(isinstance(v, str) for v in values)


def _wrong_length(values: int, samples: int) -> str:
    return f"it has {values} values, time has {samples}. Save it with a value for every sample."


def _distinct(signals: list[Signal], taken: set[str]) -> list[Signal]:
    """The signals with names that differ: the full name where a short one occurs twice, then a number."""
    often = Counter(s.name for s in signals)
    named = [replace(s, name=s.path) if s.path and (often[s.name] > 1 or s.name in taken) else s for s in signals]
    taken, found = set(taken), []
    for signal in named:
        name, count = signal.name or "unnamed", 2
        while name in taken:
            name, count = f"{signal.name} ({count})", count + 1
        taken.add(name)
        found.append(replace(signal, name=name))
    return found
