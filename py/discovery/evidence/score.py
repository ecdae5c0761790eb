"""The score of a fit: how far what it leaves lies above what nothing missing would leave, by output and time scale.

    S = sum over outputs j, scales k of   n_jk / 2  ln max(v_jk / f_jk, 1)   [nats]

v_jk is the mean square of the n_jk Haar coefficients of the residual of output j at scale k (2^k samples), f_jk what
noise, rounding, the accuracy of the runs and the inexact form of a right law may leave there. White noise has the same
variance at every scale; what a structure lacks moves slowly, and stands far above it at the scales of the motion. So a
drift of ten thousand samples counts as the handful of independent values that it is.
Source: Y. Bard, Nonlinear Parameter Estimation, 1974, ch. IV (unknown size of the error); S. Mallat, A Wavelet Tour of
Signal Processing, 2009, ch. 7.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .deciding import DECIDING


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Sums of squares and numbers of Haar coefficients of residuals, both (scales, ny), SI squared.

    The squares are infinite where a run diverged.
    """

    squares: np.ndarray
    counts: np.ndarray

    @property
    def variance(self) -> np.ndarray:
        """Mean squares (scales, ny), 0 where there is no coefficient."""
        return self.squares / np.maximum(self.counts, 1)

    @property
    def rmse(self) -> np.ndarray:
        """Root mean square of every output (ny,), nan where nothing was measured: the transform keeps lengths."""
        counts = self.counts.sum(axis=0)
        return np.where(counts > 0, np.sqrt(self.squares.sum(axis=0) / np.maximum(counts, 1)), np.nan)


def spectrum(residuals: Sequence[np.ndarray]) -> Spectrum:
    """The `Spectrum` of residuals (n, ny) per recording, nan where not measured; missing samples are passed over."""
    longest = max(len(r) for r in residuals)
    scales = int(np.ceil(np.log2(max(longest, 2)))) + 1
    squares, counts = (np.zeros((scales, residuals[0].shape[1])) for _ in range(2))
    for residual in residuals:
        for j, column in enumerate(residual.T):
            for k, coefficients in enumerate(_haar(column[~np.isnan(column)])):
                squares[k, j] += float(coefficients @ coefficients)
                counts[k, j] += len(coefficients)
    return Spectrum(squares, counts)


def _haar(values: np.ndarray) -> list[np.ndarray]:
    """Orthonormal Haar coefficients, finest first; what has no partner goes to the next scale."""
    if not np.isfinite(values).all():
        return [np.full(len(values), np.inf)]
    found = []
    while len(values) > 1:
        paired = values[: len(values) // 2 * 2].reshape(-1, 2)
        found.append((paired[:, 0] - paired[:, 1]) / np.sqrt(2))
        values = np.concatenate([paired.sum(axis=1) / np.sqrt(2), values[len(paired) * 2 :]])
    return [*found, values] if len(values) else found


@dataclass(frozen=True, eq=False)
class Floor:
    """What nothing missing would leave.

    noise : of the sensors (ny,), SI; coloured : what of it is no white noise (ny,), SI: rounding, accuracy of the runs.
    base : mean squares (scales, ny) that the base leaves, of which a right law keeps the share ``law`` (of the root).
    shown : mean squares (scales, ny) that the best fit leaves: no more of the noise than this is coloured.
    """

    noise: np.ndarray
    coloured: np.ndarray
    base: np.ndarray | None = None
    law: float = DECIDING.law
    shown: np.ndarray | None = None

    def variance(self, counts: np.ndarray) -> np.ndarray:
        """f (scales, ny) for so many coefficients, SI squared."""
        scales = np.arange(len(counts))[:, None]
        chance = DECIDING.known + DECIDING.chance * np.sqrt(2 / np.maximum(counts, 1))
        white = np.square(self.noise)
        noise = white * (1 + chance) + np.square(self.coloured) * 2.0**scales
        if self.shown is not None:
            noise = np.fmin(noise, np.fmax(self.shown[: len(counts)], white) * (1 + chance))
        return noise if self.base is None else noise + self.law**2 * self.base


def score(left: Spectrum, floor: Floor) -> float:
    """S of what a fit leaves, nats; infinite where a run diverged."""
    return float(np.nansum(by_output(left, floor)))


def by_output(left: Spectrum, floor: Floor) -> np.ndarray:
    """S of every output (ny,), nats."""
    with np.errstate(invalid="ignore"):
        ratio = left.variance / floor.variance(left.counts)
        used = (left.counts > 0) & np.isfinite(floor.noise)
        return np.where(used, 0.5 * left.counts * np.log(np.maximum(ratio, 1.0)), 0.0).sum(axis=0)


def least(fits: Sequence[Spectrum], noise: np.ndarray) -> np.ndarray | None:
    """Mean squares (scales, ny) of the likeliest of fits to the same recordings; None where none came to an end."""
    ended = [s for s in fits if np.isfinite(s.squares).all()]
    white = Floor(noise, np.zeros_like(noise))
    return min(ended, key=lambda s: score(s, white)).variance if ended else None


def sharper(noise: np.ndarray, fits: Sequence[Spectrum], told: np.ndarray, least: np.ndarray) -> np.ndarray:
    """The noise (ny,), SI, where a fit leaves less than was taken for it: lightly damped motion looks like noise.

    told : outputs (ny,) whose noise the user gave; least : (ny,), SI, below which no noise is looked for.
    """
    finest = [np.sqrt(s.variance[0]) for s in fits if np.isfinite(s.squares).all() and s.counts[0].any()]
    if not finest:
        return noise
    left = np.fmax(np.min(finest, axis=0), least)
    return np.where(told | ~np.isfinite(noise) | ~(left > 0), noise, np.fmin(noise, left))
