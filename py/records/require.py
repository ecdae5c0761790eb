"""Does a record hold what a model needs? And its inputs at every sample."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.errors import DataError, UnitError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible, dimension, way_out

from . import resampling
from .record import Record

OWN_STEP = 1.5  # of its own median steps: a longer stretch without a sample is a gap in an input, not its slower raster


def require(record: Record, signals: Sequence[Signal], model_name: str) -> Record:
    """The record with just the columns of ``signals``, in that order, all present and of the right dimension.

    Raises `DataError` for a missing column, `UnitError` for one of another dimension; each names the file.
    """
    where = record.source or record.name
    for signal in signals:
        if signal.name not in record:
            raise DataError(
                f"{where}: no column '{signal.name}', {model_name} needs '{signal.name} [{signal.unit}]'. "
                f"{nearest(signal.name, record.names)}"
            )
        if not compatible(record.units[signal.name], signal.unit):
            shown = record.display_units.get(signal.name, record.units[signal.name])
            why = f" {way_out(shown, signal.unit)}" if dimension(shown) == dimension(signal.unit) else ""
            raise UnitError(
                f"{where}: column '{signal.name}' is in {shown}, the model needs {signal.unit}.{why} "
                f"Give a scale: --scale {signal.name}={_example(shown, signal)}."
            )
    return record.select([s.name for s in signals])


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
    apart = np.diff(np.concatenate([record.time[:1], own, record.time[-1:]]))
    if len(own) < 2 or apart.max() > OWN_STEP * np.median(np.diff(own)):
        raise DataError(
            f"{record.source or record.name}: input column '{signal.name}' has gaps (got {(~known).sum()} values that "
            f"are not finite, the first at t = {record.time[np.argmin(known)]:g} s). {model_name} needs every "
            "sample of its inputs. Fill them, or take the part without (Record.window)."
        )
    if signal.held:
        return resampling.hold(own, values, record.time)
    return np.interp(record.time, own, values)


def _example(shown: str, signal: Signal) -> str:
    """A scale that would do: full range in % is taken as the signal's nominal value, a bare 1/s as radians."""
    if dimension(shown) == dimension(signal.unit) == dimension("1/s"):
        return "1 rad" if compatible(signal.unit, "rad/s") else "1 1/rev"
    if shown == "1":
        return f"{signal.nominal:g} {signal.unit}"
    over = f"({shown})" if any(c in shown for c in "./*") else shown
    return f"{signal.nominal / (100 if shown == '%' else 1):g} {_divided(signal.unit, over)}"


def _divided(unit: str, over: str) -> str:
    return f"{unit}/{over}" if unit and "/" not in unit else f"({unit})/{over}"
