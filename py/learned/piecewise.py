"""Learn a valve's piecewise linear characteristic, six numbers and a dead time, from command and position or speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from itertools import combinations
from time import perf_counter

import numpy as np

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .block_file import LearnedBlock, assemble
from .grey_box_data import (
    FitProgress,
    Run,
    Watch,
    best_ratio,
    block_period,
    certify,
    falls,
    named,
    one_in_one_out,
    run_of,
    seen_late,
    weighing,
)
from .grey_box_fit import monotone, shares
from .piecewise_block import PIECEWISE, piecewise_states, whole_and_share
from .training_data import training_box

LONGEST = 125  # periods of dead time
SCAN_KNOTS = 13
NARROWEST = 1e-3  # of the range of the input: the way from a deadband's edge to saturation
SIDES = ("saturated below", "deadband from", "deadband to", "saturated above")


@dataclass(frozen=True, eq=False)
class _Curve:
    """Dead time [s], edges (4,) [input] and the rates (2,) at the outer ones; loss: mean square of weighed misses."""

    dead_time: float
    edges: np.ndarray
    rates: np.ndarray
    loss: float
    misses: np.ndarray


@dataclass(frozen=True, eq=False)
class _Problem:
    runs: Sequence[Run]
    period: float
    integrating: bool
    dead_time: float | None
    ratio: float | None

    @property
    def span(self) -> tuple[float, float]:
        return min(r.input.min() for r in self.runs), max(r.input.max() for r in self.runs)

    def rows(self, columns_of: Callable[[Run], np.ndarray]) -> np.ndarray:
        maps = weighing(self.runs, self.ratio)
        return np.concatenate([weigh(run.sampled(columns_of(run))) for run, weigh in zip(self.runs, maps, strict=True)])

    def target(self) -> np.ndarray:
        maps = weighing(self.runs, self.ratio)
        return np.concatenate([weigh(run.output) for run, weigh in zip(self.runs, maps, strict=True)])


def learn_piecewise(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    period: float | None = None,
    validate: Sequence[Record] = (),
    dead_time: float | None = None,
    integrating: bool = True,
    starts: int = 3,
    seed: int = 0,
    name: str = "piecewise",
    progress: Callable[[FitProgress], None] | None = None,
) -> LearnedBlock:
    """Fit the characteristic of `piecewise_block` to recordings of one command and one output; answer it as a Block.

    The two slopes are linear least squares for given edges and dead time, which the outer solver moves. What is left
    of an integrating output is taken as sensor noise on a random walk (`grey_box_data.Whitening`).

    Args:
        records: training recordings without gaps, of even or uneven times. inputs, outputs: one each.
        period: s between steps of the block; None: as `grey_box_data.block_period` finds it.
        validate: recordings that choose among the starts; none: the training loss does.
        dead_time: s; None: found with the rest; 0: none.
        integrating: the characteristic gives the rate of the output (a position); False: the output itself (a speed).
        starts: curves refined, from the best of a scan. seed: kept for the record; nothing here is random.
        progress: called with a `FitProgress` after every evaluation.

    ``provenance["identified"]`` holds the edges, slopes, saturations and the machine's dead time. An edge at the end
    of the inputs seen means that no saturation was. Ctrl-C ends the fit with the best so far.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options.
    """
    began = perf_counter()
    _check_options(starts, dead_time)
    records, validate, input_, output = one_in_one_out("learn_piecewise", records, inputs, outputs, validate)
    period = block_period("learn_piecewise", records, period)
    runs, judges = ([run_of(r, period, input_, output) for r in part] for part in (records, validate))
    sign = -1.0 if falls(runs, integrating) else 1.0
    runs, judges = ([replace(r, output=sign * r.output) for r in part] for part in (runs, judges))
    problem = _Problem(runs, period, integrating, dead_time, 1.0 if integrating else None)
    watch = Watch(progress)
    curve = _fit(problem, judges, starts, watch)
    curve = replace(curve, rates=sign * curve.rates)
    block = _block(curve, integrating, period, name, records, input_, output)
    provenance = {
        "kind": "piecewise",
        "trained_on": named(records),
        "selected_on": named(validate) or "the training loss",
        "identified": _identified(curve, seen_late(records, period, input_) if dead_time is None else 0.0),
        "seed": seed,
        "evaluations": watch.evaluations,
        "seconds": round(perf_counter() - began, 2),
        "stopped": watch.stopped or "finished",
        "versions": {package: metadata.version(package) for package in ("numpy", "scipy", "casadi")},
    }
    expected = [_output(problem, curve, run) + sign * run.output[0] * integrating for run in runs]
    return replace(block, provenance=provenance, certificate=certify(block, runs, expected))


def _late(columns: np.ndarray, dead_time: float, period: float, integrating: bool) -> np.ndarray:
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


def _output(problem: _Problem, curve: _Curve, run: Run) -> np.ndarray:
    """Output of the curve at the block's samples, (m,), from zero where it integrates."""
    sides = _late(_sides(run.input, curve.edges), curve.dead_time, problem.period, problem.integrating)
    return sides @ curve.rates


def _evaluate(problem: _Problem, dead_time: float, edges: np.ndarray) -> _Curve:
    """The best saturations, hence slopes, for these edges."""

    def columns(run):
        return _late(_sides(run.input, edges), dead_time, problem.period, problem.integrating)

    rows, target = problem.rows(columns), problem.target()
    rates = np.linalg.lstsq(rows, target, rcond=None)[0]
    misses = target - rows @ rates
    return _Curve(dead_time, edges, rates, float(np.mean(misses**2)), misses)


def _fit(problem: _Problem, judges, starts: int, watch: Watch) -> _Curve:
    """Scan the dead time with a free monotone curve, put four edges on it, refine, weigh anew, refine."""
    try:
        dead_time = _scan_dead_time(problem)
        for delay, edges in [(dead_time, e) for e in _edges_on_curve(problem, dead_time, 1)]:
            watch(_evaluate(problem, delay, edges))
        problem = _reweighed(problem, watch.best)
        dead_time = _scan_dead_time(problem)
        watch.anew()
        tried = [_refine(problem, dead_time, edges, watch) for edges in _edges_on_curve(problem, dead_time, starts)]
        best = min(tried, key=lambda curve: _judged(problem, judges, curve))
        problem = _reweighed(problem, best)
        watch.anew()
        return _refine(problem, best.dead_time, best.edges, watch)
    except KeyboardInterrupt:
        if watch.best is None:
            raise
        watch.stopped = "interrupted"
        return watch.best


def _scan_dead_time(problem: _Problem) -> float:
    """The dead time at which a free monotone curve is best."""
    if problem.dead_time is not None:
        return problem.dead_time
    h = problem.period
    delays = [0.0, *np.geomspace(h, 0.7 * LONGEST * h, 9)]
    losses = [float(np.mean(_free_curve(problem, delay)[2] ** 2)) for delay in delays]
    return float(delays[int(np.argmin(losses))])


def _free_curve(problem: _Problem, dead_time: float):
    """Knots, the monotone values at them, misses, and the weight of each knot."""
    knots = np.linspace(*problem.span, SCAN_KNOTS)
    rows = problem.rows(lambda run: _late(shares(run.input, knots).T, dead_time, problem.period, problem.integrating))
    values, misses = monotone(rows, problem.target(), knots)
    return knots, values, misses, np.square(rows).sum(axis=0)


def _edges_on_curve(problem: _Problem, dead_time: float, keep: int) -> list[np.ndarray]:
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


def _refine(problem: _Problem, dead_time: float, edges: np.ndarray, seen: Callable) -> _Curve:
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


def _judged(problem: _Problem, judges, curve: _Curve) -> float:
    if not judges:
        return curve.loss
    other = replace(problem, runs=judges)
    return float(np.mean((other.target() - other.rows(lambda run: _output(problem, curve, run))) ** 2))


def _reweighed(problem: _Problem, curve: _Curve) -> _Problem:
    """The problem with the most likely ratio of walk to sensor noise."""
    if problem.ratio is None:
        return problem
    misses = [np.diff(run.output - run.sampled(_output(problem, curve, run))) for run in problem.runs]
    if max(np.abs(m).max() for m in misses) <= 1e-9 * max(np.ptp(run.output) for run in problem.runs):
        return problem  # nothing is left to weigh
    return replace(problem, ratio=best_ratio(problem.runs, misses))


def _identified(curve: _Curve, late: float) -> dict[str, float]:
    a, b, c, d = curve.edges
    low, high = curve.rates
    return dict(zip(SIDES, map(float, curve.edges), strict=True)) | {
        "slope below": float(-low / (b - a)),
        "slope above": float(high / (d - c)),
        "saturation below": float(low),
        "saturation above": float(high),
        "dead_time": curve.dead_time + late,
    }


def _block(curve: _Curve, integrating, period, name, records, input_: Signal, output: Signal) -> LearnedBlock:
    structure = {"delay": whole_and_share(curve.dead_time, period)[0] + 1, "integrating": int(integrating)}
    arrays = {"edges": curve.edges, "rates": curve.rates, "dead_time": [curve.dead_time], "period": [period]}
    return assemble(
        PIECEWISE,
        arrays,
        structure,
        name=name,
        inputs=(input_,),
        outputs=(output,),
        states=piecewise_states(structure, input_, output),
        parameters=(),
        period=period,
        domain=training_box(records, (input_, output)),
        description=(
            f"piecewise linear, nothing from {curve.edges[1]:.3g} to {curve.edges[2]:.3g} {input_.unit}, "
            f"dead time {1e3 * curve.dead_time:.3g} ms"
        ),
        provenance={},
    )


def _check_options(starts, dead_time) -> None:
    if int(starts) != starts or starts < 1:
        raise DeclarationError(f"learn_piecewise: starts must be a whole number from 1 up (got {starts}).")
    if dead_time is not None and not (np.isfinite(dead_time) and dead_time >= 0):
        raise DeclarationError(f"learn_piecewise: dead_time must not be negative (got {dead_time} s).")
