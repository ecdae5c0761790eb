"""Starts that differ in the frequency of a lightly damped mode: which hollow of the cost a descent ends in.

Windows of three periods forgive a frequency that is 15 % off (`horizon.PERIODS`). An oil column whose stiffness and
volumes are each a third off is 40 % off, or stands beyond half the sampling frequency: then every descent from there
ends in another hollow, with whatever damping and volumes make the least of it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel

from .horizon import lightly_damped
from .problem import FreeParameters, Recording

SPACING = 1.2  # between frequencies: no more than windows forgive to either side
EACH_WAY = 2
STEP = 1e-3  # in q
CLOSE = 0.25  # of the spacing: how near a frequency has to come
MOVES = 0.01  # of the largest slope of the frequency, and relative slope of the damping: a parameter of the mode


def tuned_starts(flat: FlatModel, recordings: Sequence[Recording], free: FreeParameters) -> list[dict[str, float]]:
    """Starts that give the fastest lightly damped mode this and other frequencies, with the least change in q.

    Values by path of those free parameters alone that its frequency or damping depends on, the present ones first.
    None where every mode is damped, where nothing that is free moves the mode, or where bounds stand in the way.
    """
    if flat.black_box:
        return []
    fastest = lightly_damped(flat, recordings)

    def mode(q: np.ndarray) -> np.ndarray:
        """Logarithm of the frequency, and damping ratio."""
        try:
            found = fastest(free.vector(q))
        except SolveError:  # no equilibrium to begin in
            found = None
        return np.array([np.log(abs(found)), -found.real / abs(found)]) if found else np.full(2, np.nan)

    def log_frequency(q: np.ndarray) -> float:
        return mode(q)[0]

    q0 = free.scaled(free.start)
    slopes = np.array([mode(q0 + e) - mode(q0 - e) for e in STEP * np.eye(len(q0))]).reshape(-1, 2) / (2 * STEP)
    if not np.isfinite(slopes).all():
        return []
    slope, of_damping = slopes.T
    ratios = [SPACING**k for k in range(-EACH_WAY, EACH_WAY + 1) if k]
    found = [q for q in (_moved(free, log_frequency, slope, np.log(ratio)) for ratio in ratios) if q is not None]
    if not found:
        return []
    own = np.abs(slope) > MOVES * np.abs(slope).max()
    own |= np.abs(of_damping) > MOVES * np.abs(mode(q0)[1])
    return [
        {n: v for n, v, of_mode in zip(free.names, free.values(q).tolist(), own, strict=True) if of_mode}
        for q in (q0, *found)
    ]


def _moved(free: FreeParameters, log_frequency: Callable, slope: np.ndarray, by: float) -> np.ndarray | None:
    """q with the logarithm of the frequency moved ``by`` so much, inside the bounds."""
    lower, upper = free.scaled(free.lower), free.scaled(free.upper)
    q = free.scaled(free.start)
    wanted, close = log_frequency(q) + by, CLOSE * np.log(SPACING)
    for _ in range(2 * len(q)):  # a bound may be met every second time
        missing = wanted - log_frequency(q)
        if not abs(missing) > close:
            break
        stopped = np.where(missing * slope > 0, q >= upper, q <= lower)
        along = np.where(stopped, 0.0, slope)
        if not along @ along > 0:
            break
        q = np.clip(q + missing * along / (along @ along), lower, upper)
    return q if abs(missing) <= close else None
