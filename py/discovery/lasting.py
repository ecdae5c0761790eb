"""Lasting: does what was named keep its values while it is recorded?

A load that grows heavier half way is explained, for the most part, by one mass, which is right at no time. So what was
named is fitted once more with two values of each of its parameters, one before the middle of a recording, one after,

    p(t) = p_1 + late(t) (p_2 - p_1),   late = 0, 1,

and where that leaves less by far, here and on held-out recordings, and one value is less than half of the other, what
is missing is no constant of the machine.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
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
    """A parameter of a named effect, SI, with the values it has before and after the middle of the recordings."""

    candidate: Candidate
    parameter: str
    unit: str
    before: float
    after: float


@dataclass(frozen=True)
class Changing:
    """The parameters that do not keep their values, and the share of the gap that is closed when they need not."""

    parameters: tuple[Change, ...]
    closed: float

    def told(self) -> str:
        """The answer where what would explain the gap does not keep its values."""
        effects = dict.fromkeys(f"{c.candidate.effect.title} at {c.candidate.site.name}" for c in self.parameters)
        values = "; ".join(f"{c.parameter} {c.before:.4g} then {c.after:.4g} {c.unit}" for c in self.parameters)
        return (
            f"Something changes while it is recorded: {' and '.join(effects)} would explain {100 * self.closed:.0f} % "
            f"of the gap, but not as a constant of the machine ({values}, before and after the middle of a recording). "
            "Record each state by itself."
        )


def changing(search: Search, now: Structure, base: Structure) -> Changing | None:
    """What does not keep its values in a structure that would explain the gap of ``base``, once it need not.

    None when all do, when that does not explain the gap either, and of an FMU, of which nothing is known.
    """
    flat = search.model(now.members).flat
    delays = {s.dead_time for s in flat.inputs}  # read by the driver, not by the equations
    names = [n for c in now.members for n in c.free if n not in delays]
    if flat.black_box or not names:
        return None
    q, fitted = search.question, now.fitted
    question = dataclasses.replace(q, fit=halved(q.fit), select=halved(q.select))
    start = {**fitted.values, **{_later(n): fitted.values[n] for n in names}}
    job = RefitJob(
        with_two_values(flat, names), (*search.names(now.members), *map(_later, names)), question, (start,),
        fitted.states, fitted.size, label=label_of(now.members),
    )  # fmt: skip
    found = search.run(refit, [job], "look back")[0]
    if isinstance(found, str):
        return None
    over, share = compared(found, fitted, q), closed(found, base.fitted, q)
    if not (over.passes(len(search.candidates)) and over.closed > MOST_OF_IT and share > NAMED):
        return None
    units = {p.name: p.unit for p in flat.parameters}
    two = [
        (c, n, units[n], found.values[n], found.values[_later(n)]) for c in now.members for n in c.free if n in names
    ]
    rows = tuple(row for row in (Change(*values) for values in two) if _differs(row))
    return Changing(rows, share) if rows else None


def _differs(row: Change) -> bool:
    """Whether one value is less than half of the other, as it is or beyond neutral: a mass, and what is added to it."""
    neutral = row.candidate.neutral[row.parameter]
    beyond = row.before - neutral, row.after - neutral
    return any(a * b < HALF * max(a * a, b * b) for a, b in ((row.before, row.after), beyond))


def with_two_values(flat: FlatModel, names: Sequence[str]) -> FlatModel:
    """A model in which these parameters have another value, ``NAME.later``, where the added input ``late`` is 1."""
    t, x, u, p = (ca.SX.sym(n, flat.ode.size1_in(i)) for i, n in enumerate("txup"))
    late, later = ca.SX.sym(LATE), ca.SX.sym(LATER, len(names))
    index, present = [flat.index_of(n) for n in names], ca.SX(p)
    for k, i in enumerate(index):
        present[i] = p[i] + late * (later[k] - p[i])
    both, wider = ca.vertcat(p, later), ca.vertcat(u, late)
    ode = ca.Function(flat.ode.name(), [t, x, wider, both], flat.ode(t, x, u, present), list("txup"), ["xdot", "y"])

    def initialisation(given: tuple[str, ...]) -> ca.Function:
        z, start = ca.SX.sym("z", len(given)), flat.start_given(given)
        return ca.Function("start", [wider, both, z], [start(u, p, z)], ["u", "p", "z"], ["x"])

    added = (dataclasses.replace(flat.parameters[i], name=_later(n)) for n, i in zip(names, index, strict=True))
    return dataclasses.replace(
        flat,
        inputs=(*flat.inputs, Signal(LATE, "1")),
        parameters=(*flat.parameters, *added),
        ode=ode,
        initialisation=initialisation,
    )


def _later(name: str) -> str:
    return f"{name}.{LATER}"


def halved(recordings: Sequence[Recording]) -> tuple[Recording, ...]:
    """The recordings with ``late`` as a last input: 1 from the middle of each on, of all where one follows another."""
    spans = [(r.time[0], r.time[-1]) for r in recordings]
    ordered = sorted(spans)
    follow = len(spans) > 1 and all(a[1] < b[0] for a, b in pairwise(ordered))
    whole = (ordered[0][0], ordered[-1][1]) if follow else None
    found = []
    for recording, span in zip(recordings, spans, strict=True):
        late = recording.time >= 0.5 * sum(whole or span)
        found.append(dataclasses.replace(recording, u=np.column_stack([recording.u, late])))
    return tuple(found)
