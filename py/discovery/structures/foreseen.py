"""What effects promise to first order, from where a structure was fitted: the order in which they are looked at."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from hydrotwin.identification.horizon import first_guess
from hydrotwin.models.effects import Candidate
from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.simulation import prepare

from ..fits.response import WINDOWS, Promise, Responses, stretch_of
from .jobs import Jobs
from .starts import compatible, sized, usually
from .table import Entry, Table

GROWN = 2  # structures, the best, to which effects are added
SAMPLES = 1500  # of stretches in which windows leave most
LIKELY = 16  # single effects that are looked at with more care: those that promise most
IN_ALL = 2000  # of whole recordings: a gap that shows in all of them alone is small


class Foreseen(NamedTuple):
    """To first order: the share of what a structure leaves that is left with an effect, and its values, by path.

    start : empty where nothing is expected of it.
    """

    left: float
    start: dict[str, float]


def foreseen(table: Table, jobs: Jobs, known: Entry) -> dict[str, Foreseen]:
    """What is to be expected of every other effect in addition to a fitted structure, by label.

    Those of which nothing can be said are not in it: of FMUs, and of recordings of a few samples, none.
    """
    fitted, found = table.foreseen.get(known.key, (None, {}))
    if fitted is not known.fitted:
        others = [c for c in table.candidates if c not in known.members and compatible((*known.members, c))]
        found = _foreseen(table, jobs, known, others)
        table.foreseen[known.key] = known.fitted, found
    return found


def singles(jobs: Jobs) -> list[Entry]:
    """Single effects, those first that promise most to first order."""
    table = jobs.table
    known = foreseen(table, jobs, table.entry())
    left = {label: one.left for label, one in known.items()}
    entries = [table.entry([c]) for c in sorted(table.candidates, key=lambda c: left.get(c.label, 1.0))]
    jobs.likely = [e.key for e in entries[:LIKELY]]
    return entries


def larger(jobs: Jobs, size: int) -> list[Entry]:
    """The best structures of one effect less with one more each, and pairs of the most promising effects."""
    table, pool = jobs.table, promising(jobs.table)[: jobs.effort.pool]
    known = [e for e in table.entries.values() if len(e.key) == size - 1 and not e.failed]
    best = sorted(known, key=lambda e: _worth(table, e))[:GROWN]
    groups = [(*e.members, c) for e in best for c in beside(jobs, e, len(pool))]
    if size == 2:
        pairs = itertools.combinations(pool, 2)
        groups += sorted(pairs, key=lambda pair: pool.index(pair[0]) + pool.index(pair[1]))
    return list({e.key: e for e in map(table.entry, filter(compatible, groups))}.values())


def beside(jobs: Jobs, known: Entry, count: int) -> list[Candidate]:
    """So many effects that may be missing beside a structure, the most promising first.

    To first order from where it was fitted: alone an effect may promise nothing, for the base is bent by what the
    structure holds. Where nothing can be said, those that promise most alone.
    """
    table = jobs.table
    left = {label: one.left for label, one in foreseen(table, jobs, known).items()} if known.fitted else {}
    more = [c for c in table.candidates if c.label in left] if left else promising(table)
    more = sorted(more, key=lambda c: left.get(c.label, 0.0))[:count]
    return [c for c in more if c not in known.members]


def promising(table: Table) -> list[Candidate]:
    """Single effects, the most promising first; of what was not looked at nothing is known."""
    alone = [table.entries.get((c.label,), table.possible([c])) for c in table.candidates]
    return [e.members[0] for e in sorted(alone, key=lambda e: _worth(table, e)) if not e.failed]


def _worth(table: Table, e: Entry) -> float:
    """Share of what the base leaves that a structure leaves, or promises to."""
    return min(table.promise(e), table.share(e) if e.fitted else np.inf)


def _foreseen(table: Table, jobs: Jobs, known: Entry, others: Sequence[Candidate]) -> dict[str, Foreseen]:
    flat, values = table.model(known).flat, dict(known.fitted.values)
    if flat.black_box or not flat.states or min(len(r.time) for r in table.question.fit) <= WINDOWS:
        return {}
    along = _along(table, jobs, known, flat, values)
    found = []
    for one in others:
        entry = table.possible([one])  # one model an effect: those of pairs would take longer to build than to ask
        if table.usable(entry):
            model, starts = table.model(entry).flat, jobs.starts_of(one, known)
            own = table.of_its_own(entry, values)
            sets = np.array([model.parameter_vector({**own, **start}) for start in starts])
            found.append((one, starts, along.of(model, sets)))
    promises = along.promises([response for *_, response in found]) if found else []
    return {
        one.label: Foreseen(promise.left, _expected(one, starts, promise) if promise.size > 0 else {})
        for (one, starts, _), promise in zip(found, promises, strict=True)
    }


def _expected(one: Candidate, starts: Sequence[Mapping[str, float]], promise: Promise) -> dict[str, float]:
    """The values at which it explains most to first order, which knows of no bounds: no mass becomes negative."""
    return usually(one, sized(one, starts[promise.which], promise.size))


def _along(table: Table, jobs: Jobs, known: Entry, flat: FlatModel, values: Mapping[str, float]) -> Responses:
    """Responses along the fit where whole recordings are looked at, else where windows leave most.

    A residual counts in units of what is left of its output there.
    """
    question, p, size = table.question, flat.parameter_vector(dict(values)), known.fitted.rmse
    propagator, stretches = prepare(flat, step=question.step), []
    most = (SAMPLES if question.lengths else IN_ALL) // len(question.fit)
    along = [] if question.lengths else jobs.runs_of(known)
    for i, recording in enumerate(question.fit):

        def run(part: slice, x0: np.ndarray, recording=recording):
            time = recording.time[part]
            try:
                return propagator.run(time, recording.u[part], p, x0)
            except SolveError:
                return np.full((len(time), recording.y.shape[1]), np.nan), np.tile(x0, (len(time), 1))

        T = question.lengths[-1] if question.lengths else recording.time[-1] - recording.time[0]
        window = max(T, most * float(np.median(np.diff(recording.time)))) / WINDOWS
        states = along[i] if along else first_guess(flat, [recording], propagator, p, window)[0]
        stretches.append(stretch_of(recording, states, run, size, T, most))
    there = np.concatenate([s.left.reshape(-1, s.left.shape[-1]) for s in stretches])
    there = np.sqrt(np.nansum(there**2, axis=0) / np.maximum(np.isfinite(there).sum(axis=0), 1))
    return Responses(flat, p, table.names(known), stretches, np.fmax(there, table.noise), table.base.flat)
