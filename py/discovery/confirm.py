"""Confirm: of several effects, those that recordings left out of the fit speak against are taken back.

A law that is not quite the machine's leaves something, and of sixty effects one will follow that where it was fitted:
a drive that drifts, beside a flow that saturates more suddenly than written. Elsewhere it does harm. A name must hold
where nobody looked, each of several by itself: so the recordings to learn from are left out of the fit in turn.
Source: S. Geisser, The predictive sample reuse method, Journal of the American Statistical Association 1975.
"""

from __future__ import annotations

import dataclasses
import itertools

from hydrotwin.models.effects import Candidate

from .answering import Found, fitted_to
from .decide import T_NEEDED, WORTH, Evidence, compared
from .forward import reduced
from .refinements import with_refinements
from .refit import Question, Refitted, refit
from .search import Search
from .structure import Structure
from .verdict import AGAINST

FOLDS = 3  # parts of the recordings that are left out one after the other; with fewer recordings nothing is asked


def confirmed(search: Search, found: Found) -> Found:
    """What was found without what the recordings left out are explained better without, one effect after the other."""
    while len(found.last.members) > 1:
        refuted = _most_refuted(search, found.last)
        less = refuted and _without(search, found, refuted)
        if less is None:
            break
        found = with_refinements(search, less)
    return found


def folds(q: Question) -> list[Question]:
    """The question with another part of its recordings left out of the fit each time; none where they are too few."""
    learned = (*q.fit, *q.select) if q.held_out else ()
    if len(learned) < FOLDS:
        return []
    parts = [tuple(learned[k::FOLDS]) for k in range(FOLDS)]
    return [
        dataclasses.replace(q, fit=tuple(itertools.chain(*parts[:k], *parts[k + 1 :])), select=parts[k])
        for k in range(FOLDS)
    ]


def _most_refuted(search: Search, now: Structure) -> Candidate | None:
    """The effect of ``now`` without which the others, fitted again, do clearly better on what was left out."""
    parts = folds(search.question)
    if not parts:
        return None
    structures = [now, *(now.without(m) for m in now.members)]
    answers = search.run(refit, [fitted_to(search, q, s) for s in structures for q in parts], "look back")
    whole, *others = (answers[k : k + FOLDS] for k in range(0, len(answers), FOLDS))
    found = []
    for member, other in zip(now.members, others, strict=True):
        over = _over_all(other, whole, search.question)
        if over and over.paired_t > T_NEEDED and over.closed > WORTH:
            found.append((over.paired_t, member))
    return max(found, key=lambda pair: pair[0])[1] if found else None


def _over_all(better: list[Refitted | str], other: list[Refitted | str], q: Question) -> Evidence | None:
    """Evidence for one structure over another from all that was left out; None where a fit of either diverges."""
    if any(isinstance(fitted, str) for fitted in (*better, *other)):
        return None
    one, two = (
        dataclasses.replace(f[0], residuals_select=tuple(r for each in f for r in each.residuals_select))
        for f in (better, other)
    )
    return compared(one, two, q)


def _without(search: Search, found: Found, refuted: Candidate) -> Found | None:
    """What was found without this effect, the reason beside it in the table of what was tried; None when it stays."""
    (fitted,) = search.run(refit, [search.refit_of(found.last.without(refuted))], "look back")
    step = next((s for s in found.steps if refuted in s.choice.best.members), None)
    if step is None or isinstance(fitted, str):
        return None
    told = tuple(dataclasses.replace(t, reason=AGAINST) if refuted in t.members else t for t in step.tried)
    last = search.keep(Structure(found.last.without(refuted).members, fitted))
    less = reduced(search, found, last)
    if refuted in less.last.members:  # of a pair: alone it was better than the other, and nothing is gained
        return None
    return dataclasses.replace(less, screens=(*less.screens, (None, step.ranked, told)))
