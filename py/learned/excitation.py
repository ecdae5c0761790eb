"""Inputs that go one way only: one step or one ramp, from which a model learns little about other commands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.records import Record

LEVELS = 10  # of the range of an input, between which it is taken for still
SWING = 4  # levels that it must go without turning back, to have moved
LEAST = 2  # such moves: there and back


def moves(values: np.ndarray) -> int:
    """How often (n,) values go `SWING` of `LEVELS` of their range without going as far back."""
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return 0
    levels = np.round(LEVELS * (values - low) / (high - low)).astype(int)
    levels = levels[np.append(True, np.diff(levels) != 0)]
    count, way = 0, 0
    least = most = levels[0]
    for level in levels.tolist():
        least, most = min(least, level), max(most, level)
        if way <= 0 and level - least >= SWING:
            count, way, most = count + 1, 1, level
        elif way >= 0 and most - level >= SWING:
            count, way, least = count + 1, -1, level
    return count


def one_way(records: Sequence[Record], inputs: Sequence[str]) -> list[str]:
    """A sentence for every input that moves, but never there and back in all of the recordings together."""
    answer = []
    for name in (n for n in inputs if all(n in r for r in records)):
        if moves(np.concatenate([r[name] for r in records])) < LEAST:
            seconds = sum(r.duration for r in records)
            answer.append(
                f"{name} goes one way only ({seconds:.3g} s without a way back of {SWING / LEVELS:.0%} of its range): "
                "how the machine answers to other commands is not known. Record it going there and back, at several "
                "levels."
            )
    return answer
