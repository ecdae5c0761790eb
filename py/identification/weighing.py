"""What a residual of each output costs: one over the sensor's noise, or one over what the model leaves.

A model that lacks an effect cannot reach the noise. Weighted by noise the best sensor then rules alone: the fit buys
tenths of a millimetre with a hundred bar. Weighted by what is left, every output counts by its own relative change,

    min over p, s   sum_j n_j ln s_j + RSS_j(p) / (2 s_j^2),   s_j >= noise_j,

the likelihood with unknown error sizes s_j, never below the sensor's. For given p: s_j = max(noise_j, RMSE_j).
Source: Y. Bard, Nonlinear Parameter Estimation, 1974, ch. IV (unknown covariance); G. Seber & C. Wild, 1989, ch. 11.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from hydrotwin.models.language.errors import SolveError

from .descent import Task, undecided, whole_runs
from .least_squares import Minimum, minimise
from .noise import weights

WEIGHTS = ("auto", "noise", "residual")
WORTH_IT = 1.5  # times the noise: below that weights change nothing
BROAD = 0.05  # of the spread of an output: the error that a model may have before anything is known of it
ROUNDS = 6
COLOURED = {"absolute": 0.05, "stalled": 5.0}  # what is left is coloured: fewer degrees of freedom than samples
STEADY = 0.03  # relative change of the sizes that ends the rounds


@dataclasses.dataclass(frozen=True, eq=False)
class Weighed:
    """A minimum with the task (its weights) it belongs to; ``score`` is the likelihood's negative logarithm."""

    task: Task
    minimum: Minimum
    score: float


def left_over(task: Task, found: Minimum) -> np.ndarray:
    """RMSE of every output over the training recordings at a minimum of free runs, SI; nan where not measured.

    Under a robust loss, the root of the mean loss: outliers count there as little as in the fit. Recordings that
    diverge are not counted. Raises SolveError when all do.
    """
    return _left_over(task, runs_of(task, found))


def runs_of(task: Task, found: Minimum) -> list[np.ndarray | None]:
    """Weighted residuals of every training recording, integrated as the minimum asks; None where a run diverges.

    Raises SolveError when all do.
    """
    shooting, _ = whole_runs(undecided(task))
    runs = [shooting.residuals(i, found.q, found.z[i]) for i in range(len(task.recordings))]
    if all(run is None for run in runs):
        raise SolveError(
            f"identify: every run of {task.flat.name} diverges where the fit ended. Start elsewhere, or free fewer "
            "parameters."
        )
    return runs


def _left_over(task: Task, runs: list[np.ndarray | None]) -> np.ndarray:
    left = np.full(len(task.weights), np.nan)
    for j in np.flatnonzero(task.weights > 0):
        r = np.concatenate([run[:, j][np.isfinite(run[:, j])] for run in runs if run is not None])
        left[j] = np.sqrt(2 * task.loss.cost(r) / max(len(r), 1)) / task.weights[j]
    return left


def broadly_weighed(task: Task, adaptable: np.ndarray) -> Task:
    """The task with an error of a few percent of its spread allowed to every output that is ``adaptable``."""
    y = np.concatenate([r.y for r in task.recordings])
    with np.errstate(invalid="ignore"):
        broad = np.array([BROAD * np.nanstd(c) if np.isfinite(c).any() else np.nan for c in y.T])
    size = np.where(adaptable, np.fmax(task.noise, broad), task.noise)
    return dataclasses.replace(task, weights=weights(size))


def weighed_by_residual(task: Task, found: Minimum, adaptable: np.ndarray, most: int) -> Weighed:
    """Free runs under weights from what they leave, in turns, from a minimum until both agree."""
    size = _sizes(task, found, adaptable)
    for _ in range(ROUNDS):
        task = dataclasses.replace(task, weights=weights(size))
        shooting, _ = whole_runs(undecided(task))
        task.report("free run, weighed by what is left", 0, np.nan)
        on_step = task.step_report("weighed free run")
        found = minimise(shooting, found.q, found.z, **COLOURED, most=most, on_step=on_step)
        before, size = size, _sizes(task, found, adaptable)
        if np.nanmax(np.abs(np.log(size / before))) < STEADY:
            break
    return Weighed(task, found, score(task, found))


def score(task: Task, found: Minimum) -> float:
    """sum_j n_j ln(s_j / noise_j) + cost: comparable between weights."""
    counts = np.sum([np.isfinite(r.y).sum(axis=0) for r in task.recordings], axis=0)
    used = task.weights > 0
    return found.cost - float(counts[used] @ np.log(task.weights[used] * task.noise[used]))


def misses(task: Task, found: Minimum) -> np.ndarray:
    """What is left of each output over its noise, (ny,); 0 where not measured, infinite where a recording diverges."""
    runs = runs_of(task, found)
    ratio = np.nan_to_num(_left_over(task, runs) / task.noise)
    return np.where((task.weights > 0) & any(run is None for run in runs), np.inf, ratio)


def _sizes(task: Task, found: Minimum, adaptable: np.ndarray) -> np.ndarray:
    left = left_over(task, found)
    return np.where(adaptable & (left > WORTH_IT * task.noise), left, task.noise)
