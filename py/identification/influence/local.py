"""Local sensitivities: how far each parameter moves each output, by the exact derivatives of the run.

    moved_jk(t) = dy_j/dp_k reach_k,     reach_k : half the interval of parameter k

Its root mean square over time is in the unit of the output; over the noise it says what a sensor sees, over the range
of the output what an engineer sees. Summed over the samples, the same derivatives are the information that a run holds.
Source: R. Brun, P. Reichert, H. Kuensch, Water Resources Research 37, 2001 (scaled sensitivities).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import SolveError

from .intervals import Interval
from .runs import Run, Runs

CURVE = 400  # samples of a run that are kept of a curve
NOTHING = 1e-9  # of the range of an output: what moves it by less has no effect on it; runs agree no better


@dataclass(frozen=True, eq=False)
class RunInformation:
    """Sums over the samples of one run of the products of derivatives, by output, SI: all (ny, k, k), and seen, those
    where the output was measured; k : the parameters, then the start states that are measured.

    left : (ny,) sum of squares of what the nominal run leaves of what was measured; measured : (ny,) how many samples.
    """

    all: np.ndarray
    seen: np.ndarray
    left: np.ndarray
    measured: np.ndarray
    samples: int


@dataclass(frozen=True, eq=False)
class Curve:
    """How far each parameter moves each output of one run over time: time (m,), moved (m, ny, np), SI, with its sign.

    outputs : (m, ny), the nominal run.
    """

    record: str
    time: np.ndarray
    moved: np.ndarray
    outputs: np.ndarray


@dataclass(frozen=True, eq=False)
class Local:
    """Local sensitivities over all runs.

    moved : (ny, np), SI, root mean square over all samples; by_stretch : the same of every run, (stretches, ny, np).
    range : (ny,) of the nominal runs. curves : one of every run. information : of every run.
    """

    moved: np.ndarray
    by_stretch: tuple[np.ndarray, ...]
    range: np.ndarray
    curves: tuple[Curve, ...]
    information: tuple[RunInformation, ...]

    @property
    def share(self) -> np.ndarray:
        """``moved`` over the range of each output, (ny, np); 0 for an output that never changes."""
        return np.divide(self.moved, self.range[:, None], out=np.zeros_like(self.moved), where=self.range[:, None] > 0)

    @property
    def without_effect(self) -> np.ndarray:
        """(np,) which parameters move no output."""
        return ~(self.share > NOTHING).any(axis=0) & ~self.moved[self.range <= 0].any(axis=0)


def local(runs: Runs, intervals: Sequence[Interval]) -> Local:
    """Sensitivities of every run at the nominal parameters.

    Raises Diverged where a nominal run stops, SolveError where its derivatives leave the finite numbers.
    """
    reach = np.array([i.reach for i in intervals])
    by_stretch, curves, informations = [], [], []
    low, high = np.full(len(runs.flat.outputs), np.inf), np.full(len(runs.flat.outputs), -np.inf)
    squares, samples = 0.0, 0
    for run in runs.runs:
        y, dy = runs.sensitivities(run)
        if not np.isfinite(dy).all():
            raise SolveError(
                f"sensitivity: the derivatives of {runs.flat.name} over {run.name} leave the finite numbers. A contact "
                "or a valve may be steep there. Shorten the recording, or give a smaller step."
            )
        moved = dy[:, :, : len(reach)] * reach
        sums = np.add.reduceat(moved**2, run.edges[:-1], axis=0)
        by_stretch.append(np.sqrt(sums / np.diff(run.edges)[:, None, None]))
        squares, samples = squares + sums.sum(axis=0), samples + len(run.time)
        low, high = np.minimum(low, y.min(axis=0)), np.maximum(high, y.max(axis=0))
        every = slice(None, None, max(1, len(run.time) // CURVE))
        curves.append(Curve(run.name, run.time[every], moved[every], y[every]))
        informations.append(information(run, y, dy))
    return Local(np.sqrt(squares / samples), tuple(by_stretch), high - low, tuple(curves), tuple(informations))


def information(run: Run, y: np.ndarray, dy: np.ndarray) -> RunInformation:
    """What a run holds, from its outputs y (n, ny) and their derivatives dy (n, ny, k)."""
    seen = np.isfinite(run.y)
    whole = np.einsum("tja,tjb->jab", dy, dy, optimize=True)
    here = np.where(seen[:, :, None], dy, 0.0)
    left = np.where(seen, y - np.where(seen, run.y, 0.0), 0.0)
    measured = whole if seen.all() else np.einsum("tja,tjb->jab", here, here, optimize=True)
    return RunInformation(whole, measured, np.square(left).sum(axis=0), seen.sum(axis=0), len(run.time))
