"""So far: while a search goes on, the answer as its table stands is told now and then."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from dataclasses import dataclass, field

from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.models.language.model import Model

from ..evidence.posterior import NOTHING
from ..recordings import Split
from ..structures.search import Search
from ..structures.table import Table
from .answering import answer
from .discovery import Discovery
from .words import joined, lowered

AFTER = 45.0  # seconds until it is told first
EVERY = 60.0  # seconds at least between two
COSTS = 0.1  # of the time that it takes at most: an answer has final fits and is written
STAGE = "best so far"


@dataclass(eq=False)
class SoFar:
    """Tells the answer so far, when it is due.

    tell : called with it. complete : what is known of every answer, such as the seconds, put into one.
    due : the time of `time.monotonic` [s] from which it is told again. by : the search that told what is missing.
    """

    tell: Callable[[Discovery], None]
    complete: Callable[[Discovery], Discovery]
    due: float = field(default_factory=lambda: time.monotonic() + AFTER)
    by: Search | None = None

    def of(self, data: Split, model: Model) -> Callable[[Search], None]:
        """What a search among these recordings calls between its batches; ``model`` as for `answer`."""
        return lambda search: self._between(search, data, model)

    def _between(self, search: Search, data: Split, model: Model) -> None:
        began, base = time.monotonic(), search.table.entries.get(NOTHING)
        if began < self.due or not (base and base.fitted):
            return
        try:
            found = as_it_stands(search, data, model)
        except HydrotwinError:  # a last fit that fails now costs this telling only
            found = None
        if found and (found.steps or self.by in (None, search)):  # one that begins anew has found nothing yet
            self.by = search if found.steps else self.by
            self.tell(self.complete(found))
        now = time.monotonic()
        self.due = now + max(EVERY, (now - began) * (1 / COSTS - 1))


def as_it_stands(search: Search, data: Split, model: Model) -> Discovery:
    """The answer of a search that goes on, which stays as it is."""
    table = dataclasses.replace(search.table, entries=dict(search.table.entries))  # an answer makes entries of its own

    def run(function, jobs, _) -> list:
        return search.run(function, jobs, STAGE)

    soon = dataclasses.replace(search.effort, iterations=1)  # of a last fit: the search itself goes on with these
    found = answer(dataclasses.replace(search, table=table, run=run, pause=None, effort=soon), data, model)
    counted = _counted(search)
    told = f"gap: the search goes on: {counted}. The answer is the best of those, and may change."
    reason = found.reason
    if found.verdict == "unknown" and not reason:
        fitted = "fitted to all recordings" if search.part else "fitted"
        reason = f"Something is missing, and nothing that was {fitted} explains it yet: {counted}."
    untried = tuple(" + ".join(e.key) for e in search.waiting()[:5])
    return dataclasses.replace(found, reason=reason, findings=(told, *found.findings), untried=untried)


def _counted(search: Search) -> str:
    """How far it is."""
    table = search.part.table if search.part else search.table
    where = f", in the beginnings of the recordings{_closest(table)}" if search.part else ""
    alone = [table.entries.get((c.label,)) for c in table.candidates]
    looked = sum(bool(e and e.seen) for e in alone)
    fitted = sum(bool(e.members) for e in table.fitted)
    structures = "1 structure" if fitted == 1 else f"{fitted} structures"
    return f"{looked} of {len(alone)} candidates were looked at so far, {structures} fitted{where}"


def _closest(table: Table) -> str:
    """What leaves least in the beginnings of recordings, of which the table of the answer does not know yet."""
    best = min((e for e in table.fitted if e.members), key=table.score, default=None)
    if not best:
        return ""
    names = joined([f"{lowered(c.effect.title)} at {c.site.name}" for c in best.members])
    return f", where {names} {'explains all' if table.explained([best]) else 'leaves least'}"
