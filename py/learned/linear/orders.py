"""The order of an ARX equation, its free run, and the order that runs best on parts held out of its fit.

    level   y[k] = c + sum_i a_i y[k-i] + sum_j b_j u[k-delay-j]
    rate    the same equation for the increments y[k] - y[k-1]: a pole at 1, exactly, for what integrates

Both are fitted to the same rows, 1, y[k-1], past increments, inputs, one step ahead. Each output has an equation of its
own: in free run all outputs follow from the inputs alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from .regressors import COUNTS, DELAYS, Rows, solved

SIMPLER = 1.02  # of the least free-run error: what the simplest order may leave
NOTHING = 1e-12  # of the variance of an output: less is none
STABLE = 1.0 - 1e-6  # the largest pole, that of the integration apart
ROUNDS = 3  # of the search over one part of an order after the other
WINDOW = (1, 4)  # delay and samples of every input, with which the search begins
ROWS = 3  # rows for each coefficient, at least


@dataclass(frozen=True, order=True)
class Order:
    """Of one output: whether the equation is that of its rate, past values, (delay, samples) of every input."""

    rate: bool
    past: int
    windows: tuple[tuple[int, int], ...]

    @property
    def size(self) -> int:
        """Coefficients, the constant among them."""
        return 1 + self.past + sum(count for _, count in self.windows)


@dataclass(frozen=True)
class Asked:
    """What of an order is not chosen: None is. latest : the longest delay that is tried."""

    rate: bool | None = None
    past: int | None = None
    count: int | None = None
    delay: int | None = None
    latest: int = DELAYS[-1]

    @property
    def reach(self) -> int:
        """The lag of an input that is needed for what is asked."""
        if self.count is None and self.delay is None:
            return 0
        return (self.delay or 0) + (self.count or COUNTS[-1]) - 1

    def pasts(self, most: int) -> Sequence[int]:
        """Numbers of past values to try."""
        return range(most + 1) if self.past is None else (self.past,)

    @property
    def delays(self) -> Sequence[int]:
        """Delays to try."""
        return [d for d in DELAYS if d <= self.latest] if self.delay is None else (self.delay,)

    @property
    def counts(self) -> Sequence[int]:
        """Numbers of samples of an input to try."""
        return COUNTS if self.count is None else (self.count,)


@dataclass(frozen=True, eq=False)
class Equation:
    """An order with its coefficients, over scales.

    level : of y[k-1]; -1 where only inputs decide. increments : of past increments. constant; inputs : by (input, lag).
    """

    order: Order
    level: float
    increments: np.ndarray
    constant: float
    inputs: dict[tuple[int, int], float]

    @property
    def feedback(self) -> np.ndarray:
        """a_1, a_2, ... of the level, or of the increments where the equation is that of the rate."""
        if self.order.rate:
            return self.increments
        if not self.order.past:
            return np.zeros(0)
        padded = np.concatenate([[0.0], self.increments, [0.0]])
        answer = np.diff(padded)
        answer[0] += 1 + self.level
        return answer

    @property
    def stable(self) -> bool:
        """Whether all poles, that of the integration apart, lie inside the unit circle."""
        a = self.feedback
        return bool(np.isfinite(a).all()) and (not len(a) or np.abs(np.roots([1.0, *-a])).max() < STABLE)


def columns_of(rows: Rows, output: int, order: Order) -> tuple[list[int], list[int]]:
    """Columns of `Rows` that an order feeds back, and those it is driven by (the constant first)."""
    at = rows.output(output)
    back = range(at + 1, at + 1 + order.past) if order.rate else range(at, at + order.past)
    driven = [0] + [rows.input(i) + d + m for i, (d, n) in enumerate(order.windows) for m in range(n)]
    return list(back), driven


def fitted(rows: Rows, factor: np.ndarray, output: int, order: Order) -> Equation:
    """The equation by least squares one step ahead, from a triangular factor of `Rows`."""
    back, driven = columns_of(rows, output, order)
    target = factor[:, rows.target(output)]
    alone = not order.rate and not order.past
    if alone:
        target = target + factor[:, rows.output(output)]
    return equation(order, solved(factor, back + driven, target))


def equation(order: Order, coefficients: np.ndarray) -> Equation:
    """From the coefficients in the order of `columns_of`."""
    past, keys = order.past, [(i, d + m) for i, (d, n) in enumerate(order.windows) for m in range(n)]
    back, constant, inputs = coefficients[:past], coefficients[past], coefficients[past + 1 :]
    if order.rate:
        level, increments = 0.0, back
    else:
        level, increments = (float(back[0]), back[1:]) if past else (-1.0, back)
    return Equation(order, level, increments, float(constant), dict(zip(keys, inputs.tolist(), strict=True)))


def free_run(eq: Equation, driven: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Output (n,) with what the inputs drive (n,), on from the past ``y`` (y[-1] last, at least `past` + 1 of them)."""
    from scipy.signal import lfilter

    order, a = eq.order, eq.feedback
    if not order.rate and not order.past:
        return driven
    past = np.diff(y)[::-1] if order.rate else y[::-1]
    start = np.array([a[m:] @ past[: len(a) - m] for m in range(len(a))])
    run = lfilter([1.0], [1.0, *-a], driven, zi=start)[0] if len(a) else driven
    return y[-1] + np.cumsum(run) if order.rate else run


def free_run_of(
    rows: Rows, part: int, output: int, eq: Equation, first: int = 0, last: int | None = None
) -> np.ndarray:
    """Samples ``first`` to ``last`` of an output in a recording of ``rows``, on from its measured past."""
    _, columns = columns_of(rows, output, eq.order)
    measured = rows.parts[part].y[:, output]
    before = measured[np.maximum(np.arange(first - rows.past - 1, first) + (first == 0), 0)]
    first += first == 0  # a run begins with the measured sample
    driven = rows.matrices[part][first:last, columns] @ np.array([eq.constant, *eq.inputs.values()])
    with np.errstate(over="ignore", invalid="ignore"):
        run = free_run(eq, driven, before)
    return run


@dataclass(eq=False)
class Search:
    """Orders of one output at one period, by the mean square of free runs over what is held out, over scales."""

    rows: Rows
    output: int
    asked: Asked
    errors: dict[Order, float] = field(default_factory=dict)

    def error(self, order: Order) -> float:
        """Remembered; infinite where the equation is unstable or too large for the rows."""
        if order not in self.errors:
            self.errors[order] = self._error(order)
        return self.errors[order]

    def _error(self, order: Order) -> float:
        rows = self.rows
        if max(d + n - 1 for d, n in order.windows) > rows.reach or order.past > rows.past:
            return np.inf
        if ROWS * order.size > rows.fitted:
            return np.inf
        equations = [fitted(rows, factor, self.output, order) for factor in rows.factors]
        return held_out_error(rows, self.output, equations)

    def run(self) -> Order:
        """The best order of either form."""
        forms = (False, True) if self.asked.rate is None else (self.asked.rate,)
        return min((self._best(rate) for rate in forms), key=self.error)

    def by_fold(self, order: Order) -> np.ndarray:
        """Mean squares of the free runs over every fold that is held out, (folds,)."""
        equations = [fitted(self.rows, factor, self.output, order) for factor in self.rows.factors]
        return held_out_errors(self.rows, self.output, equations)

    def _best(self, rate: bool) -> Order:
        """The best order of a form: its parts are moved one after the other until none helps."""
        asked = self.asked
        begin = Order(
            rate,
            min(2, self.rows.past) if asked.past is None else asked.past,
            (tuple(w if a is None else a for a, w in zip((asked.delay, asked.count), WINDOW, strict=True)),)
            * self.rows.parts[0].u.shape[1],
        )
        best = begin
        for _ in range(ROUNDS):
            before = best
            for moves in (self._pasts, self._delays, self._counts, self._apart, self._beside):
                best = min([best, *moves(best)], key=lambda o: (max(self.error(o), NOTHING), o.size))
            if best == before:
                break
        return best

    def ranked(self) -> list[Order]:
        """Orders that run, the simplest of those within `SIMPLER` of the least error first, then by error."""
        found = sorted((o for o, e in self.errors.items() if np.isfinite(e)), key=self.error)
        near = [o for o in found if self.error(o) <= SIMPLER**2 * self.error(found[0]) + NOTHING]
        first = min(near, key=lambda o: (o.size, self.error(o)), default=None)
        return [first, *(o for o in found if o != first)] if found else []

    def _pasts(self, order: Order) -> Iterator[Order]:
        return (replace(order, past=past) for past in self.asked.pasts(self.rows.past))

    def _delays(self, order: Order) -> Iterator[Order]:
        for delay in self.asked.delays:
            yield replace(order, windows=tuple((delay, count) for _, count in order.windows))

    def _counts(self, order: Order) -> Iterator[Order]:
        for count in self.asked.counts:
            yield replace(order, windows=tuple((delay, count) for delay, _ in order.windows))

    def _apart(self, order: Order) -> Iterator[Order]:
        """Every input on its own, where there are several."""
        for i, (delay, count) in enumerate(order.windows if len(order.windows) > 1 else ()):
            windows = [*((d, count) for d in self.asked.delays), *((delay, n) for n in self.asked.counts)]
            for window in windows:
                yield replace(order, windows=(*order.windows[:i], window, *order.windows[i + 1 :]))

    def _beside(self, order: Order) -> Iterator[Order]:
        """A sample more or less at either end of the window of an input."""
        asked = self.asked
        for i, (delay, count) in enumerate(order.windows):
            for d, n in ((delay + 1, count - 1), (delay, count - 1), (delay - 1, count + 1), (delay, count + 1)):
                fixed = asked.delay not in (None, d) or asked.count not in (None, n)
                if 0 <= d <= max(asked.latest, delay) and n >= 1 and not fixed:
                    yield replace(order, windows=(*order.windows[:i], (d, n), *order.windows[i + 1 :]))


def held_out_error(rows: Rows, output: int, equations: Sequence[Equation]) -> float:
    """Mean square of free runs, each held fold by the equation without it; infinite where one is not stable."""
    squares = _squares(rows, output, equations)
    if squares is None:
        return np.inf
    with np.errstate(over="ignore", invalid="ignore"):
        error = float(np.mean(np.concatenate([s for _, s in squares])))
    return error if np.isfinite(error) else np.inf


def held_out_errors(rows: Rows, output: int, equations: Sequence[Equation]) -> np.ndarray:
    """The same by fold, (folds,); infinite for all where an equation is not stable."""
    squares = _squares(rows, output, equations)
    if squares is None:
        return np.full(len(rows.held), np.inf)
    fold, square = (np.concatenate(part) for part in zip(*squares, strict=True))
    with np.errstate(over="ignore", invalid="ignore"):
        return np.array([square[fold == k].mean() if (fold == k).any() else np.inf for k in rows.held])


def _squares(rows: Rows, output: int, equations: Sequence[Equation]) -> list[tuple[np.ndarray, np.ndarray]] | None:
    """By recording, the fold of every recorded time and the square missed there; None where one is not stable."""
    if not all(e.stable for e in equations):
        return None
    found = []
    for k, (part, cuts) in enumerate(zip(rows.parts, rows.cuts, strict=True)):
        pieces = [(eq, *cuts[fold : fold + 2]) for fold, eq in zip(rows.held, equations, strict=True)]
        runs = [free_run_of(rows, k, output, eq, a, b) for eq, a, b in pieces if a < b]
        if runs:
            miss = part.miss(np.concatenate([part.y[:1, output], *runs]), output)
            begins = np.append(part.time, np.inf)[cuts[1:-1]]
            fold = np.searchsorted(begins, part.own_time[: len(miss)], side="right")
            with np.errstate(over="ignore", invalid="ignore"):
                found.append((fold, miss**2))
    return found
