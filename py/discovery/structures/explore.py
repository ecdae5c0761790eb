"""explore: the new search beside the one of `discover`, for the benchmark until it takes its place.

It finds a `Standing`, no `Discovery`: nothing is asked of recordings that judge, and nothing is told yet.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Executor

import numpy as np

from hydrotwin.identification.horizon import measured_start
from hydrotwin.identification.noise import quanta, solver_error

from ..asked import Asked, Wanted
from ..discover import inside
from ..evidence.deciding import DECIDING
from ..executor import Starts, cores_of, executor_for, mapped
from ..fits.job import Job, Question
from .search import EFFORTS, Search
from .standing import Standing, standing
from .table import Table


def explore(
    model,
    records: Sequence,
    *,
    effects: Sequence[str] | None = None,
    most: int = 3,
    effort: str = "normal",
    time_limit: float | None = None,
    initial_states: str = "auto",
    noise=None,
    executor: str | Executor | None = None,
    report: Callable[[str, int, float], None] | None = None,
) -> tuple[Search, Standing]:
    """The finished search and what its fits say.

    records, effects, initial_states, noise, executor as in `discover`; most: effects of a structure; effort: a key of
    `EFFORTS`; time_limit [s]; report: called with the stage, its number of jobs, and the seconds since the beginning.
    Raises what `discover` raises.
    """
    began = time.monotonic()
    asked = inside(model, Wanted(records, (), None, effects, (), initial_states, None, noise, None, None))
    with executor_for(executor) as pool:

        def run(function, jobs: Sequence[Job], stage: str) -> list:
            cores = cores_of(pool)
            last = len(jobs) % cores
            threads = [cores // last if len(jobs) - i <= last else 1 for i in range(len(jobs))]
            answers = list(mapped(pool, function, [portable(*job) for job in zip(jobs, threads, strict=True)]))
            if report:
                report(stage, len(jobs), time.monotonic() - began)
            return answers

        until = began + (np.inf if time_limit is None else time_limit)
        told = [o.name in (noise or {}) for o in asked.model.flat.outputs]
        search = Search(table_of(asked, told), run, EFFORTS[effort], most, until)
        search.go()
    return search, standing(search.table)


def table_of(asked: Asked, told: Sequence[bool]) -> Table:
    """The empty table of a search; told: outputs with a given noise."""
    flat, data = asked.bounded.flat, asked.data
    usual = {p.name: p.value for p in asked.model.flat.parameters if p.name in asked.names}
    question = Question(data.train, data.noise, initial_states=asked.initial_states, usual=usual)
    unseen = [o.name for o, n in zip(flat.outputs, question.counts, strict=True) if not n]
    here = tuple(c for c in asked.candidates if c.site.through not in unseen)  # no faults of sensors that are not
    digits = quanta(data.train)
    with np.errstate(invalid="ignore"):
        rounding = np.where(digits > DECIDING.coarse * data.noise, digits / np.sqrt(12), 0.0)
    coloured = np.fmax(solver_error(data.train), rounding)
    return Table(asked.bounded, asked.names, here, question, coloured, np.array(told))


def portable(job: Job, threads: int) -> Job:
    """A job that can travel: its model keeps the start functions that the job needs, and no others."""
    flat, order = job.flat, [s.name for s in job.flat.states]
    measured = {tuple(measured_start(flat, r)) for r in job.question.fit}
    together = set.intersection(*(set(names) for names in measured))
    wanted = {*measured, tuple(n for n in order if n in together), tuple(order)}
    wanted |= {tuple(n for n in order if n in states) for states in job.states}
    starts = Starts({names: flat.start_given(names) for names in wanted})
    return dataclasses.replace(job, flat=dataclasses.replace(flat, initialisation=starts), threads=threads)
