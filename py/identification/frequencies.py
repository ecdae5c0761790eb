"""Frequencies: other starts of a fit, in which the fastest lightly damped mode is slower or faster.

A mode whose frequency is wrong by a sixth is half a turn late after three periods, so a fit to it ends in the wrong
valley. Which parameters move the mode is found from the equations: a step along the gradient of its frequency, in
logarithms of the parameters, is the smallest change that makes it slower or faster.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hydrotwin.models.language.flat import FlatModel

from .horizon import lightly_damped
from .problem import FreeParameters, Recording

APART = 0.25  # of ln frequency between neighbours: no frequency is further from a start than the half of it
FURTHEST = 2  # starts on either side: from 0.6 to 1.65 times the frequency of the user's start
DIFFERENCE = 1e-3  # of ln p, for the gradient


def detuned(
    flat: FlatModel, recordings: Sequence[Recording], free: FreeParameters, known: Mapping[str, float]
) -> list[dict[str, float]]:
    """Starts by path, the user's first and empty: those that move the mode through what ``known`` parameters allow."""
    start = free.scaled(free.start)
    positive = free.logarithmic & np.array([n in known for n in free.names], dtype=bool)
    slope = _slope(lightly_damped(flat, recordings), free, start, positive)
    if not slope.any():
        return [{}]
    steps = [k * APART for j in range(1, FURTHEST + 1) for k in (-j, j)]
    moved = [free.values(start + slope * (step / (slope @ slope))) for step in steps]
    return [{}, *({n: float(v) for n, v, s in zip(free.names, p, slope, strict=True) if s} for p in moved)]


def _slope(mode: Callable, free: FreeParameters, start: np.ndarray, moves: np.ndarray) -> np.ndarray:
    """Derivative of ln frequency by the scaled parameters, 0 where they may not move; all 0 without such a mode."""
    slope, here = np.zeros(len(start)), mode(free.vector(start))
    for i in np.flatnonzero(moves) if here else ():
        step = np.where(np.arange(len(start)) == i, DIFFERENCE, 0.0)
        there = mode(free.vector(start + step))
        slope[i] = np.log(abs(there) / abs(here)) / DIFFERENCE if there else 0.0
    return slope
