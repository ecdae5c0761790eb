"""Confirm: of several effects, those that recordings which took no part speak against are taken back.

A law that is not quite the machine's leaves something, and of sixty effects one will follow that where both were
fitted: a drive that drifts, beside a flow that saturates more suddenly than written. Elsewhere it does harm. A name
must hold where nobody looked, each of several by itself.
"""

from __future__ import annotations

import dataclasses

from hydrotwin.models.effects import Candidate

from .answering import Found, final_job
from .decide import T_NEEDED, WORTH, compared
from .forward import reduced
from .recordings import Split
from .refinements import with_refinements
from .refit import refit
from .search import Search
from .structure import Structure
from .verdict import AGAINST


def confirmed(search: Search, data: Split, found: Found) -> Found:
    """What was found without what the recordings that judge are explained better without, one after the other."""
    while data.report and len(found.last.members) > 1:
        refuted = _most_refuted(search, data, found.last)
        less = refuted and _without(search, found, refuted)
        if less is None:
            break
        found = with_refinements(search, less)
    return found


def _most_refuted(search: Search, data: Split, now: Structure) -> Candidate | None:
    """The effect of ``now`` without which the others, fitted again, do clearly better on those recordings."""
    q = dataclasses.replace(search.question, fit=data.train, select=data.report)
    jobs = [final_job(search, q, s) for s in (now, *(_less(now, m) for m in now.members))]
    whole, *others = search.run(refit, jobs, "look back")
    if isinstance(whole, str):
        return None
    found = []
    for member, other in zip(now.members, others, strict=True):
        over = None if isinstance(other, str) else compared(other, whole, q)
        if over and over.paired_t > T_NEEDED and over.closed > WORTH:
            found.append((over.paired_t, member))
    return max(found, key=lambda pair: pair[0])[1] if found else None


def _less(now: Structure, member: Candidate) -> Structure:
    """The others, as they stand beside it."""
    return Structure(tuple(m for m in now.members if m is not member), now.fitted)


def _without(search: Search, found: Found, refuted: Candidate) -> Found | None:
    """What was found without this effect, the reason beside it in the table of what was tried; None when it stays."""
    (fitted,) = search.run(refit, [search.refit_of(_less(found.last, refuted))], "look back")
    step = next((s for s in found.steps if refuted in s.choice.best.members), None)
    if step is None or isinstance(fitted, str):
        return None
    told = tuple(dataclasses.replace(t, reason=AGAINST) if refuted in t.members else t for t in step.tried)
    last = search.keep(Structure(_less(found.last, refuted).members, fitted))
    less = reduced(search, found, last)
    if refuted in less.last.members:  # of a pair: alone it was better than the other, and nothing is gained
        return None
    return dataclasses.replace(less, screens=(*less.screens, (None, step.ranked, told)))
