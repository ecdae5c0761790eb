"""Alternatives: what else could be missing, asked from where the best structure ended.

Where that explains all, the base is right, whatever it was bent to while an effect was missing: a few steps from there
show of every other effect whether it explains as much. What does is fitted. Effects that were asked so, and were not
fitted, are no longer in question.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.effects import Candidate

from ..evidence.score import Floor, score
from ..fits.job import Job, Look, Question
from .extent import enough_of
from .jobs import Jobs
from .table import Entry, Table

LIKELY = 0.25  # of the gap that the best structure closes: an effect that a few steps left more of is not fitted


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
                self._instead(best)

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
    def _instead(self, best: Entry) -> None:
        """Look from there at every effect in the place of each of the best's; fit those that explain as much."""
        for one in best.members:
            others = [self.table.entry(members) for members in self.table.instead(best, one)]
            others = [e for e in others if not self._as_good(e, best) and self.table.usable(e)]
            others.sort(key=self.table.promise)
            question, gap = self._gap(best, one)
            seen: list[tuple[Entry, Look]] = []
            for batch in batches(others, self.batch):
                looks = self.run([self.jobs.glance_from(best, e, question) for e in batch])
                for entry, look in zip(batch, looks, strict=True):
                    entry.beside = self._share(look, gap) if isinstance(look, Look) else np.inf
                    seen += [(entry, look)] if entry.beside < LIKELY else []
            self._fit_likely(sorted(seen, key=lambda pair: pair[0].beside))

    def _fit_likely(self, seen: Sequence[tuple[Entry, Look]]) -> None:
        """Fit structures, the likeliest first, until none of those that are fitted together explains all."""
        for together in batches(seen, self.jobs.effort.together):
            fits = self.run([self.jobs.soon(entry, look) for entry, look in together])
            for (entry, _), found in zip(together, fits, strict=True):
                self.table.keep_better(entry, found)
            if not any(e.fitted and self.table.explained([e]) for e, _ in together):
                return

    def _gap(self, best: Entry, one: Candidate) -> tuple[Question, Look]:
        """The shortest beginnings of recordings in which it shows that an effect is missing, and what is left there."""
        rest = self.table.entry([m for m in best.members if m is not one])

        def look(question: Question):
            return self.run([self.jobs.left_by(rest, best, question)])[0]

        return enough_of(self.table, look, look(self.table.question))

    def _share(self, look: Look, gap: Look) -> float:
        """Share of a gap that a look leaves, of nats above white noise: all are compared with each other."""
        white = Floor(self.table.noise, np.zeros_like(self.table.noise))
        whole = score(gap.left, white)
        return score(look.left, white) / whole if whole > 0 else 1.0

    def _as_good(self, entry: Entry, best: Entry) -> bool:
        return bool(entry.fitted) and self.table.score(entry) < self.table.score(best) + 1.0


def batches(entries: Sequence[Entry], size: int) -> Iterator[Sequence[Entry]]:
    """Structures, so many at once."""
    for k in range(0, len(entries), size):
        yield entries[k : k + size]
