"""Windows: a structure led from the start through short windows to longer ones, every start state free.

A free run from a wrong start leaves the recording, and an effect that is missing bends the base to its bounds; over a
fraction of a second neither happens. What a structure leaves there tells soon what it promises.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping

import numpy as np

from hydrotwin.identification import horizon
from hydrotwin.identification.descent import Task, undecided, windows
from hydrotwin.identification.least_squares import minimise
from hydrotwin.identification.noise import weights
from hydrotwin.identification.shooting import Shooting
from hydrotwin.models.language.errors import SolveError

from .job import Job, Look, broad, not_below, task_of

STAGE = {"absolute": 0.5, "relative": 3e-3, "stalled": 2.0, "most": 8}  # of a minimisation over windows
TURNS = 2  # of weights and minimum at every length
CHANGED = np.log(1.5)  # of the sizes that are left, from which on another turn is worth it


def look(job: Job) -> Look | str:
    """Lead a structure through some lengths of windows; a sentence when it diverges there. Pure and picklable."""
    began = time.perf_counter()
    try:
        return dataclasses.replace(_led(job.beginning()), seconds=time.perf_counter() - began)
    except SolveError as error:
        return str(error)


def _led(job: Job) -> Look:
    q, (begin, end) = job.question, job.stages
    size = broad(q) if job.size is None else not_below(q.noise, job.size)
    names = [s.name for s in job.flat.states]
    task = task_of(job, job.starts[0], size, names, few_runs=True)
    point, states = _cheapest(task, job, q.lengths[0])
    squares, counts, trail = [], [], []
    for seconds in q.lengths[begin:end]:
        for _ in range(TURNS):
            shooting, z = windows(undecided(task), point, seconds, states)
            found = minimise(shooting, point, z, **STAGE, until=job.seconds)
            point = found.q
            states = _filled(task, point, q.lengths[0], shooting.trajectories(found.q, found.z))
            left, count = _left(shooting, found)
            before, size = size, not_below(q.noise, np.sqrt(left / np.maximum(count, 1)))
            task = dataclasses.replace(task, weights=weights(size))
            if not np.nanmax(np.abs(np.log(size / before))) > CHANGED:
                break
        squares.append(left)
        counts.append(count)
        trail.append(dict(zip(task.free.names, task.free.values(point).tolist(), strict=True)))
    first = tuple(dict(zip(names, x[0].tolist(), strict=True)) for x in states)
    return Look(trail[-1], np.array(squares), np.array(counts), size, first, tuple(trail[:-1]))


def _cheapest(task: Task, job: Job, seconds: float) -> tuple[np.ndarray, list[np.ndarray]]:
    """Scaled parameters of the start that costs least in the shortest windows, and state trajectories (n, nx)."""
    points = [_point(task, start) for start in job.starts]
    states = _guess(task, points[0], seconds)
    if len(points) > 1:
        shooting, z = windows(task, points[0], seconds, states)
        points.sort(key=lambda q: shooting.cost(q, z))
    return points[0], states


def _point(task: Task, start: Mapping[str, float]) -> np.ndarray:
    free = task.free
    first = dict(zip(free.names, free.start.tolist(), strict=True))
    values = np.array([start.get(n, first[n]) for n in free.names])
    return free.scaled(np.clip(values, free.lower, free.upper))


def _guess(task: Task, q: np.ndarray, seconds: float) -> list[np.ndarray]:
    return horizon.first_guess(task.flat, task.recordings, task.propagator, task.free.vector(q), seconds)


def _filled(task: Task, q: np.ndarray, seconds: float, states: list[np.ndarray]) -> list[np.ndarray]:
    """State trajectories with those of short runs where none is known."""
    if all(np.isfinite(x).all() for x in states):
        return states
    return [np.where(np.isfinite(x), x, g) for x, g in zip(states, _guess(task, q, seconds), strict=True)]


def _left(shooting: Shooting, found) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squares (ny,), SI, of all windows, and how many values they are worth beside the free start states."""
    squares = found.at.squares
    counts = np.sum([seen.sum(axis=0) for seen in shooting._measured], axis=0).astype(float)
    with np.errstate(invalid="ignore"):
        total = np.where(np.isfinite(squares), squares, np.inf).sum(axis=0)
    spent = shooting.locals * len(shooting.segments)
    return np.where(counts > 0, total, 0.0), counts * max(1 - spent / max(counts.sum(), 1), 0.1)
