"""What the steps of a time axis say: where samples are missing.

On an even axis one sample that is missing shows, and a held command that is half a step late bends a fit by several
sigmas. Few at a time are lost on many buses; many at a time are a hole. On an uneven axis only a hole can be told, by
what the longest of its usual steps are.
"""

from __future__ import annotations

import numpy as np

ALIKE, EVEN = 0.1, 0.75  # share of its steps within so much of their median that makes a time axis even
MISSING = 1.5  # median steps: a longer one lacks a sample, if the one beside it is not as much shorter
HOLE = 5.0  # median steps of an even time axis from which on a step is a hole
UNEVEN, USUAL = 4.0, 0.9  # times this quantile of the steps is a hole on an uneven one
LONGEST = 20.0  # median steps that a step may have on any


def holes_at(time: np.ndarray) -> np.ndarray:
    """Samples of a time axis (n,) behind which there is a hole."""
    steps = np.diff(time)
    if len(steps) < 2:
        return np.zeros(0, dtype=int)
    usual = float(np.median(steps))
    longest = HOLE * usual if is_even(steps) else min(LONGEST * usual, UNEVEN * float(np.quantile(steps, USUAL)))
    return np.flatnonzero(steps > longest)


def missing_at(time: np.ndarray) -> np.ndarray:
    """Samples of a time axis (n,) behind which at least one is missing, holes too. A late stamp lacks none."""
    steps = np.diff(time)
    if len(steps) < 2 or not is_even(steps):
        return holes_at(time)
    usual = float(np.median(steps))
    before, after = np.concatenate([[usual], steps[:-1]]), np.concatenate([steps[1:], [usual]])
    shorter = np.minimum(before, after)
    return np.flatnonzero((steps > MISSING * usual) & (steps + shorter > (MISSING + 1.0) * usual))


def few_lost(time: np.ndarray) -> int:
    """How many samples of a time axis (n,) are missing beside those in its holes."""
    steps, at = np.diff(time), np.setdiff1d(missing_at(time), holes_at(time))
    return int(np.sum(np.round(steps[at] / np.median(steps)) - 1)) if len(at) else 0


def is_even(steps: np.ndarray) -> bool:
    """Whether steps (n,) of a time axis are those of a clock that ticks evenly."""
    return bool(np.mean(np.abs(steps - np.median(steps)) <= ALIKE * np.median(steps)) >= EVEN)
