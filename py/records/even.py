"""Even sampling behind printed times: 0.003, 0.007, 0.010 s are 300 Hz, written in milliseconds."""

from __future__ import annotations

import numpy as np

from .resampling import NEAR

FINEST = 9  # digits after the point that times are looked at for
ROUNDING = 1.0  # of the last digit printed: as far as rounding moves a time from a line that is fitted through all
FEWEST, ENOUGH = 3, 10  # times that say something of a grid; and of one that rounding has moved further
LOST, MOSTLY = 20, 0.75  # samples that may be missing from a grid, and share of its steps that must be there


def even_times(time: np.ndarray) -> np.ndarray | None:
    """The times (n,) [s] on an even grid that printed ones (n,) are of, a few of it missing; None where there is none.

    Every time lies within its last digit of the grid, or nearer than a small share of a step.
    """
    if len(time) < FEWEST:
        return time
    whole = np.arange(len(time), dtype=float)
    step = (time[-1] - time[0]) / (len(time) - 1)
    if np.abs(time - time[0] - step * whole).max() <= NEAR * step:
        return time[0] + step * whole
    if len(time) < ENOUGH:
        return None
    digit = _last_digit(time)
    for lost in range(LOST + 1):
        step = (time[-1] - time[0]) / (len(time) - 1 + lost)
        ticks = np.round((time - time[0]) / step)
        if np.diff(ticks).min() < 1 or (np.diff(ticks) == 1).mean() < max(1 - 2 * lost / len(time), MOSTLY):
            continue
        slope, offset = np.polyfit(ticks, time - time[0] - step * ticks, 1)
        grid = time[0] + offset + (step + slope) * ticks
        near = NEAR * step if lost else ROUNDING * digit  # of a whole grid, what is nearer was seen before
        if np.abs(time - grid).max() <= min(max(near, ROUNDING * digit), 0.5 * step):
            return grid
    return None


def is_whole(times: np.ndarray) -> bool:
    """Whether times on an even grid lack none of it."""
    return len(times) < FEWEST or bool(np.ptp(np.diff(times)) < 0.5 * np.diff(times).min())


def _last_digit(time: np.ndarray) -> float:
    """What the last digit of printed times counts [s]; 0 of times that have no fixed number of digits."""
    for digits in range(FINEST + 1):
        scaled = time * 10.0**digits
        if np.abs(scaled - np.round(scaled)).max() <= 1e-3 + 4e-16 * np.abs(scaled).max():
            return 10.0**-digits
    return 0.0
