"""What the steps of a time axis say: where samples are missing.

On an even axis one sample that is missing shows, and a held command that is half a step late bends a fit by several
sigmas. Few at a time are lost on many buses; many at a time are a hole. On an uneven axis only a hole can be told, by
what the longest of its usual steps are. What is usual is so for a while: a logger that turns slower lacks nothing.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import median_filter

AROUND = 101  # steps, of which the median is a usual one in their middle; on ends mirrored
ALIKE, EVEN = 0.1, 0.75  # share of its steps within so much of usual ones that makes a time axis even
MISSING = 1.5  # usual steps: a longer one lacks a sample, if the one beside it is not as much shorter
HOLE = 5.0  # usual steps of an even time axis from which on a step is a hole
UNEVEN, USUAL = 4.0, 0.9  # times this quantile of the steps, in usual ones, is a hole on an uneven one
LONGEST = 20.0  # usual steps that a step may have on any


def holes_at(time: np.ndarray) -> np.ndarray:
    """Samples of a time axis (n,) behind which there is a hole."""
    steps = np.diff(time)
    if len(steps) < 2:
        return np.zeros(0, dtype=int)
    ratios = steps / usual(steps)
    longest = HOLE if is_even(steps) else min(LONGEST, UNEVEN * float(np.quantile(ratios, USUAL)))
    return np.flatnonzero(ratios > longest)


def usual(steps: np.ndarray) -> np.ndarray:
    """A usual step (n,) where each of ``steps`` (n,) is: the median of those around it."""
    middle = float(np.median(steps)) if len(steps) else 0.0
    if len(steps) <= AROUND // 2 or steps.max() <= MISSING * middle:
        return np.full(len(steps), middle)
    return median_filter(steps, AROUND, mode="mirror")


def missing_at(time: np.ndarray) -> np.ndarray:
    """Samples of a time axis (n,) behind which at least one is missing, holes too. A late stamp lacks none."""
    steps = np.diff(time)
    if len(steps) < 2 or not is_even(steps):
        return holes_at(time)
    ratios = steps / usual(steps)
    shorter = np.minimum(np.concatenate([[1.0], ratios[:-1]]), np.concatenate([ratios[1:], [1.0]]))
    return np.flatnonzero((ratios > MISSING) & (ratios + shorter > MISSING + 1.0))


def few_lost(time: np.ndarray) -> int:
    """How many samples of a time axis (n,) are missing beside those in its holes."""
    steps, at = np.diff(time), np.setdiff1d(missing_at(time), holes_at(time))
    return int(np.sum(np.round((steps / usual(steps))[at]) - 1)) if len(at) else 0


def is_even(steps: np.ndarray) -> bool:
    """Whether steps (n,) of a time axis are those of a clock that ticks evenly."""
    return bool(np.mean(np.abs(steps / usual(steps) - 1.0) <= ALIKE) >= EVEN)
