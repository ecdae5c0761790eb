"""Parts of the training recordings that take no part in training, to run a block freely on.

A free run over a part is a run that is going on: it begins with the first sample of the recording, as every run of a
block does, and what it does in the part is counted. So no kind needs a start in the middle of a motion, an output that
integrates drifts for as long as the recording is, and yardsticks are told what the block is told: inputs, and one
sample. ARX, linear, state_nn and hybrid choose in the same way, see `linear.whole_runs`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.records import Record

WHOLE = 5  # recordings, from which on every fifth is held out as it is; of fewer, the end of each
FROM_ONE = 2  # parts of a recording that is alone: the end of each half, for its end may be like nothing else in it
SHARES = (0.2, 0.3, 0.4)  # of a recording that may be held out: the first in which the outputs move in every part
AROUND = 0.03  # of a recording: how far the end of a part may be moved to where the machine is quiet
PLACES = 40  # of that end that are tried
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
    """The last fifth of many recordings, the end of each of a few, two parts of one that is alone.

    Training goes on behind a part where the machine is quiet, for there it starts at rest. What is held out must move
    an output; the recordings themselves are checked by who trains.
    """
    records, names = list(records), [*inputs, *outputs]
    if not records or not outputs or not all(n in r and np.isfinite(r[n]).all() for r in records for n in names):
        return Split(records, why="the recordings lack a signal or samples")
    ranges = {n: float(np.ptp(np.concatenate([r[n] for r in records]))) or 1.0 for n in names}
    if len(records) >= WHOLE:
        held = records[-(len(records) // WHOLE) :]
        if any(_moves(r, outputs, ranges) for r in held):
            return Split(records[: -len(held)], [Part.of(r) for r in held])
    fit, parts = [], []
    for record in records:
        edges = _edges(record, names, outputs, ranges, FROM_ONE if len(records) == 1 else 1)
        begins, ends = [0, *(b for _, b in edges)], [*(a for a, _ in edges), len(record) - 1]
        fit += [record.window(record.time[i], record.time[j]) for i, j in zip(begins, ends, strict=True) if i < j]
        parts += [Part(record, float(record.time[a]), float(record.time[b])) for a, b in edges]
    if not parts:
        return Split(records, why="no part of a recording is long enough and moves the outputs")
    return Split(fit, parts)


def _edges(record: Record, names: Sequence[str], outputs, ranges: dict[str, float], most: int) -> list[tuple[int, int]]:
    """First and last sample of the parts of a recording: the ends of its halves (``most`` = 2), or its end; or none."""
    n = len(record)
    normal = np.column_stack([record[name] / ranges[name] for name in names])
    for share in SHARES:
        for count in range(most, 0, -1):
            if n * share < count * FEWEST:
                continue
            ends = [*(_quiet(normal, k / count) for k in range(1, count)), n - 1]
            edges = [(int(n * (k + 1 - share) / count), end) for k, end in enumerate(ends)]
            long = all(b + 1 - a >= FEWEST for a, b in edges)
            if long and all(_moves(record.window(record.time[a], record.time[b]), outputs, ranges) for a, b in edges):
                return edges
    return []


def _quiet(normal: np.ndarray, share: float) -> int:
    """The sample near ``share`` of a recording, signals (n, k) over ranges, before which they moved least."""
    n = len(normal)
    before = max(n // 100, 5)
    places = np.unique(np.linspace(n * (share - AROUND), n * (share + AROUND), PLACES).astype(int))
    places = [k for k in places if before <= k < n] or [int(n * share)]
    return int(min(places, key=lambda k: np.ptp(normal[k - before : k + 1], axis=0).sum()))


def _moves(record: Record, outputs: Sequence[str], ranges: dict[str, float]) -> bool:
    return any(np.ptp(record[name]) >= MOVES * ranges[name] for name in outputs)
