"""Long recordings: their beginnings are searched first, and what explains those is fitted to all of them.

A search costs as much as the recordings are long, and far from all of them is needed to tell what is missing: a gap of
a thousand nats tells as much as one of a million. What the beginnings cannot tell is searched for in all, as it would
have been without them.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

from ..evidence.posterior import NOTHING
from ..fits.job import Job
from .extent import ENOUGH, FAIR, brief
from .table import Entry, Table

if TYPE_CHECKING:
    from .search import Search


def beginning_of(search: Search) -> Search | None:
    """The search of the beginnings of long recordings; None where they are not."""
    table, question = search.table, brief(search.table.question)
    if question is None:
        return None
    own = Table(table.base, table.free, table.candidates, question, table.coloured, table.told)
    # the best so far is told of all recordings
    pause = search.pause and (lambda _: search.pause(search))
    return dataclasses.replace(search, table=own, pause=pause, surprises=[], twice=set())


def shows(part: Table, whole: Table) -> bool:
    """Whether beginnings show what is missing: well, and no less than is their share of the gap in all recordings."""
    samples = [sum(len(r.time) for r in t.question.fit) for t in (part, whole)]
    fair = FAIR * samples[0] / samples[1] * whole.score(whole.entry())
    return part.score(part.entry()) > max(ENOUGH, fair)


def against_all(search: Search, part: Entry) -> Job:
    """The fit of a structure to all recordings from where that to their beginnings ended."""
    known = part.fitted
    return search.jobs.of(search.table.entry(part.members), [known.values], states=known.states, size=known.rmse)


def likely(part: Table) -> list[Entry]:
    """The structures that may be the answer in the beginnings, the most probable first; the best where none is."""
    best = [e for e in part.fitted if e.members]
    return [part.entries[k] for k in part.posterior().class_() if k != NOTHING] or sorted(best, key=part.score)[:1]


def take_over(search: Search, part: Search, likely: list[Entry]) -> None:
    """Put into the table of a search what the search of the beginnings has asked: those are no longer in question.

    What may be the answer stays in question until it was fitted to all recordings.
    """
    search.alternatives.settled |= part.alternatives.settled
    for known in part.table.entries.values():
        if known in likely or not known.members:
            continue
        entry = search.table.entry(known.members)
        entry.failed = entry.failed or known.failed
        if known.look or known.fitted:
            entry.early = part.table.share(known) if known.fitted else part.table.promise(known)
        entry.beside, entry.foreseen = known.beside if known.asked or not known.fitted else entry.early, known.foreseen
