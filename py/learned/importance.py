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

from .held_out import Part, as_parts, through

IDLE = 1.02  # times the error with all inputs: an input without which it grows by less is worth nothing


def importance(block: Block, records: Sequence[Record | Part], outputs: Sequence[str]) -> dict[str, dict[str, float]]:
    """RMS error of the free runs over ``records``, or parts of them, by input that is put at its mean and output, SI.

    Infinite where a run diverges without the input. Nothing for a block with one input: all it knows is in that.
    """
    if len(block.inputs) < 2:
        return {}
    return {s.name: _without(block, s.name, as_parts(records), outputs) for s in block.inputs}


def idle(found: Mapping[str, Mapping[str, float]], errors: Mapping[str, float]) -> list[str]:
    """Inputs without which no output runs worse; errors : RMS by output with all inputs."""
    return [name for name, without in found.items() if all(without[o] < IDLE * e for o, e in errors.items() if e > 0)]


def _without(block: Block, name: str, parts: Sequence[Part], outputs: Sequence[str]) -> dict[str, float]:
    def run(whole: Record) -> Record:
        return simulate(block, whole.with_signals({name: np.full(len(whole), float(np.mean(whole[name])))}))

    try:
        found = through(run, parts)
    except Diverged:
        return dict.fromkeys(outputs, float("inf"))
    return {o: _rms([r[o] - part.seen[o] for r, part in zip(found, parts, strict=True)]) for o in outputs}


def _rms(misses: Sequence[np.ndarray]) -> float:
    return float(np.sqrt(np.mean(np.concatenate(misses) ** 2)))
