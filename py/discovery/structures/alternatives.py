"""Alternatives: what else could be missing, asked from where the best structure ended.

Where that explains all, the base is right, whatever it was bent to while an effect was missing: a few steps from there
show of every other effect whether it explains as much. Without any effect the base would bend again to hide the gap,
and with a useless one it takes the same way: those that are not ahead of it after the first steps go no further. What
explains much is fitted. Effects that were asked so, and were not fitted, are no longer in question.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.effects import Candidate

from ..evidence.deciding import DECIDING
from ..evidence.score import Floor, score
from ..fits.job import Job, Look, Question
from .extent import ENOUGH, enough_of
from .jobs import Jobs
from .table import Entry, Table

LIKELY = 0.25  # of the gap that the best structure closes: an effect that a few steps left more of is not fitted
FIRST = 3  # steps after which an effect has to leave less than the rest of the best alone would, on its way to its bend
AHEAD = 0.5  # of what the rest leaves after as many steps: an effect that leaves more only bends it, too
SHOWN = 100.0  # nats that the rest leaves after them where half of that is told from all of it


@dataclass(eq=False)
class Alternatives:
    """What asks a table for alternatives to its best structure.

    run : jobs to answers, in order. batch : looks that are run at once. settled : structures that were the best.
    least : nats above which none is asked for alternatives any more: the last one left hardly more.
    """

    table: Table
    jobs: Jobs
    run: Callable[[Sequence[Job]], list]
    batch: int
    settled: set = field(default_factory=set)
    least: float = np.inf

    @property
    def best(self) -> Entry:
        """The most probable structure; one with an effect where the base leaves more than names would cost.

        Nothing may be as probable then, but only once the others were asked.
        """
        structures = self.table.posterior().structures
        known = structures if self.table.explained([self.table.entry()]) else {k: p for k, p in structures.items() if k}
        return self.table.entries[max(known or structures, key=(known or structures).__getitem__)]

    def settle(self) -> None:
        """Ask for alternatives until the best structure stays the best."""
        while (best := self.best).key not in self.settled:
            self.settled.add(best.key)
            self.fit_from(best, self.less(best))
            left = self.table.score(best)
            if self.best is best and best.members and self.table.explained([best]) and left < self.least:
                self.least = left - self.table.temperature
                for one in best.members:
                    self._instead(best, one)

    def less(self, best: Entry) -> list[Entry]:
        """What says less than the best: without one of its effects, or with a plainer form of it."""
        found = []
        for one in best.members:
            rest = [m for m in best.members if m is not one]
            found += [self.table.entry(rest)] if rest else []
            found += [self.table.entry(e) for e in self.table.instead(best, one) if any(map(one.refines, e))]
        return [e for e in found if not self._as_good(e, best)]

    def fit_from(self, best: Entry, entries: Sequence[Entry]) -> None:
        """Fit structures from where the best ended: a fit of their own may have ended in a local minimum."""
        usable = [e for e in entries if self.table.usable(e)]
        for entry, found in zip(usable, self.run([self.jobs.from_there(e, best) for e in usable]), strict=True):
            self.table.keep_better(entry, found)

    # -- in the place of one effect ------------------------------------------------------------------------------
    def _instead(self, best: Entry, one: Candidate) -> None:
        """Look from there at every effect in the place of one of the best's; fit those that explain as much."""
        others = [self.table.entry(members) for members in self.table.instead(best, one)]
        others = [e for e in others if not self._as_good(e, best) and self.table.usable(e)]
        ahead = self._ahead(best, one, sorted(others, key=self.table.promise))
        question, gap = self._gap(best, one, ENOUGH)  # what the rest can bend to shows in so much
        seen = self._looked(ahead, gap, lambda e: self.jobs.glance_on(best, e, ahead[e], question))
        likely = [(e, look) for e, look in seen.items() if e.beside < LIKELY]
        self._fit_likely(sorted(likely, key=lambda pair: pair[0].beside))

    def _ahead(self, best: Entry, one: Candidate, others: Sequence[Entry]) -> dict[Entry, Look]:
        """Entries, with their looks, that leave clearly less after the first steps than the rest alone."""
        for well in (DECIDING.visible, ENOUGH, np.inf):
            question, gap = self._gap(best, one, well)
            (bent,) = self.run([self.jobs.left_by(self._rest(best, one), best, question, FIRST)])
            level = AHEAD * self._nats(bent)
            if level > AHEAD * SHOWN:
                break
        seen = self._looked(others, gap, lambda e: self.jobs.glance_from(best, e, question, FIRST))
        return {e: look for e, look in seen.items() if self._nats(look) < level}

    def _looked(self, entries: Iterable[Entry], gap: Look | str, job: Callable[[Entry], Job]) -> dict[Entry, Look]:
        """Looks of entries by a job of each, as far as they came to an end; what they leave of a gap is kept."""
        found = {}
        for batch in batches(list(entries), self.batch):
            for entry, look in zip(batch, self.run([job(e) for e in batch]), strict=True):
                entry.beside = self._share(look, gap)
                found |= {entry: look} if isinstance(look, Look) else {}
        return found

    def _fit_likely(self, seen: Sequence[tuple[Entry, Look]]) -> None:
        """Fit structures, the likeliest first, until none of those that are fitted together explains all."""
        for together in batches(seen, self.jobs.effort.together):
            fits = self.run([self.jobs.soon(entry, look) for entry, look in together])
            for (entry, _), found in zip(together, fits, strict=True):
                self.table.keep_better(entry, found)
            if not any(e.fitted and self.table.explained([e]) for e, _ in together):
                return

    def _gap(self, best: Entry, one: Candidate, well: float) -> tuple[Question, Look | str]:
        """The shortest beginnings of recordings in which the rest leaves so many nats, and that.

        All of them, and why, where it diverges.
        """
        rest = self._rest(best, one)

        def look(question: Question):
            return self.run([self.jobs.left_by(rest, best, question)])[0]

        whole = look(self.table.question)
        return enough_of(self.table, look, whole, well) if isinstance(whole, Look) else (self.table.question, whole)

    def _rest(self, best: Entry, one: Candidate) -> Entry:
        return self.table.entry([m for m in best.members if m is not one])

    def _share(self, look: Look | str, gap: Look | str) -> float:
        """Share of a gap that a look leaves: all are compared with each other."""
        left, whole = self._nats(look), self._nats(gap)
        return left / whole if whole > 0 and np.isfinite(left) else max(left, 1.0)

    def _nats(self, look: Look | str) -> float:
        """What a look leaves above white noise; without end where it diverges."""
        white = Floor(self.table.noise, np.zeros_like(self.table.noise))
        return score(look.left, white) if isinstance(look, Look) else np.inf

    def _as_good(self, entry: Entry, best: Entry) -> bool:
        return bool(entry.fitted) and self.table.score(entry) < self.table.score(best) + 1.0


def batches(entries: Sequence[Entry], size: int) -> Iterator[Sequence[Entry]]:
    """Structures, so many at once."""
    for k in range(0, len(entries), size):
        yield entries[k : k + size]
