"""The base: the model as it came, identified before any effect is looked for."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np

from hydrotwin.identification.problem import free_parameters
from hydrotwin.identification.tuned import tuned_starts

from .refit import Led, RefitJob, Refitted, lead, refit
from .search import Search

STAGE = "identify the base"
SAME = 0.02  # in q: starts that have come so close through the first windows end in one place


def identified(search: Search, meanwhile: Iterable = ()) -> Refitted | str:
    """The base fitted from where it came and from other frequencies of its fastest lightly damped mode.

    The lowest; ``search.first`` is where it began. A sentence when it diverges from all of them. A base in the wrong
    hollow would leave a gap that no effect explains, or that a wrong one does. Starts that the first windows lead to
    the same place are followed once.
    """
    flat, question = search.base.flat, search.question
    starts = [search.first, *tuned_starts(flat, question.fit, free_parameters(flat, search.free))]
    jobs = [RefitJob(flat, search.free, question, (start,), coarse=True, label=flat.name) for start in starts]
    if len(jobs) > 1:
        jobs = _apart(jobs, search.run(lead, jobs, STAGE, meanwhile))
        meanwhile = ()
    answers = search.run(refit, jobs, STAGE, meanwhile)
    found = [(fitted, job.starts[0]) for fitted, job in zip(answers, jobs, strict=True) if not isinstance(fitted, str)]
    if not found:
        return answers[0]
    best, search.first = min(found, key=lambda pair: pair[0].likelihood)
    return best


def _apart(jobs: Sequence[RefitJob], led: Sequence[Led | str]) -> list[RefitJob]:
    """The jobs that go on: one of those that stand in the same place, and from its start what diverged in windows."""
    kept: list[RefitJob] = []
    for job, end in zip(jobs, led, strict=True):
        if isinstance(end, str):
            kept.append(job)
        elif not any(k.led and np.abs(end.q - k.led.q).max() < SAME for k in kept):
            kept.append(dataclasses.replace(job, led=end))
    return kept
