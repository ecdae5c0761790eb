"""Lasting: does what was named keep its values while it is recorded?

A load that grows heavier half way is explained, for the most part, by one mass, which is right at no time. So what was
named is fitted once more with two values of its parameter, one before the middle of a recording, one after,

    p(t) = p_1 + late(t) (p_2 - p_1),   late = 0, 1,

and where that leaves less by far, here and on held-out recordings, and one value is less than half of the other, what
is missing is no constant of the machine. Where a gap is left, all that has one parameter is asked the same in the place
of what was named: a push that comes and goes is, for two wrong names, a sensor that drifts and a leak.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import casadi as ca
import numpy as np

from hydrotwin.identification.problem import Recording
from hydrotwin.models.effects import Candidate
from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel, Signal

from .decide import closed, compared
from .refit import Question, RefitJob, refit
from .screen import Screen, Screened
from .search import Search
from .structure import Structure, label_of
from .verdict import NAMED

LATE, LATER = "late", "later"
INSTEAD = 4  # effects that are asked in the place of what was named
HALF = 0.5  # of the larger value: what the smaller one must be for both to be one
MOST_OF_IT = 0.5  # of what is left: what two values must explain


@dataclass(frozen=True)
class Change:
    """A parameter of a named effect, SI, with the values it has before and after the middle of the recordings.

    closed : the share of the gap that is closed when it need not keep its value.
    """

    candidate: Candidate
    parameter: str
    unit: str
    before: float
    after: float
    closed: float

    def told(self) -> str:
        """The answer where this would explain the gap if it kept its value."""
        c = self.candidate
        return (
            f"Something changes while it is recorded: {c.effect.title} at {c.site.name} would explain "
            f"{100 * self.closed:.0f} % of the gap, but not as a constant of the machine ({self.parameter} is "
            f"{self.before:.4g} {self.unit} before the middle of a recording and {self.after:.4g} {self.unit} after). "
            "Record each state by itself."
        )


def changing(search: Search, now: Structure, base: Structure) -> Change | None:
    """What most surely does not keep its value and explains the gap of ``base`` once it need not: of ``now``, or alone.

    Effects of one parameter are asked, each by itself: of several one could do another's work, and none had changed.
    None when all last, when that does not explain the gap either, and of an FMU, of which nothing is known.
    """
    if search.base.flat.black_box:
        return None
    question = _halved(search.question)
    flat = search.model(now.members).flat
    asked = [(c, _job(search, question, now, c)) for c in now.members if _has_one_value(c, flat)]
    if not search.explained(now):
        asked += _instead(search, question, base)
    return _surest(search, asked, now, base)


def _has_one_value(c: Candidate, flat: FlatModel) -> bool:
    """Whether an effect has one parameter, which the equations read; a delay is read by the driver."""
    return len(c.free) == 1 and c.free[0] not in {s.dead_time for s in flat.inputs}


def _surest(
    search: Search, asked: Sequence[tuple[Candidate, RefitJob]], now: Structure, base: Structure
) -> Change | None:
    """The effect that leaves far less than ``now`` with two values, and explains the gap of ``base``; the surest."""
    found, jobs = [], [job for _, job in asked]
    for (c, job), fitted in zip(asked, search.run(refit, jobs, "look back") if jobs else (), strict=True):
        if isinstance(fitted, str):
            continue
        (name,), share = c.free, closed(fitted, base.fitted, search.question)
        unit = job.flat.parameters[job.flat.index_of(name)].unit
        change = Change(c, name, unit, fitted.values[name], fitted.values[_later(name)], share)
        over = compared(fitted, now.fitted, search.question)
        if over.passes(len(search.candidates)) and over.closed > MOST_OF_IT and share > NAMED and _differs(change):
            found.append((over.bic_gain, change))
    return max(found, key=lambda pair: pair[0])[1] if found else None


def _instead(search: Search, question: Question, base: Structure) -> list[tuple[Candidate, RefitJob]]:
    """The base with each of the most promising effects alone, two values for its parameter."""
    search.report("screen", 0, len(search.candidates), "")
    one = [c for c in search.candidates if _has_one_value(c, search.big)]
    twice = [_with_both(c) for c in one]
    big = with_two_values(search.big, *(c.free[0] for c in one))
    try:
        screen = Screen(big, search.names(()), twice, base.fitted, question)
    except SolveError:
        return []
    seen = [(screen.by_derivative(both), c) for both, c in zip(twice, one, strict=True)]
    promising = sorted((row for row in seen if row[0].gain > 0), key=lambda row: -row[0].gain)[:INSTEAD]
    return [(c, _job(search, question, Structure((c,), base.fitted), c, s)) for s, c in promising]


def _with_both(c: Candidate) -> Candidate:
    """A candidate of one parameter with both values free."""
    (name,) = c.free

    def both(known: Mapping) -> dict:
        return {**known, _later(name): known[name]} if name in known else dict(known)

    return dataclasses.replace(
        c, free=(name, _later(name)), neutral=both(c.neutral), typical=both(c.typical),
        probes=tuple(both(p) for p in c.probes),
    )  # fmt: skip


def _job(
    search: Search, question: Question, now: Structure, changes: Candidate, screened: Screened | None = None
) -> RefitJob:
    """The structure's fit from where it stands, or from what a screen proposes, with two values of one parameter."""
    (name,), fitted = changes.free, now.fitted
    here = fitted.values.get(name, changes.neutral[name])
    start = {**fitted.values, name: here, _later(name): here}
    start = {**start, **screened.beside, **screened.start} if screened else start
    return RefitJob(
        with_two_values(search.model(now.members).flat, name), (*search.names(now.members), _later(name)), question,
        (start,), fitted.states, fitted.size, label=label_of(now.members),
    )  # fmt: skip


def _differs(row: Change) -> bool:
    """Whether one value is less than half of the other, as it is or beyond neutral: a mass, and what is added to it."""
    neutral = row.candidate.neutral[row.parameter]
    beyond = row.before - neutral, row.after - neutral
    return any(a * b < HALF * max(a * a, b * b) for a, b in ((row.before, row.after), beyond))


def with_two_values(flat: FlatModel, *names: str) -> FlatModel:
    """A model in which parameters have other values, ``NAME.later``, where the added input ``late`` is 1."""
    t, x, u, p = (ca.SX.sym(n, flat.ode.size1_in(i)) for i, n in enumerate("txup"))
    late, later, present = ca.SX.sym(LATE), ca.SX.sym(LATER, len(names)), ca.SX(p)
    index = [flat.index_of(name) for name in names]
    for k, i in enumerate(index):
        present[i] = p[i] + late * (later[k] - p[i])
    both, wider = ca.vertcat(p, later), ca.vertcat(u, late)
    ode = ca.Function(flat.ode.name(), [t, x, wider, both], flat.ode(t, x, u, present), list("txup"), ["xdot", "y"])

    def initialisation(given: tuple[str, ...]) -> ca.Function:
        z, start = ca.SX.sym("z", len(given)), flat.start_given(given)
        return ca.Function("start", [wider, both, z], [start(u, p, z)], ["u", "p", "z"], ["x"])

    added = (dataclasses.replace(flat.parameters[i], name=_later(n)) for i, n in zip(index, names, strict=True))
    return dataclasses.replace(
        flat,
        inputs=(*flat.inputs, Signal(LATE, "1")),
        parameters=(*flat.parameters, *added),
        ode=ode,
        initialisation=initialisation,
        loops=(),  # they are of the parameters before
    )


def _later(name: str) -> str:
    return f"{name}.{LATER}"


def halved(recordings: Collection[Recording]) -> dict[str, Recording]:
    """By name, with ``late`` as a last input: 1 from the middle of each on, of all where one follows another.

    The parts of a lone recording follow each other; whole ones all begin at 0.
    """
    spans = sorted((r.time[0], r.time[-1]) for r in recordings)
    follow = len(spans) > 1 and all(a[1] < b[0] for a, b in pairwise(spans))
    found = {}
    for recording in recordings:
        first, last = (spans[0][0], spans[-1][1]) if follow else (recording.time[0], recording.time[-1])
        late = recording.time >= 0.5 * (first + last)
        found[recording.name] = dataclasses.replace(recording, u=np.column_stack([recording.u, late]))
    return found


def _halved(q: Question) -> Question:
    """The question with ``late`` in all its recordings."""
    late = halved({r.name: r for r in (*q.fit, *q.select)}.values())
    return dataclasses.replace(q, fit=_of(late, q.fit), select=_of(late, q.select))


def _of(late: Mapping[str, Recording], recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    return tuple(late[r.name] for r in recordings)
