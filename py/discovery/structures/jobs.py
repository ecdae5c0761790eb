"""Jobs of a search: the next step of a structure, and where each fit of it begins."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.effects import Candidate
from hydrotwin.models.language.errors import SolveError

from ..fits.job import Fitted, Job, Look, Question
from ..fits.whole import trajectories
from .starts import diagonal, looks, seen_by, small, usual
from .table import Entry, Key, Table

TOGETHER = 6  # starts of several effects, of all combinations of theirs
KEPT = 4  # fits whose runs are kept
SOON = 2.0  # looks that a fit may take which is soon done if it is right


@dataclass(frozen=True)
class Effort:
    """How far a search goes.

    fits : structures that are fitted at last though they promise less than the best. pool : single effects, the most
    promising, of which pairs and larger structures are made. look, seconds : the most that a look and a fit take [s].
    iterations : the most of every stage of a fit. batch : looks between which the most promising are fitted.
    together : structures that are led on at once.
    """

    fits: int = 6
    pool: int = 8
    look: float = 5.0
    seconds: float = 40.0
    iterations: int = 15
    batch: int = 16
    together: int = 4


EFFORTS = {
    "quick": Effort(fits=4, pool=6, look=3.0, seconds=20.0, iterations=10),
    "normal": Effort(),
    "thorough": Effort(fits=20, pool=24, look=60.0, seconds=300.0, iterations=30),
}


@dataclass(eq=False)
class Jobs:
    """What can be asked of the structures of a table.

    extent : what looks at whole recordings see; None: all. windows : the question whose windows lead a fit from its
    start, where looks do not go through them. begin : base parameters by path that begin elsewhere than
    where the user put them, since the recordings show another frequency. likely : structures that first order puts
    first: looks at them, as all fits, try the first steps from every start.
    """

    table: Table
    effort: Effort
    extent: Question | None = None
    windows: Question | None = None
    begin: Mapping[str, float] = field(default_factory=dict)
    led: Mapping[str, float] | None = None
    likely: Sequence[Key] = ()
    _runs: dict[Key, tuple[Fitted, list[np.ndarray]]] = field(default_factory=dict)

    def next(self, entry: Entry, first: int) -> Job:
        """The next step of a structure, from where it stands."""
        lengths, seen = len(self.table.question.lengths), entry.look
        if seen is None:
            limit = self.effort.look if entry.members else self.effort.seconds
            if not lengths and entry.members:
                return self.glance(entry, self.extent)
            return self.first_look(entry, min(first, lengths), limit)
        if seen.end < lengths and not entry.members:  # shorter windows tell the states where longer ones begin
            settings = {"stages": (seen.end - 1, lengths), "seconds": self.effort.seconds, "tells_courses": True}
            return self.of(entry, [seen.values], size=seen.size, **settings)
        return self.whole(entry)

    def first_look(self, entry: Entry, end: int, limit: float) -> Job:
        """The first look in the last windows before the length ``end``, from where these led the base.

        Effects have any of their sizes there, and windows begin in the states that the base's have found: what does
        nothing beside the base leaves as much as the base does after as many steps more. There the base has hardly bent
        yet to hide what it lacks. Where nothing is known of the base any structure, and that first, begins where its
        user put it, in the shortest windows.
        """
        look, settings = self.table.entry().look, {"seconds": limit}
        if not look or look.left is not None:
            return self.of(entry, self.starts(entry), **settings, stages=(0, end), tells_courses=not entry.members)
        last = end - 1
        starts = self._sizes(entry.members, self.table.entry(), look.after_length(last))
        settings |= {"stages": (last, end), "course": look.courses[last], "size": look.size_at(last)}
        return self.of(entry, starts, **settings)

    def from_its_start(self, entry: Entry, first: int) -> Job:
        """The first look in windows from where the user put the base, effects at usual sizes."""
        stages, look = (0, min(first, len(self.table.question.lengths))), self.table.entry().look
        settings = {"course": look.courses[0]} if look and look.left is None and not look.begin and look.courses else {}
        return self.of(entry, self.starts(entry), stages=stages, seconds=self.effort.look, **settings)

    def along(self, known: Entry, stage: int, values: Sequence[Mapping[str, float]]) -> Job:
        """A structure in windows of one length along the course of the base there, from the cheapest of known values.

        Its effects have these beside what windows led the base to, too: it is never to leave more than that.
        """
        look = self.table.entry().look
        base = look.after_length(stage)
        beside = [{n: base.get(n, v) for n, v in one.items()} for one in values]
        settings = {"stages": (stage, stage + 1), "seconds": self.effort.look, "tells_courses": True}
        return self.of(known, [*values, *beside], **settings, course=look.courses[stage], size=look.size_at(stage))

    def grown(self, entry: Entry, part: Entry, along: Look, windows: int) -> Job:
        """What stands beside a part of a structure, at any of its sizes, in so many windows along the part's course.

        What does nothing there leaves as much as the part.
        """
        more = [c for c in entry.members if c not in part.members]
        starts = self._sizes(more, part if part.fitted else self.table.entry(), along.values)
        settings = {"stages": (along.begin, along.end), "seconds": self.effort.look, "size": along.size}
        job = self.of(entry, starts, **settings, course=along.courses[0])
        return dataclasses.replace(job, question=dataclasses.replace(job.question, windows=windows))

    def through_windows_of(self, other: Entry) -> Job:
        """The base through all windows from where another structure began to explain them."""
        base, stages = self.table.entry(), (0, len(self.table.question.lengths))
        start = {n: v for n, v in other.look.shortest.items() if n in self.table.names(base)}
        return self.of(base, [start], stages=stages, tells_courses=True)

    def glance(self, entry: Entry, question: Question | None) -> Job:
        """A few steps over whole recordings from where the base ended, effects at usual sizes or a tenth of them.

        That is where windows led it, where its fit bent it far from there, and it begins there itself. Where a part of
        the structure was fitted, from where that ended, too: it is never to look worse than its part.
        """
        base = self.table.entry()
        known = base.look if entry.members and base.look.left is not None else base.fitted
        starts = self._sizes(entry.members, base, self.led or known.values)
        part = min((e for e in self.table.parts(entry) if e.members), key=self.table.score, default=None)
        if part:
            known, starts = part.fitted, [*self.beside(entry, part)[:2], *starts]
        settings = {"stages": (0, 0), "seconds": self.effort.look, "states": known.states, "size": base.fitted.rmse}
        return dataclasses.replace(self.of(entry, starts, **settings), question=question or self.table.question)

    def _sizes(self, members: Sequence[Candidate], beside: Entry, begin: Mapping[str, float]) -> list[dict[str, float]]:
        """Starts from known values, effects at expected and usual sizes, or at a tenth of the first of these."""
        if not members:
            return [dict(begin)]
        starts = self._together(members, beside, expected=True)
        little = {n: v for c in members for n, v in small(c, starts[0]).items()}
        return [{**begin, **start} for start in (*starts, little)]

    def whole(self, entry: Entry) -> Job:
        """The fit to whole recordings from where its looks ended, or cheaper from where they came by or began."""
        seen = entry.look
        starts = [seen.values, *seen.trail, *self.starts(entry)]
        return self.of(entry, starts, size=seen.size, states=seen.states)

    def whole_soon(self, entry: Entry) -> Job:
        """The same with as much time as a fit takes that explains all."""
        return dataclasses.replace(self.whole(entry), seconds=SOON * self.effort.look)

    def plain_soon(self, entry: Entry) -> Job:
        """The fit from its own start through windows, with as much time for these and for whole recordings."""
        question, seconds = self.windows or self.table.question, SOON * self.effort.look
        return dataclasses.replace(self.of(entry, self.starts(entry), seconds=seconds), question=question)

    def further(self, entry: Entry) -> Job:
        """The fit that goes on from where it stopped."""
        known = entry.fitted
        return self.of(entry, [known.values], states=known.states, size=known.rmse)

    def of(self, entry: Entry, starts: Sequence[Mapping[str, float]], **settings) -> Job:
        """The job of a structure from these starts; settings as in `Job`."""
        table, effort = self.table, self.effort
        tries = settings.get("stages") is None or entry.key in self.likely
        settings = {"iterations": effort.iterations, "seconds": effort.seconds, "tries": tries, **settings}
        label = " + ".join(entry.key) or table.base.name
        return Job(table.model(entry).flat, table.names(entry), table.question, tuple(starts), label=label, **settings)

    def from_part(self, entry: Entry, part: Entry) -> Job:
        """The fit from where a part of it ended, with the rest at a tenth of its expected, or usual, size."""
        known = part.fitted
        return self.of(entry, self.beside(entry, part)[:1], states=known.states, size=known.rmse)

    def soon(self, entry: Entry, look: Look) -> Job:
        """The fit from where a look from the right base ended."""
        seconds = SOON * self.effort.look
        return self.of(entry, [look.values], states=look.states, size=look.size, seconds=seconds)

    def from_there(self, entry: Entry, best: Entry) -> Job:
        """The fit of a structure from where the best ended, its effects at any size; soon done if it is right."""
        known, seconds = best.fitted, SOON * self.effort.look
        return self.of(entry, self.beside(entry, best), states=known.states, size=known.rmse, seconds=seconds)

    def left_by(self, entry: Entry, best: Entry, question: Question, steps: int = 0) -> Job:
        """So many steps of a part of the best in the recordings of a question, from where the best has its values."""
        known, names = best.fitted, self.table.names(entry)
        begin = {n: v for n, v in known.values.items() if n in names}
        settings = {"stages": (0, 0), "seconds": self.effort.look, "states": known.states, "size": known.rmse}
        return dataclasses.replace(self.of(entry, [begin], **settings), question=question, iterations=steps)

    def glance_from(self, best: Entry, entry: Entry, more: Mapping[str, float], question: Question, steps: int) -> Job:
        """So many steps in the recordings of a question from where the best ended, with effects at more values, too."""
        job, seconds = self.from_there(entry, best), self.effort.look
        starts = (*([{**job.starts[0], **more}] if more else []), *job.starts)
        settings = {"stages": (0, 0), "seconds": seconds, "iterations": steps, "tries": False}
        return dataclasses.replace(job, starts=starts, question=question, **settings)

    def glance_on(self, best: Entry, entry: Entry, look: Look, question: Question) -> Job:
        """A few steps more from where such a look ended."""
        settings = {"stages": (0, 0), "seconds": self.effort.look, "states": look.states, "size": best.fitted.rmse}
        return dataclasses.replace(self.of(entry, [look.values], **settings), question=question)

    def starts(self, entry: Entry) -> list[dict[str, float]]:
        """Starts of a structure: each of its effects at usual values, the base where its user put it."""
        found = self._together(entry.members, self.table.entry())
        return [{**self.begin, **start} for start in found] + (found[:1] if self.begin and entry.members else [])

    def beside(self, entry: Entry, known: Entry) -> list[dict[str, float]]:
        """Starts of a structure from where another was fitted: what it has more at a tenth of a size, then as usual."""
        names, more = self.table.names(entry), [c for c in entry.members if c not in known.members]
        begin = {n: v for n, v in known.fitted.values.items() if n in names}
        starts = self._together(more, known, expected=True)
        little = {n: v for c in more for n, v in small(c, starts[0]).items()}
        return [{**start, **begin} for start in (little, *starts)]

    def _together(self, members: Sequence[Candidate], along: Entry, expected: bool = False) -> list[dict[str, float]]:
        """Starts of several effects, first choices first; those that are expected belong to where ``along`` ended."""
        each = [(self._expected(c, along) if expected else []) + self.starts_of(c, along) for c in members]
        together = itertools.islice(diagonal(each), TOGETHER if len(each) > 1 else None)
        return [{n: v for start in starts for n, v in start.items()} for starts in together]

    def _expected(self, candidate: Candidate, along: Entry) -> list[dict[str, float]]:
        """Values that first order expects of an effect beside a structure, see `foreseen`, where it was asked there.

        Usual sizes may be a thousand times too large: of what integrates, a drop of oil shows.
        """
        fitted, known = self.table.foreseen.get(along.key, (None, {}))
        if fitted is not along.fitted or candidate.label not in known or not known[candidate.label].start:
            return []
        return [known[candidate.label].start]

    def starts_of(self, candidate: Candidate, along: Entry) -> list[dict[str, float]]:
        """Values of one effect: from what its part would see along the run of a fitted structure, else usual ones."""
        return usual(candidate, self._seen(candidate, along) if looks(candidate) and along.fitted else None)

    def _seen(self, candidate: Candidate, along: Entry) -> dict[str, np.ndarray] | None:
        table = self.table
        entry, runs = table.possible([candidate]), self.runs_of(along)
        if not runs or not table.usable(entry):
            return None
        states = [s.name for s in table.model(along).flat.states]
        values = table.of_its_own(entry, along.fitted.values)
        return seen_by(candidate, table.model(entry), table.question.fit, states, runs, values)

    def runs_of(self, entry: Entry) -> list[np.ndarray]:
        """State trajectories along a fit, of the few that were asked for last; none where a run diverges."""
        fitted, runs = self._runs.pop(entry.key, (None, []))
        if fitted is not entry.fitted:
            try:
                runs = trajectories(self.table.model(entry).flat, self.table.question, entry.fitted)
            except SolveError:
                runs = []
        self._runs[entry.key] = entry.fitted, runs
        self._runs = dict(list(self._runs.items())[-KEPT:])
        return runs
