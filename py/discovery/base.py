"""The base: the model as it came, identified before any effect is looked for."""

from __future__ import annotations

from collections.abc import Iterable

from hydrotwin.identification.problem import free_parameters
from hydrotwin.identification.tuned import tuned_starts

from .refit import RefitJob, Refitted, refit
from .search import Search


def identified(search: Search, meanwhile: Iterable = ()) -> Refitted | str:
    """The base fitted from where it came and from other frequencies of its fastest lightly damped mode.

    The lowest; ``search.first`` is where it began. A sentence when it diverges from all of them. A base in the wrong
    hollow would leave a gap that no effect explains, or that a wrong one does.
    """
    flat, question = search.base.flat, search.question
    starts = [search.first, *tuned_starts(flat, question.fit, free_parameters(flat, search.free))]
    jobs = [RefitJob(flat, search.free, question, (start,), coarse=True, label=flat.name) for start in starts]
    answers = search.run(refit, jobs, "identify the base", meanwhile)
    found = [(fitted, start) for fitted, start in zip(answers, starts, strict=True) if not isinstance(fitted, str)]
    if not found:
        return answers[0]
    best, search.first = min(found, key=lambda pair: pair[0].likelihood)
    return best
