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
from functools import cache

import casadi as ca
import numpy as np

from ..walking import Walk
from .kernels import Hyper, Kernel, half_squares, stationary

LARGEST = 1e3  # normalised: a run beyond it has diverged
TRIES = 8  # dampings of one iteration
NARROW = 12  # runs side by side: beyond these, one step of NumPy over all of them is quicker than theirs in CasADi
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
    """Outputs (T, B, ny) of runs from the starts of ``s``; with derivatives, also (T, B, ny, P) by all weights.

    NaN from where a run has diverged.
    """
    ny, (low, high) = model.lags.outputs, model.output_bounds
    with np.errstate(invalid="ignore", over="ignore"):
        x, o = (_walked if len(s.y) <= NARROW else _stepped)(model, weights, s)
        free = x[..., :ny] + model.step * np.clip(o, -model.limit, model.limit)
        found = np.clip(free, low, high)
        lost = ~(np.isfinite(found) & (np.abs(found) <= LARGEST)).all(axis=(1, 2))
    end = int(np.argmax(lost)) if lost.any() else len(found)
    found[end:] = np.nan
    if not derivatives:
        return found
    J = np.full((*found.shape, sum(model.sizes)), np.nan)
    rows, stays = np.abs(o[:end]) <= model.limit, found[:end] == free[:end]
    J[:end] = _carried(model, s, *_derivatives(model, weights, s, x[:end]), rows, stays)
    return found, J


def _features(model: Model, x: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """What a step sees, of states (..., ny (1 + increments)) and inputs (..., m)."""
    return np.concatenate([x[..., 0 if model.lags.level else model.lags.outputs :], lines], axis=-1)


def _stepped(model: Model, weights: Sequence[np.ndarray], s: Stretch) -> tuple[np.ndarray, np.ndarray]:
    """States (T, B, ny (1 + increments)) of runs side by side, and increments (T, B, ny) before their limits."""
    ny, now = model.lags.outputs, np.hstack([s.y, s.d])
    x, o = np.full((len(s.lines), *now.shape), np.nan), np.full((*s.lines.shape[:2], ny), np.nan)
    for k in range(len(s.lines)):
        x[k] = now
        seen = np.clip(_features(model, now, s.lines[k]), *model.feature_bounds)
        for j, (basis, v) in enumerate(zip(model.bases, weights, strict=True)):
            o[k, :, j] = v @ basis.values(seen)
        d = np.clip(o[k], -model.limit, model.limit)
        y = np.clip(now[:, :ny] + model.step * d, *model.output_bounds)
        if not np.isfinite(y).all():
            break
        now = np.hstack([y, d, now[:, ny:]])[:, : now.shape[1]]
    return x, o


def _walked(model: Model, weights: Sequence[np.ndarray], s: Stretch) -> tuple[np.ndarray, np.ndarray]:
    """As `_stepped`, one run after the other (`walking`); what the inputs bring to the kernels comes first."""
    lags, (lower, upper) = model.lags, model.feature_bounds
    fb, given = lags.fed_back, np.clip(s.lines, lower[lags.fed_back :], upper[lags.fed_back :])
    known, parts = [], [model.step, model.limit, *model.output_bounds, lower[:fb], upper[:fb]]
    for basis, v in zip(model.bases, weights, strict=True):
        parts += [basis.inverse.T @ v, basis.hyper.variances]
        for (_, base), length in zip(basis.hyper.kernel.factors, basis.hyper.lengths, strict=True):
            own, at = basis.points / length, (given / length[fb:]).reshape(-1, given.shape[2])
            brought = at @ own[:, fb:].T if base == "linear" else half_squares(at, own[:, fb:])
            known.append(brought.reshape(*given.shape[:2], -1))
            parts += [own[:, :fb].T, length[:fb]]
    walk = _walk(lags, model.bases[0].hyper.kernel, len(model.bases[0].points))
    constants = np.concatenate([np.ravel(part) for part in parts])
    seen = walk(np.hstack([s.y, s.d]), np.concatenate(known, axis=2).swapaxes(0, 1), constants).swapaxes(0, 1)
    return seen[..., : -lags.outputs], seen[..., -lags.outputs :]


@cache
def _walk(lags: Lags, kernel: Kernel, points: int) -> Walk:
    """The step of a process; it shows states, and increments before their limits. Constants as in `_walked`."""
    ny, fb, terms = lags.outputs, lags.fed_back, len(kernel.terms)
    x, w, parts = ca.SX.sym("x", ny * (1 + lags.increments)), ca.SX.sym("w", ny * len(kernel.factors) * points), []

    def constant(*size: int) -> ca.SX:
        parts.append(ca.SX.sym(f"c{len(parts)}", *size))
        return parts[-1]

    step, limit, low, high, lower, upper = (constant(n, 1) for n in (*[ny] * 4, fb, fb))
    fed = ca.fmin(ca.fmax(x[0 if lags.level else ny :, :], lower), upper)
    brought, o = iter(ca.vertsplit(w, points)), []
    for _ in range(ny):
        weights, variances = constant(points, 1), constant(terms, 1)
        products = ca.vertsplit(variances)
        for t, base in kernel.factors:
            own, at, known = constant(points, fb), fed / constant(fb, 1), next(brought)
            apart = own - ca.repmat(at.T, points, 1)
            linear = base == "linear"
            value = known + ca.mtimes(own, at) if linear else stationary(base, known + 0.5 * ca.sum2(apart**2))
            products[t] = products[t] * value
        o.append(ca.dot(weights, sum(products)))
    d = ca.fmin(ca.fmax(ca.vertcat(*o), -limit), limit)
    y = ca.fmin(ca.fmax(x[:ny, :] + step * d, low), high)
    after = ca.vertcat(y, ca.vertcat(d, x[ny:, :])[: ny * lags.increments, :])
    given = [x, w, ca.vertcat(*map(ca.vec, parts))]
    return Walk(ca.Function("step", given, [ca.densify(after), ca.densify(ca.vertcat(x, *o))]))


def _derivatives(model: Model, weights: Sequence[np.ndarray], s: Stretch, x: np.ndarray):
    """Of the increments at states x (T, B, ...), by what is fed back (T, B, ny, fed back), by weights (T, B, ny, P)."""
    fb, ny = model.lags.fed_back, model.lags.outputs
    z = _features(model, x, s.lines[: len(x)])
    seen = np.clip(z, *model.feature_bounds)
    rows, at = seen.reshape(-1, z.shape[2]), 0
    slopes, direct = np.empty((len(rows), ny, fb)), np.zeros((len(rows), ny, sum(model.sizes)))
    for j, (basis, v) in enumerate(zip(model.bases, weights, strict=True)):
        slopes[:, j] = basis.slopes(rows, v, fb)
        direct[:, j, at : at + len(v)] = basis.values(rows).T
        at += len(v)
    slopes = slopes.reshape(*z.shape[:2], ny, fb) * (z == seen)[:, :, None, :fb]
    return slopes, direct.reshape(*z.shape[:2], ny, -1)


def _carried(model: Model, s: Stretch, slopes, direct, inside, stays) -> np.ndarray:
    """Derivatives of the outputs (T, B, ny, P), carried along the runs; nothing passes where a bound has stopped it."""
    ny, fed = model.lags.outputs, 0 if model.lags.level else model.lags.outputs
    S = np.zeros((len(s.y), ny * (1 + model.lags.increments), direct.shape[-1]))
    slopes, direct, step = slopes * inside[..., None], direct * inside[..., None], model.step[:, None]
    J = np.empty(direct.shape)
    for k in range(len(J)):
        So = slopes[k] @ S[:, fed:]
        So += direct[k]
        J[k] = (S[:, :ny] + step * So) * stays[k][..., None]
        S = np.concatenate([J[k], So, S[:, ny:]], axis=1)[:, : S.shape[1]]
    return J


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
