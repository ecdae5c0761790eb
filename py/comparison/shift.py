"""How late a prediction is: correlations of two curves over the shifts of one of them."""

from __future__ import annotations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

ALIKE = 1e-10  # correlations nearer to each other than this are one


def correlations(measured: np.ndarray, predicted: np.ndarray, reach: int) -> np.ndarray:
    """Correlation coefficients (2 reach + 1,) of what overlaps once the prediction is ``k`` samples late.

    k runs from -reach to reach; -inf where one of both does not move in the overlap.
    """
    n, late = len(measured), np.arange(-reach, reach + 1)
    y, p = measured - measured.mean(), predicted - predicted.mean()
    size = next_fast_len(2 * n - 1, real=True)
    products = irfft(rfft(p, size) * rfft(y[::-1], size), size)[n - 1 - reach : n + reach]
    count = n - np.abs(late)
    sums = [_sums(a, side) for a, side in ((y, -late), (p, late))]
    (y1, y2), (p1, p2) = sums
    spread = np.sqrt(np.maximum(y2 - y1**2 / count, 0.0) * np.maximum(p2 - p1**2 / count, 0.0))
    known = spread > 1e-12 * np.sqrt(np.sum(y**2) * np.sum(p**2))
    return np.where(known, (products - y1 * p1 / count) / np.where(known, spread, 1.0), -np.inf)


def first_best(found: np.ndarray) -> int:
    """The shift of the highest correlation, in samples; the smallest one of those that are alike."""
    reach = len(found) // 2
    best = np.flatnonzero(found >= found.max() - ALIKE) - reach
    return int(min(best, key=lambda k: (abs(k), -k)))


def lag(measured: np.ndarray, predicted: np.ndarray, period: float, share: float) -> float:
    """Seconds that the prediction comes after the measurement, both (n,) on a uniform grid of ``period`` s.

    The highest correlation within ``share`` of the recording either way, between samples by the parabola through it and
    its neighbours. NaN where a curve does not move, or the highest is at the end of what was looked through.
    Source: Knapp, Carter, IEEE Trans. ASSP 24 (1976) 320-327.
    """
    reach = int(share * len(measured))
    if reach < 1 or not np.ptp(measured) or not np.ptp(predicted):
        return float("nan")
    found = correlations(measured, predicted, reach)
    k = first_best(found)
    if abs(k) == reach or not np.isfinite(found[k + reach - 1 : k + reach + 2]).all():
        return float("nan")
    left, top, right = found[k + reach - 1 : k + reach + 2]
    bend = left - 2 * top + right
    between = 0.5 * (left - right) / bend if bend < -ALIKE else 0.0
    return float((k + np.clip(between, -0.5, 0.5)) * period)


def _sums(values: np.ndarray, late: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums and sums of squares of ``values`` from sample ``late`` on, or up to so many before its end."""
    n = len(values)
    first, end = np.maximum(late, 0), n + np.minimum(late, 0)
    totals = [np.concatenate(([0.0], np.cumsum(v))) for v in (values, values**2)]
    return totals[0][end] - totals[0][first], totals[1][end] - totals[1][first]
