"""The free run of a network with hidden states and its derivatives with respect to every weight, in NumPy.

A run goes forward once, sample by sample. The derivatives of one step with respect to states and weights are then found
for all samples at once, and only their linear recursion

    S[k+1] = A[k] S[k] + D[k]        S: states by weights; S[0] from the encoder

goes sample by sample again. NumPy costs a quarter of PyTorch here: the arrays of a step are tiny, and the time goes
into calls. Normal equations of a least-squares step are what comes out.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import casadi as ca
import numpy as np

from ..walking import NARROW, Walk
from .equations import StateShape

AT_ONCE = 4_000_000  # numbers of derivatives of one step that are held at a time


@dataclass(frozen=True, eq=False)
class Sections:
    """B sections, time first: features of the encoder (B, ne), first outputs (B, ny), inputs (T, B, nu).

    targets (T, B, ny) are the outputs at the samples 1 ... T; weights (T, B) tell what counts (0: padding).
    """

    encoder: np.ndarray
    first: np.ndarray
    inputs: np.ndarray
    targets: np.ndarray
    weights: np.ndarray

    @property
    def samples(self) -> int:
        """Steps that are simulated, padding included."""
        return self.weights.size


@dataclass(frozen=True, eq=False)
class Network:
    """A shape, rates and bounds of its states (nx,), normalised, and a flat vector of weights."""

    shape: StateShape
    rate: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    flat: np.ndarray

    @property
    def parts(self) -> dict[str, np.ndarray]:
        """The weights as matrices, views of the flat vector."""
        return split_weights(self.flat, self.shape)


def split_weights(flat: np.ndarray, shape: StateShape) -> dict[str, np.ndarray]:
    """The flat vector as matrices by name."""
    parts, at = {}, 0
    for name, size in shape.weights.items():
        count = int(np.prod(size))
        parts[name] = flat[at : at + count].reshape(size)
        at += count
    return parts


def joined_weights(parts: Mapping[str, np.ndarray], shape: StateShape) -> np.ndarray:
    """The matrices as one flat vector; those that are missing are zero."""
    return np.concatenate([np.ravel(parts.get(name, np.zeros(size))) for name, size in shape.weights.items()])


def encode(net: Network, s: Sections) -> np.ndarray:
    """First states (B, nx) of the sections."""
    w = net.parts
    hidden = s.encoder @ w["encoder_linear_weights"].T + w["encoder_bias"]
    if net.shape.encoder_hidden:
        h = np.tanh(s.encoder @ w["encoder_hidden_weights"].T + w["encoder_hidden_bias"])
        hidden = hidden + h @ w["encoder_output_weights"].T
    ny = net.shape.outputs
    return np.hstack([s.first, np.clip(hidden, net.lower[ny:], net.upper[ny:])])


def free_run(net: Network, s: Sections, start: np.ndarray | None = None) -> np.ndarray:
    """States and inputs z (T + 1, B, nx + nu) of a free run, the last inputs 0; ``start`` replaces the encoder's."""
    w, nx = net.parts, net.shape.order
    steps, count, nu = s.inputs.shape
    z = np.zeros((steps + 1, count, nx + nu))
    z[0, :, :nx], z[:-1, :, nx:] = encode(net, s) if start is None else start, s.inputs
    if count <= NARROW:
        z[1:, :, :nx] = _walked(net, z[0, :, :nx], s.inputs)
        return z
    linear, bias = w["linear_weights"].T * net.rate, w["output_bias"] * net.rate
    into, at, out = w["hidden_weights"].T.copy(), w["hidden_bias"], w["output_weights"].T * net.rate
    linear[:nx] += np.eye(nx)
    for k in range(steps):
        now = z[k]
        following = now @ linear + bias
        if net.shape.hidden:
            following += np.tanh(now @ into + at) @ out
        np.minimum(np.maximum(following, net.lower, out=following), net.upper, out=z[k + 1, :, :nx])
    return z


def _walked(net: Network, start: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """States (T, B, nx) after every step, of runs one after the other (`walking`)."""
    w, nx, hidden = net.parts, net.shape.order, net.shape.hidden
    known = inputs @ np.vstack([w["linear_weights"][:, nx:], w["hidden_weights"][:, nx:]]).T
    known += np.concatenate([w["output_bias"], w["hidden_bias"]])
    parts = w["linear_weights"][:, :nx].T, w["hidden_weights"][:, :nx].T, w["output_weights"].T  # by columns
    constants = np.concatenate([*map(np.ravel, parts), net.rate, net.lower, net.upper])
    return _walk(nx, hidden)(start, known.swapaxes(0, 1), constants).swapaxes(0, 1)


@cache
def _walk(nx: int, hidden: int) -> Walk:
    """The step of a network; it shows the states after it."""
    x, known = ca.SX.sym("x", nx), ca.SX.sym("known", nx + hidden)
    shapes = [(nx, nx), (hidden, nx), (nx, hidden), *[(nx, 1)] * 3]
    parts = [ca.SX.sym(f"c{k}", *size) for k, size in enumerate(shapes)]
    linear, into, out, rate, lower, upper = parts
    moved = known[:nx] + ca.mtimes(linear, x) + ca.mtimes(out, ca.tanh(ca.mtimes(into, x) + known[nx:, :]))
    after = ca.densify(ca.fmin(ca.fmax(x + rate * moved, lower), upper))
    return Walk(ca.Function("step", [x, known, ca.vertcat(*map(ca.vec, parts))], [after, after]))


def errors(net: Network, s: Sections) -> np.ndarray:
    """Weighted errors of the outputs (T, B, ny)."""
    return (free_run(net, s)[1:, :, : net.shape.outputs] - s.targets) * s.weights[..., None]


def normal_equations(net: Network, s: Sections) -> tuple[np.ndarray, np.ndarray, float]:
    """``J'J`` (P, P), ``J'e`` (P,) and ``e'e`` of the weighted errors of a free run."""
    shape, z = net.shape, free_run(net, s)
    JJ, Je, ee = np.zeros((shape.size, shape.size)), np.zeros(shape.size), 0.0
    count, ny, nx, steps = z.shape[1], shape.outputs, shape.order, len(s.inputs)
    S = _encoder_derivatives(net, s)
    chunk = max(1, AT_ONCE // (count * shape.order * shape.size))
    for first in range(0, steps, chunk):
        part = slice(first, min(first + chunk, steps))
        A, D = _step_derivatives(net, z[part])
        following = z[first + 1 : part.stop + 1, :, :nx]
        inside = (net.lower < following) & (following < net.upper)
        A, D = (d * inside[..., None] for d in (A, D)) if not inside.all() else (A, D)
        J = np.empty((len(A), count, ny, shape.size))
        for k in range(len(A)):  # of an unstable network they grow beyond all numbers, which who asks finds in JJ
            S = np.matmul(A[k], S)
            S[..., : D.shape[-1]] += D[k]
            J[k] = S[:, :ny]
        weight = s.weights[part, :, None]
        J *= weight[..., None]
        e = ((following[..., :ny] - s.targets[part]) * weight).ravel()
        J = J.reshape(-1, shape.size)
        with np.errstate(all="ignore"):
            JJ, Je, ee = JJ + J.T @ J, Je + J.T @ e, ee + float(e @ e)
    return JJ, Je, ee


def _encoder_derivatives(net: Network, s: Sections) -> np.ndarray:
    """d x[0] / d weights (B, nx, P)."""
    shape, w = net.shape, net.parts
    states, ny, count = shape.hidden_states, shape.outputs, len(s.first)
    S = np.zeros((count, shape.order, shape.size))
    rows, e = np.eye(states), s.encoder
    h = np.tanh(e @ w["encoder_hidden_weights"].T + w["encoder_hidden_bias"])
    slope = w["encoder_output_weights"] * (1 - h * h)[:, None, :]  # (B, nh, units)
    direct = [
        (rows[None, :, :, None] * e[:, None, None, :]).reshape(count, states, -1),
        np.broadcast_to(rows, (count, states, states)),
        (slope[..., None] * e[:, None, None, :]).reshape(count, states, -1),
        slope,
        (rows[None, :, :, None] * h[:, None, None, :]).reshape(count, states, -1),
    ]
    first = encode(net, s)[:, ny:]
    inside = (net.lower[ny:] < first) & (first < net.upper[ny:])
    S[:, ny:, shape.size - sum(d.shape[-1] for d in direct) :] = np.concatenate(direct, axis=2) * inside[..., None]
    return S


def _step_derivatives(net: Network, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """d x[k+1] / d x[k] (T, B, nx, nx) and d x[k+1] / d weights of the step (T, B, nx, Ps)."""
    shape, w, nx = net.shape, net.parts, net.shape.order
    h = np.tanh(z @ w["hidden_weights"].T + w["hidden_bias"])
    out = w["output_weights"] * net.rate[:, None]
    slope = out * (1 - h * h)[..., None, :]  # (T, B, nx, units)
    A = np.eye(nx) + net.rate[:, None] * w["linear_weights"][:, :nx] + slope @ w["hidden_weights"][:, :nx]
    rows, lead = np.diag(net.rate), z.shape[:2]
    D = np.empty((*lead, nx, sum(int(np.prod(size)) for size in shape.step_weights.values())))
    direct = (
        rows[:, :, None] * z[..., None, None, :],
        np.broadcast_to(rows, (*lead, nx, nx)),
        slope[..., None] * z[..., None, None, :],
        slope,
        rows[:, :, None] * h[..., None, None, :],
    )
    at = 0
    for part in direct:
        part = part.reshape(*lead, nx, -1)
        D[..., at : at + part.shape[-1]] = part
        at += part.shape[-1]
    return A, D
