"""Training of a network on its own free run: Levenberg-Marquardt from linear least squares on.

    minimise  mean |y_sim - y|^2 + decay |w - w_linear|^2

The linear model of the same form, refined in free run, is where the network starts and what it is drawn to: more decay
is less network. Stretches grow from a few samples to whole recordings. Sources: Hagan, Menhaj, IEEE Trans. Neural
Networks 5 (1994) 989-993; Sjoberg, Ljung, Int. J. Control 62 (1995) 1391-1407 (regularisation and early stopping).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..interruption import INTERRUPTED
from .form import Form
from .free_run import Scales, Stretches, free_run, normal_equations, weight_arrays
from .narx import NarxShape
from .series import Piece, Series, one_step, squares, stretches

SETTLED = 3e-3  # of the cost: an iteration that gains less ends a stage
GROWS = 1e-9  # beyond 1: magnitude of a pole from which on a linear model is unstable; one that integrates has 1
RAISE, TRIES = 6.0, 8  # of the damping, until a step lowers the cost


@dataclass(frozen=True)
class Stage:
    """At most ``iterations`` on stretches of ``horizon`` samples (None: whole pieces)."""

    horizon: int | None
    iterations: int


@dataclass(frozen=True)
class TrainingProgress:
    """One accepted iteration. Errors are RMS over outputs, each divided by its spread; ``best`` is on held-out data."""

    seed: int
    horizon: int
    iteration: int
    train_error: float
    best: float
    seconds: float


class Ended(Exception):
    """The time limit that was asked for, or Ctrl-C: what was found so far is taken."""


class Meter:
    """Iterations so far, the time limit [s] where there is one, the best error found, and who is told."""

    def __init__(self, limit: float | None, progress: Callable[[TrainingProgress], None] | None):
        self.limit, self.progress = limit, progress
        self.iterations, self.best, self.stopped, self.began = 0, np.inf, "", time.monotonic()

    @property
    def seconds(self) -> float:
        """Since the training began."""
        return time.monotonic() - self.began

    def count(self, seed: int, horizon: int, iteration: int, error: float) -> None:
        """An iteration is done. Raises `Ended` where it was the last."""
        self.iterations += 1
        try:
            if self.progress:
                self.progress(TrainingProgress(seed, horizon, iteration, error, self.best, self.seconds))
        except KeyboardInterrupt:
            self.stop(INTERRUPTED)
        if self.limit is not None and self.seconds > self.limit:
            self.stop(f"time limit of {self.limit:g} s after {self.iterations} iterations")

    def stop(self, why: str) -> None:
        """End the training."""
        self.stopped = why
        raise Ended


@dataclass(frozen=True, eq=False)
class Problem:
    """A form over a series: what trains it and judges it."""

    form: Form
    series: Series
    shape: NarxShape
    scales: Scales
    trained: np.ndarray

    @classmethod
    def of(cls, form: Form, series: Series) -> Problem:
        """The shape, scales and trained weights of ``form``."""
        sizes = series.pieces[0].inputs.shape[1], series.pieces[0].outputs.shape[1]
        shape = form.shape(*sizes)
        return cls(form, series, shape, series.scales(shape), form.trained(*sizes))

    def judge(self, weights: np.ndarray, pieces: Sequence[Piece]) -> float:
        """RMS of free runs over outputs, each over its spread."""
        total, count = squares(weights, pieces, self.shape, self.scales)
        error = float(np.sqrt(total.sum() / max(count * self.shape.outputs, 1))) if count else np.inf
        return error if np.isfinite(error) else np.inf

    def grows(self, weights: np.ndarray) -> bool:
        """Whether a linear free run grows without bound: such a model may fit every part and leave any longer run."""
        if self.shape.hidden:
            return False
        ny, fed_back = self.shape.outputs, self.shape.fed_back
        own, gain = np.eye(fed_back), weight_arrays(weights, self.shape)[3][:, :fed_back]
        following = np.vstack([own[:ny] + self.scales.increment[:, None] * gain, gain, own[ny : fed_back - ny]])
        poles = np.linalg.eigvals(following[:fed_back])
        return bool(np.abs(poles).max() > 1 + GROWS)

    def least_squares(self, pieces: Sequence[Piece]) -> np.ndarray:
        """Linear weights by least squares one step ahead: of measured or of smoothed outputs, what runs better."""
        starts = [self._solved(*one_step(pieces, self.shape, self.scales.increment, quiet)) for quiet in (False, True)]
        return min(starts, key=lambda w: self.judge(w, pieces))

    def _solved(self, rows: np.ndarray, targets: np.ndarray) -> np.ndarray:
        weights, flags = np.zeros(self.shape.size), np.zeros(self.shape.size, dtype=bool)
        flags[self.trained] = True
        seen = np.append(weight_arrays(flags, self.shape)[3][0], True)
        solution = np.linalg.lstsq(rows[:, seen], targets, rcond=None)[0]
        _, _, _, W, b = weight_arrays(weights, self.shape)
        W[:, seen[:-1]], b[:] = solution[:-1].T, solution[-1]
        return weights

    def around(self, linear: np.ndarray, linear_shape: NarxShape, seed: int) -> tuple[np.ndarray, np.ndarray]:
        """First weights of a network around linear ones, reproducible by seed, and what they are drawn to."""
        rng, centre = np.random.default_rng(seed), np.zeros(self.shape.size)
        W, b = weight_arrays(linear, linear_shape)[3:]
        weight_arrays(centre, self.shape)[3][:], weight_arrays(centre, self.shape)[4][:] = W, b
        first = centre.copy()
        W1, b1, W2, _, _ = weight_arrays(first, self.shape)
        for part, spread in ((W1, 1.0 / np.sqrt(self.shape.features)), (b1, 0.3), (W2, 0.03)):
            part[:] = spread * rng.standard_normal(part.shape)
        left_out = np.setdiff1d(np.arange(self.shape.size), self.trained)
        first[left_out] = 0.0
        return first, centre

    def path(
        self, weights: np.ndarray, centre: np.ndarray, pieces, stages: Sequence[Stage], decay: float, meter: Meter,
        seed: int,
    ) -> list[np.ndarray]:  # fmt: skip
        """Weights at the end of every stage."""
        ends = []
        for stage in stages:
            batches = stretches(pieces, stage.horizon, self.shape, self.scales)
            if batches:
                weights = self._levenberg_marquardt(weights, centre, batches, stage, decay, meter, seed)
            ends.append(weights)
        return ends

    def _levenberg_marquardt(self, weights, centre, batches, stage: Stage, decay: float, meter: Meter, seed: int):
        damping, horizon = 1e-3, max(len(b.u) for b in batches)
        for iteration in range(stage.iterations):
            A, g, before = self._equations(weights, centre, batches, decay)
            if not np.isfinite(A).all():
                break
            following, after, damping = self._step(weights, centre, batches, A, g, before, decay, damping)
            if following is None:
                break
            weights = following
            meter.count(seed, horizon, iteration, float(np.sqrt(after)))
            if before - after < SETTLED * before:
                break
        return weights

    def _equations(self, weights, centre, batches: Sequence[Stretches], decay: float):
        sums = [normal_equations(weights, self.shape, self.scales, b, 1, self.trained) for b in batches]
        JJ, Je, ee, count = (sum(part) for part in zip(*sums, strict=True))
        off = (weights - centre)[self.trained]
        A = JJ / count + decay * np.eye(len(off))
        return A, Je / count + decay * off, ee / count + decay * float(off @ off)

    def _step(self, weights, centre, batches, A, g, before, decay: float, damping: float):
        """The first damped step that lowers the cost: (weights, cost after it, damping for the next)."""
        for _ in range(TRIES):
            trial = weights.copy()
            trial[self.trained] -= np.linalg.solve(A + damping * np.diag(np.diag(A) + 1e-300), g)
            after = self._cost(trial, centre, batches, decay)
            if after < before:
                return trial, after, max(damping / RAISE, 1e-9)
            damping *= RAISE
        return None, before, damping

    def _cost(self, weights, centre, batches, decay: float) -> float:
        errors = [free_run(weights, self.shape, self.scales, b).outputs - b.target for b in batches]
        off = (weights - centre)[self.trained]
        count = sum(e.size for e in errors)
        return sum(float(np.square(e).sum()) for e in errors) / count + decay * float(off @ off)
