"""How much of the recordings a look goes through: no more than shows the gap well."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from hydrotwin.models.effects import Candidate

from ..evidence.deciding import DECIDING
from ..evidence.posterior import NOTHING
from ..evidence.score import score
from ..fits.job import WINDOWS, Fitted, Look, Question
from .table import Table

SHORT = 2  # lengths of windows in which a large gap shows
ENOUGH = 1000.0  # nats that the base leaves in what is looked through: more would cost time and tell no more
FEWEST = 40  # windows of a length
LONG = 15000  # samples of all recordings from which on a look goes through no more of them than it must
MANY = 9000  # samples of all recordings from which on their beginnings are searched first
BRIEF = 5000  # samples of those beginnings
PARTS = (1 / 32, 1 / 16, 1 / 8, 1 / 4, 1 / 2)  # of every recording, from its beginning, that may do for a look
UNSEEN = 1e3  # times the most that is usual: what is known no better shows in nothing but rounding
FAIR = 0.5  # of the gap in all recordings, in proportion: what acts later than in such a part is looked for in all


def testable(known: Look | Fitted | None, c: Candidate) -> bool:
    """Whether anything moves in the recordings of a look or fit when the parameters of an effect do."""
    if known is None or not known.sigmas or not c.free:
        return True
    return any(known.sigmas.get(n, np.inf) < UNSEEN * _most(c, n) for n in c.free)


def _most(c: Candidate, name: str) -> float:
    """The most that a parameter of an effect usually moves; infinite where nothing is usual."""
    return float(np.max(np.abs(np.subtract(c.typical.get(name, np.inf), c.neutral.get(name, 0.0)))))


def telling(table: Table) -> int:
    """How many lengths of windows a first look goes through: until the base leaves enough to tell candidates apart.

    0 where short ones do not show it: the gap is small then, and the base near what it would be.
    """
    base = table.entries[NOTHING]
    if not (base.look and table.question.lengths):
        return 0
    stages = range(min(base.look.end, SHORT))
    return next((k + 1 for k in stages if table.visible(k) > DECIDING.visible), 0)


def with_fewer_windows(table: Table, first: int) -> bool:
    """Whether fewer windows show the gap well; the table's question has those then."""
    enough = int(WINDOWS * ENOUGH / table.visible(first - 1)) if first else WINDOWS
    if enough < 0.8 * WINDOWS:
        table.question = dataclasses.replace(table.question, windows=max(enough, FEWEST))
        return True
    return False


def enough_windows(table: Table, look: Look) -> int:
    """How many windows of the length of a look show what it leaves well."""
    question, stage = table.question, look.begin
    seconds = sum(r.time[-1] - r.time[0] for r in question.fit)
    there = min(question.windows, seconds / question.lengths[stage])
    return max(int(np.ceil(there * min(1.0, ENOUGH / table.in_windows(look, stage)))), 1)


def beginnings(question: Question, part: float) -> Question:
    """The question of the first part of every recording."""
    cut = [dataclasses.replace(r, time=r.time[:n], u=r.u[:n], y=r.y[:n])
           for r in question.fit if (n := max(int(part * len(r.time)), 2))]  # fmt: skip
    return dataclasses.replace(question, fit=tuple(cut))


def brief(question: Question) -> Question | None:
    """The question of the beginnings of long recordings; None where they are not."""
    samples = sum(len(r.time) for r in question.fit)
    return beginnings(question, BRIEF / samples) if samples > MANY else None


def enough_of(
    table: Table, look: Callable[[Question], object], whole: Look, well: float = ENOUGH
) -> tuple[Question, Look]:
    """The shortest beginnings of the recordings that show the gap well, and what is left there.

    Where twice as much would be too long for a look, a fair share of the gap is enough. look : of a structure through
    the recordings of a question; whole : what that left of all of them; well : nats that show it well.
    """
    floor = table.floor()
    total = score(whole.left, floor)
    samples = sum(len(r.time) for r in table.question.fit)
    for part in PARTS:
        enough = well if 2 * part * samples <= LONG else 0.0
        if total <= enough:
            continue
        question = beginnings(table.question, part)
        found = look(question)
        if isinstance(found, Look) and score(found.left, floor) > max(enough, FAIR * part * total):
            return question, found
    return table.question, whole
