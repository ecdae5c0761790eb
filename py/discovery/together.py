"""Together: what no recording can confirm of another is named where it explains all of them, down to the noise.

A slide that meets one stop in one recording and the other stop in another tells nothing by recording: what is fitted to
the one cannot prove itself in the other. Where a search has ended so, or leaves nothing in what was fitted to and a lot
in what was not, all recordings to learn from are fitted to. Blocks of them then stand where held-out ones would, which
confirms less; so more is asked: nothing may be left, in any output of any recording. What validates is not looked at.
"""

from __future__ import annotations

import dataclasses

from .answering import Found
from .decide import CLEARLY, LARGE, closed, has_gap
from .ends import both_ends
from .forward import begun, searched
from .recordings import Split
from .refit import Question, RefitJob, Refitted, refit
from .search import Search
from .structure import Structure
from .verdict import CONFIRMED, likeliest, unconfirmed, verdict_of


def explained_together(search: Search, data: Split, found: Found, most: int) -> tuple[Search, Found]:
    """The search and where it ended; those of a search in all recordings where only that explains all there is."""
    known = likeliest(search, found)
    only_others = _only_others_show_more((known or found.base).fitted, search.question)
    if not only_others and (verdict_of(search, found) != "unknown" or not unconfirmed(search, found)):
        return search, found
    question = dataclasses.replace(
        search.question, fit=data.train, select=data.train, noise=search.sensors, inexact=False
    )
    again = search.asking(question)
    flat = again.base.flat
    size = again.first_size
    begun_anew = RefitJob(flat, again.free, question, (again.first,), size=size, coarse=True, label=flat.name)
    going_on = RefitJob(flat, again.free, question, (found.base.fitted.values,), label=flat.name)
    bases = [b for b in again.run(refit, [begun_anew, going_on], "identify the base") if not isinstance(b, str)]
    if not bases:
        return search, found
    base = Structure((), min(bases, key=lambda fitted: fitted.likelihood))
    near = known is None or _remembered(again, base, known)
    if not (near or only_others):
        return search, found
    other = searched(again, begun(again, base), most)
    whole = verdict_of(again, other) in ("named", "class") and again.explained(other.last)
    return (again, other) if whole else (search, found)


def _only_others_show_more(fitted: Refitted, q: Question) -> bool:
    """Whether nothing is left in what was fitted to, and a large gap where not."""
    left = has_gap(fitted.residuals_fit, q.noise, CLEARLY).any()
    return not left and any(has_gap([r], q.noise, LARGE).any() for r in fitted.residuals_select)


def _remembered(search: Search, base: Structure, known: Structure) -> bool:
    """Fits may begin where the first search ended, too, with what the other recordings add: the other end of a stop.

    Whether that closes much of the gap of all of them, and comes near the noise.
    """
    tried = search.refitted(base, [(known.members, [known.fitted.values])])
    (grown,) = both_ends(search, base, tried)
    search.forget()
    if grown.structure is None:
        return False
    search.hints[tuple(sorted(known.key))] = grown.structure.fitted.values
    much = closed(grown.structure.fitted, base.fitted, search.question) > CONFIRMED
    return much and search.near_noise(grown.structure)
