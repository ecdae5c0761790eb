"""The objective rating of ISO/TS 18571: corridor, phase, magnitude and slope of one curve against another.

Source: ISO/TS 18571:2014, Road vehicles - Objective rating metric for non-ambiguous signals. The
standard is written for 10 kHz; here the samples are those of the recording, at most LONGEST of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .shift import Parts, correlations, first_best
from .warping import warped

LONGEST = 1000  # samples; longer recordings are rated on so many uniform ones
SHORTEST = 20  # samples
INNER, OUTER = 0.05, 0.5  # half widths of the corridors, of the largest measurement in size
SHIFT = 0.2  # of the recording: the largest shift that is tried
WINDOW = 0.1  # of the samples: how far time is warped
MOST_MAGNITUDE, MOST_SLOPE = 0.5, 2.0  # relative errors from which on the rating is 0
MEANS = (1, 3, 5, 7, 9)  # samples that a slope is a mean of, from the ends inwards


@dataclass(frozen=True)
class Rating:
    """Corridor Z, phase EP, magnitude EM and slope ES, each 0 to 1, and the overall rating R of them."""

    corridor: float
    phase: float
    magnitude: float
    slope: float

    @property
    def overall(self) -> float:
        """R = 0.4 Z + 0.2 EP + 0.2 EM + 0.2 ES: above 0.94 excellent, 0.8 good, 0.58 fair."""
        return 0.4 * self.corridor + 0.2 * (self.phase + self.magnitude + self.slope)


def rating(measured: Parts, predicted: Parts) -> Rating:
    """Rating of ``predicted`` against ``measured``, both in parts (n,) on uniform grids of one period, finite.

    The parts are what is between holes: nothing is shifted, warped or differentiated across one. NaN where one of both
    does not move, or no part is long enough.

    >>> rating([np.sin(np.arange(50))], [np.sin(np.arange(50))]).overall
    1.0
    """
    measured, predicted = ([np.asarray(part, float) for part in curve] for curve in (measured, predicted))
    y, p, longest = np.concatenate(measured), np.concatenate(predicted), max(map(len, measured))
    if longest < SHORTEST or not np.ptp(y) or not np.ptp(p):
        return Rating(*[float("nan")] * 4)
    most = SHIFT * longest
    late = first_best(correlations(measured, predicted, int(most)), len(y))
    parts = [_shifted(*both, late) for both in zip(measured, predicted, strict=True) if len(both[0]) >= SHORTEST]
    parts = [both for both in parts if len(both[0]) > len(MEANS) * 2]
    sloped = [(_slopes(reference), _slopes(curve)) for reference, curve in parts]
    return Rating(
        corridor=_corridor(y, p),
        phase=max(0.0, 1.0 - abs(late) / most),
        magnitude=max(0.0, 1.0 - _relative([_warped(*both) for both in parts]) / MOST_MAGNITUDE),
        slope=max(0.0, 1.0 - _relative(sloped) / MOST_SLOPE),
    )


def _shifted(measured: np.ndarray, predicted: np.ndarray, late: int) -> tuple[np.ndarray, np.ndarray]:
    """Both where they overlap once the prediction is moved by ``late`` samples."""
    n = max(0, len(measured) - abs(late))
    return (measured[:n], predicted[late:]) if late >= 0 else (measured[len(measured) - n :], predicted[:n])


def _corridor(measured: np.ndarray, predicted: np.ndarray) -> float:
    off = np.abs(predicted - measured) / np.abs(measured).max()
    return float(np.mean(np.clip((OUTER - off) / (OUTER - INNER), 0.0, 1.0) ** 2))


def _warped(reference: np.ndarray, curve: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    first, second = warped(curve, reference, int(np.ceil(WINDOW * len(curve))) - 1)
    return reference[second], curve[first]


def _relative(parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    """The error of curves against their references, over the size of these."""
    size = sum(float(np.abs(reference).sum()) for reference, _ in parts)
    return sum(float(np.abs(curve - reference).sum()) for reference, curve in parts) / size if size else float("inf")


def _slopes(values: np.ndarray) -> np.ndarray:
    """Central differences, each a mean over nine; over fewer towards the ends."""
    slopes, half = np.gradient(values), len(MEANS) - 1
    means = np.empty_like(slopes)
    means[half:-half] = np.convolve(slopes, np.full(MEANS[-1], 1.0 / MEANS[-1]), mode="valid")
    for k, n in enumerate(MEANS[:-1]):
        means[k], means[-1 - k] = slopes[:n].mean(), slopes[-n:].mean()
    return means
