"""Fit of the piecewise linear characteristic: both saturations by linear least squares, edges and dead time outside."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ..grey_box.data import Run, Watch, best_ratio, weighing
from ..grey_box.fit import monotone, shares
from ..interruption import INTERRUPTED
from .block import whole_and_share

LONGEST = 125  # periods of dead time
SCAN_KNOTS = 13
NARROWEST = 1e-3  # of the range of the input: the way from a deadband's edge to saturation


@dataclass(frozen=True, eq=False)
class Curve:
    """Dead time [s], edges (4,) [input] and the rates (2,) at the outer ones; loss: mean square of weighed misses."""

    dead_time: float
    edges: np.ndarray
    rates: np.ndarray
    loss: float
    misses: np.ndarray


@dataclass(frozen=True, eq=False)
class CurveProblem:
    """Runs of one input and one output, a dead time where it is given, and how misses are weighed (see `weighing`)."""

    runs: Sequence[Run]
    period: float
    integrating: bool
    dead_time: float | None
    ratio: float | None

    @property
    def span(self) -> tuple[float, float]:
        """Range of the input."""
        return min(r.input.min() for r in self.runs), max(r.input.max() for r in self.runs)

    def rows(self, columns_of: Callable[[Run], np.ndarray]) -> np.ndarray:
        """Weighed rows of what ``columns_of`` gives at the block's samples."""
        maps = weighing(self.runs, self.ratio)
        return np.concatenate([weigh(run.sampled(columns_of(run))) for run, weigh in zip(self.runs, maps, strict=True)])

    def target(self) -> np.ndarray:
        """The weighed outputs."""
        maps = weighing(self.runs, self.ratio)
        return np.concatenate([weigh(run.output) for run, weigh in zip(self.runs, maps, strict=True)])


def late(columns: np.ndarray, dead_time: float, period: float, integrating: bool) -> np.ndarray:
    """What columns (m, ...) of the input cause after the dead time, integrated where the output integrates."""
    whole, share = whole_and_share(dead_time, period)
    padded = np.concatenate([np.repeat(columns[:1], whole + 1, axis=0), columns])[: len(columns) + 1]
    late = (1 - share) * padded[1:] + share * padded[:-1]
    if not integrating:
        return late
    return np.concatenate([np.zeros_like(late[:1]), np.cumsum(period * late[:-1], axis=0)])


def _sides(u: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """How far the input is along each slope, (m, 2), 0 in the deadband and 1 in saturation."""
    a, b, c, d = edges
    return np.column_stack([np.clip((b - u) / (b - a), 0, 1), np.clip((u - c) / (d - c), 0, 1)])


def output_of(problem: CurveProblem, curve: Curve, run: Run) -> np.ndarray:
    """Output of the curve at the block's samples, (m,), from zero where it integrates."""
    sides = late(_sides(run.input, curve.edges), curve.dead_time, problem.period, problem.integrating)
    return sides @ curve.rates


def _evaluate(problem: CurveProblem, dead_time: float, edges: np.ndarray) -> Curve:
    """The best saturations, hence slopes, for these edges."""

    def columns(run):
        return late(_sides(run.input, edges), dead_time, problem.period, problem.integrating)

    rows, target = problem.rows(columns), problem.target()
    rates = np.linalg.lstsq(rows, target, rcond=None)[0]
    misses = target - rows @ rates
    return Curve(dead_time, edges, rates, float(np.mean(misses**2)), misses)


def fit_curve(problem: CurveProblem, judges, starts: int, watch: Watch) -> Curve:
    """Scan the dead time with a free monotone curve, put four edges on it, refine, weigh anew, refine."""
    try:
        dead_time = scan_dead_time(problem)
        for delay, edges in [(dead_time, e) for e in _edges_on_curve(problem, dead_time, 1)]:
            watch(_evaluate(problem, delay, edges))
        problem = _reweighed(problem, watch.best)
        dead_time = scan_dead_time(problem)
        watch.anew()
        tried = [_refine(problem, dead_time, edges, watch) for edges in _edges_on_curve(problem, dead_time, starts)]
        best = min(tried, key=lambda curve: _judged(problem, judges, curve))
        problem = _reweighed(problem, best)
        watch.anew()
        return _refine(problem, best.dead_time, best.edges, watch)
    except KeyboardInterrupt:
        if watch.best is None:
            raise
        watch.stopped = INTERRUPTED
        return watch.best


def scan_dead_time(problem: CurveProblem) -> float:
    """The dead time at which a free monotone curve is best."""
    if problem.dead_time is not None:
        return problem.dead_time
    h = problem.period
    delays = [0.0, *np.geomspace(h, 0.7 * LONGEST * h, 9)]
    losses = [float(np.mean(_free_curve(problem, delay)[2] ** 2)) for delay in delays]
    return float(delays[int(np.argmin(losses))])


def _free_curve(problem: CurveProblem, dead_time: float):
    """Knots, the monotone values at them, misses, and the weight of each knot."""
    knots = np.linspace(*problem.span, SCAN_KNOTS)
    rows = problem.rows(lambda run: late(shares(run.input, knots).T, dead_time, problem.period, problem.integrating))
    values, misses = monotone(rows, problem.target(), knots)
    return knots, values, misses, np.square(rows).sum(axis=0)


def _edges_on_curve(problem: CurveProblem, dead_time: float, keep: int) -> list[np.ndarray]:
    """Sets of four edges among the knots of a free curve, the ones that come nearest to it."""
    knots, values, _, weight = _free_curve(problem, dead_time)
    root = np.sqrt(weight)
    scored = []
    for chosen in combinations(range(len(knots)), 4):
        edges = knots[list(chosen)]
        sides = _sides(knots, edges) * root[:, None]
        rates = np.linalg.lstsq(sides, values * root, rcond=None)[0]
        scored.append((float(np.sum((values * root - sides @ rates) ** 2)), chosen))
    return [knots[list(chosen)] for _, chosen in sorted(scored)[:keep]]


def _refine(problem: CurveProblem, dead_time: float, edges: np.ndarray, seen: Callable) -> Curve:
    """Move edges and dead time to the least loss."""
    from scipy.optimize import least_squares

    low, high = problem.span
    width, h, free = high - low, problem.period, problem.dead_time is None
    a, b, c, d = edges
    first = np.array([(b - low) / width, (c - b) / width, (b - a) / width, (d - c) / width, dead_time / h])

    def decoded(z):
        b = low + width * z[0]
        c = b + width * z[1]
        edges = np.array([b - width * z[2], b, c, c + width * z[3]])
        edges[0] = min(max(edges[0], low), b - NARROWEST * width)
        edges[3] = max(min(edges[3], high), c + NARROWEST * width)
        return (float(z[4]) * h if free else problem.dead_time), edges

    def misses(z):
        curve = _evaluate(problem, *decoded(z))
        seen(curve)
        return curve.misses

    lower = np.array([0, 0, NARROWEST, NARROWEST, 0.0])[: 4 + free]
    upper = np.array([1, 1, 1.1, 1.1, LONGEST])[: 4 + free]
    start = np.clip(first[: 4 + free], lower + 1e-4, upper - 1e-4)
    scale = np.median(np.abs(problem.target())) or 1.0
    found = least_squares(
        lambda z: misses(z) / scale, start, bounds=(lower, upper), xtol=1e-13, ftol=1e-13, gtol=1e-15, max_nfev=40
    )
    return _evaluate(problem, *decoded(found.x))


def _judged(problem: CurveProblem, judges, curve: Curve) -> float:
    if not judges:
        return curve.loss
    other = replace(problem, runs=judges)
    return float(np.mean((other.target() - other.rows(lambda run: output_of(problem, curve, run))) ** 2))


def _reweighed(problem: CurveProblem, curve: Curve) -> CurveProblem:
    """The problem with the most likely ratio of walk to sensor noise."""
    if problem.ratio is None:
        return problem
    misses = [np.diff(run.output - run.sampled(output_of(problem, curve, run))) for run in problem.runs]
    if max(np.abs(m).max() for m in misses) <= 1e-9 * max(np.ptp(run.output) for run in problem.runs):
        return problem  # nothing is left to weigh
    return replace(problem, ratio=best_ratio(problem.runs, misses))
