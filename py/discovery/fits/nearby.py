"""Minima nearby: whole recordings may have several, close to each other along what they say least about.

A lightly damped mode that rings through a whole recording makes them. Where windows explain all, and a fit to whole
recordings does not, it came to rest in one of the wrong ones: points along its weakest directions lead to the others.
"""

from __future__ import annotations

import contextlib
import dataclasses
import time

import numpy as np

from hydrotwin.identification.descent import Task, along_valleys, whole_runs
from hydrotwin.identification.least_squares import Minimum, minimise
from hydrotwin.models.language.errors import SolveError

from .job import Fitted, Job
from .whole import FIRST, TOLERANCE, concluded, first, precisely

LENGTHS = (-0.2, -0.1, 0.1, 0.2)  # how far, in q of the parameter that moves most
DIRECTIONS = 3  # in which the recordings say least
STEPS = 8  # from there, which show where it leads
MOVES = 4  # from minimum to minimum, at most


def lowest_nearby(job: Job) -> Fitted | str:
    """Fit a structure to whole recordings, and go on to lower minima beside that one until there is none.

    Pure and picklable. A sentence when it diverges.
    """
    began, job = time.perf_counter(), job.beginning()
    try:
        task, found = first(job, rough=True)
        for _ in range(MOVES):
            best = _beside(task, found, job.seconds)
            if best.cost > found.cost - 1.0:
                break
            found = minimise(whole_runs(task)[0], best.q, best.z, **TOLERANCE, most=job.iterations, until=job.seconds)
        answer = concluded(*precisely(job, task, found))
    except SolveError as error:
        return str(error)
    return dataclasses.replace(answer, seconds=time.perf_counter() - began)


def _beside(task: Task, found: Minimum, until: float) -> Minimum:
    """The lowest of a minimum and of a few steps from each point beside it."""
    shooting, free, best = whole_runs(task)[0], task.free, found
    lower, upper = free.scaled(free.lower), free.scaled(free.upper)
    for point in along_valleys(found, LENGTHS, DIRECTIONS):
        if time.process_time() > until:
            break
        with contextlib.suppress(SolveError):
            tried = minimise(shooting, np.clip(point, lower, upper), found.z, **FIRST, most=STEPS, until=until)
            best = min(best, tried, key=lambda m: m.cost)
    return best
