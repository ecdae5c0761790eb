"""A part of the training recordings that takes no part in training, to run a block freely on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.records import Record

WHOLE = 5  # recordings, from which on every fifth is held out as it is; of fewer, the end of each
ENDS = (0.2, 0.3, 0.4)  # share of a recording that may be its end: the first in which the outputs move
AROUND = 0.05  # of a recording: how far the cut may be moved to where the machine is quiet
PLACES = 40  # of the cut that are tried
MOVES = 0.1  # of the range of the outputs: less is no test of a block
FEWEST = 25  # samples of a recording that can be cut, in its end


@dataclass(frozen=True)
class Split:
    """What is trained on, and what is held out; ``why`` nothing is."""

    fit: list[Record]
    held_out: list[Record]
    why: str = ""

    def told(self) -> list[dict]:
        """The parts held out, for the provenance."""
        return [
            {"name": r.name, "from": float(r.time[0]), "to": float(r.time[-1]), "samples": len(r)}
            for r in self.held_out
        ]


def split(records: Sequence[Record], inputs: Sequence[str], outputs: Sequence[str]) -> Split:
    """The end of every recording, cut where the machine is quiet, or the last fifth of many recordings.

    What is held out must move an output; the recordings themselves are checked by who trains.
    """
    records, names = list(records), [*inputs, *outputs]
    if not records or not outputs or not all(n in r and np.isfinite(r[n]).all() for r in records for n in names):
        return Split(records, [], "the recordings lack a signal or samples")
    ranges = {n: float(np.ptp(np.concatenate([r[n] for r in records]))) or 1.0 for n in names}
    if len(records) >= WHOLE:
        held = records[-(len(records) // WHOLE) :]
        if any(_moves(r, outputs, ranges) for r in held):
            return Split(records[: -len(held)], held)
    fit, held = [], []
    for record in records:
        at = _cut(record, names, outputs, ranges)
        fit.append(record if at is None else record.window(None, record.time[at]))
        held += [] if at is None else [record.window(record.time[at], None)]
    if not held:
        return Split(records, [], "no end of a recording is long enough and moves the outputs")
    return Split(fit, held)


def _cut(record: Record, names: Sequence[str], outputs: Sequence[str], ranges: dict[str, float]) -> int | None:
    """The sample at which the end begins: where inputs and outputs moved least over the last hundredth."""
    n = len(record)
    before = max(n // 100, 5)
    normal = np.column_stack([record[name] / ranges[name] for name in names])
    for share in ENDS:
        places = np.unique(np.linspace(n * (1 - share - AROUND), n * (1 - share + AROUND), PLACES).astype(int))
        places = [k for k in places if k >= before and n - k >= FEWEST]
        places = [k for k in places if _moves(record.window(record.time[k], None), outputs, ranges)]
        if places:
            return int(min(places, key=lambda k: np.ptp(normal[k - before : k + 1], axis=0).sum()))
    return None


def _moves(record: Record, outputs: Sequence[str], ranges: dict[str, float]) -> bool:
    return any(np.ptp(record[name]) >= MOVES * ranges[name] for name in outputs)
