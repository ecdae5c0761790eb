"""Lasting: does what was named keep its values while it is recorded?

A load that grows heavier half way is explained, for the most part, by one mass, which is right at no time. So what was
named is fitted once more with two values of its parameter, one before the middle of a recording, one after,

    p(t) = p_1 + late(t) (p_2 - p_1),   late = 0, 1,

and where that leaves less by far, here and on held-out recordings, and one value is less than half of the other, what
is missing is no constant of the machine.
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
from hydrotwin.models.language.flat import FlatModel, Signal

from .decide import closed, compared
from .refit import RefitJob, refit
from .search import Search
from .structure import Structure, label_of
from .verdict import NAMED

LATE, LATER = "late", "later"
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
    """What most surely does not keep its value in a structure that explains the gap of ``base`` once it need not.

    Effects of one parameter are asked, each by itself: of several one could do another's work, and none had changed.
    None when all last, when that does not explain the gap either, and of an FMU, of which nothing is known.
    """
    flat = search.model(now.members).flat
    delays = {s.dead_time for s in flat.inputs}  # read by the driver, not by the equations
    asked = [c for c in now.members if len(c.free) == 1 and c.free[0] not in delays]
    if flat.black_box or not asked:
        return None
    jobs = [_job(search, now, flat, c.free[0]) for c in asked]
    found, units = [], {p.name: p.unit for p in flat.parameters}
    for c, fitted in zip(asked, search.run(refit, jobs, "look back"), strict=True):
        if isinstance(fitted, str):
            continue
        (name,), share = c.free, closed(fitted, base.fitted, search.question)
        change = Change(c, name, units[name], fitted.values[name], fitted.values[_later(name)], share)
        over = compared(fitted, now.fitted, search.question)
        if over.passes(len(search.candidates)) and over.closed > MOST_OF_IT and share > NAMED and _differs(change):
            found.append((over.bic_gain, change))
    return max(found, key=lambda pair: pair[0])[1] if found else None


def _job(search: Search, now: Structure, flat: FlatModel, name: str) -> RefitJob:
    """The structure's fit from where it stands, with two values of one parameter."""
    q, fitted = search.question, now.fitted
    late = halved({r.name: r for r in (*q.fit, *q.select)}.values())
    question = dataclasses.replace(q, fit=_of(late, q.fit), select=_of(late, q.select))
    start = {**fitted.values, _later(name): fitted.values[name]}
    return RefitJob(
        with_two_values(flat, name), (*search.names(now.members), _later(name)), question, (start,), fitted.states,
        fitted.size, label=label_of(now.members),
    )  # fmt: skip


def _differs(row: Change) -> bool:
    """Whether one value is less than half of the other, as it is or beyond neutral: a mass, and what is added to it."""
    neutral = row.candidate.neutral[row.parameter]
    beyond = row.before - neutral, row.after - neutral
    return any(a * b < HALF * max(a * a, b * b) for a, b in ((row.before, row.after), beyond))


def with_two_values(flat: FlatModel, name: str) -> FlatModel:
    """A model in which a parameter has another value, ``NAME.later``, where the added input ``late`` is 1."""
    t, x, u, p = (ca.SX.sym(n, flat.ode.size1_in(i)) for i, n in enumerate("txup"))
    late, later, index, present = ca.SX.sym(LATE), ca.SX.sym(LATER), flat.index_of(name), ca.SX(p)
    present[index] = p[index] + late * (later - p[index])
    both, wider = ca.vertcat(p, later), ca.vertcat(u, late)
    ode = ca.Function(flat.ode.name(), [t, x, wider, both], flat.ode(t, x, u, present), list("txup"), ["xdot", "y"])

    def initialisation(given: tuple[str, ...]) -> ca.Function:
        z, start = ca.SX.sym("z", len(given)), flat.start_given(given)
        return ca.Function("start", [wider, both, z], [start(u, p, z)], ["u", "p", "z"], ["x"])

    return dataclasses.replace(
        flat,
        inputs=(*flat.inputs, Signal(LATE, "1")),
        parameters=(*flat.parameters, dataclasses.replace(flat.parameters[index], name=_later(name))),
        ode=ode,
        initialisation=initialisation,
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


def _of(late: Mapping[str, Recording], recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    return tuple(late[r.name] for r in recordings)
