"""Shooting: recordings cut into segments, each run from its own start states, and what the runs leave unexplained.

    r = w (y(t; p, x0) - y_measured),   x0 = x0(p, z)

z are the start states a segment is free to choose. A first sample is a measurement like any other: a start state that
an output measures is free, and the first residual is its prior, so noise in it does not bias the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel

from .loss import Loss
from .problem import FreeParameters, Recording

WEAK_PRIOR = 0.1  # per state nominal: an unmeasured start state may move by ten nominals for one sigma
DIVERGED = 100.0  # a segment this many times worse than predicting the mean has diverged


@dataclass(frozen=True)
class Segment:
    """Samples [begin, last) of one recording; residuals count from ``first`` on.

    Between begin and first a delayed input fills its delay line with what was really recorded.
    """

    recording: int
    begin: int
    first: int
    last: int


class StartStates:
    """x0(u0, p, z) of a segment with its derivatives; ``names`` are the states that z gives, the model finds the rest.

    ``held`` are given but not free: they keep their value.
    """

    def __init__(self, flat: FlatModel, names: Sequence[str], free_index: np.ndarray, held: bool = False):
        order = [s.name for s in flat.states]
        self.names = tuple(n for n in order if n in names)
        self.columns = np.array([order.index(n) for n in self.names], dtype=int)
        self.nominal = np.array([flat.states[i].nominal for i in self.columns])
        self.bounds = np.array([flat.states[i].bounds for i in self.columns]).reshape(-1, 2)
        self.measured = np.array([flat.states[i].measured_by is not None for i in self.columns], dtype=bool)
        self.held = held
        self.whole = len(self.names) == len(order)
        self.free_index = free_index
        self._nx = len(order)
        if not self.whole:
            self._function = _start_with_jacobians(flat, self.names, free_index)

    def __call__(self, u0: np.ndarray, p: np.ndarray, z: np.ndarray):
        """x0 (nx,), dx0/dp of the free parameters (nx, np), dx0/dz (nx, nz)."""
        if self.whole:
            x0 = np.empty(self._nx)
            x0[self.columns] = z
            return x0, np.zeros((self._nx, len(self.free_index))), np.eye(self._nx)[:, self.columns]
        x0, by_p, by_z = (np.array(m) for m in self._function(u0, p, z))
        return x0.ravel(), by_p, by_z.reshape(self._nx, -1)


def _start_with_jacobians(flat: FlatModel, names: Sequence[str], free_index: np.ndarray) -> ca.Function:
    u, p, z = ca.SX.sym("u", len(flat.inputs)), ca.SX.sym("p", len(flat.parameters)), ca.SX.sym("z", len(names))
    x0 = flat.start_given(names)(u, p, z)
    by_p = ca.jacobian(x0, p)[:, [int(i) for i in free_index]] if len(free_index) else ca.SX(x0.shape[0], 0)
    return ca.Function("start_states", [u, p, z], [x0, ca.densify(by_p), ca.densify(ca.jacobian(x0, z))])


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Cost and its Gauss-Newton expansion over q and the scaled start states, segment by segment.

    gradient (segments, k), hessian (segments, k, k); k = free parameters, then start states. A segment in ``diverged``
    has a constant cost and no derivative.
    """

    cost: float
    costs: np.ndarray
    diverged: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray


@dataclass(frozen=True, eq=False)
class Shooting:
    """Segments of recordings with everything needed to run them; ``z`` is scaled by the states' nominals."""

    propagator: object
    free: FreeParameters
    recordings: tuple[Recording, ...]
    segments: tuple[Segment, ...]
    weights: np.ndarray
    start: StartStates
    centre: np.ndarray
    loss: Loss
    threads: int = 1

    @property
    def locals(self) -> int:
        """Free start states of one segment."""
        return 0 if self.start.held else len(self.start.names)

    def clip(self, z: np.ndarray) -> np.ndarray:
        """Scaled start states inside the states' bounds."""
        low, high = (self.start.bounds[:, side] / self.start.nominal for side in (0, 1))
        return np.clip(z, low, high)

    def linearise(self, q: np.ndarray, z: np.ndarray) -> Linearisation:
        """Cost, gradient and Gauss-Newton Hessian at parameters q (np,) and start states z (segments, nz)."""
        rows = self._over_segments(lambda i: self._expand(i, q, z[i]))
        costs, diverged, gradient, hessian = (np.array(c) for c in zip(*rows, strict=True))
        return Linearisation(float(costs.sum()), costs, diverged, gradient, hessian)

    def cost(self, q: np.ndarray, z: np.ndarray) -> float:
        """Cost alone."""
        return float(sum(self._over_segments(lambda i: self._cost(i, q, z[i]))))

    def residuals(self, i: int, q: np.ndarray, z: np.ndarray) -> np.ndarray | None:
        """Weighted residuals (samples, ny) of segment i, nan where nothing was measured; None when it diverged."""
        segment, time, u, p = self._inputs(i, q)
        x0, _, _ = self.start(u[0], p, z * self.start.nominal)
        y = self._run(time, u, p, x0)
        return None if y is None else self._weighted(segment, y)

    def sensitivities(self, i: int, q: np.ndarray, z: np.ndarray):
        """Weighted residuals (m,), d/dq and d/dz (m, k) over the measured samples; dy of every output (n, ny, k).

        None when the segment diverged.
        """
        segment, time, u, p = self._inputs(i, q)
        x0, by_p, by_z = self.start(u[0], p, z * self.start.nominal)
        seeds = np.zeros((len(x0), len(self.free.names) + self.propagator_states))
        seeds[:, : len(self.free.names)] = by_p
        if not self.start.held:
            seeds[:, len(self.free.names) : len(self.free.names) + self.locals] = by_z
        try:
            y, dy, _, _ = self.propagator.sensitivity(time, u, p, x0, seeds)
        except SolveError:
            return None
        k = len(self.free.names) + self.locals
        scale = np.concatenate([self.free.slope(q), self.start.nominal[: self.locals]])
        dy = dy[:, :, :k] * scale
        r = self._weighted(segment, y)
        here = np.isfinite(r)
        if not np.isfinite(y).all() or not np.isfinite(dy).all():
            return None
        rows = (dy[segment.first - segment.begin :] * self.weights[:, None])[here]
        return r[here], rows, dy

    @property
    def propagator_states(self) -> int:
        """Columns the propagator keeps for start states: all of them, whether free here or not."""
        return len(self.propagator.free_states)

    def trajectories(self, q: np.ndarray, z: np.ndarray) -> list[np.ndarray]:
        """State trajectories (n, nx) of every recording, put together from its segments; nan where one diverged."""
        nx = len(self.start.nominal) if self.start.whole else self.start._nx
        states = [np.full((len(r.time), nx), np.nan) for r in self.recordings]
        for i, segment in enumerate(self.segments):
            _, time, u, p = self._inputs(i, q)
            x0, _, _ = self.start(u[0], p, z[i] * self.start.nominal)
            try:
                _, x = self.propagator.run(time, u, p, x0)
            except SolveError:
                continue
            states[segment.recording][segment.first : segment.last] = x[segment.first - segment.begin :]
        return states

    def with_loss(self, loss: Loss) -> Shooting:
        """The same segments under another loss."""
        return replace(self, loss=loss)

    def _inputs(self, i: int, q: np.ndarray):
        segment = self.segments[i]
        recording = self.recordings[segment.recording]
        part = slice(segment.begin, segment.last)
        return segment, recording.time[part], recording.u[part], self.free.vector(q)

    def _run(self, time, u, p, x0):
        try:
            y, _ = self.propagator.run(time, u, p, x0)
        except SolveError:
            return None
        return y if np.isfinite(y).all() else None

    def _weighted(self, segment: Segment, y: np.ndarray) -> np.ndarray:
        measured = self.recordings[segment.recording].y[segment.first : segment.last]
        return (y[segment.first - segment.begin :] - measured) * self.weights

    def _limit(self, i: int) -> float:
        segment = self.segments[i]
        measured = self.recordings[segment.recording].y
        spread = np.nan_to_num(np.nanvar(np.where(self.weights > 0, measured, 0.0), axis=0))
        samples = segment.last - segment.first
        return float(DIVERGED * 0.5 * samples * (spread * self.weights**2 + (self.weights > 0)).sum())

    def _cost(self, i: int, q: np.ndarray, z: np.ndarray) -> float:
        r, limit = self.residuals(i, q, z), self._limit(i)
        if r is None:
            return limit
        cost = self.loss.cost(r[np.isfinite(r)]) + self._prior(i, z)[0]
        return cost if cost < limit else limit

    def _expand(self, i: int, q: np.ndarray, z: np.ndarray):
        k, limit = len(self.free.names) + self.locals, self._limit(i)
        found = self.sensitivities(i, q, z)
        prior, by_z, curvature = self._prior(i, z)
        cost = np.inf if found is None else self.loss.cost(found[0]) + prior
        if not cost < limit:
            return limit, True, np.zeros(k), np.zeros((k, k))
        r, J = self.loss.linearised(found[0], found[1])
        gradient, hessian = J.T @ r, J.T @ J
        if self.locals:
            gradient[-self.locals :] += by_z
            hessian[-self.locals :, -self.locals :] += np.diag(curvature)
        return cost, False, gradient, hessian

    def _prior(self, i: int, z: np.ndarray):
        weight = np.where(self.start.measured, 0.0, WEAK_PRIOR**2)
        away = z - self.centre[i]
        return 0.5 * float(weight @ away**2), (weight * away), weight

    def _over_segments(self, work) -> list:
        order = range(len(self.segments))
        if self.threads == 1 or len(self.segments) == 1:
            return [work(i) for i in order]
        chunks = np.array_split(np.arange(len(self.segments)), min(len(self.segments), 4 * self.threads))
        with ThreadPoolExecutor(self.threads) as pool:
            return [row for rows in pool.map(lambda chunk: [work(i) for i in chunk], chunks) for row in rows]
