"""FMUs that give what another model of a comparison gives: the same model, exported."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hydrotwin.comparison import FREE_RUN, Comparison
from hydrotwin.records import Record

SAME = 1e-4  # of the range of a signal: two models that differ by less everywhere are one


@dataclass(frozen=True)
class Copy:
    """``fmu`` gives the outputs of ``model``, to within ``difference`` of the range of each signal."""

    fmu: str
    model: str
    difference: float

    @property
    def sentence(self) -> str:
        """The copy and how near it is."""
        if self.difference == 0.0:
            return f"{self.fmu} gives exactly the outputs of {self.model}."
        return f"{self.fmu} gives the outputs of {self.model} to within {self.difference:.0e} of their range."


def copies(comparison: Comparison) -> tuple[Copy, ...]:
    """Every FMU whose free runs are those of another model on all outputs of all recordings."""
    scored = [s.name for s in comparison.outputs]
    runs: dict[str, dict[str, Record]] = {}
    for t in comparison.trajectories:
        if t.mode == FREE_RUN:
            runs.setdefault(t.model, {})[t.record] = t.prediction.select([n for n in scored if n in t.prediction])
    exported = {e.name for e in comparison.entrants if e.kind == "fmu"}
    found: list[Copy] = []
    for fmu in (m for m in comparison.models if m in exported and m in runs):
        known = {c.fmu for c in found}
        rivals = (m for m in comparison.models if m in runs and m != fmu and m not in known | comparison.yardsticks)
        near = min((Copy(fmu, m, _difference(runs[fmu], runs[m])) for m in rivals), key=_size, default=None)
        if near and near.difference < SAME:
            found.append(near)
    return tuple(found)


def _size(copy: Copy) -> float:
    return copy.difference


def _difference(one: Mapping[str, Record], other: Mapping[str, Record]) -> float:
    """Largest difference over the range of its signal; infinite when they do not run the same outputs."""
    if one.keys() != other.keys() or any(set(one[r].signals) != set(other[r].signals) for r in one):
        return math.inf
    return max(
        float(np.abs(values - other[r][name]).max() / (np.ptp(other[r][name]) or 1.0))
        for r, run in one.items()
        for name, values in run.signals.items()
    )
