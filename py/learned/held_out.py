"""Parts of the training recordings that take no part in training, to run a block freely on.

A free run over a part is a run that is going on: it begins with the first sample of the recording, as every run of a
block does, and what it does in the part is counted. So no kind needs a start in the middle of a motion, an output that
integrates drifts for as long as the recording is, and yardsticks that run do it in the same way. ARX, linear, state_nn
and hybrid choose in such runs, too (`linear.whole_runs`).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.records import Record

from .verdicts import STRETCHES

FIFTH = 5  # of so many recordings one is held out as it is, where they are many
WHOLE = STRETCHES * FIFTH  # recordings are many; of fewer, the end of each is held out: one tells nothing of chance
ENDS = (0.2, 0.3, 0.4)  # share of a recording that may be its end: the first in which the outputs move
# Ends, and nothing in between: training behind a gap starts in the middle of a motion and sees shorter runs. Of 30
# blocks of five kinds on single recordings of C-EHA, valve, tanks and EMPS, 21 ran worse on others with a gap, by 27 %
# in the mean.
MOVES = 0.1  # of the range of the outputs: less is no test of a block
FEWEST = 25  # samples of a part


@dataclass(frozen=True, eq=False)
class Part:
    """The samples of a recording from ``begin`` to ``end`` [s]."""

    whole: Record
    begin: float
    end: float

    @classmethod
    def of(cls, record: Record) -> Part:
        """All of a recording."""
        return cls(record, float(record.time[0]), float(record.time[-1]))

    @property
    def seen(self) -> Record:
        """What was measured there."""
        return self.cut(self.whole)

    def cut(self, run: Record) -> Record:
        """What a run of the whole recording holds there."""
        return run.window(self.begin, self.end)


@dataclass(frozen=True)
class Split:
    """What is trained on, and what is held out; ``why`` nothing is."""

    fit: list[Record]
    parts: list[Part] = field(default_factory=list)
    why: str = ""

    @property
    def held_out(self) -> list[Record]:
        """What was measured in the parts."""
        return [part.seen for part in self.parts]

    def told(self) -> list[dict]:
        """The parts held out, for the provenance."""
        return [
            {"name": r.name, "from": float(r.time[0]), "to": float(r.time[-1]), "samples": len(r)}
            for r in self.held_out
        ]


def as_parts(records: Sequence[Record | Part]) -> list[Part]:
    """Recordings as parts that are all of them; parts as they are."""
    return [r if isinstance(r, Part) else Part.of(r) for r in records]


def through(run: Callable[[Record], Record], parts: Sequence[Part]) -> list[Record]:
    """What ``run`` answers in each part, when it runs through the whole recordings; each is run once."""
    runs: dict[int, Record] = {}
    for part in parts:
        if id(part.whole) not in runs:
            runs[id(part.whole)] = run(part.whole)
    return [part.cut(runs[id(part.whole)]) for part in parts]


def split(records: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]) -> Split:
    """The end of every recording, or the last fifth of many recordings.

    What is held out must move an output; the recordings themselves are checked by who trains.
    """
    records, names = list(records), [*inputs, *outputs]
    if not records or not outputs or not all(n in r and np.isfinite(r[n]).all() for r in records for n in names):
        return Split(records, why="the recordings lack a signal or samples")
    ranges = {n: float(np.ptp(np.concatenate([r[n] for r in records]))) or 1.0 for n in outputs}
    if len(records) >= WHOLE:
        held = records[-(len(records) // FIFTH) :]
        if any(_moves(r, ranges) for r in held):
            return Split(records[: -len(held)], [Part.of(r) for r in held])
    fit, parts = [], []
    for record in records:
        part = _end(record, ranges)
        fit.append(record if part is None else record.window(None, part.begin))
        parts += [] if part is None else [part]
    if not parts:
        return Split(records, why="no end of a recording is long enough and moves the outputs")
    return Split(fit, parts)


def _end(record: Record, ranges: dict[str, float]) -> Part | None:
    """The shortest end that is long enough and moves an output."""
    n = len(record)
    for share in ENDS:
        k = int(n * (1 - share))
        if n - k >= FEWEST:
            part = Part(record, float(record.time[k]), float(record.time[-1]))
            if _moves(part.seen, ranges):
                return part
    return None


def _moves(record: Record, ranges: dict[str, float]) -> bool:
    return any(np.ptp(record[name]) >= MOVES * range_ for name, range_ in ranges.items())
