"""How late a prediction is: correlations of two curves over the shifts of one of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

NAN = float("nan")
Parts = Sequence[np.ndarray]  # of a curve, (n,) each: what is between its holes
ALIKE = 1e-10  # correlations nearer to each other than this are one
CHANCE = 4.0  # over the root of the samples: how far apart Fisher's z of two shifts may be by noise alone


def correlations(measured: Parts, predicted: Parts, reach: int) -> np.ndarray:
    """Correlation coefficients (2 reach + 1,) of what overlaps once the prediction is ``k`` samples late.

    Both in the parts between holes, across which nothing overlaps. k runs from -reach to reach; -inf where one of both
    does not move in the overlap.
    """
    y, p = (np.concatenate(parts) for parts in (measured, predicted))
    each = [_overlap(one - y.mean(), other - p.mean(), reach) for one, other in zip(measured, predicted, strict=True)]
    products, count, y1, y2, p1, p2 = np.sum(each, axis=0)
    count = np.maximum(count, 1.0)  # without an overlap nothing moves
    spread = np.sqrt(np.maximum(y2 - y1**2 / count, 0.0) * np.maximum(p2 - p1**2 / count, 0.0))
    known = spread > 1e-12 * np.sqrt(np.sum((y - y.mean()) ** 2) * np.sum((p - p.mean()) ** 2))
    return np.where(known, (products - y1 * p1 / count) / np.where(known, spread, 1.0), -np.inf)


def _overlap(y: np.ndarray, p: np.ndarray, reach: int) -> np.ndarray:
    """Sums over the overlap (6, 2 reach + 1) of one part: of products, samples, y, y^2, p and p^2."""
    n, most = len(y), min(reach, len(y) - 1)
    late = np.arange(-most, most + 1)
    size = next_fast_len(2 * n - 1, real=True)
    products = irfft(rfft(p, size) * rfft(y[::-1], size), size)[n - 1 - most : n + most]
    (y1, y2), (p1, p2) = _sums(y, -late), _sums(p, late)
    found = np.zeros((6, 2 * reach + 1))
    found[:, reach - most : reach + most + 1] = products, n - np.abs(late), y1, y2, p1, p2
    return found


def first_best(found: np.ndarray, samples: int) -> int:
    """The shift of the highest correlation, in samples; the smallest one of those that are alike, see `bests`."""
    return bests(found, samples)[0]


def bests(found: np.ndarray, samples: int) -> list[int]:
    """The best shifts, in samples, the smallest first.

    A motion that repeats correlates as well a period later: there is one for every stretch of shifts in which
    correlations are as high as the highest, but for what noise of ``samples`` does (Fisher's z = artanh r).
    Source: Fisher, Metron 1 (1921) 3-32.
    """
    shifts = np.arange(len(found)) - len(found) // 2
    z = np.arctanh(np.clip(found, ALIKE - 1, 1 - ALIKE))
    as_high = z >= z.max() - CHANCE / np.sqrt(samples)
    stretch, best = np.cumsum(~as_high), []
    for at in np.unique(stretch[as_high]):
        here = as_high & (stretch == at)
        alike = shifts[here & (found >= found[here].max() - ALIKE)]
        best.append(int(min(alike, key=lambda k: (abs(k), -k))))
    return sorted(best, key=lambda k: (abs(k), -k))


def lag(measured: Parts, predicted: Parts, period: float, share: float) -> tuple[float, float]:
    """Seconds that the prediction comes after the measurement, both in parts (n,) on uniform grids of ``period`` s; and
    how many seconds more or less fit as well, for the motion repeats (NaN where none do).

    The highest correlation within ``share`` of the longest part either way, between samples by the parabola through it
    and its neighbours. NaN where a curve does not move, or the highest is at the end of what was looked through.
    Source: Knapp, Carter, IEEE Trans. ASSP 24 (1976) 320-327.
    """
    reach = int(share * max(map(len, measured)))
    if reach < 1 or not np.ptp(np.concatenate(measured)) or not np.ptp(np.concatenate(predicted)):
        return NAN, NAN
    found = correlations(measured, predicted, reach)
    k, *others = bests(found, sum(map(len, measured)))
    if abs(k) == reach or not np.isfinite(found[k + reach - 1 : k + reach + 2]).all():
        return NAN, NAN
    left, top, right = found[k + reach - 1 : k + reach + 2]
    bend = left - 2 * top + right
    between = 0.5 * (left - right) / bend if bend < -ALIKE else 0.0
    repeats = min((abs(other - k) for other in others), default=NAN)
    return float((k + np.clip(between, -0.5, 0.5)) * period), float(repeats * period)


def _sums(values: np.ndarray, late: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sums and sums of squares of ``values`` from sample ``late`` on, or up to so many before its end."""
    n = len(values)
    first, end = np.maximum(late, 0), n + np.minimum(late, 0)
    totals = [np.concatenate(([0.0], np.cumsum(v))) for v in (values, values**2)]
    return totals[0][end] - totals[0][first], totals[1][end] - totals[1][first]
