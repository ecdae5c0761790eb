"""The search: structures are looked at in windows, the most promising fitted first, until none can improve the answer.

Nothing is forbidden: what promises little waits, and is tried when nothing better is left and there is time.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..fits.job import Fitted, Job, Look, Question, factor
from ..fits.whole import as_look, step
from .alternatives import Alternatives, batches
from .base import LEFT, SAME, BaseFit
from .beginning import against_all, beginning_of, likely, shows, take_over
from .ends import Freed, OutOfTime, Surprised
from .extent import enough_of, telling, testable
from .foreseen import larger, singles
from .full_fits import Fits
from .growth import EARLY, Growth
from .jobs import Effort, Jobs
from .table import Entry, Table

BY_WINDOWS = 2  # effects of a structure up to which windows alone are looked at
FIRST = 2  # structures that are fitted when the time is over before any was
FREED = 0.5  # of it: a base that leaves less from where a structure ended had been in a local minimum
ASKED = 2  # structures, that windows say are right and whole recordings not, for which a search is interrupted


@dataclass(eq=False)
class Search:
    """A table, how jobs are run, and how far to go.

    until : the time of `time.monotonic` [s] at which it ends; complete : whether it came to its end.
    first : how many lengths of windows a first look goes through; 0: whole recordings, or a part of them.
    pause : called with the search between its batches of jobs. surprises : structures that explain all in short
    windows, whose starts are free, and not in longer runs. least : nats that the best structure left from where the
    base was fitted, too. twice : structures that were looked at from both starts. part : the search of the beginnings
    of long recordings, until it is done.
    """

    table: Table
    run: Callable[[Callable, Sequence, str], list]
    effort: Effort = field(default_factory=Effort)
    most: int = 3
    until: float = np.inf
    complete: bool = True
    first: int = 0
    pause: Callable[[Search], None] | None = None
    surprises: list[Entry] = field(default_factory=list)
    least: float = np.inf
    twice: set = field(default_factory=set)
    part: Search | None = None

    def __post_init__(self) -> None:
        self.jobs = Jobs(self.table, self.effort)
        self.batch = self.effort.together if np.isfinite(self.until) else self.effort.batch  # then limits are seen
        self.base = BaseFit(self.table, self.jobs, self._ran)
        self.fits = Fits(self.table, self.jobs, self._ran)
        self.growth = Growth(self.table, self.jobs, self._ran, self.batch, self.most)
        self.alternatives = Alternatives(self.table, self.jobs, self._ran, self.batch)

    def go(self) -> Entry | None:
        """Search until nothing promises to improve the answer, or the time is over.

        A surprise is answered before that; the search goes on from there when it is called again.
        """
        try:
            self._go()
        except Freed:
            return self.go()
        except Surprised:
            return self.surprises[-1]
        except OutOfTime:
            self.complete = False
            self.until = np.inf  # what promises much is worth its fit, and the best where nothing else was fitted
            seen = [e for e in self.waiting() if e.look]
            chosen = [e for e in seen if self.table.promise(e) < EARLY][: self.effort.together]
            chosen = chosen or ([] if len(self.table.fitted) > 1 else seen[:FIRST])
            self._take(chosen, self._ran([self.jobs.whole_soon(e) for e in chosen]))
            best = self.alternatives.best  # what fits as well without one of its effects says less
            self.alternatives.fit_from(best, [e for e in self.alternatives.less(best) if not e.fitted])
        return None

    def _go(self) -> None:
        if self.table.explained([self.identify()]):
            return
        if self.part:
            self._begin()
        if self.table.explained():
            self.alternatives.settle()
            return
        if self.first:
            seen = self._through(min(self.most, BY_WINDOWS))
            if not self.table.explained():
                self._climb(sorted(seen, key=self.table.promise)[: self.effort.together])
        if not self.table.explained():
            self._to_whole_recordings()
        self._through(self.most)
        self._climb(list(self.table.entries.values()), self.effort.fits)
        self.alternatives.settle()

    def _begin(self) -> None:
        """Search the beginnings of long recordings, and fit to all of them what explains those.

        Where that is not all, the search goes through all of them, as it does where beginnings do not show the gap.
        """
        part = self.part
        if shows(part.table, self.table):
            if surprise := part.go():
                self.surprises.append(surprise)
                raise Surprised
            known = likely(part.table)
            soon = known if part.complete else known[:FIRST]
            entries = [self.table.entry(e.members) for e in soon]
            self._take(entries, self.run(step, [against_all(self, e) for e in soon], "search"))
            if self.table.explained():
                take_over(self, part, known)
            for entry in entries:  # where none explains all, every one is asked again, from its own start, too
                entry.failed = entry.failed if self.table.explained() else ""
            self.part = None
            if not part.complete:
                raise OutOfTime
            if not self.table.explained():  # else the base was asked what it lacks in the beginnings
                self._settle(entries)
        self.part = None
        if not self.table.explained():
            self.first = self.base.looks_through(self.base.lead())

    def _through(self, most: int) -> list[Entry]:
        """Go through structures of up to ``most`` effects until one explains all: those that promise much."""
        table, seen = self.table, []
        for size in range(1, min(most, len(table.candidates)) + 1):
            entries = singles(self.jobs) if size == 1 else larger(self.jobs, size)
            self._looked(entries)
            if not self.first:
                self._climb(entries)
            elif size == 1 and not table.explained():
                self.growth.grow(self.first)
                if not table.explained():
                    self._look_again([e for e in entries if e.open and e.look])
            seen += entries
            if self.table.explained():
                break
        return [e for e in seen if table.promise(e) < EARLY]

    def _to_whole_recordings(self) -> None:
        """Look at whole recordings from now on: windows show too little of what is missing, it is slow or acts seldom.

        What they led to is known already. Looks begin where the base was fitted, or windows led it if that bent it far.
        """
        table, jobs, base = self.table, self.jobs, self.table.entry()
        jobs.windows = table.question if table.question.lengths else jobs.windows
        slow = self.first > 0  # all of it is needed: the beginnings show no more than windows did
        table.question, self.first = dataclasses.replace(table.question, lengths=()), 0

        def look(question: Question):
            return self._ran([jobs.glance(base, question)])[0]

        jobs.led = base.look.values if base.look and base.look.left is None else None
        found = look(table.question) if jobs.led else None
        bent = isinstance(found, Look) and factor(table.question.noise, found.size, base.fitted.rmse) > LEFT
        base.look, jobs.led = (found, jobs.led) if bent else (as_look(base.fitted), None)
        if not slow:
            jobs.extent, base.look = enough_of(table, look, base.look)
        table.look_anew()

    def identify(self) -> Entry:
        """The base, fitted. Raises SolveError where it diverges."""
        base = self.table.entry()
        if not base.fitted:
            self.part = beginning_of(self)
            if self.part:
                self.base.fit_from(self.part.identify().fitted, self.part.first)
                self.jobs.begin = self.part.jobs.begin
            else:
                self.first = self.base.identify()
        return base

    def take_looks(self, before: Search) -> None:
        """Take over looks in the same windows: all start states are free there, whatever is assumed of recordings.

        A fit under another assumption is one more start. What was surprising is fitted at once.
        """
        if self.part and before.part:
            self.part.take_looks(before.part)
        one, other = self.table.question, before.table.question
        if (one.lengths, one.windows) != (other.lengths, other.windows):
            return
        own = {c.label: c for c in self.table.candidates}
        for known in before.table.entries.values():
            if known.look and known.look.left is None and known.members and set(known.key) <= set(own):
                more = (known.fitted.values,) if known.fitted else ()
                look = dataclasses.replace(known.look, trail=(*known.look.trail, *more))
                self.table.entry([own[label] for label in known.key]).look = look
        first = [self.table.entries[e.key] for e in before.surprises if e.key in self.table.entries]
        if time.monotonic() < self.until:
            self._take(first, self._ran([self.jobs.whole(e) for e in first]))

    @property
    def afterwards(self) -> float:
        """What a job after the search may take [s]: little once its time is over."""
        return self.effort.seconds if self.complete else self.effort.look

    def waiting(self) -> list[Entry]:
        """Structures that a longer search would try, the most promising first."""
        open_ = (e for e in self.table.entries.values() if e.open and e.members and not e.asked)
        return sorted(open_, key=self.table.promise)

    # -- steps ---------------------------------------------------------------------------------------------------
    def _looked(self, entries: Sequence[Entry]) -> None:
        """Look at structures in turn; what promises everything is fitted as soon as it is seen, the best first.

        Where one explains all, the others are asked from where it ended: see `Alternatives`.
        """
        self.growth.grow(self.first)
        for batch in batches([e for e in entries if e.open and not e.look], self.effort.together):
            if self.table.explained():
                return
            self._look(batch)
            while early := [e for e in batch if e.open and e.look and self._promises_much(e)]:
                level = SAME + min(self.table.promise(e) for e in early)
                self._fit([e for e in early if self.table.promise(e) < level])
                if self.table.explained():
                    return
            self._fit_as_it_stands(entries)

    def _promises_much(self, entry: Entry) -> bool:
        """Whether it promises to leave little of what the best part of it that was fitted leaves."""
        parts = (self.table.share(part) for part in self.table.parts(entry))
        return self.table.promise(entry) < EARLY * min(parts, default=1.0)

    def _fit_as_it_stands(self, entries: Sequence[Entry]) -> None:
        """Fit what promises most, whatever that is: looks may not show all that it explains."""
        table = self.table
        best = min((e for e in entries if e.look), key=table.promise, default=None)
        if best and best.open:
            self._fit([best])

    def _climb(self, entries: Sequence[Entry], later: int = 0) -> None:
        """Fit structures, always those that promise most.

        Ends when one explains all, for the others are asked from there, or when what is left promises less than the
        best did and reached, or so many later.
        """
        table, beyond = self.table, 0
        while not table.explained() and (waiting := sorted((e for e in entries if e.open), key=table.promise)):
            best = min((e for e in entries if e.fitted and e.members), key=table.share, default=None)
            reached = max(table.share(best), table.promise(best)) if best else table.promise(waiting[0])
            near = table.promise(waiting[0]) < SAME + reached
            if not near and beyond >= later:
                return
            level = SAME + (reached if near else table.promise(waiting[0]))
            chosen = [e for e in waiting if table.promise(e) < level][: self.effort.together]
            self._fit(chosen, later=True)
            beyond += 0 if near else sum(not e.open for e in chosen)

    # -- jobs ----------------------------------------------------------------------------------------------------
    def _look(self, entries: Sequence[Entry]) -> None:
        """Look at structures from where the base was led or fitted; where that diverges, from where the user put it."""
        known = [e for e in entries if self.table.usable(e)]
        looks = self._ran([self.jobs.next(e, self.first) for e in known])
        self._take(known, looks)
        self._look_again([e for e in known if not e.look])
        if self.jobs.extent not in (None, self.table.question):
            seen = [(e, look) for e, look in zip(known, looks, strict=True) if isinstance(look, Look)]
            self._look_at_all([e for e, look in seen if not any(testable(look, c) for c in e.members)])

    def _look_at_all(self, entries: Sequence[Entry]) -> None:
        """What shows nothing in the part of the recordings that looks go through may show in all of them."""
        wholly = self._ran([self.jobs.glance(e, self.table.question) for e in entries])
        for entry, found in zip(entries, wholly, strict=True):
            if isinstance(found, Look):
                entry.look = dataclasses.replace(entry.look, sigmas=found.sigmas)

    def _fit(self, entries: Sequence[Entry], later: bool = False) -> None:
        """Fit structures, and ask what that says of their parts and of the base. later : there is time for it."""
        known = [e for e in entries if e.open and self.table.usable(e)]
        self._look([e for e in known if not e.look])
        known = [e for e in known if e.open]
        self.fits.fit(known, later=later)
        self._settle(known)

    def _look_again(self, entries: Sequence[Entry]) -> None:
        """Look at structures in windows from where the user put them, too: a bent base may hide what they lack.

        Of two minima that explain all that one counts which is near to what is known.
        """
        for batch in batches([e for e in entries if e.key not in self.twice], self.batch):
            self.twice.update(e.key for e in batch)
            looks = self._ran([self.jobs.from_its_start(e, self.first) for e in batch])
            for e, found in zip(batch, looks, strict=True):
                before, enough = e.look, max(self.table.promise(e), SAME)
                if isinstance(found, Look):
                    e.look, e.failed = found, ""
                    e.look = before if before and self.table.promise(e) > enough else found

    def _settle(self, known: Sequence[Entry]) -> None:
        """Fit again what may have come to rest beside its minimum, and ask what that says of the base."""
        self._free_base(known)
        worse = [(e, part) for e in known if e.fitted and (part := self.table.better_part(e))]
        if self.table.explained():  # by something else: they are asked from there, see `Alternatives`
            worse = [(e, part) for e, part in worse if self.table.explained([part])]
        for (e, _), found in zip(worse, self._ran([self.jobs.from_part(*pair) for pair in worse]), strict=True):
            self.table.keep_better(e, found)
        self._wonder(known)

    def _free_base(self, entries: Sequence[Entry]) -> None:
        """Fit the base from where a structure ended that leaves far less; raise Freed where that was what it lacked."""
        table, base = self.table, self.table.entry()
        best = min((e for e in entries if e.fitted and e.members), key=table.score, default=None)
        before = table.score(base) if best else 0.0
        if not best or table.score(best) >= FREED * min(before, self.least):
            return
        self.least = table.score(best)
        (found,) = self._ran([self.jobs.from_there(base, best)])
        own = base.fitted
        self.table.keep_better(base, found)
        if table.score(base) > FREED * before:
            return
        freed, base.fitted = base.fitted, own
        self.base.further()
        before = table.score(base)
        self.table.keep_better(base, freed)
        if table.score(base) > FREED * before:
            return
        if self.first and best.look:
            (look,) = self._ran([self.jobs.through_windows_of(best)])
            base.look = look if isinstance(look, Look) else base.look
            self.first = telling(table)
        self.twice.clear()
        table.look_anew()
        raise Freed

    def _wonder(self, entries: Sequence[Entry]) -> None:
        """Raise Surprised for a structure that explains all in some windows and not in longer runs, a few times."""
        right = [e for e in entries if e.members and e.look and self.table.was_right(e, SAME)]
        for e in right:
            if len(self.surprises) >= ASKED or self.table.explained():
                return
            if e.open and self.table.promise(e) > EARLY:
                self._take([e], self._ran([self.jobs.whole(e)]))
            if e.fitted:
                self.surprises.append(e)
                raise Surprised

    def _take(self, entries: Sequence[Entry], answers: Sequence) -> None:
        for entry, found in zip(entries, answers, strict=True):
            if isinstance(found, Look):
                part = self.jobs.extent not in (None, self.table.question)  # what does not show in it may show later
                entry.look = dataclasses.replace(found, sigmas={}) if part else found.after(entry.look)
            elif isinstance(found, Fitted):
                entry.fitted = found
            else:
                entry.failed = found

    def _ran(self, jobs: Sequence[Job], function: Callable | None = None) -> list:
        if not jobs:
            return []
        if time.monotonic() > self.until and len(self.table.entries) > 1:
            raise OutOfTime
        if self.pause:
            self.pause(self)
        return self.run(function or step, jobs, "search")
