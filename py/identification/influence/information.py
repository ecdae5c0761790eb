"""What recordings say of the parameters: their information, once the start states have adapted.

    H = sum over runs of ( H_pp - H_pz H_zz^-1 H_zp ),     H = sum over outputs and samples of dy^T dy / noise^2

In the scaled coordinates q of identification (ln p, or p over its unit). H^-1 is the covariance that a fit could reach.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy.linalg

from hydrotwin.models.language.flat import FlatModel

from ..fit import Finding
from ..identifiability import identifiability
from ..noise import output_noise
from ..problem import FreeParameters, Recording, free_parameters
from .intervals import Interval
from .local import Local, RunInformation
from .runs import Run, Runs

VAGUE = 1.0  # deviation of a parameter before any recording, in its own size: known to a factor of e, or to that
LEAST = 1e-12  # eigenvalue of the scaled information: a direction that nothing shows is a correlation of one


@dataclass(frozen=True, eq=False)
class Known:
    """What recordings say.

    free : the parameters and their scale. noise : (ny,), SI, of the sensors; worth : (ny,), SI, the error of a sample,
    which is the noise, or what the model as it is leaves, if that is more. Nan for an output without recording.
    matrix : H (np, np).
    """

    free: FreeParameters
    noise: np.ndarray
    worth: np.ndarray
    matrix: np.ndarray

    @property
    def correlation(self) -> np.ndarray:
        """Of the parameters, as a fit to these recordings would have it; nan for one that they do not show."""
        size = np.sqrt(np.diag(self.matrix))
        seen = size > 0
        answer = np.full(self.matrix.shape, np.nan)
        if seen.any():
            scaled = self.matrix[np.ix_(seen, seen)] / np.outer(size[seen], size[seen])
            values, vectors = np.linalg.eigh(scaled)
            inverse = (vectors / np.maximum(values, LEAST)) @ vectors.T
            sigma = np.sqrt(np.diag(inverse))
            answer[np.ix_(seen, seen)] = np.clip(inverse / np.outer(sigma, sigma), -1.0, 1.0)
        return answer

    def covariance(self, more: np.ndarray | float = 0.0) -> np.ndarray:
        """Of q when ``more`` information (np, np) comes to these recordings; before them all was `VAGUE`."""
        prior = np.diag(1 / (VAGUE * self.free.sizes) ** 2)
        return np.linalg.inv(self.matrix + more + prior)


def known(runs: Runs, asked: Sequence[Interval], found: Local, noise: Mapping[str, float]) -> Known:
    """What the recordings say; ``noise`` by output, SI, where it is known.

    A parameter that is asked about over more than its own size is taken to be as large as that. An output that never
    changes, and whose noise nobody gives, says nothing. Raises DataError as `output_noise`.
    """
    free = free_parameters(runs.flat, runs.names)
    free = replace(free, nominal=np.maximum(free.nominal, [i.reach for i in asked]))
    sigma = output_noise(runs.flat, [_changing(run, runs.flat, noise) for run in runs.runs], noise)
    left, samples = (sum(getattr(i, part) for i in found.information) for part in ("left", "measured"))
    worth = np.where(np.isfinite(sigma), np.fmax(sigma, np.sqrt(left / np.maximum(samples, 1))), np.nan)
    weights = np.where(np.isfinite(worth), 1 / np.where(np.isfinite(worth), worth, 1.0), 0.0)
    matrix = information_of(found.information, weights, np.zeros_like(weights), slope_of(free))
    return Known(free, sigma, worth, matrix)


def _changing(run: Run, flat: FlatModel, noise: Mapping[str, float]) -> Recording:
    """The recording without outputs of which nothing tells the noise."""
    y = run.y.copy()
    for j, signal in enumerate(flat.outputs):
        known = y[np.isfinite(y[:, j]), j]
        if signal.name not in noise and not (len(known) > 1 and np.ptp(known) > 0):
            y[:, j] = np.nan
    return Recording(run.name, run.digest, run.time, run.u, y)


def slope_of(free: FreeParameters) -> np.ndarray:
    """dp/dq at the parameters as they are."""
    return free.slope(free.scaled(free.start))


def information_of(
    runs: Sequence[RunInformation], recorded: np.ndarray, added: np.ndarray, slope: np.ndarray
) -> np.ndarray:
    """H (np, np) in q of the samples that were recorded, and of ``added`` outputs at every sample; weights (ny,)."""
    return sum(
        _freed(np.einsum("j,jab->ab", recorded**2, r.seen) + np.einsum("j,jab->ab", added**2, r.all), slope)
        for r in runs
    )


def _freed(whole: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Information on the parameters when the start states of the run are free."""
    n = len(slope)
    size = np.sqrt(np.diag(whole))
    unit = np.where(size > 0, size, 1.0)
    scaled = whole / np.outer(unit, unit)
    own = scipy.linalg.pinvh(scaled[n:, n:], rtol=1e-9) if whole.shape[0] > n else np.zeros((0, 0))
    left = scaled[:n, :n] - scaled[:n, n:] @ own @ scaled[n:, :n]
    return left * np.outer(unit[:n] * slope, unit[:n] * slope)


def not_told_apart(flat: FlatModel, found: Local, known: Known) -> list[Finding]:
    """Parameters that these recordings do not show, or only together, and the output that would part them."""
    slope, n = slope_of(known.free), len(known.free.names)
    unrecorded = {}
    for j, signal in enumerate(flat.outputs):
        if not np.isfinite(known.noise[j]):
            whole = sum(r.all[j, :n, :n] for r in found.information) / sum(r.samples for r in found.information)
            unrecorded[signal.name] = whole * np.outer(slope, slope)
    held = np.zeros(n, dtype=bool)
    return identifiability(flat, known.free, known.matrix, unrecorded, held)
