"""Together: what no recording can confirm of another is named where it explains all of them, down to the noise.

A slide that meets one stop in one recording and the other stop in another tells nothing by recording: what is fitted to
the one cannot prove itself in the other. Where a search has ended so, all recordings to learn from are fitted to.
Blocks of them then stand where held-out ones would, which confirms less; so more is asked: nothing may be left, in any
output of any recording. What validates is not looked at.
"""

from __future__ import annotations

import dataclasses

from .answering import Found
from .decide import CLEARLY, has_gap
from .ends import both_ends
from .forward import begun, searched
from .recordings import Split
from .refit import RefitJob, refit
from .search import Search, Structure
from .verdict import likeliest, unconfirmed, verdict_of


def explained_together(search: Search, data: Split, found: Found, most: int) -> tuple[Search, Found]:
    """The search and where it ended; those of a search in all recordings where only that explains all there is."""
    if verdict_of(search, found) != "unknown" or not _for_want_of_a_recording(search, found):
        return search, found
    question = dataclasses.replace(
        search.question, fit=data.train, select=data.train, noise=search.sensors, inexact=False
    )
    again = search.asking(question)
    flat = again.base.flat
    job = RefitJob(flat, again.free, question, coarse=True, label=flat.name)
    (base,) = again.run(refit, [job], "identify the base")
    if isinstance(base, str):
        return search, found
    base, known = Structure((), base), likeliest(search, found)
    if known and not _promises(again, base, known):
        return search, found
    other = searched(again, begun(again, base), most)
    whole = verdict_of(again, other) in ("named", "class") and again.explained(other.last)
    return (again, other) if whole else (search, found)


def _for_want_of_a_recording(search: Search, found: Found) -> bool:
    """Whether what explains the recordings that were fitted to is confirmed by no other, or only others show a gap."""
    fitted = found.base.fitted
    return bool(unconfirmed(search, found)) or not has_gap(fitted.residuals_fit, search.question.noise, CLEARLY).any()


def _promises(search: Search, base: Structure, known: Structure) -> bool:
    """Whether what the first search found comes near the noise in all recordings; fits of it may begin there.

    With what the other recordings add to it: the other end of a stop.
    """
    tried = search.refitted(base, [(known.members, [known.fitted.values])])
    (grown,) = both_ends(search, base, tried)
    search.forget()
    if grown.structure is None or not search.near_noise(grown.structure):
        return False
    search.hints[tuple(sorted(known.key))] = grown.structure.fitted.values
    return True
