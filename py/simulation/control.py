"""Control of the steps: how long they are, what error one may have, and the accuracy that runs reach."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

TOLERANCE = 2e-6  # between a step and its two halves, in units of nominal + |x| of each state
IMPLICIT_SHARE = 0.005  # of it, that an implicit step may have: it is not the same for all values of the parameters
IMPLICIT_BURST, IMPLICIT_STEPS = 300_000, 300  # steps of an implicit run, and for every sample: it gives up beyond
EXACT = 0.01  # tolerances of an implicit run that was asked for: what others are held against
SMOOTH = 40.0  # tolerances of roughness (`equations.rk4_substep`) up to which an explicit step is not looked at
DEEPEST = 30  # halvings of a step around a kink: a nanosecond of a second
BURST = 10_000  # steps tried around kinks that every run may take, whatever they cost
ACCURACY = 1e-3  # of an output's range: what a run is to reach by itself
STILL = 1e-6, 1e-6  # of nominal, of the largest value: the least that counts as an output's range
FAR = 4.0  # factor by which a parameter has moved far
SMALL = 1e-2  # of nominal: parameters below are as good as zero


class Control(NamedTuple):
    """How a run is stepped.

    step : the longest [s]; tolerance : error of one, in units of nominal + |x|, infinite: whatever it is;
    trials : steps that may be tried around kinks for each plain one, before the implicit method is cheaper.
    """

    step: float
    tolerance: float = np.inf
    trials: float = np.inf

    def finer(self) -> Control:
        """What this is held against: half the step, an eighth of the error, as smooth steps have it."""
        return Control(self.step / 2, self.tolerance / 8, 4 * self.trials)


class Choice(NamedTuple):
    """How the next run goes: read once by each, so that threads may share a propagator.

    at : the parameters at which it was decided.
    """

    method: str
    control: Control
    at: np.ndarray | None = None

    @property
    def implicit(self) -> bool:
        return self.method == "implicit"

    def finer(self) -> Choice:
        """What this is held against."""
        return self._replace(control=self.control.finer())


@dataclass(frozen=True, eq=False)
class Accuracy:
    """How far a run is from the one with half the step, infinite where that one diverged.

    error : in ranges of the output that is furthest off, ``output``, at ``time`` [s]. apart : of each output, largest,
    SI. method, step [s] : of the run.
    """

    error: float
    output: str
    time: float
    apart: Mapping[str, float]
    method: str
    step: float

    @property
    def reached(self) -> bool:
        """Within `ACCURACY`."""
        return self.error <= ACCURACY

    def as_data(self) -> dict:
        """For JSON and model files."""
        return {"error": self.error, "reached": self.reached, "wanted": ACCURACY} | {
            key: getattr(self, key) for key in ("output", "time", "method", "step")
        }

    def __str__(self) -> str:
        how = f"{self.method}, step {self.step:.3g} s"
        if self.reached:
            return f"accurate to {self.error:.1e} of the range ({self.output}; {how})"
        return (
            f"not accurate: half the step changes {self.output} by {self.error:.2g} of its range (at t = "
            f"{self.time:.4g} s; {how}), and {ACCURACY:g} is wanted. "
            "Take method 'auto', a smaller step, smooth what jumps, or declare the nominal of states that move far less"
        )


def compared(flat, time, y, finer, method: str, step: float) -> Accuracy:
    """The accuracy of outputs ``y`` (n, ny), known from the ``finer`` run."""
    nominal = np.array([s.nominal for s in flat.outputs])
    least = np.maximum(STILL[0] * nominal, STILL[1] * np.abs(finer).max(axis=0))
    with np.errstate(invalid="ignore"):
        apart = np.nan_to_num(np.abs(y - finer), nan=np.inf, posinf=np.inf)
        ratio = np.where(np.isfinite(apart), apart / np.maximum(np.ptp(finer, axis=0), least), np.inf)
    k, j = np.unravel_index(np.argmax(ratio), ratio.shape)
    by_output = dict(zip([s.name for s in flat.outputs], map(float, apart.max(axis=0)), strict=True))
    return Accuracy(float(ratio[k, j]), flat.outputs[j].name, float(time[k]), by_output, method, step)


def moved_far(p: np.ndarray, before: np.ndarray, nominal: np.ndarray) -> bool:
    """Whether a parameter is another order of magnitude than ``before``: what was easy may be stiff there."""
    ratio = (np.abs(p) + SMALL * nominal) / (np.abs(before) + SMALL * nominal)
    return bool(((ratio > FAR) | (ratio < 1 / FAR)).any())
