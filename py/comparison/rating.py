"""The objective rating of ISO/TS 18571: corridor, phase, magnitude and slope of one curve against another.

Source: ISO/TS 18571:2014, Road vehicles - Objective rating metric for non-ambiguous signals. The
standard is written for 10 kHz; here the samples are those of the recording, at most LONGEST of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .shift import correlations, first_best
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


def rating(measured: np.ndarray, predicted: np.ndarray) -> Rating:
    """Rating of ``predicted`` against ``measured``, (n,) on one uniform grid, finite. NaN where one does not move.

    >>> rating(np.sin(np.arange(50)), np.sin(np.arange(50))).overall
    1.0
    """
    measured, predicted = np.asarray(measured, float), np.asarray(predicted, float)
    if len(measured) < SHORTEST or not np.ptp(measured) or not np.ptp(predicted):
        return Rating(*[float("nan")] * 4)
    most = SHIFT * len(measured)
    late = first_best(correlations(measured, predicted, int(most)))
    reference, curve = _shifted(measured, predicted, late)
    return Rating(
        corridor=_corridor(measured, predicted),
        phase=max(0.0, 1.0 - abs(late) / most),
        magnitude=_magnitude(reference, curve),
        slope=max(0.0, 1.0 - _relative(_slopes(curve), _slopes(reference)) / MOST_SLOPE),
    )


def _shifted(measured: np.ndarray, predicted: np.ndarray, late: int) -> tuple[np.ndarray, np.ndarray]:
    """Both where they overlap once the prediction is moved by ``late`` samples."""
    n = len(measured) - abs(late)
    return (measured[:n], predicted[late:]) if late >= 0 else (measured[-n:], predicted[:n])


def _corridor(measured: np.ndarray, predicted: np.ndarray) -> float:
    off = np.abs(predicted - measured) / np.abs(measured).max()
    return float(np.mean(np.clip((OUTER - off) / (OUTER - INNER), 0.0, 1.0) ** 2))


def _magnitude(reference: np.ndarray, curve: np.ndarray) -> float:
    first, second = warped(curve, reference, int(np.ceil(WINDOW * len(curve))) - 1)
    return max(0.0, 1.0 - _relative(curve[first], reference[second]) / MOST_MAGNITUDE)


def _relative(curve: np.ndarray, reference: np.ndarray) -> float:
    size = float(np.abs(reference).sum())
    return float(np.abs(curve - reference).sum()) / size if size else float("inf")


def _slopes(values: np.ndarray) -> np.ndarray:
    """Central differences, each a mean over nine; over fewer towards the ends."""
    slopes, half = np.gradient(values), len(MEANS) - 1
    means = np.empty_like(slopes)
    means[half:-half] = np.convolve(slopes, np.full(MEANS[-1], 1.0 / MEANS[-1]), mode="valid")
    for k, n in enumerate(MEANS[:-1]):
        means[k], means[-1 - k] = slopes[:n].mean(), slopes[-n:].mean()
    return means
