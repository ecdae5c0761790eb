"""The band of a Gaussian process with output feedback: the few directions of its weights that a free run shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .feedback_run import Stretch, free_run, stretches
from .feedback_training import LONGEST, Trained
from .integrated_band import leading

DIRECTIONS = 20  # of the weights, at most
LEAST_FACTOR = 1e-12  # of the largest variance of a weight, on the diagonal before the square root


def directions(trained: Trained, runs: Sequence[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, float]:
    """Directions (ny, M, R) for the arrays of the block, and the share of the variance of free runs that they hold.

    They are those of the weights' posterior that free runs over ``runs`` (SI) show most, see `leading`.
    """
    P, sizes = sum(trained.model.sizes), trained.model.sizes
    JJ = np.zeros((P, P))
    for s in run_starts(trained, runs):
        _, J = free_run(trained.model, trained.weights, s, derivatives=True)
        J = J[np.isfinite(J).all(axis=(1, 2, 3))].reshape(-1, P)
        JJ += J.T @ J
    values, vectors = np.linalg.eigh(trained.covariance)
    C = vectors * np.sqrt(np.maximum(values, LEAST_FACTOR * values[-1]))
    D, share = leading(C, JJ, DIRECTIONS)
    parts = zip(trained.model.bases, np.split(D, np.cumsum(sizes)[:-1]), strict=True)
    return np.stack([b.inverse.T @ d for b, d in parts]), share


def run_starts(trained: Trained, runs: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[Stretch]:
    """Whole recordings as free runs, those that are too long in parts."""
    longest = max(len(u) for u, _ in runs)
    horizon = None if longest <= LONGEST else LONGEST
    return stretches(trained.data.normal(runs), trained.form.lags, trained.data.step, horizon)


def unexplained(trained: Trained) -> np.ndarray:
    """The most of the prior variance that the points leave unexplained at the training rows, by output (ny,)."""
    parts = stretches(trained.data.normal(trained.data.runs), trained.form.lags, trained.data.step, 1)
    most = []
    for basis in trained.model.bases:
        worst = 0.0
        for s in parts:
            z = np.hstack([[s.y, s.d], [s.d]][1 - trained.form.lags.level] + [s.lines[0]])
            left = basis.hyper.diagonal(z) - np.sum(basis.values(z) ** 2, axis=0)
            worst = max(worst, float(left.max(initial=0.0)))
        most.append(worst)
    return np.array(most)


def first_increments(runs: Sequence[tuple[np.ndarray, np.ndarray]], scale: np.ndarray) -> np.ndarray:
    """RMS of the first increments of recordings over their scale, (ny,): what a start at rest does not know."""
    first = np.array([y[1] - y[0] for _, y in runs if len(y) > 1])
    return np.sqrt(np.mean((first / scale) ** 2, axis=0))
