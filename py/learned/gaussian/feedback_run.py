"""The free run of a Gaussian process that feeds its outputs back, in numpy, and its weights fitted to that run.

The process is a sum of M functions with whitened weights v ~ N(0, 1), see `sparse`. One step fits them to the next
sample; here they are fitted to whole runs, which noise of the fed-back samples does not bias:

    minimise  sum |y_run(v) - y|^2 / noise + |v|^2

by Gauss-Newton with derivatives carried along the run (real-time recurrent learning). The posterior of v is Gaussian
about the minimum (Laplace): covariance (J'J / noise + 1)^-1. Sources: Williams, Zipser, Neural Computation 1 (1989);
MacKay, Neural Computation 4 (1992) 415-447 (noise from what is left and the number of well-determined weights).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from .kernels import Hyper

LARGEST = 1e3  # normalised: a run beyond it has diverged
TRIES = 8  # dampings of one iteration
SETTLED = 1e-3  # of the cost: an iteration that gains less is the last


@dataclass(frozen=True)
class Lags:
    """What a step sees: the outputs themselves (level), past increments of them, samples of the inputs."""

    inputs: int
    outputs: int
    level: int
    increments: int
    samples: int

    @property
    def fed_back(self) -> int:
        """Features that come from the block's own outputs."""
        return self.outputs * (self.level + self.increments)

    @property
    def features(self) -> int:
        return self.fed_back + self.inputs * self.samples

    def structure(self) -> dict[str, int]:
        """The counts for the block file's header."""
        return {"level": self.level, "increments": self.increments, "samples": self.samples}


@dataclass(frozen=True, eq=False)
class Basis:
    """One output's functions: whitened, L^-1 k(Z, z)."""

    hyper: Hyper
    points: np.ndarray
    factor: np.ndarray
    inverse: np.ndarray

    def values(self, z: np.ndarray) -> np.ndarray:
        """(M, n) at z (n, d)."""
        return self.inverse @ self.hyper.values(self.points, z)

    def slopes(self, z: np.ndarray, v: np.ndarray, columns: int) -> np.ndarray:
        """Derivative of v'values by the first features, (n, columns)."""
        return self.hyper.slopes(self.points, z, self.inverse.T @ v, columns)


@dataclass(frozen=True, eq=False)
class Model:
    """Everything of a run but the weights; normalised.

    bases: one per output. step (ny,): an increment's scale over the output's. limit: of increments (ny,). lower, upper:
    of outputs (ny,) and of features (d,).
    """

    lags: Lags
    bases: tuple[Basis, ...]
    step: np.ndarray
    limit: np.ndarray
    output_bounds: tuple[np.ndarray, np.ndarray]
    feature_bounds: tuple[np.ndarray, np.ndarray]

    @property
    def sizes(self) -> list[int]:
        """Weights of each output."""
        return [len(b.points) for b in self.bases]


@dataclass(frozen=True, eq=False)
class Stretch:
    """B runs side by side: first outputs (B, ny), increments (B, n ny), input lines (T, B, m), targets (T, B, ny)."""

    y: np.ndarray
    d: np.ndarray
    lines: np.ndarray
    target: np.ndarray


def stretches(runs: Sequence[tuple[np.ndarray, np.ndarray]], lags: Lags, step: np.ndarray, horizon: int | None):
    """Recordings (inputs (n, nu), outputs (n, ny)) cut into runs of ``horizon`` samples, those of one length together.

    None: whole recordings, started as the deployed block starts: from the first sample, at rest.
    """
    pieces: dict[int, list] = {}
    for u, y in runs:
        lines = np.hstack([u[np.maximum(np.arange(len(u)) - i, 0)] for i in range(lags.samples)])
        moved = np.diff(y, axis=0, prepend=y[:1]) / step
        ago = [np.maximum(np.arange(len(y)) - i, 0) for i in range(lags.increments)]
        past = np.hstack([moved[k] for k in ago] or [moved[:, :0]])
        first = max(lags.increments, lags.samples - 1) if horizon else 0
        span = min(horizon or len(y), len(y) - 1 - first)
        starts = range(first, len(y) - span, span) if horizon else [0]
        for k in starts:
            d = past[k] if horizon else 0 * past[k]
            pieces.setdefault(span, []).append((y[k], d, lines[k : k + span], y[k + 1 : k + 1 + span]))
    joined = []
    for parts in pieces.values():
        y, d, lines, target = (np.array(part) for part in zip(*parts, strict=True))
        joined.append(Stretch(y, d, lines.transpose(1, 0, 2), target.transpose(1, 0, 2)))
    return joined


def free_run(model: Model, weights: Sequence[np.ndarray], s: Stretch, derivatives: bool = False):
    """Outputs (T, B, ny) of runs from the starts of ``s``; with derivatives, also (T, B, ny, P) by all weights."""
    lags, ny = model.lags, model.lags.outputs
    y, d, T, B = s.y, s.d, len(s.lines), len(s.y)
    found, P = np.full((T, B, ny), np.nan), sum(model.sizes)
    S = np.zeros((B, ny + d.shape[1], P)) if derivatives else None
    J = np.empty((T, B, ny, P)) if derivatives else None
    for k in range(T):
        z = np.hstack([*[y, d][1 - lags.level :], s.lines[k]])
        seen = np.clip(z, *model.feature_bounds)
        o = np.empty((B, ny))
        if derivatives:
            So, at = np.zeros((B, ny, P)), 0
            past = S[:, (0 if lags.level else ny) :]
        for j, (basis, v) in enumerate(zip(model.bases, weights, strict=True)):
            A = basis.values(seen)
            o[:, j] = v @ A
            if derivatives:
                slope = basis.slopes(seen, v, lags.fed_back) * (z == seen)[:, : lags.fed_back]
                So[:, j] = (slope[:, None] @ past)[:, 0]
                So[:, j, at : at + len(v)] += A.T
                at += len(v)
        inside = np.abs(o) <= model.limit
        o = np.clip(o, -model.limit, model.limit)
        free = y + model.step * o
        y = np.clip(free, *model.output_bounds)
        d = np.hstack([o, d])[:, : d.shape[1]]
        if derivatives:
            So *= inside[:, :, None]
            Sy = (S[:, :ny] + model.step[:, None] * So) * (y == free)[:, :, None]
            S = np.concatenate([Sy, np.concatenate([So, S[:, ny:]], axis=1)[:, : d.shape[1]]], axis=1)
            J[k] = Sy
        if not np.isfinite(y).all() or np.abs(y).max() > LARGEST:
            break
        found[k] = y
    return (found, J) if derivatives else found


@dataclass(frozen=True, eq=False)
class Fitted:
    """Weights by output, their covariance (P, P), noise variance (ny,), cost per sample, iterations."""

    weights: list[np.ndarray]
    covariance: np.ndarray
    noise: np.ndarray
    error: float
    iterations: int


def refined(
    model: Model,
    weights: Sequence[np.ndarray],
    parts: Sequence[Stretch],
    iterations: int,
    *,
    least_noise: np.ndarray,
    progress: Callable[[int, float], None] | None = None,
) -> Fitted:
    """Fit the weights to the runs, from ``weights``; the noise is re-estimated after every iteration."""
    v = np.concatenate(weights)
    ends = np.cumsum(model.sizes)[:-1]
    squares, alike = _squares(model, np.split(v, ends), parts)
    count = sum(p.target.shape[0] * p.target.shape[1] for p in parts)
    noise = np.maximum(squares / count, least_noise) * alike
    damping, done, H = 1e-3, 0, np.eye(len(v))
    for _ in range(iterations):
        H, g = _normal(model, np.split(v, ends), parts, noise)
        if not np.isfinite(H).all():
            break
        before = _cost(squares, noise, v)
        for _ in range(TRIES):
            step = -np.linalg.solve(H + np.eye(len(v)) + damping * np.diag(np.diag(H) + 1.0), g + v)
            after, alike = _squares(model, np.split(v + step, ends), parts)
            cost = _cost(after, noise, v + step)
            if cost < before:
                break
            damping *= 6
        else:
            break
        v, squares, damping, done = v + step, after, max(damping / 6, 1e-9), done + 1
        told = np.trace(np.linalg.solve(H + np.eye(len(v)), H))
        noise = np.maximum(squares / max(count - told / len(noise), count / 10), least_noise) * alike
        if progress:
            progress(done, float(np.sqrt(squares.sum() / count)))
        if before - cost < SETTLED * abs(before):
            break
    H, _ = _normal(model, np.split(v, ends), parts, noise)
    covariance = np.linalg.inv(H + np.eye(len(v)))
    return Fitted(np.split(v, ends), covariance, noise, float(np.sqrt(squares.sum() / count)), done)


def _cost(squares, noise, v) -> float:
    return float(np.sum(squares / noise) + v @ v) if np.isfinite(squares).all() else np.inf


def _squares(model, weights, parts) -> tuple[np.ndarray, np.ndarray]:
    """Sum of squared misses by output, (ny,), and how many samples in a row tell as much as one, (ny,)."""
    misses = [free_run(model, weights, p) - p.target for p in parts]
    squares = sum((e**2).sum(axis=(0, 1)) for e in misses)
    return squares, alike_in_a_row(misses, squares)


def alike_in_a_row(misses: Sequence[np.ndarray], squares: np.ndarray) -> np.ndarray:
    """1 + 2 sum of the autocorrelations of misses (T, B, ny) up to the first that is not positive, (ny,)."""
    total, open_ = np.ones(len(squares)), np.ones(len(squares), dtype=bool)
    longest = max(len(e) for e in misses)
    with np.errstate(all="ignore"):
        for lag in range(1, longest):
            shared = sum((e[lag:] * e[:-lag]).sum(axis=(0, 1)) for e in misses if len(e) > lag) / squares
            open_ &= shared > 0
            total = total + np.where(open_, 2 * shared, 0)
            if not open_.any():
                break
    return np.where(np.isfinite(total), total, 1.0)


def _normal(model, weights, parts, noise):
    """J'J / noise and J'e / noise over all runs."""
    P, ny = sum(model.sizes), model.lags.outputs
    H, g = np.zeros((P, P)), np.zeros(P)
    for part in parts:
        found, J = free_run(model, weights, part, derivatives=True)
        e = found - part.target
        for j in range(ny):
            Jj = J[:, :, j].reshape(-1, P)
            H += Jj.T @ Jj / noise[j]
            g += Jj.T @ e[:, :, j].ravel() / noise[j]
    return H, g
