"""An ARX equation fitted to its free run (output error), from where least squares one step ahead ends.

What the run is off by depends on a coefficient through its own past, so its derivative runs through the same equation:

    dy[k]/dq = z_q[k] + sum_i a_i dy[k-i]/dq        z_q: what the coefficient q multiplies

A recording begins as the block does, at rest in its first sample: a level or a motion that were fitted along would be
what no user of the block can give. Source: Ljung, System Identification (1999), section 4.2.
"""

from __future__ import annotations

import numpy as np

from .gauss_newton import minimum
from .orders import Equation, Order, Search, columns_of, equation, fitted, held_out_error
from .regressors import Rows

ITERATIONS = 25


def refined(search: Search, order: Order) -> tuple[Equation, float] | None:
    """The equation of an order fitted to free runs over all recordings, and its error on what is held out.

    None where no stable equation came of it.
    """
    rows = search.rows
    starts = [fitted(rows, factor, search.output, order) for factor in rows.factors]
    held = [_fit(rows, search.output, eq, k) for k, eq in zip(rows.held, starts, strict=True)]
    if any(eq is None for eq in held):
        return None
    error = held_out_error(rows, search.output, held)
    whole = _fit(rows, search.output, fitted(rows, rows.all, search.output, order), rows.never)
    return None if whole is None or not np.isfinite(error) else (whole, error)


def _fit(rows: Rows, output: int, start: Equation, fold: int | None) -> Equation | None:
    """Fitted to free runs over all but one fold."""
    if not start.stable:
        return None
    runs = [_Run(rows, k, output, start.order, fold) for k in range(len(rows.parts))]

    def residual(parameters):
        eq = equation(start.order, parameters)
        if not eq.stable:
            return None
        r = np.concatenate([run.residual(eq) for run in runs])
        return r if np.isfinite(r).all() else None

    def jacobian(parameters):
        eq = equation(start.order, parameters)
        return np.concatenate([run.jacobian(eq) for run in runs])

    found = minimum(residual, jacobian, coefficients(start), ITERATIONS)
    eq = equation(start.order, found.parameters)
    return eq if np.isfinite(found.cost) and eq.stable else None


def coefficients(eq: Equation) -> np.ndarray:
    """In the order of `columns_of`: what is fed back, the constant, inputs."""
    back = eq.increments if eq.order.rate else [eq.level, *eq.increments][: eq.order.past]
    return np.array([*back, eq.constant, *eq.inputs.values()])


class _Run:
    """One recording of an output, run from rest in its first sample."""

    def __init__(self, rows: Rows, part: int, output: int, order: Order, fold: int | None):
        self.part, self.output, self.order = rows.parts[part], output, order
        self.driven = rows.matrices[part][:, columns_of(rows, output, order)[1]]
        self.start = float(self.part.y[0, output])
        self.times = np.ones(len(self.part.at_own_times(self.part.y[:, output])), dtype=bool)
        if fold is not None:
            a, b = rows.cuts[part][fold : fold + 2]
            own = self.part.own_time[: len(self.times)]
            if a < b:
                self.times[(own >= self.part.time[a]) & (own <= self.part.time[b - 1])] = False

    def run(self, eq: Equation) -> np.ndarray:
        """The output (n,) at the samples."""
        v = self.driven @ np.array([eq.constant, *eq.inputs.values()])
        return self._filtered(eq, v) + self._free(eq)

    def residual(self, eq: Equation) -> np.ndarray:
        """What it is off by, at the recorded times that count."""
        return self.part.miss(self.run(eq), self.output)[self.times]

    def jacobian(self, eq: Equation) -> np.ndarray:
        """By the coefficients."""
        n, order = len(self.driven), self.order
        y = np.concatenate([np.full(order.past + 2, self.start), self.run(eq)])
        d, at = np.diff(y, prepend=self.start), order.past + 2
        levels = [y[at - 1 : at - 1 + n]] if order.past and not order.rate else []
        columns = [*levels, *(d[at - lag : at - lag + n] for lag in range(1, order.past + order.rate))]
        driven = [self._filtered(eq, column) for column in (*columns, *self.driven.T)]
        return self.part.at_own_times(np.column_stack(driven))[self.times]

    def _filtered(self, eq: Equation, v: np.ndarray) -> np.ndarray:
        from scipy.signal import lfilter

        run = lfilter([1.0], [1.0, *-eq.feedback], v)
        return np.cumsum(run) if self.order.rate else run

    def _free(self, eq: Equation) -> np.ndarray:
        """The answer to the rest before the recording."""
        from scipy.signal import lfilter

        n, a = len(self.driven), eq.feedback
        if self.order.rate:
            return np.full(n, self.start)
        state = self.start * np.array([a[m:].sum() for m in range(len(a))])
        return lfilter([1.0], [1.0, *-a], np.zeros(n), zi=state)[0] if len(a) else np.zeros(n)
