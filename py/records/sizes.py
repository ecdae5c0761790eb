"""Columns that are far larger than what a model declares as usual, most likely in another unit than their file says.

And those whose range a few samples alone make.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible, convert_difference, display_units

from .record import Record

FAR = 100.0  # usual sizes: mm for m, Pa for bar, mV for V are more
UNSAID = 1.0  # the usual size of what declares none
FEW, SHARE = 5, 1 / 200  # samples that may stand alone, at either end of a range; and of all
BEYOND, STRETCHED = 0.5, 1.5  # ranges beyond that of the rest, and times that of all others: so far a few stand alone


def far_from_usual(records: Sequence[Record], signals: Iterable[Signal]) -> list[str]:
    """Of every signal that some recordings have far larger than its model declares (``nominal``) a sentence."""
    told = []
    for signal in {s.name: s for s in signals if s.nominal != UNSAID and s.unit != "1"}.values():
        sizes = {r.name: _largest(r[signal.name]) for r in records if _measures(r, signal)}
        far = {name: size for name, size in sizes.items() if size > FAR * abs(signal.nominal) > 0}
        if far:
            worst, unit = max(far, key=far.__getitem__), display_units(signal.unit)[0]
            size, usual = (convert_difference(v, signal.unit, unit) for v in (far[worst], signal.nominal))
            more = f" (and {len(far) - 1} more)" if len(far) > 1 else ""
            told.append(
                f"{signal.name} of {worst}{more} is as large as {size:.4g} {unit}, {far[worst] / signal.nominal:.4g} "
                f"times what its model declares as usual ({usual:.4g} {unit}). Check its unit: "
                f"--unit '{signal.name}={unit}'."
            )
    return told


def made_by_few(records: Sequence[Record], names: Iterable[str]) -> list[str]:
    """Of every signal whose range a few samples alone make, readings of a fault perhaps, a sentence."""
    return [_told(r, name, far) for name in dict.fromkeys(names) for r in records
            if name in r.signals and len(far := _alone(r[name]))]  # fmt: skip


def _alone(values: np.ndarray) -> np.ndarray:
    """The few samples of values (n,) that are far outside of what all others move in."""
    known = np.sort(values[np.isfinite(values)])
    few = min(FEW, int(SHARE * len(known)))
    low, high = known[[few, -few - 1]] if few else (0.0, 0.0)
    if not low < high:
        return np.zeros(0, dtype=int)
    far = np.maximum(low - values, values - high) > BEYOND * (high - low)
    stands_out = far.any() and np.ptp(known) > STRETCHED * np.ptp(values[np.isfinite(values) & ~far])
    return np.flatnonzero(far) if stands_out else np.zeros(0, dtype=int)


def _told(record: Record, name: str, far: np.ndarray) -> str:
    unit, values = display_units(record.units[name])[0], record[name]
    ranges = [np.nanmax(some) - np.nanmin(some) for some in (values, np.delete(values, far))]
    every, most = (convert_difference(float(one), record.units[name], unit) for one in ranges)
    which = "one sample makes" if len(far) == 1 else f"{len(far)} samples make"
    return (
        f"{name} of {record.name}: {which} its range, {every:.4g} {unit} where all others move by {most:.4g} {unit} "
        f"(at {record.time[far[0]]:.6g} s). What counts by the range is judged by that. If it is no measurement, leave "
        "the cell empty (--missing keep)."
    )


def _measures(record: Record, signal: Signal) -> bool:
    return signal.name in record.signals and compatible(record.units[signal.name], signal.unit)


def _largest(values: np.ndarray) -> float:
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if len(known) else 0.0
