"""Growth: the best structure is fitted with what promises most beside it, before all else is looked at.

What is missing beside it may show in long runs alone, in which nothing else is seen as long as it is missing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from ..fits.job import Fitted, Job, Look
from .alternatives import batches
from .foreseen import beside
from .jobs import Jobs
from .starts import compatible
from .table import Entry, Table

EARLY = 0.4  # of what a part of it leaves: what promises to leave less is fitted as soon as it is seen


@dataclass(eq=False)
class Growth:
    """What adds effects to the best structure of a table.

    run : jobs to answers, in order. batch : looks that are run at once. most : effects of a structure. grown : keys of
    the structures that were added to.
    """

    table: Table
    jobs: Jobs
    run: Callable[[Sequence[Job]], list]
    batch: int
    most: int
    grown: set = field(default_factory=set)

    def grow(self, first: int) -> None:
        """Fit the best structure with what promises most beside it, once, where it explains much and not all.

        What a fit leaves that has not come to its end says little of that: it goes on first. first : how many lengths
        of windows looks go through; 0: whole recordings.
        """
        table = self.table
        best = min((e for e in table.fitted if e.members), key=table.score, default=None)
        if not best or len(best.key) >= self.most or best.key in self.grown or table.share(best) > EARLY:
            return
        if not (best.fitted.converged or table.explained()):
            table.keep_better(best, self.run([self.jobs.further(best)])[0])
        self.grown.add(best.key)
        if table.explained():
            return
        jobs = (self._in_windows(best, first) if first else {}) or self._to_first_order(best, first)
        level = table.score(best) - table.temperature
        for entry, found in zip(jobs, self.run(list(jobs.values())), strict=True):
            entry.fitted = found if isinstance(found, Fitted) else None
            if entry.fitted and table.score(entry) > level:
                entry.fitted = None  # from its own start it may do better

    def _in_windows(self, best: Entry, first: int) -> dict[Entry, Job]:
        """Fits of what leaves clearly less beside the best, in windows along the best's own course; none of nothing."""
        table, jobs = self.table, self.jobs
        (along,) = self.run([jobs.along(best, first)])
        if not isinstance(along, Look):
            return {}
        enough = EARLY * table.promise(Entry(best.members, look=along))
        others = [table.possible((*best.members, c)) for c in table.candidates if c not in best.members]
        others = [e for e in others if compatible(e.members) and table.usable(e)]
        seen = []
        for batch in batches(others, self.batch):
            for entry, look in zip(batch, self.run([jobs.grown(e, best, along) for e in batch]), strict=True):
                entry.look = look if isinstance(look, Look) else None
                seen += [entry] if entry.look and table.promise(entry) < enough else []
        found = {}
        for one in sorted(seen, key=table.promise)[: jobs.effort.together]:
            entry = table.entry(one.members)
            entry.look = entry.look or one.look
            found |= {entry: jobs.whole_soon(entry)} if entry.open else {}
        return found

    def _to_first_order(self, best: Entry, first: int) -> dict[Entry, Job]:
        """Fits of what is expected to leave least beside the best, to first order from where that was fitted."""
        if not best.fitted.converged:
            return {}
        more = beside(self.jobs, best, first, self.jobs.effort.together)
        entries = [self.table.entry(m) for c in more if compatible(m := (*best.members, c))]
        return {e: self.jobs.from_there(e, best) for e in entries if e.open and self.table.usable(e)}
