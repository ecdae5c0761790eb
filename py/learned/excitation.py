"""Inputs that go one way only: one step or one ramp, from which a model learns little about other commands."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.records import Record

LEAST = 2  # times that an input crosses the middle of its range: there and back
MARGIN = 0.1  # of the range on either side of the middle: less is no crossing


def crossings(values: np.ndarray) -> int:
    """How often (n,) values cross the middle of their range, from `MARGIN` below to `MARGIN` above or back."""
    low, high = float(values.min()), float(values.max())
    if not high > low:
        return 0
    place = (values - low) / (high - low) - 0.5
    sides = np.sign(place[np.abs(place) > MARGIN])
    return int(np.count_nonzero(np.diff(sides)))


def one_way(records: Sequence[Record], inputs: Sequence[str]) -> list[str]:
    """A sentence for every input that moves, but never there and back in all of the recordings together."""
    answer = []
    for name in (n for n in inputs if all(n in r for r in records)):
        count = crossings(np.concatenate([r[name] for r in records]))
        if count < LEAST:
            seconds = sum(r.duration for r in records)
            answer.append(
                f"{name} goes one way only ({'once' if count else 'not once'} through the middle of its range in "
                f"{seconds:.3g} s): how the machine answers to other commands is not known. Record it going there and "
                "back, at several levels."
            )
    return answer
