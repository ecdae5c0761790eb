"""Free runs of a state space over whole recordings, fitted by linear and by nonlinear least squares.

A fold is left out of a fit by not counting its samples; the run goes on through it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from .gauss_newton import minimum
from .regressors import CUTOFF, Rows
from .state_space import Form, StateSpace
from .subspace import dynamics

ROUNDS = 3  # of a refinement whose starts follow from the model
LEAST = 1e-12  # of the spread of the states: what every direction has
ROWS = 4  # samples for each fitted number, at least


@dataclass(frozen=True, eq=False)
class Fitted:
    """A state space, the start of every recording beside settled (n,), and how often runs were evaluated."""

    model: StateSpace
    starts: list[np.ndarray]
    evaluations: int = 0


@dataclass(frozen=True, eq=False)
class Way:
    """How a run starts: x0 = gain (y[0] - y settled); an output that integrates has w in place of y, and w[0] = 0."""

    gain: np.ndarray
    rates: np.ndarray

    def start(self, model: StateSpace, u: np.ndarray, y: np.ndarray) -> np.ndarray:
        """The start (n,) from the first inputs and outputs, beside settled."""
        settled = model.C @ model.settled(u) + model.D @ u + model.e
        return self.gain @ (np.where(self.rates, 0.0, y) - settled)


class WholeRuns:
    """Recordings at one period, run by state spaces of one form."""

    def __init__(self, rows: Rows, form: Form):
        self.rows, self.form = rows, form
        late = [np.maximum(np.arange(len(p.u)) - form.delay, 0) for p in rows.parts]
        self.inputs = [p.u[k] for p, k in zip(rows.parts, late, strict=True)]
        self.first = [p.y[0] for p in rows.parts]
        self.measured = [p.own_y[: len(p.at_own_times(p.y))] for p in rows.parts]
        self.frees_start = not all(form.rates)

    def increments(self, outputs: Sequence[np.ndarray]) -> list[np.ndarray]:
        """w (n - 1, ny) of outputs per recording, over `spread`: increments of those that integrate."""
        return [w / self.spread for w in self._moves(outputs)]

    @cached_property
    def spread(self) -> np.ndarray:
        """Standard deviation of w (ny,) as measured."""
        found = np.concatenate(self._moves([p.y for p in self.rows.parts])).std(axis=0)
        return np.where(found > 0, found, 1.0)

    def _moves(self, outputs: Sequence[np.ndarray]) -> list[np.ndarray]:
        """From the first input on, or from the second where inputs act at once."""
        rates, at = np.array(self.form.rates), int(self.form.direct)
        return [np.where(rates, np.diff(y, axis=0), y[at : len(y) - 1 + at]) for y in outputs]

    def folds(self, part: int) -> np.ndarray:
        """The fold of every recorded time of a recording, (m,)."""
        own = self.rows.parts[part].own_time[: len(self.measured[part])]
        edges = self.rows.cuts[part]
        times = self.rows.parts[part].time
        inner = [times[min(e, len(times) - 1)] if e < len(times) else np.inf for e in edges[1:-1]]
        return np.searchsorted(np.where(np.asarray(edges[1:-1]) == 0, -np.inf, inner), own, side="right")

    def counted(self, part: int, fold: int | None) -> np.ndarray:
        """Which recorded times count in a fit without a fold."""
        return np.ones(len(self.measured[part]), dtype=bool) if fold is None else self.folds(part) != fold

    def fits(self, order: int) -> bool:
        """Whether there are samples enough for an order."""
        nu, ny = self.inputs[0].shape[1], len(self.form.rates)
        return ROWS * order * (nu + ny + len(self.inputs) * self.frees_start) <= self.rows.fitted * ny

    def linear(self, observability: np.ndarray, order: int, fold: int | None) -> Fitted:
        """A, C of an order from the subspace; B, D, e and starts by least squares of the runs without a fold."""
        ny, nu = len(self.form.rates), self.inputs[0].shape[1]
        A, C = dynamics(observability, order, ny)
        C = C * self.spread[:, None]
        empty = StateSpace(self.form, A, np.zeros((order, nu)), C, np.zeros((ny, nu)), np.zeros(ny))
        found = self._solved(empty, [np.zeros(order)] * len(self.inputs), fold)
        if self.frees_start:
            return found
        return self._solved(empty, self.started(found.model, self.best_way(found.model, fold)), fold)

    def _solved(self, empty: StateSpace, starts: Sequence[np.ndarray], fold: int | None) -> Fitted:
        """B, D and e, and starts where they are free, of A and C."""
        J, r = self._stacked(empty, starts, fold, all_of_it=False)
        scale = np.sqrt(np.einsum("ij,ij->j", J, J))
        scale[scale == 0] = 1.0
        found = -np.linalg.lstsq(J / scale, r, rcond=CUTOFF)[0] / scale
        size, of_B = len(empty.parameters) - empty.A.size - empty.C.size, empty.B.size
        parameters = np.concatenate([empty.A.ravel(), found[:of_B], empty.C.ravel(), found[of_B:size]])
        return Fitted(empty.with_parameters(parameters), self._starts(found[size:], starts))

    def refined(self, begin: Fitted, fold: int | None, iterations: int) -> Fitted:
        """All of it by Gauss-Newton on the runs without a fold; as it began where no stable run is better."""
        if self.frees_start:
            return self._refined(begin, fold, iterations)
        best, evaluations = begin, 0
        for _ in range(ROUNDS):
            found = self._refined(best, fold, max(1, iterations // ROUNDS))
            starts = self.started(found.model, self.best_way(found.model, fold))
            evaluations += found.evaluations
            found = Fitted(found.model, starts)
            if not self._cost(found, fold) < self._cost(best, fold):
                break
            best = found
        return Fitted(best.model, best.starts, evaluations)

    def _cost(self, fitted: Fitted, fold: int | None) -> float:
        return float(sum(np.sum(m**2) for m in self.misses(fitted.model, fitted.starts, fold)))

    def _refined(self, begin: Fitted, fold: int | None, iterations: int) -> Fitted:
        model, size = begin.model, len(begin.model.parameters)
        free = np.concatenate(begin.starts) if self.frees_start else np.zeros(0)

        def split(values):
            return model.with_parameters(values[:size]), self._starts(values[size:], begin.starts)

        def residual(values):
            there, own = split(values)
            if not there.stable:
                return None
            r = np.concatenate([m.ravel() for m in self.misses(there, own, fold)])
            return r if np.isfinite(r).all() else None

        def jacobian(values):
            return self._stacked(*split(values), fold)[0]

        found = minimum(residual, jacobian, np.concatenate([model.parameters, free]), iterations)
        return Fitted(*split(found.parameters), found.evaluations)

    def misses(self, model: StateSpace, starts: Sequence[np.ndarray], fold: int | None) -> list[np.ndarray]:
        """What runs are off by, (m, ny) per recording, at the recorded times that count."""
        return [self.miss(model, k, start)[self.counted(k, fold)] for k, start in enumerate(starts)]

    def miss(self, model: StateSpace, k: int, start: np.ndarray) -> np.ndarray:
        """What a run is off by at the recorded times, (m, ny)."""
        run = model.run(self.inputs[k], self.first[k], start)
        return self.rows.parts[k].at_own_times(run) - self.measured[k]

    def held_out_error(self, fitted: Fitted, fold: int) -> tuple[np.ndarray, int]:
        """Sum of squares (ny,) over a fold, and its samples; from the block's start where it is a whole recording."""
        total, count = np.zeros(len(self.form.rates)), 0
        for k in range(len(self.inputs)):
            inside = self.folds(k) == fold
            if not inside.any():
                continue
            known = not inside[0]  # its start was fitted
            way = None if known else self.best_way(fitted.model, fold)
            start = fitted.starts[k] if known else way.start(fitted.model, self.inputs[k][0], self.first[k])
            miss = self.miss(fitted.model, k, start)[inside]
            miss = miss - np.where(np.array(self.form.rates) & known, miss[0], 0.0)
            with np.errstate(over="ignore"):
                total, count = total + np.sum(miss**2, axis=0), count + len(miss)
        return total, count

    def ways(self, model: StateSpace) -> list[Way]:
        """Ways to start from a first sample: the likeliest state, or the one that moves least; at rest, or moving."""
        states = [model.states(u) for u in self.inputs[: len(self.inputs) - self.rows.judges]]
        spread = np.atleast_2d(np.cov(np.concatenate(states).T))
        moves = np.atleast_2d(np.cov(np.concatenate([np.diff(x, axis=0) for x in states]).T))
        apart = np.linalg.inv(model.A - np.eye(model.order))
        rates = np.array(self.form.rates)
        answer = []
        for known in [~rates, np.ones(len(rates), dtype=bool)] if rates.any() else [~rates]:
            for P in (spread, apart @ moves @ apart.T) if known.any() else (spread,):
                P = P + LEAST * np.trace(P) * np.eye(len(P))
                C = model.C[known]
                gain = np.zeros((model.order, len(rates)))
                gain[:, known] = np.linalg.lstsq(C @ P @ C.T, C @ P, rcond=CUTOFF)[0].T
                answer.append(Way(gain, rates))
        return answer

    def started(self, model: StateSpace, way: Way) -> list[np.ndarray]:
        """Starts (n,) of all recordings, beside settled."""
        return [way.start(model, u[0], y) for u, y in zip(self.inputs, self.first, strict=True)]

    def best_way(self, model: StateSpace, fold: int | None = None) -> Way:
        """That of `ways` with which the recordings, without a fold, run best."""

        def error(way):
            r = np.concatenate(self.misses(model, self.started(model, way), fold))
            return float(np.mean(r**2)) if np.isfinite(r).all() else np.inf

        return min(self.ways(model), key=error)

    def _starts(self, free: np.ndarray, fixed: Sequence[np.ndarray]) -> list[np.ndarray]:
        return list(free.reshape(len(fixed), -1)) if self.frees_start else list(fixed)

    def _stacked(self, model: StateSpace, starts, fold, all_of_it: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Jacobian and misses of all recordings, by parameters and starts."""
        blocks, misses = [], []
        for k, start in enumerate(starts):
            D = model.derivatives(self.inputs[k], start, all_of_it)
            D = self.rows.parts[k].at_own_times(D)[self.counted(k, fold)].reshape(-1, D.shape[2])
            size, n = D.shape[1] - model.order, model.order
            whole = np.zeros((len(D), size + n * len(starts) * self.frees_start))
            whole[:, :size] = D[:, :size]
            if self.frees_start:
                whole[:, size + k * n : size + (k + 1) * n] = D[:, size:]
            blocks.append(whole)
            misses.append(self.miss(model, k, start)[self.counted(k, fold)].ravel())
        return np.concatenate(blocks), np.concatenate(misses)
