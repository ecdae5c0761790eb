"""Growth: the best structure is joined by what promises most beside it, before all else is looked at.

What is missing beside it may show in long runs alone, in which nothing else is seen as long as it is missing.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

from hydrotwin.models.effects import Candidate

from ..evidence.deciding import DECIDING
from ..fits.job import Fitted, Look
from .alternatives import batches
from .base import SAME
from .extent import enough_windows
from .foreseen import beside, foreseen, promising
from .full_fits import Fits
from .jobs import Jobs
from .starts import compatible
from .table import Entry, Table

EARLY = 0.4  # of what a part of it leaves: what promises to leave less is fitted as soon as it is seen


@dataclass(eq=False)
class Growth:
    """What adds effects to the best structure of a table.

    run : jobs, and by which function, to answers, in order. batch : looks that are run at once. most : effects of a
    structure. grown : keys of the structures that were added to.
    """

    table: Table
    jobs: Jobs
    run: Callable[..., list]
    batch: int
    most: int
    grown: set = field(default_factory=set)

    def __post_init__(self) -> None:
        self.fits = Fits(self.table, self.jobs, self.run)

    def grow(self, first: int) -> None:
        """Fit the best structure with what promises most beside it, once, where it explains much and not all.

        What a fit leaves that has not come to its end says little of that: it goes on first. first : how many lengths
        of windows looks go through; 0: whole recordings.
        """
        best = self._best(bool(first))
        if not best or len(best.key) >= self.most or best.key in self.grown:
            return
        self.grown.add(best.key)
        if best.fitted and not (best.fitted.converged or self.table.explained()):
            self.table.keep_better(best, self.run([self.jobs.further(best)])[0])
        if self.table.explained() or (first and self._in_windows(best, first)):
            return
        self._to_first_order(best)

    def _best(self, windows: bool) -> Entry | None:
        """The structure whose fit leaves least; where none leaves little, that which promises least in windows."""
        table = self.table
        fits = min((e for e in table.fitted if e.members), key=table.score, default=None)
        if fits and table.share(fits) <= EARLY:
            return fits
        seen = [e for e in table.entries.values() if windows and e.members and e.look and not e.failed]
        best = min(seen, key=lambda e: table.promise(e), default=None)
        return best if best and table.promise(best) <= EARLY else None

    def _in_windows(self, best: Entry, first: int) -> bool:
        """Fit what leaves clearly less beside the best in windows along the best's own course; whether anything does.

        What leaves clearly less than all before it is fitted as soon as it is seen.
        """
        table, jobs = self.table, self.jobs
        along = self._course(best, first)
        if not along:
            return False
        level = enough = EARLY * table.promise(Entry(best.members, look=along))
        windows = enough_windows(table, along)
        found, fitted = [], []
        others = [table.possible((*best.members, c)) for c in self._order(best)]
        for together in batches([e for e in others if compatible(e.members)], self.batch):
            batch = [e for e in together if table.usable(e)]
            for entry, look in zip(batch, self.run([jobs.grown(e, best, along, windows) for e in batch]), strict=True):
                entry.look = look if isinstance(look, Look) else None
            seen = [e for e in batch if e.look and table.promise(e) < enough]
            found += seen
            least = min((table.promise(e) for e in seen), default=level)
            if least < level:
                level = EARLY * least
                alike = [e for e in seen if table.promise(e) < SAME + least]
                self._fit_seen(best, alike)
                fitted += alike
            if table.explained():
                return True
        self._fit_seen(best, [e for e in found if e not in fitted])
        return bool(found)

    def _order(self, best: Entry) -> list[Candidate]:
        """Effects in the order in which they join the best: first what promises most alone or to first order beside it.

        What the best hides promises nothing alone; where the best is bent, first order from there tells little.
        """
        alone = [c for c in promising(self.table) if c not in best.members]
        left = foreseen(self.table, self.jobs, best) if best.fitted else {}
        known = sorted((c for c in alone if c.label in left), key=lambda c: left[c.label].left)
        return list({c.label: c for pair in itertools.zip_longest(known, alone) for c in pair if c}.values())

    def _course(self, best: Entry, first: int) -> Look | None:
        """The best in the shortest windows in which it leaves enough to tell what is missing; None where none does.

        It begins where windows led it or where its fit ended, which may be far: that is bent by what is missing.
        """
        table, values = self.table, [one.values for one in (best.look, best.fitted) if one]
        for stage in range(first - 1, len(table.question.lengths)):
            (found,) = self.run([self.jobs.along(best, stage, values)])
            if not isinstance(found, Look) or table.in_windows(found, stage) > DECIDING.visible:
                return found if isinstance(found, Look) else None
            values = [found.values]
        return None

    def _fit_seen(self, best: Entry, seen: Sequence[Entry]) -> None:
        """Fit those that promise most of what was seen beside the best."""
        table, entries = self.table, []
        for one in sorted(seen, key=table.promise)[: self.jobs.effort.together]:
            entry = table.entry(one.members)
            entry.look = entry.look or one.look
            entries += [entry] if entry.open else []
        self.fits.fit(entries, keep=lambda some, found: self._keep(best, some, found))

    def _to_first_order(self, best: Entry) -> None:
        """Fit what is expected to leave least beside the best, to first order from where that was fitted."""
        if not (best.fitted and best.fitted.converged):
            return
        more = beside(self.jobs, best, self.jobs.effort.together)
        entries = [self.table.entry(m) for c in more if compatible(m := (*best.members, c))]
        entries = [e for e in entries if e.open and self.table.usable(e)]
        self._keep(best, entries, self.run([self.jobs.from_there(e, best) for e in entries]))

    def _keep(self, best: Entry, entries: Sequence[Entry], fits: Sequence) -> None:
        """Keep of these fits those that leave less than the best did: from their own starts others may do better."""
        table = self.table
        level = table.score(best) - table.temperature if best.fitted else EARLY * table.score(table.entry())
        for entry, found in zip(entries, fits, strict=True):
            if isinstance(found, Fitted):
                table.keep_better(entry, found)
            if entry.fitted and table.score(entry) > level:
                entry.fitted = None
