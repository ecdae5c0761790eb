"""The base: the model as it came, identified before any effect is looked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from hydrotwin.identification.problem import free_parameters
from hydrotwin.identification.tuned import tuned_starts

from .refit import Led, RefitJob, Refitted, lead, refit
from .search import Search

STAGE = "identify the base"
SAME = 0.02  # in q: starts that have come so close through the first windows end in one place


def identified(search: Search, meanwhile: Iterable = ()) -> Refitted | str:
    """The base fitted from where it came and from other frequencies of its fastest lightly damped mode.

    The lowest; ``search.first`` and ``search.first_size`` are how it began. A sentence when it diverges from all of
    them. A base in the wrong hollow would leave a gap that no effect explains, or that a wrong one does.

    An oscillation is small beside the motion. From where the base came, a few percent of the motion are allowed for
    errors: that finds gains and time constants and hardly sees the oscillation. The other starts know them from there,
    weigh by the noise, and so see nothing else. Those that the first windows lead to one place are followed once.
    """
    flat, question = search.base.flat, search.question
    own = RefitJob(flat, search.free, question, (search.first,), coarse=True, label=flat.name)
    meanwhile = iter(meanwhile)  # what one run of jobs leaves of it is for the next
    jobs, tuned = [own], tuned_starts(flat, question.fit, free_parameters(flat, search.free, search.first))
    if tuned:
        own = _going_on(own, *search.run(lead, [own], STAGE, meanwhile))
        known = {**search.first, **_values(own)}
        jobs = [dataclasses.replace(own, starts=({**known, **t},), size=question.noise, led=None) for t in tuned]
        jobs = _apart([own, *map(_going_on, jobs, search.run(lead, jobs, STAGE, meanwhile))])
    answers = search.run(refit, jobs, STAGE, meanwhile)
    found = [(fitted, job) for fitted, job in zip(answers, jobs, strict=True) if not isinstance(fitted, str)]
    if not found:
        return answers[0]
    best, job = min(found, key=lambda pair: pair[0].likelihood)
    search.first, search.first_size = job.starts[0], job.size
    return best


def _going_on(job: RefitJob, end: Led | str) -> RefitJob:
    """The job from where the first windows have led it; from its start where they diverged."""
    return job if isinstance(end, str) else dataclasses.replace(job, led=end)


def _values(job: RefitJob) -> Mapping[str, float]:
    """Free values by path where a job has been led."""
    free = free_parameters(job.flat, job.free, job.starts[0])
    return dict(zip(free.names, free.values(job.led.q).tolist(), strict=True)) if job.led else {}


def _apart(jobs: Sequence[RefitJob]) -> list[RefitJob]:
    """The jobs that go on: one of those that stand in the same place and weigh alike, and what diverged in windows."""
    free = free_parameters(jobs[0].flat, jobs[0].free, jobs[0].starts[0])
    kept: list[tuple[RefitJob, np.ndarray | None]] = []
    for job in jobs:
        q = free.scaled(np.array([_values(job)[n] for n in free.names])) if job.led else None
        alike = [k for other, k in kept if k is not None and (other.size is None) == (job.size is None)]
        if q is None or not any(np.abs(q - k).max() < SAME for k in alike):
            kept.append((job, q))
    return [job for job, _ in kept]
