"""Even sampling behind printed times: 0.003, 0.007, 0.010 s are 300 Hz, written in milliseconds."""

from __future__ import annotations

import numpy as np

from .resampling import NEAR

FINEST = 9  # digits after the point that times are looked at for
ROUNDING = 0.501  # of the last digit printed: as far as rounding moves a time
FEWEST, ENOUGH = 3, 10  # times that say something of a grid; and of one that rounding has moved further


def even_times(time: np.ndarray) -> np.ndarray | None:
    """The even grid (n,) [s] that printed times (n,) are of; None where sampling is not even.

    Every time lies within its last digit of the grid, or nearer than a small share of a step.
    """
    if len(time) < FEWEST:
        return time
    k = np.arange(len(time), dtype=float)
    ends = (time[-1] - time[0]) / (len(time) - 1)
    away = time - time[0] - ends * k
    if np.abs(away).max() <= NEAR * ends:
        return time[0] + ends * k
    if len(time) < ENOUGH or np.abs(away).max() > ends:  # no rounding moves a time by more than a step
        return None
    slope, offset = np.polyfit(k, away, 1)
    grid = time[0] + offset + (ends + slope) * k
    return grid if np.abs(time - grid).max() <= ROUNDING * _last_digit(time) < 0.5 * ends else None


def _last_digit(time: np.ndarray) -> float:
    """What the last digit of printed times counts [s]; 0 of times that have no fixed number of digits."""
    for digits in range(FINEST + 1):
        scaled = time * 10.0**digits
        if np.abs(scaled - np.round(scaled)).max() <= 1e-3 + 4e-16 * np.abs(scaled).max():
            return 10.0**-digits
    return 0.0
