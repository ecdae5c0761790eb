"""Columns that are far larger than what a model declares as usual: most likely in another unit than their file says."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible, convert_difference, display_units

from .record import Record

FAR = 100.0  # usual sizes: mm for m, Pa for bar, mV for V are more
UNSAID = 1.0  # the usual size of what declares none


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


def _measures(record: Record, signal: Signal) -> bool:
    return signal.name in record.signals and compatible(record.units[signal.name], signal.unit)


def _largest(values: np.ndarray) -> float:
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if len(known) else 0.0
