"""Alternatives: what else could be missing, asked from where the best structure ended.

Where that explains all, the base is right, whatever it was bent to while an effect was missing: a few steps from there
show of every other effect whether it explains as much. Without any effect the base would bend again to hide the gap,
and with a useless one it takes the same way: those that are not ahead of it after the first steps go no further. What
explains much is fitted. Where the gap is small, runs tell little that was not foreseen to first order: if the best was
foreseen, those that were not need no look. Effects that were asked so, and were not fitted, are no longer in question.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.effects import Candidate

from ..evidence.deciding import DECIDING
from ..evidence.score import Floor, score
from ..fits.job import Job, Look, Question
from .extent import ENOUGH, enough_of
from .foreseen import Foreseen, foreseen
from .jobs import Jobs
from .table import Entry, Table

FIRST = 3  # steps after which an effect has to leave less than the rest of the best alone would, on its way to its bend
AHEAD = 0.5  # of what the rest leaves after as many steps: an effect that leaves more only bends it, too
SHOWN = 100.0  # nats that the rest leaves after them where half of that is told from all of it
FORESEEN = 0.5  # of what the best explains in fact: first order that foresaw as much of it foresees that of others, too


@dataclass(frozen=True, eq=False)
class Ahead:
    """An entry whose look leaves a small share of what the rest of the best leaves after as many steps."""

    entry: Entry
    look: Look
    share: float


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
        rest = self.table.entry([m for m in best.members if m is not one])
        others = [self.table.entry(members) for members in self.table.instead(best, one)]
        others = [e for e in others if not self._as_good(e, best)]
        known = foreseen(self.table, self.jobs, rest) if rest.fitted else {}
        others = [e for e in self._unforeseen(best, rest, others, known) if self.table.usable(e)]
        if not others:
            return
        question, bent = self._bent(best, rest)

        def first(entry: Entry) -> Job:
            expected = known.get(_new(entry, rest))
            return self.jobs.glance_from(best, entry, expected.start if expected else {}, question, FIRST)

        seen = self._ahead(sorted(others, key=self.table.promise), bent, first)
        if not seen:
            return
        longer, _ = self._gap(best, rest, ENOUGH)  # what the rest bends to at last shows in so much
        if isinstance(bent, Look):
            (bent,) = self.run([self.jobs.glance_on(best, rest, bent, longer)])
        likely = self._ahead(list(seen), bent, lambda e: self.jobs.glance_on(best, e, seen[e].look, longer))
        self._fit_likely(sorted(likely.values(), key=lambda one: one.share))

    def _unforeseen(
        self, best: Entry, rest: Entry, others: Sequence[Entry], known: Mapping[str, Foreseen]
    ) -> list[Entry]:
        """Those of which first order does not tell that they explain too little; the others have been asked.

        It tells that where the rest was fitted, and where it foresees there what the best explains in fact.
        """
        if _new(best, rest) not in known or not rest.fitted.converged:
            return list(others)
        own = 1 - known[_new(best, rest)].left
        if not own > FORESEEN * _explained(best, rest):
            return list(others)
        found = []
        for entry in others:
            expected = known.get(_new(entry, rest))
            left = 1 - (1 - expected.left) / own if expected else 0.0
            if left < AHEAD:
                found.append(entry)
            else:
                entry.put_aside(left, foreseen=True)
        return found

    def _bent(self, best: Entry, rest: Entry) -> tuple[Question, Look | str]:
        """Beginnings of recordings that show what the rest leaves after the first steps, and that; else all of them."""
        for well in (DECIDING.visible, ENOUGH, np.inf):
            question, _ = self._gap(best, rest, well)
            (bent,) = self.run([self.jobs.left_by(rest, best, question, FIRST)])
            if self._nats(bent) > SHOWN:
                break
        return question, bent

    def _ahead(self, entries: Sequence[Entry], bent: Look | str, job: Callable[[Entry], Job]) -> dict[Entry, Ahead]:
        """Those that leave clearly less, after a job of each, than the rest alone after as many steps.

        The others have been asked.
        """
        found = {}
        for batch in batches(entries, self.batch):
            for entry, look in zip(batch, self.run([job(e) for e in batch]), strict=True):
                share = self._share(look, bent)
                if share < AHEAD:
                    found[entry] = Ahead(entry, look, share)
                else:
                    entry.put_aside(share)
        return found

    def _fit_likely(self, seen: Sequence[Ahead]) -> None:
        """Fit structures, the likeliest first, until none of those that are fitted together explains all."""
        for together in batches(seen, self.jobs.effort.together):
            fits = self.run([self.jobs.soon(one.entry, one.look) for one in together])
            for one, found in zip(together, fits, strict=True):
                self.table.keep_better(one.entry, found)
            if not any(one.entry.fitted and self.table.explained([one.entry]) for one in together):
                break
        for one in seen:
            one.entry.put_aside(one.share)

    def _gap(self, best: Entry, rest: Entry, well: float) -> tuple[Question, Look | str]:
        """The shortest beginnings of recordings in which the rest leaves so many nats, and that.

        All of them, and why, where it diverges.
        """

        def look(question: Question):
            return self.run([self.jobs.left_by(rest, best, question)])[0]

        whole = look(self.table.question)
        return enough_of(self.table, look, whole, well) if isinstance(whole, Look) else (self.table.question, whole)

    def _share(self, look: Look | str, bent: Look | str) -> float:
        """Share of what the rest leaves that a look leaves: all are compared with each other."""
        left, whole = self._nats(look), self._nats(bent)
        return left / whole if whole > 0 and np.isfinite(left) else max(left, 1.0)

    def _nats(self, look: Look | str) -> float:
        """What a look leaves above white noise; without end where it diverges."""
        white = Floor(self.table.noise, np.zeros_like(self.table.noise))
        return score(look.left, white) if isinstance(look, Look) else np.inf

    def _as_good(self, entry: Entry, best: Entry) -> bool:
        return bool(entry.fitted) and self.table.score(entry) < self.table.score(best) + 1.0


def _new(entry: Entry, rest: Entry) -> str:
    """The label of the effect that a structure has beside the rest."""
    return next(label for label in entry.key if label not in rest.key)


def _explained(best: Entry, rest: Entry) -> float:
    """Share of the squared errors of the rest that the best explains, in the mean over outputs; 1 of nothing."""
    own, other = best.fitted.rmse, rest.fitted.rmse
    known = np.isfinite(own) & (other > 0)
    return 1 - float(np.mean((own[known] / other[known]) ** 2)) if known.any() else 1.0


def batches(entries: Sequence[Entry], size: int) -> Iterator[Sequence[Entry]]:
    """Structures, so many at once."""
    for k in range(0, len(entries), size):
        yield entries[k : k + size]
