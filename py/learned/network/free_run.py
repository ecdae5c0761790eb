"""The free run of a network, and the derivatives of every simulated sample by every trained weight; NumPy alone.

The network is run from a measured start over stretches of recording, feeding back its own outputs. The derivatives are
carried along (real-time recurrent learning): between two samples they obey

    S[k+1] = F[k] S[k] + G[k]        S: of the fed-back features, by the trained weights

where F and G depend on the run alone. The run comes first, all F and G at once after it, and what remains for every
sample is one small product. Source: Williams, Zipser, Neural Computation 1 (1989) 270-280.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from ..training_data import smoothed
from ..walking import NARROW, Walk
from .narx import NarxShape

CHUNK = 2e6  # numbers of G that are held at a time


@dataclass(frozen=True)
class Stretches:
    """B stretches, time first: start outputs (B, ny), start increments (B, nd ny), inputs (T, B, nu m), targets."""

    y: np.ndarray
    d: np.ndarray
    u: np.ndarray
    target: np.ndarray


@dataclass(frozen=True)
class Scales:
    """What the free run needs besides weights, normalised.

    Per output: increment per output unit, bounds of increment and output. Per feature: the range seen in training.
    """

    increment: np.ndarray
    limit: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    feature_lower: np.ndarray
    feature_upper: np.ndarray

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray]) -> Scales:
        """From the arrays of a block (`narx.array_shapes`), SI."""
        centre, spread = arrays["output_centre"], arrays["output_scale"]
        lower, upper = ((arrays[f"output_{side}"] - centre) / spread for side in ("lower", "upper"))
        return cls(
            arrays["increment_scale"] / spread, arrays["increment_limit"], lower, upper,
            arrays["feature_lower"], arrays["feature_upper"],
        )  # fmt: skip


@dataclass(frozen=True)
class Run:
    """A free run: states before each sample (T, B, fed back), outputs after it (T, B, ny), hidden units (T, B, hidden).

    moving, inside : where neither the increments nor the outputs were at their bounds (T, B, ny).
    """

    states: np.ndarray
    outputs: np.ndarray
    hidden: np.ndarray
    moving: np.ndarray
    inside: np.ndarray


def weight_arrays(weights: np.ndarray, shape: NarxShape) -> list[np.ndarray]:
    """The flat weight vector as matrices, in the order of `NarxShape.weights`."""
    ends = np.cumsum([int(np.prod(s)) for s in shape.weights.values()])[:-1]
    return [w.reshape(s) for w, s in zip(np.split(weights, ends), shape.weights.values(), strict=True)]


def cut(
    inputs: np.ndarray, outputs: np.ndarray, horizon: int | None, shape: NarxShape, increment: np.ndarray, *, rest,
    quiet: np.ndarray | None = None,
):  # fmt: skip
    """Stretches of one recording, (inputs (n, nu), outputs (n, ny), normalised), as a list of tuples.

    ``rest``: one stretch that starts as a deployed block does, from the first output with nothing moving.
    quiet : the smoothed outputs, from which all others start, where they are known.
    """
    n, ny = outputs.shape
    lines = np.concatenate([inputs[np.maximum(np.arange(n) - i, 0)] for i in range(shape.input_lags)], axis=1)
    if rest:
        return [(outputs[0], np.zeros(ny * shape.output_lags), lines[:-1], outputs[1:])]
    quiet = smoothed(outputs) if quiet is None else quiet
    first = max(shape.output_lags, shape.input_lags - 1)
    span = min(horizon or n, n - 1 - first)
    starts = range(first, n - span, span)
    past = [[(quiet[k - i] - quiet[k - i - 1]) / increment for i in range(shape.output_lags)] for k in starts]
    return [
        (quiet[k], np.ravel(d), lines[k : k + span], outputs[k + 1 : k + 1 + span])
        for k, d in zip(starts, past, strict=True)
    ]


def gather(pieces: Sequence[tuple]) -> list[Stretches]:
    """Pieces of equal length in batches."""
    batches = []
    for length in sorted({len(p[2]) for p in pieces}):
        y, d, u, target = (np.array(part) for part in zip(*(p for p in pieces if len(p[2]) == length), strict=True))
        batches.append(Stretches(y, d, *(np.ascontiguousarray(a.transpose(1, 0, 2)) for a in (u, target))))
    return batches


def free_run(weights: np.ndarray, shape: NarxShape, scales: Scales, s: Stretches) -> Run:
    """Run the network over stretches; what leaves the finite numbers stays so."""
    W1, b1, _, W, b = weight_arrays(weights, shape)
    fb = shape.fed_back
    base = s.u @ W[:, fb:].T + b
    seen_u = np.clip(s.u, scales.feature_lower[fb:], scales.feature_upper[fb:]) if shape.hidden else s.u
    run = _walked if s.u.shape[1] <= NARROW else _stepped
    return run(weights, shape, scales, s, base, seen_u @ W1[:, fb:].T + b1)


def _walked(weights, shape: NarxShape, scales: Scales, s: Stretches, base: np.ndarray, first: np.ndarray) -> Run:
    """Runs one after the other (`walking`); base (T, B, ny), first (T, B, hidden): what the inputs bring."""
    ny, fb = shape.outputs, shape.fed_back
    W1, _, W2, W, _ = weight_arrays(weights, shape)
    ends = scales.increment, scales.limit, scales.lower, scales.upper, scales.feature_lower[:fb]
    parts = (W1[:, :fb].T, W2.T, W[:, :fb].T, *ends, scales.feature_upper[:fb])  # by columns, as CasADi holds them
    known = np.concatenate([base, first], axis=2).swapaxes(0, 1)
    walk, constants = _walk(ny, shape.output_lags, shape.hidden), np.concatenate([np.ravel(p) for p in parts])
    seen = walk(np.hstack([s.y, s.d]), known, constants).swapaxes(0, 1)
    states, free, hidden = np.split(seen, [fb, fb + ny], axis=2)
    d = np.minimum(np.maximum(free, -scales.limit), scales.limit)
    y = states[..., :ny] + scales.increment * d
    outputs = np.minimum(np.maximum(y, scales.lower), scales.upper)
    return Run(states, outputs, hidden, np.abs(free) <= scales.limit, y == outputs)


@cache
def _walk(ny: int, output_lags: int, hidden: int) -> Walk:
    """The step of a network; it shows states, increments before their bounds, and hidden units."""
    fb = ny * (1 + output_lags)
    x, w = ca.SX.sym("x", fb), ca.SX.sym("w", ny + hidden)
    shapes = [(hidden, fb), (ny, hidden), (ny, fb), *[(ny, 1)] * 4, *[(fb, 1)] * 2]
    parts = [ca.SX.sym(f"c{k}", *size) for k, size in enumerate(shapes)]
    W1, W2, W, increment, limit, low, high, lower, upper = parts
    h = ca.tanh(ca.mtimes(W1, ca.fmin(ca.fmax(x, lower), upper)) + w[ny:, :])  # two indices: [0:] of a scalar is (1, 0)
    o = ca.mtimes(W, x) + w[:ny] + ca.mtimes(W2, h)
    d = ca.fmin(ca.fmax(o, -limit), limit)
    y = ca.fmin(ca.fmax(x[:ny] + increment * d, low), high)
    after = ca.vertcat(y, ca.vertcat(d, x[ny:, :])[: fb - ny, :])
    c = ca.vertcat(*map(ca.vec, parts))
    return Walk(ca.Function("step", [x, w, c], [ca.densify(after), ca.densify(ca.vertcat(x, o, h))]))


def _stepped(weights, shape: NarxShape, scales: Scales, s: Stretches, base: np.ndarray, first: np.ndarray) -> Run:
    """Runs side by side, in NumPy; base and first as in `_walked`."""
    W1, _, W2, W, _ = weight_arrays(weights, shape)
    ny, fb, (T, B) = shape.outputs, shape.fed_back, s.u.shape[:2]
    lower, upper = scales.feature_lower[:fb], scales.feature_upper[:fb]
    W1x, Wx, W2t = (np.ascontiguousarray(m.T) for m in (W1[:, :fb], W[:, :fb], W2))
    states, outputs, free, free_y = (np.empty((T, B, size)) for size in (fb, ny, ny, ny))
    hidden, x = np.empty((T, B, shape.hidden)), np.concatenate([s.y, s.d], axis=1)
    for k in range(T):
        states[k] = x
        o = x @ Wx
        o += base[k]
        if shape.hidden:
            h = np.minimum(np.maximum(x, lower), upper) @ W1x
            h += first[k]
            np.tanh(h, out=hidden[k])
            o += hidden[k] @ W2t
        free[k] = o
        o = np.minimum(np.maximum(o, -scales.limit), scales.limit)
        y = x[:, :ny] + scales.increment * o
        free_y[k] = y
        outputs[k] = np.minimum(np.maximum(y, scales.lower), scales.upper)
        following = np.empty_like(x)
        following[:, :ny] = outputs[k]
        if shape.output_lags:
            following[:, ny : 2 * ny] = o
            following[:, 2 * ny :] = x[:, ny : fb - ny]
        x = following
    return Run(states, outputs, hidden, np.abs(free) <= scales.limit, free_y == outputs)


def next_step(weights: np.ndarray, shape: NarxShape, scales: Scales, features: np.ndarray):
    """Outputs one period later (n, ny) and increments over the outputs' scale (n, ny) at ``features`` z (n, nf)."""
    W1, b1, W2, W, b = weight_arrays(weights, shape)
    seen = np.clip(features, scales.feature_lower, scales.feature_upper)
    o = np.clip(np.tanh(seen @ W1.T + b1) @ W2.T + features @ W.T + b, -scales.limit, scales.limit)
    y = features[:, : shape.outputs] + scales.increment * o
    return np.clip(y, scales.lower, scales.upper), scales.increment * o


def derivatives(
    weights: np.ndarray, shape: NarxShape, scales: Scales, s: Stretches, run: Run, trained: np.ndarray
) -> Iterator[tuple[slice, np.ndarray]]:
    """Samples, and d(outputs)/d(trained weights) (t, B, ny, P) at them, in chunks of time.

    trained : positions (P,) of the trained weights in the flat vector.
    """
    ny, fb, (T, B) = shape.outputs, shape.fed_back, s.u.shape[:2]
    S, span = np.zeros((B, fb, len(trained))), max(1, int(CHUNK / (B * ny * shape.size)))
    rows = 2 * ny if shape.output_lags else ny
    for first in range(0, T, span):
        part = slice(first, min(first + span, T))
        F, G = _recursion(weights, shape, scales, s, run, part, trained)
        J = np.empty((len(F), B, ny, len(trained)))
        for k in range(len(F)):
            following = np.empty_like(S)
            np.matmul(F[k], S, out=following[:, :rows])
            following[:, :rows] += G[k]
            following[:, rows:] = S[:, ny : fb - ny]
            S = following
            J[k] = S[:, :ny]
        yield part, J


def _recursion(weights, shape: NarxShape, scales: Scales, s: Stretches, run: Run, part: slice, trained: np.ndarray):
    """F (t, B, rows, fed back) and G (t, B, rows, P); rows are the outputs and, where they are fed back, increments."""
    W1, _, W2, W, _ = weight_arrays(weights, shape)
    ny, fb = shape.outputs, shape.fed_back
    z = np.concatenate([run.states[part], s.u[part]], axis=2)
    seen, h = np.clip(z, scales.feature_lower, scales.feature_upper), run.hidden[part]
    slope = W2 * (1.0 - h * h)[:, :, None, :]
    D = (
        (slope @ W1[:, :fb]) * (seen == z)[:, :, None, :fb] + W[:, :fb]
        if shape.hidden
        else np.broadcast_to(W[:, :fb], (*z.shape[:2], ny, fb))
    )
    moving, inside = run.moving[part][..., None], run.inside[part][..., None]
    direct = _direct(slope, seen, h, z, ny)
    direct = direct if len(trained) == direct.shape[-1] else direct[..., trained]
    So, direct = (D, direct) if moving.all() else (D * moving, direct * moving)
    own = np.zeros((ny, fb))
    own[:, :ny] = np.eye(ny)
    gain = scales.increment[:, None]
    F, G = own + gain * So, gain * direct
    F, G = (F, G) if inside.all() else (F * inside, G * inside)
    if not shape.output_lags:
        return F, G
    return np.concatenate([F, So], axis=2), np.concatenate([G, direct], axis=2)


def _direct(slope: np.ndarray, seen: np.ndarray, h: np.ndarray, z: np.ndarray, ny: int) -> np.ndarray:
    """d(increments)/d(weights) (t, B, ny, all weights) at fixed features."""
    t, B = z.shape[:2]
    answer = np.zeros((t, B, ny, slope.shape[-1] * (seen.shape[-1] + 1) + ny * (h.shape[-1] + z.shape[-1] + 1)))
    inner = slope.shape[-1] * seen.shape[-1]
    answer[..., :inner] = (slope[..., None] * seen[:, :, None, None, :]).reshape(t, B, ny, inner)
    at = inner + slope.shape[-1]
    answer[..., inner:at] = slope
    for values in (h, z, np.ones((t, B, 1))):
        for j in range(ny):
            answer[:, :, j, at : at + values.shape[-1]] = values
            at += values.shape[-1]
    return answer


def normal_equations(weights, shape: NarxShape, scales: Scales, s: Stretches, every: int, trained: np.ndarray):
    """Sums over every ``every``-th sample: ``J'J`` (P, P), ``J'e`` (P,), ``e'e``, number of residuals."""
    run = free_run(weights, shape, scales, s)
    P = len(trained)
    JJ, Je, ee, count = np.zeros((P, P)), np.zeros(P), 0.0, 0
    with np.errstate(over="ignore", invalid="ignore"):  # who trains looks whether they are finite
        for part, J in derivatives(weights, shape, scales, s, run, trained):
            kept = slice((every - 1 - part.start) % every, None, every)
            rows = J[kept].reshape(-1, P)
            e = (run.outputs[part] - s.target[part])[kept].reshape(-1)
            JJ, Je, ee, count = JJ + rows.T @ rows, Je + rows.T @ e, ee + float(e @ e), count + len(e)
    return JJ, Je, ee, count
