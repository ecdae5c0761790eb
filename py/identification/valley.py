"""Along the valleys: what else explains the recordings as well as the minimum that was found.

A lightly damped mode that the recordings barely show makes the cost rough: every phase of it is a hollow, the descent
rests in one, and (J^T J)^-1 describes that hollow alone. Residuals averaged over many periods of the mode do not see
it: their cost is smooth, its minimum is near the truth, and its ellipsoid says where the hollows to be tried lie (few
periods: a narrow ellipsoid, a careful search; many: a wide one). From points of that ellipsoid the full cost is
minimised again: a lower minimum is taken, others that are nearly as low show how far the truth may be (a coarse
profile likelihood).
Source: A. Raue et al., Bioinformatics 2009 (profile likelihood); D. Bates & D. Watts, Nonlinear Regression, 1988.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from scipy.special import chdtri, ndtri

from hydrotwin.models.language.errors import SolveError

from . import horizon
from .descent import Task, undecided, whole_runs
from .least_squares import Minimum, minimise
from .shooting import Shooting

LONG = 0.02  # sigma along an axis of the ellipsoid, in q, from which on hollows are looked for
LONGEST = 1.0  # of what is taken from the coarse ellipsoid, in q
AVERAGED = (16.0, 2.0)  # periods of the fastest lightly damped mode, in turns
FEWEST = 4  # samples averaged
ROUNDS = 3
POINTS = 8  # a power of two
LOOK, GO = 6, 25  # iterations: to see whether a point leads somewhere, and to get there
TROUBLE = 12  # iterations of free runs after which a minimum is not believed without another start
BLIND = 1e-14  # of the largest information: an axis without any
LOWER = 0.5  # units of cost worth another round


def along_the_valleys(
    task: Task, found: Minimum, rounds: int = ROUNDS, averaged: Sequence[float] = AVERAGED
) -> tuple[list[Minimum], bool]:
    """``found`` or what is lower, after it other minima that explain the recordings as well; whether it has settled."""
    if longest_axis(found) < LONG:
        return [found], found.iterations < TROUBLE
    shooting, _ = whole_runs(undecided(task))
    minima, since = [found], found.cost
    for number in range(rounds):
        for periods in averaged:
            task.report("along the valleys", 0, minima[0].cost)
            smooth = dataclasses.replace(shooting, averaged=_samples(task, minima[0], periods))
            points = _points(task, smooth, minima[0], seed=number)
            minima = _collected([*minima, *_reached(shooting, minima[0], points)])
        if minima[0].cost > since - LOWER:
            return minima, True
        since = minima[0].cost
    return minima, False


def longest_axis(found: Minimum) -> float:
    """Longest half-axis of the confidence ellipsoid in q, 0 where nothing is free."""
    if not len(found.q):
        return 0.0
    return float(1 / np.sqrt(np.maximum(np.linalg.eigvalsh(found.information())[0], np.finfo(float).tiny)))


def margin(parameters: int) -> float:
    """Units of cost within which the truth lies 99 times of 100."""
    return 0.5 * float(chdtri(parameters, 0.01))


def _samples(task: Task, found: Minimum, periods: float) -> int:
    """Samples in as many periods of the fastest lightly damped mode."""
    frequency = horizon.fastest_oscillation(task.flat, task.recordings, task.free.vector(found.q))
    period = float(np.median(np.concatenate([np.diff(r.time) for r in task.recordings])))
    shortest = min(len(r.time) for r in task.recordings)
    wanted = int(np.ceil(periods / frequency / period)) if frequency else int(FEWEST * periods)
    return min(max(FEWEST, wanted), max(1, shortest // 20))


def _points(task: Task, smooth: Shooting, found: Minimum, seed: int) -> Iterator[np.ndarray]:
    """The minimum of the smooth cost, then points of its ellipsoid."""
    from scipy.stats import qmc  # takes most of a second, and few fits come here

    lower, upper = (task.free.scaled(b) for b in (task.free.lower, task.free.upper))
    try:
        coarse = minimise(smooth, found.q, found.z, most=GO)
    except SolveError:
        coarse = found
    yield coarse.q
    values, vectors = np.linalg.eigh(coarse.information())
    seen = values > BLIND * values[-1]  # along the other axes the recordings say nothing: there is nowhere to look
    reach = np.where(seen, np.minimum(1 / np.sqrt(np.where(seen, values, 1.0)), LONGEST), 0.0)
    for normal in ndtri(qmc.Sobol(len(values), seed=seed).random_base2(int(np.log2(POINTS)))):
        yield np.clip(coarse.q + vectors @ (reach * normal), lower, upper)


def _reached(shooting: Shooting, found: Minimum, points: Iterator[np.ndarray]) -> list[Minimum]:
    reached = []
    for point in points:
        try:
            seen = minimise(shooting, point, found.z, most=LOOK)
            if not seen.converged and seen.cost < found.cost + margin(len(found.q)):
                seen = minimise(shooting, seen.q, seen.z, most=GO)
        except SolveError:
            continue
        reached.append(seen)
    return reached


def _collected(minima: Sequence[Minimum]) -> list[Minimum]:
    """The lowest first, then those within the margin of it."""
    ordered = sorted(minima, key=lambda m: m.cost)
    return [m for m in ordered if m.cost - ordered[0].cost < margin(len(m.q))]
