"""Gaps: how much more than the noise residuals are, and which share of that an effect closes."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.special import chdtri

from hydrotwin.records.whiteness import SIGNIFICANCE, ljung_box

MEASURABLE = 1.02  # MSE over noise^2
CLEARLY = 1.1  # MSE over noise^2: a gap that asks for a reason
LARGE = 1.2  # MSE over noise^2: no error of a noise estimate ...
CHANCE = 1e-3  # ... nor, more seldom than this, of few samples
HUGE = 1e6  # times the noise: a run that diverged


def pooled_rmse(residuals: Sequence[np.ndarray]) -> np.ndarray:
    """Root mean square of every column over recordings: nan where nothing was measured, inf where one diverged."""
    stacked = np.concatenate(residuals)
    seen = ~np.isnan(stacked)
    counts = np.where(seen.any(axis=0), seen.sum(axis=0), np.nan)
    return np.sqrt(np.square(np.where(seen, stacked, 0.0)).sum(axis=0) / counts)


def gap_closed(before: np.ndarray, after: np.ndarray, noise: np.ndarray) -> float:
    """``1 - sum (MSE_after - s^2) / sum (MSE_before - s^2)`` over outputs (ny,) with a gap, each in units of its own.

    Outputs count by the logarithm of their gap, so that the best sensor does not rule; no noise is larger than what is
    left after, whatever was estimated.
    """
    noise = np.where(np.isfinite(noise), np.fmin(noise, after), noise)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = before / noise
    has = (ratio**2 > MEASURABLE) & ~np.isnan(after)
    if not has.any():
        return 0.0
    ratio, left = np.minimum(ratio[has], HUGE), np.minimum(after[has] / noise[has], HUGE)
    weight = np.log(ratio)
    share = 1 - (left**2 - 1) / (ratio**2 - 1)
    return float(weight @ np.clip(share, -10.0, 1.0) / weight.sum())


def output_gap_closed(before: float, after: float, noise: float) -> float:
    """The same for one output; nan when there is no measurable gap, and where what is left diverges."""
    if not before**2 > MEASURABLE * noise**2 or np.isinf(after):
        return float("nan")
    return float(min(1.0, 1 - (after**2 - noise**2) / (before**2 - noise**2)))


def has_gap(residuals: Sequence[np.ndarray], noise: np.ndarray, clearly: float = MEASURABLE) -> np.ndarray:
    """Outputs (ny,) that leave more than noise: mean square above ``clearly`` noise^2, and not white unless large.

    A noise that is estimated is uncertain by a few percent, a bias is white, and few samples are large by chance.
    """
    counts = np.maximum(np.sum([np.isfinite(r).sum(axis=0) for r in residuals], axis=0), 1)
    large = np.maximum(LARGE, chdtri(counts, CHANCE) / counts)
    with np.errstate(invalid="ignore"):
        square = (pooled_rmse(residuals) / noise) ** 2
    return (np.nan_to_num(square) > large) | ((np.nan_to_num(square) > clearly) & coloured(residuals))


def coloured(residuals: Sequence[np.ndarray]) -> np.ndarray:
    """Outputs (ny,) whose residual is no white noise in some recording."""
    columns = range(residuals[0].shape[1])
    return np.array([any(ljung_box(r[:, j])[1] < SIGNIFICANCE for r in residuals) for j in columns])
