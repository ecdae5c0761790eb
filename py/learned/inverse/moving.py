"""The characteristic of a machine whose command never rests long: a rising curve after a dead time, from all samples.

    dy/dt (t) = f(u(t - T))     or     y(t) = f(u(t - T)),     f rising

Piecewise linear with knots that gather where it bends; least squares for a given dead time, which is searched. Lags of
the machine are taken into the dead time. Play is averaged: half of it is early, half is late.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..grey_box.data import best_ratio, block_period, run_of
from ..grey_box.fit import bent_knots, monotone, shares
from ..piecewise.fit import CurveProblem, late, scan_dead_time
from ..training_data import check_excitation

KNOTS, ROUNDS = 41, 3
SEEN = 0.05  # of the usual knot's weight: a knot with less was hardly visited, and is left out


@dataclass(frozen=True, eq=False)
class MovingCurve:
    """Commands and rates (or levels) at the knots that were visited, SI; the dead time [s], lags included.

    sigma : standard deviation of one of the rates, by what is left.
    """

    commands: np.ndarray
    rates: np.ndarray
    sigma: float
    dead_time: float


def moving_curve(
    records: Sequence[Record], input_: Signal, output: Signal, rate: bool, dead_time: float | None
) -> MovingCurve:
    """Fit the curve to whole recordings. rate : of the output, else its level; dead_time [s] : None finds it.

    Raises `DataError` for signals that never move and recordings that are too short.
    """
    check_excitation(records, (input_, output))
    period = block_period("characteristic", records, None)
    runs = [run_of(r, period, input_, output) for r in records]
    problem = CurveProblem(runs, period, rate, dead_time, 1.0 if rate else None)
    knots, at = np.linspace(*problem.span, KNOTS), scan_dead_time(problem)
    for _ in range(ROUNDS):
        at = _nearest_dead_time(problem, at, knots)
        values = _fitted(problem, at, knots)[0]
        problem = _reweighed(problem, at, knots, values)
        knots = bent_knots(knots, values)
    values, misses, gram = _fitted(problem, at, knots)
    weight = np.diag(gram)
    visited = weight > SEEN * np.median(weight[weight > 0])
    spread = np.linalg.pinv(gram[np.ix_(visited, visited)]).diagonal()
    sigma = float(np.sqrt(np.mean(misses**2) * np.median(spread)))
    return MovingCurve(knots[visited], values[visited], sigma, at)


def _nearest_dead_time(problem: CurveProblem, around: float, knots: np.ndarray) -> float:
    """The dead time within a factor of two of ``around`` with which the curve leaves least."""
    if problem.dead_time is not None:
        return problem.dead_time
    bounds = (around / 2, max(2 * around, 2 * problem.period))

    def left(at: float) -> float:
        return float(np.mean(_fitted(problem, at, knots)[1] ** 2))

    tolerance = 0.1 * problem.period
    return float(minimize_scalar(left, bounds=bounds, method="bounded", options={"xatol": tolerance}).x)


def _fitted(problem: CurveProblem, at: float, knots: np.ndarray):
    """Values at the knots (k,), the weighed misses of the samples, and rows' rows (k, k)."""
    rows, target = problem.rows(lambda run: _columns(problem, run, at, knots)), problem.target()
    values = monotone(rows, target, knots)[0]
    return values, target - rows @ values, rows.T @ rows


def _columns(problem: CurveProblem, run, at: float, knots: np.ndarray) -> np.ndarray:
    return late(shares(run.input, knots).T, at, problem.period, problem.integrating)


def _reweighed(problem: CurveProblem, at: float, knots: np.ndarray, values: np.ndarray) -> CurveProblem:
    """The problem with the most likely ratio of walk to sensor noise."""
    if problem.ratio is None:
        return problem
    misses = [np.diff(r.output - r.sampled(_columns(problem, r, at, knots) @ values)) for r in problem.runs]
    if max(np.abs(m).max() for m in misses) <= 1e-9 * max(np.ptp(r.output) for r in problem.runs):
        return problem  # nothing is left to weigh
    return replace(problem, ratio=best_ratio(problem.runs, misses))
