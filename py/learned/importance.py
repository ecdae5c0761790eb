"""What each input is worth to a block: how much worse its free run becomes when that input tells nothing.

The input is put at its mean over the recording, all others as they were recorded. An input without which the block runs
as well may be left out; one that carries all says what else to record.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.records import Record
from hydrotwin.simulation import Block, simulate
from hydrotwin.simulation.stops import Diverged

IDLE = 1.02  # times the error with all inputs: an input without which it grows by less is worth nothing


def importance(block: Block, records: Sequence[Record], outputs: Sequence[str]) -> dict[str, dict[str, float]]:
    """RMS error of the free runs over ``records`` by input that is put at its mean, and by output, SI.

    Infinite where a run diverges without the input. Nothing for a block with one input: all it knows is in that.
    """
    if len(block.inputs) < 2:
        return {}
    return {s.name: _without(block, s.name, records, outputs) for s in block.inputs}


def idle(found: Mapping[str, Mapping[str, float]], errors: Mapping[str, float]) -> list[str]:
    """Inputs without which no output runs worse; errors : RMS by output with all inputs."""
    return [name for name, without in found.items() if all(without[o] < IDLE * e for o, e in errors.items() if e > 0)]


def _without(block: Block, name: str, records: Sequence[Record], outputs: Sequence[str]) -> dict[str, float]:
    squares, count = dict.fromkeys(outputs, 0.0), 0
    for record in records:
        dull = record.with_signals({name: np.full(len(record), float(np.mean(record[name])))})
        try:
            run = simulate(block, dull)
        except Diverged:
            return dict.fromkeys(outputs, float("inf"))
        count += len(record)
        for output in outputs:
            squares[output] += float(np.sum((run[output] - record[output]) ** 2))
    return {output: float(np.sqrt(total / max(count, 1))) for output, total in squares.items()}
