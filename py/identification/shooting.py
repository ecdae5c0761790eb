"""Shooting: recordings cut into segments, each run from its own start states, and what the runs leave unexplained.

    r = w (y(t; p, x0) - y_measured),   x0 = x0(p, z)

z are the start states a segment is free to choose. A first sample is a measurement like any other: a start state that
an output measures is free, and the first residual is its prior, so noise in it does not bias the parameters. Where it
has none (not measured, or not then, or while a delay line fills), a weak prior stands for it: of a body that sticks at
once nothing later tells how fast it was.
"""

from __future__ import annotations

import itertools
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydrotwin.models.language.errors import SolveError

from .loss import Loss
from .problem import FreeParameters, Prior, Recording
from .start_states import StartStates

WEAK_PRIOR = 0.1  # per state nominal: a start state without a first residual may move by ten nominals for one sigma
PIECE = 1000  # samples of a run whose Jacobian is worked on at once
NOTHING = 1e-60  # derivatives below this, in any unit, have decayed
WORTH_THREADS = 100  # samples of a call: threads wait for each other between shorter ones
EXPLODED = np.finfo(float).eps ** -2  # squared derivative in sigmas: rounding of a parameter alone moves a run by one
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


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Cost and its Gauss-Newton expansion over q and the scaled start states, segment by segment.

    gradient (segments, k), hessian (segments, k, k); k = free parameters, then start states. A segment in ``diverged``
    has a constant cost and no derivative. squares : (segments, ny), SI, of what was measured, without weights, not
    finite where a run stopped or was given up; None where the driver did not sum them.
    """

    cost: float
    costs: np.ndarray
    diverged: np.ndarray
    gradient: np.ndarray
    hessian: np.ndarray
    squares: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Shooting:
    """Segments of recordings with everything needed to run them; ``z`` is scaled by the states' nominals.

    The cost counts residuals averaged over ``averaged`` samples, in units of the average's noise. diverged : times the
    cost of the mean from which on a run has diverged; inf: not finite. until : when [s] a minimisation stops.
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
    diverged: float = DIVERGED
    until: float = np.inf

    @property
    def locals(self) -> int:
        """Free start states of one segment."""
        return 0 if self.start.held else len(self.start.names)

    @cached_property
    def count(self) -> int:
        """Measured values in all segments."""
        return max(1, int(self.counts.sum()))

    @cached_property
    def counts(self) -> np.ndarray:
        """The same by output, (ny,)."""
        return np.sum([seen.sum(axis=0) for seen in self._measured], axis=0)

    def clip(self, z: np.ndarray) -> np.ndarray:
        """Scaled start states inside the states' bounds."""
        low, high = (self.start.bounds[:, side] / self.start.nominal for side in (0, 1))
        return np.clip(z, low, high)

    def linearise(self, q: np.ndarray, z: np.ndarray, above: float = np.inf) -> Linearisation:
        """Cost, gradient and Gauss-Newton Hessian at parameters q (np,) and start states z (segments, nz).

        above : a run that costs more alone may be given up, as diverged: where costs are compared with that, who knows
        how much more it would have cost? Absurd parameters make a run a hundred times as dear as others.
        """
        at = self._point(q)
        rows = self._over_segments(lambda part: self._expansions(part, at, z, above))
        costs, diverged, gradient, hessian, squares = (np.array(c) for c in zip(*rows, strict=True))
        if self.prior:  # it belongs to no segment: the first carries it
            n = np.arange(len(q))
            costs[0] += self.prior.cost(q)
            gradient[0, n] += self.prior.weight * (q - self.prior.centre)
            hessian[0, n, n] += self.prior.weight
        known = squares if self._in_one_call else None
        return Linearisation(float(costs.sum()), costs, diverged, gradient, hessian, known)

    def cost(self, q: np.ndarray, z: np.ndarray, above: float = np.inf) -> float:
        """Cost alone; above : as in `linearise`."""
        at = self._point(q)
        known = self.prior.cost(q) if self.prior else 0.0
        return known + float(sum(self._over_segments(lambda part: self._costs(part, at, z, above))))

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
        return self._over_segments(lambda part: [self._sensitivities(i, at, z[i]) for i in part])

    def accuracy(self, i: int, q: np.ndarray, z: np.ndarray):
        """The `Accuracy` of the run of segment i; raises Diverged with it."""
        time, u = self._inputs(self.segments[i])
        p = self.free.vector(q)
        x0, _, _ = self.start(u[0], p, z * self.start.nominal)
        return self.propagator.accuracy(time, u, p, x0)

    def trajectories(self, q: np.ndarray, z: np.ndarray) -> list[np.ndarray]:
        """State trajectories (n, nx) of every recording from its segments, lead-ins too; nan where one diverged."""
        nx = self.start.size
        states, p = [np.full((len(r.time), nx), np.nan) for r in self.recordings], self.free.vector(q)
        for i, segment in enumerate(self.segments):
            time, u = self._inputs(segment)
            x0, _, _ = self.start(u[0], p, z[i] * self.start.nominal)
            try:
                _, x = self.propagator.run(time, u, p, x0)
            except SolveError:
                continue
            states[segment.recording][segment.begin : segment.last] = x
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
        left, moved = _picked(here, r, dy[-len(r) :] * (self.weights[:, None] * scale))
        return (left, moved, dy) if _has_not_exploded(np.square(moved).sum(axis=0)) else None

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
        return [self.diverged * 0.5 * (s.last - s.first) * spread[s.recording] for s in self.segments]

    @cached_property
    def _in_one_call(self) -> bool:
        """The compiled driver sums plain squares itself, for all windows of a recording in one call."""
        plain = self.loss.kind == "linear" and self.averaged == 1 and not self.propagator.flat.black_box
        return plain and self.propagator.engine == "c"

    def _by_recording(self, part: np.ndarray):
        """Of the segments ``part``: those of each recording, their cuts (s, 3), and the recording."""
        for r, members in itertools.groupby(part, key=lambda i: self.segments[i].recording):
            members = list(members)
            cuts = np.array([(s.begin, s.first, s.last) for s in (self.segments[i] for i in members)])
            yield members, cuts, self.recordings[r]

    def _costs(self, part: np.ndarray, at, z: np.ndarray, above: float) -> list[float]:
        """The costs of the segments ``part``."""
        if not self._in_one_call:
            return [self._cost(i, at, z[i]) for i in part]
        found = []
        for members, cuts, recording in self._by_recording(part):
            x0, _ = self._all_seeds(members, recording.u[cuts[:, 0]], at[0], z)
            limits = np.array([self._limits[i] for i in members])  # beyond, a run has diverged, whatever follows
            asked = recording.time, recording.u, at[0], cuts, x0, recording.y, self.weights, np.minimum(limits, above)
            ran = self.propagator.costs(*asked)
            with np.errstate(all="ignore"):
                costs = [cost + self._start_prior(i, z[i])[0] for i, cost in zip(members, ran, strict=True)]
            # a stopped run is nan: it counts as diverged
            found += [cost if cost < limit else limit for cost, limit in zip(costs, limits, strict=True)]
        return found

    def _expansions(self, part: np.ndarray, at, z: np.ndarray, above: float) -> list:
        """Cost, whether it diverged, gradient, Gauss-Newton Hessian and squares of the segments ``part``."""
        if not self._in_one_call:
            return [(*self._expand(i, at, z[i]), np.nan) for i in part]
        (p, scale), found = at, []
        k, used = len(scale), self.weights > 0
        w = self.weights[used] ** 2
        for members, cuts, recording in self._by_recording(part):
            x0, dx0 = self._all_seeds(members, recording.u[cuts[:, 0]], p, z)
            with np.errstate(divide="ignore"):
                limits = 2 * np.array([min(self._limits[i], above) for i in members])[:, None] / self.weights**2
            ran = self.propagator.expansions(recording.time, recording.u, p, cuts, x0, dx0, recording.y, limits)
            with np.errstate(all="ignore"):
                costs, gradient, hessian = (np.einsum("j,sj...->s...", w, sums[:, used]) for sums in ran)
                gradient, hessian = gradient[:, :k] * scale, hessian[:, :k, :k] * np.outer(scale, scale)
                rows = zip(members, 0.5 * costs, gradient, hessian, ran[0], strict=True)
                found += [(*self._with_prior(i, z[i], *row), squares) for i, *row, squares in rows]
        return found

    def _all_seeds(self, members: list[int], u0: np.ndarray, p: np.ndarray, z: np.ndarray):
        """`_seeds` of several segments: (s, nx) and (s, nx, n_theta)."""
        if self.start.whole:
            x0 = np.empty((len(members), self.start.size))
            x0[:, self.start.columns] = z[members] * self.start.nominal
            return x0, np.repeat(self._seeds(u0, p, z[members[0]])[1][None], len(members), axis=0)
        seeds = [self._seeds(u[None], p, z[i]) for i, u in zip(members, u0, strict=True)]
        return tuple(np.array(part) for part in zip(*seeds, strict=True))

    def _cost(self, i: int, at, z: np.ndarray) -> float:
        r = self._residuals(i, at, z)
        if r is None:
            return self._limits[i]
        with np.errstate(all="ignore"):  # a run on its way out may overflow: it then counts as diverged
            cost = self.loss.cost(self._pooled(i, r[self._measured[i]])) + self._start_prior(i, z)[0]
        return min(cost, self._limits[i]) if np.isfinite(cost) else self._limits[i]

    def _expand(self, i: int, at, z: np.ndarray):
        cost, k = 0.0, len(at[1])
        gradient, hessian = np.zeros(k), np.zeros((k, k))
        with np.errstate(all="ignore"):
            try:
                for r, J in self._pieces(i, at, z):
                    cost += self.loss.cost(r)
                    r, J = self.loss.linearised(r, J)
                    gradient += J.T @ r
                    hessian += J.T @ J
            except SolveError:
                cost = np.nan
            return self._with_prior(i, z, cost, gradient, hessian)

    def _with_prior(self, i: int, z: np.ndarray, cost: float, gradient: np.ndarray, hessian: np.ndarray):
        """A segment's expansion with what is known of its start; of one that diverged the limit and no derivative."""
        known, by_z, curvature = self._start_prior(i, z)
        cost = cost + known
        if not (cost < self._limits[i] and _has_not_exploded(hessian)):
            return self._limits[i], True, np.zeros(len(gradient)), np.zeros(hessian.shape)
        if self.locals:
            own = np.arange(len(gradient) - self.locals, len(gradient))
            gradient[own] += by_z
            hessian[own, own] += curvature
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
            yield _picked(here, r, by[rows, :, : len(at[1])] * (self.weights[:, None] * at[1]))

    def _seeds(self, u: np.ndarray, p: np.ndarray, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Start states (nx,) and their derivatives to the free parameters and states (nx, n_theta)."""
        x0, by_p, by_z = self.start(u[0], p, z * self.start.nominal)
        shared = len(self.free.names)
        seeds = np.zeros((len(x0), shared + len(self.propagator.free_states)))
        seeds[:, :shared] = by_p
        seeds[:, shared : shared + self.locals] = by_z[:, : self.locals]
        return x0, seeds

    def _start_prior(self, i: int, z: np.ndarray):
        weight, away = self._start_weight[i], z - self.centre[i]
        return 0.5 * float(weight @ away**2), (weight * away), weight

    @cached_property
    def _start_weight(self) -> np.ndarray:
        """Per segment and start state, what is known of it beside its residuals (segments, nz)."""
        by, begins = self.start.measured, [s.first == s.begin for s in self.segments]
        told = [seen[0, by] & (by >= 0) & at for seen, at in zip(self._measured, begins, strict=True)]
        return np.where(told, 0.0, WEAK_PRIOR**2)

    def _over_segments(self, work) -> list:
        """What ``work`` gives, a list for a list of segments, of all of them."""
        every, samples = np.arange(len(self.segments)), sum(s.last - s.begin for s in self.segments)
        parts = np.array_split(every, min(len(every), 4 * self.threads))
        calls = len(parts) if self._in_one_call else len(every)
        if self.threads == 1 or len(every) == 1 or samples < WORTH_THREADS * calls:
            return work(every)
        with ThreadPoolExecutor(self.threads) as pool:
            return [row for rows in pool.map(work, parts) for row in rows]


def _has_not_exploded(information: np.ndarray) -> bool:
    """Whether derivatives say anything: they are finite, and not so large that no double precision could follow."""
    return bool(np.all(np.abs(information) < EXPLODED))  # nan is not


def _picked(here: np.ndarray, r: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """What was measured of residuals (n, ny) and their derivatives (n, ny, k): (m,) and (m, k)."""
    if here.all():  # no copy of all derivatives
        return r.ravel(), rows.reshape(r.size, -1)
    return r[here], rows[here]
