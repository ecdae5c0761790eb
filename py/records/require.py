"""Does a record hold what a model needs?"""

from __future__ import annotations

from collections.abc import Sequence

from hydrotwin.models.language.errors import DataError, UnitError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible, dimension, way_out

from .record import Record


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


def _example(shown: str, signal: Signal) -> str:
    """A scale that would do: full range in % is taken as the signal's nominal value."""
    if shown == "1":
        return f"{signal.nominal:g} {signal.unit}"
    over = f"({shown})" if any(c in shown for c in "./*") else shown
    return f"{signal.nominal / (100 if shown == '%' else 1):g} {_divided(signal.unit, over)}"


def _divided(unit: str, over: str) -> str:
    return f"{unit}/{over}" if unit and "/" not in unit else f"({unit})/{over}"
