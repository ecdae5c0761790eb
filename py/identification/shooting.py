"""Shooting: recordings cut into segments, each run from its own start states, and what the runs leave unexplained.

    r = w (y(t; p, x0) - y_measured),   x0 = x0(p, z)

z are the start states a segment is free to choose. A first sample is a measurement like any other: a start state that
an output measures is free, and the first residual is its prior, so noise in it does not bias the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel

from .loss import Loss
from .problem import FreeParameters, Recording

WEAK_PRIOR = 0.1  # per state nominal: an unmeasured start state may move by ten nominals for one sigma
PIECE = 1000  # samples of a run whose Jacobian is worked on at once
NOTHING = 1e-60  # derivatives below this, in any unit, have decayed
WORTH_THREADS = 100  # samples of a segment: threads wait for each other between shorter ones
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
        self.size = len(order)
        if not self.whole:
            self._function = _start_with_jacobians(flat, self.names, free_index)

    def __call__(self, u0: np.ndarray, p: np.ndarray, z: np.ndarray):
        """x0 (nx,), dx0/dp of the free parameters (nx, np), dx0/dz (nx, nz)."""
        if self.whole:
            x0 = np.empty(self.size)
            x0[self.columns] = z
            return x0, np.zeros((self.size, len(self.free_index))), np.eye(self.size)[:, self.columns]
        x0, by_p, by_z = (np.array(m) for m in self._function(u0, p, z))
        return x0.ravel(), by_p, by_z.reshape(self.size, -1)


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
class Prior:
    """What is known of the scaled parameters q (np,) beforehand: costs ``1/2 sum weight (q - centre)^2``."""

    centre: np.ndarray
    weight: np.ndarray

    def cost(self, q: np.ndarray) -> float:
        return 0.5 * float(self.weight @ (q - self.centre) ** 2)


@dataclass(frozen=True, eq=False)
class Shooting:
    """Segments of recordings with everything needed to run them; ``z`` is scaled by the states' nominals.

    The cost counts residuals averaged over ``averaged`` samples, in units of the average's noise.
    """

    propagator: object
    free: FreeParameters
    recordings: tuple[Recording, ...]
    segments: tuple[Segment, ...]
    weights: np.ndarray
    start: StartStates
    centre: np.ndarray
    loss: Loss
    threads: int = 1
    averaged: int = 1
    prior: Prior | None = None

    @property
    def locals(self) -> int:
        """Free start states of one segment."""
        return 0 if self.start.held else len(self.start.names)

    @cached_property
    def count(self) -> int:
        """Measured values in all segments."""
        return max(1, sum(int(seen.sum()) for seen in self._measured))

    def clip(self, z: np.ndarray) -> np.ndarray:
        """Scaled start states inside the states' bounds."""
        low, high = (self.start.bounds[:, side] / self.start.nominal for side in (0, 1))
        return np.clip(z, low, high)

    def linearise(self, q: np.ndarray, z: np.ndarray) -> Linearisation:
        """Cost, gradient and Gauss-Newton Hessian at parameters q (np,) and start states z (segments, nz)."""
        at = self._point(q)
        rows = self._over_segments(lambda i: self._expand(i, at, z[i]))
        costs, diverged, gradient, hessian = (np.array(c) for c in zip(*rows, strict=True))
        if self.prior:  # it belongs to no segment: the first carries it
            n = np.arange(len(q))
            costs[0] += self.prior.cost(q)
            gradient[0, n] += self.prior.weight * (q - self.prior.centre)
            hessian[0, n, n] += self.prior.weight
        return Linearisation(float(costs.sum()), costs, diverged, gradient, hessian)

    def cost(self, q: np.ndarray, z: np.ndarray) -> float:
        """Cost alone."""
        at = self._point(q)
        known = self.prior.cost(q) if self.prior else 0.0
        return known + float(sum(self._over_segments(lambda i: self._cost(i, at, z[i]))))

    def residuals(self, i: int, q: np.ndarray, z: np.ndarray) -> np.ndarray | None:
        """Weighted residuals (samples, ny) of segment i, nan where nothing was measured; None when it diverged."""
        return self._residuals(i, self._point(q), z)

    def sensitivities(self, i: int, q: np.ndarray, z: np.ndarray):
        """Weighted residuals (m,) and d/dq, d/dz (m, k) of measured samples; dy/dp, dy/dz of all outputs (n, ny, k).

        None when the segment diverged.
        """
        return self._sensitivities(i, self._point(q), z)

    def all_sensitivities(self, q: np.ndarray, z: np.ndarray) -> list:
        """`sensitivities` of every segment."""
        at = self._point(q)
        return self._over_segments(lambda i: self._sensitivities(i, at, z[i]))

    def trajectories(self, q: np.ndarray, z: np.ndarray) -> list[np.ndarray]:
        """State trajectories (n, nx) of every recording, put together from its segments; nan where one diverged."""
        nx = self.start.size
        states, p = [np.full((len(r.time), nx), np.nan) for r in self.recordings], self.free.vector(q)
        for i, segment in enumerate(self.segments):
            time, u = self._inputs(segment)
            x0, _, _ = self.start(u[0], p, z[i] * self.start.nominal)
            try:
                _, x = self.propagator.run(time, u, p, x0)
            except SolveError:
                continue
            states[segment.recording][segment.first : segment.last] = x[segment.first - segment.begin :]
        return states

    def _point(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The whole parameter vector and the scale of each derivative column, once for all segments."""
        return self.free.vector(q), np.concatenate([self.free.slope(q), self.start.nominal[: self.locals]])

    def _inputs(self, segment: Segment) -> tuple[np.ndarray, np.ndarray]:
        recording = self.recordings[segment.recording]
        return recording.time[segment.begin : segment.last], recording.u[segment.begin : segment.last]

    def _residuals(self, i: int, at, z: np.ndarray) -> np.ndarray | None:
        time, u = self._inputs(self.segments[i])
        x0, _, _ = self.start(u[0], at[0], z * self.start.nominal)
        try:
            y, _ = self.propagator.run(time, u, at[0], x0)
        except SolveError:
            return None
        return self._weighted(i, y)

    def _sensitivities(self, i: int, at, z: np.ndarray):
        p, scale = at
        time, u = self._inputs(self.segments[i])
        x0, seeds = self._seeds(u, p, z)
        try:
            y, dy, _, _ = self.propagator.sensitivity(time, u, p, x0, seeds, with_states=False)
        except SolveError:
            return None
        dy = dy[:, :, : len(scale)]
        if not np.isfinite(dy).all():
            return None
        r, here = self._weighted(i, y), self._measured[i]
        rows = (dy[-len(r) :] * (self.weights[:, None] * scale))[here]
        return r[here], rows, dy

    def _weighted(self, i: int, y: np.ndarray) -> np.ndarray:
        segment = self.segments[i]
        measured = self.recordings[segment.recording].y[segment.first : segment.last]
        return (y[segment.first - segment.begin :] - measured) * self.weights

    @cached_property
    def _measured(self) -> list[np.ndarray]:
        """Per segment, where an output was measured (samples, ny)."""
        seen = [np.isfinite(r.y) & (self.weights > 0) for r in self.recordings]
        return [seen[s.recording][s.first : s.last] for s in self.segments]

    def _pooled(self, i: int, rows: np.ndarray) -> np.ndarray:
        """Measured rows (m, ...) of segment i summed over blocks of samples, over the root of their number."""
        if self.averaged == 1:
            return rows
        order, first, root = self._blocks[i]
        return np.add.reduceat(rows[order], first, axis=0) / root.reshape(-1, *[1] * (rows.ndim - 1))

    @cached_property
    def _blocks(self) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Per segment: measured values ordered by output and block, where each block begins, root of its length."""
        blocks = []
        for seen in self._measured:
            sample, output = np.nonzero(seen)
            label = output * (len(seen) // self.averaged + 1) + sample // self.averaged
            order = np.argsort(label, kind="stable")
            _, first, count = np.unique(label[order], return_index=True, return_counts=True)
            blocks.append((order, first, np.sqrt(count)))
        return blocks

    @cached_property
    def _limits(self) -> list[float]:
        """Per segment, the cost beyond which it counts as diverged."""
        spread = []
        for recording in self.recordings:
            seen = np.where(np.isfinite(recording.y) & (self.weights > 0), recording.y * self.weights, 0.0)
            spread.append(float((seen.var(axis=0) + 1.0).sum()))
        return [DIVERGED * 0.5 * (s.last - s.first) * spread[s.recording] for s in self.segments]

    def _cost(self, i: int, at, z: np.ndarray) -> float:
        r = self._residuals(i, at, z)
        if r is None:
            return self._limits[i]
        with np.errstate(all="ignore"):  # a run on its way out may overflow: it then counts as diverged
            cost = self.loss.cost(self._pooled(i, r[self._measured[i]])) + self._start_prior(i, z)[0]
        return min(cost, self._limits[i]) if np.isfinite(cost) else self._limits[i]

    def _expand(self, i: int, at, z: np.ndarray):
        k, limit = len(at[1]), self._limits[i]
        diverged = limit, True, np.zeros(k), np.zeros((k, k))
        gradient, hessian = np.zeros(k), np.zeros((k, k))
        with np.errstate(all="ignore"):
            cost, by_z, curvature = self._start_prior(i, z)
            try:
                for r, J in self._pieces(i, at, z):
                    cost += self.loss.cost(r)
                    r, J = self.loss.linearised(r, J)
                    gradient += J.T @ r
                    hessian += J.T @ J
            except SolveError:
                return diverged
        if not (cost < limit and np.isfinite(hessian).all()):
            return diverged
        if self.locals:
            gradient[-self.locals :] += by_z
            hessian[-self.locals :, -self.locals :] += np.diag(curvature)
        return cost, False, gradient, hessian

    def _pieces(self, i: int, at, z: np.ndarray):
        """Weighted residuals (m,) and derivatives (m, k) of segment i, a piece of the recording after the other.

        A derivative to the start of a motor with a lag of 30 ms is below 1e-308 after 21 s, where a processor is ten
        times slower: between pieces it becomes zero. A delay line or an average reaches across pieces: then there is
        one. Raises SolveError when the run diverges.
        """
        time, u = self._inputs(self.segments[i])
        flat = self.propagator.flat
        whole = flat.black_box or any(s.dead_time for s in flat.inputs)
        if self.averaged > 1 or whole or len(time) <= PIECE:
            found = self._sensitivities(i, at, z)
            if found is None:
                raise SolveError(f"identify: {self.recordings[self.segments[i].recording].name} diverges.")
            yield tuple(self._pooled(i, part) for part in found[:2])
            return
        x, dx = self._seeds(u, at[0], z)
        y, last = self.recordings[self.segments[i].recording].y[self.segments[i].first :], len(time) - 1
        for a in range(0, last, PIECE):
            b = min(a + PIECE, last)
            ran, by, x, dx = self.propagator.sensitivity(time[a : b + 1], u[a : b + 1], at[0], x, dx)
            x, dx, rows = x[-1], np.where(np.abs(dx[-1]) < NOTHING, 0.0, dx[-1]), slice(0, b - a + (b == last))
            here = self._measured[i][a : a + rows.stop]
            r = (ran[rows] - y[a : a + rows.stop]) * self.weights
            yield r[here], (by[rows, :, : len(at[1])] * (self.weights[:, None] * at[1]))[here]

    def _seeds(self, u: np.ndarray, p: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Start states (nx,) and their derivatives to the free parameters and states (nx, n_theta)."""
        x0, by_p, by_z = self.start(u[0], p, z * self.start.nominal)
        shared = len(self.free.names)
        seeds = np.zeros((len(x0), shared + len(self.propagator.free_states)))
        seeds[:, :shared] = by_p
        seeds[:, shared : shared + self.locals] = by_z[:, : self.locals]
        return x0, seeds

    def _start_prior(self, i: int, z: np.ndarray):
        weight = self._start_weight
        away = z - self.centre[i]
        return 0.5 * float(weight @ away**2), (weight * away), weight

    @cached_property
    def _start_weight(self) -> np.ndarray:
        return np.where(self.start.measured, 0.0, WEAK_PRIOR**2)

    def _over_segments(self, work) -> list:
        samples = sum(s.last - s.begin for s in self.segments)
        if self.threads == 1 or len(self.segments) == 1 or samples < WORTH_THREADS * len(self.segments):
            return [work(i) for i in range(len(self.segments))]
        chunks = np.array_split(np.arange(len(self.segments)), min(len(self.segments), 4 * self.threads))
        with ThreadPoolExecutor(self.threads) as pool:
            return [row for rows in pool.map(lambda chunk: [work(i) for i in chunk], chunks) for row in rows]
