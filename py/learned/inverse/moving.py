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

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..grey_box.data import best_ratio, block_period, falls, run_of
from ..grey_box.fit import bent_knots, monotone, shares
from ..piecewise.fit import CurveProblem, late, scan_dead_time
from ..training_data import check_excitation
from .falling import BINS, Fall, largest_fall

KNOTS, ROUNDS = 41, 3
SEEN = 0.05  # of the usual knot's weight: a knot with less was hardly visited, and is left out


@dataclass(frozen=True, eq=False)
class MovingCurve:
    """Commands and rates (or levels) at the knots that were visited, SI; the dead time [s], lags included.

    sigma : standard deviation of one of the rates, by what is left. fall : of a curve that may fall, see `falling`.
    """

    commands: np.ndarray
    rates: np.ndarray
    sigma: float
    dead_time: float
    fall: Fall | None = None


def moving_curve(
    records: Sequence[Record], input_: Signal, output: Signal, rate: bool, dead_time: float | None
) -> MovingCurve:
    """Fit the curve to whole recordings. rate : of the output, else its level; dead_time [s] : None finds it.

    Raises `DataError` for signals that never move, recordings that are too short, and what falls as the command rises.
    """
    check_excitation(records, (input_, output))
    period = block_period("characteristic", records, None)
    runs = [run_of(r, period, input_, output) for r in records]
    problem = CurveProblem(runs, period, rate, dead_time, 1.0 if rate else None)
    knots, at = np.linspace(*problem.span, KNOTS), scan_dead_time(problem)
    if falls(runs, rate):
        _refuse_turned(problem, at, knots, (input_.name, output.name))
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
    return MovingCurve(knots[visited], values[visited], sigma, at, _fall(problem, at))


def _fall(problem: CurveProblem, at: float) -> Fall | None:
    """Where a curve that may fall does, by least squares at even knots that were visited."""
    knots = np.linspace(*problem.span, BINS + 1)
    rows, target = problem.rows(lambda run: _columns(problem, run, at, knots)), problem.target()
    weight = (rows**2).sum(axis=0)
    visited = weight > SEEN * np.median(weight[weight > 0])
    values, *_ = np.linalg.lstsq(rows[:, visited], target, rcond=None)
    misses = target - rows[:, visited] @ values
    spread = np.linalg.pinv(rows[:, visited].T @ rows[:, visited]).diagonal()
    return largest_fall(knots[visited], values, np.sqrt(np.mean(misses**2) * spread))


def _refuse_turned(problem: CurveProblem, at: float, knots: np.ndarray, names: tuple[str, str]) -> None:
    """Raises DataError where the turned output rises with the command, and better: half a wave late, the output does.

    names : of input and output.
    """
    turned = replace(problem, runs=[replace(run, output=-run.output) for run in problem.runs])
    left = [
        np.mean(_fitted(p, late_by, knots)[1] ** 2) for p, late_by in ((problem, at), (turned, scan_dead_time(turned)))
    ]
    if left[1] < left[0]:
        raise DataError(
            f"characteristic of {names[1]}: it falls as '{names[0]}' rises, everywhere. What falls has no rising "
            "inverse. Turn the sign of one of the two."
        )


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
