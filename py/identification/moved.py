"""What a fit does not know, along a run: how far it may move an output, and whether errors seen there are such a move.

    e = L b + r,     b ~ N(0, I),  r ~ N(0, left^2),     cov(e) = L L^T + left^2 I

Columns of L are what parameters and start states may do together, by their covariance. Errors of a run are one draw of
b: of one recording a band may hold far less than 95 %, and be right. That it does not by chance is asked twice:

    along L   sum_i (u_i^T e)^2 / (s_i^2 + left^2) ~ chi^2,    u_i, s_i : singular vectors and values of L
    beside L  how many of r lie outside of 1.96 left, neighbours counted as often as they say something of their own

A reading in steps of q says that the value lay within q/2 of it. Where noise does not reach over a few steps, rounding
is no noise: at rest it is the same for as long as the rest lasts, and by where between two steps that is, 1 % or 8 % of
the readings lie outside. So only what is beyond q/2 counts as an error: a chance is then rather too large than too
small.
Sources: G. Seber, C. Wild, Nonlinear Regression, Wiley 1989, section 5.1; M. Priestley, Spectral Analysis and Time
Series, Academic Press 1981, section 5.3 (the mean of correlated samples); B. Widrow, I. Kollar, Quantization Noise,
Cambridge 2008, chapter 5 (when rounding is noise).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.special import chdtrc, ndtr

WIDE, OUTSIDE = 1.96, 0.05  # sigmas of a 95 % interval, and the share that lies outside
LEAST_SEEN = 0.5  # of ``left``, over the whole run: what moves it by less cannot be told from noise


@dataclass(frozen=True, eq=False)
class Moved:
    """One output of a run, SI.

    root : (n, k), root root^T is its covariance by parameters and start. left : rms of what the fit left of it.
    """

    root: np.ndarray
    left: float

    @property
    def deviation(self) -> np.ndarray:
        """Standard deviation (n,) of what its sensor reads."""
        return np.sqrt(np.sum(self.root**2, axis=1) + self.left**2)

    def chance(self, error: np.ndarray, quantum: float = 0.0) -> float:
        """How likely errors (n,), NaN where nothing was measured, are at least as far off where nothing is missing.

        quantum : step in which the output was recorded; 0 where there is none. The smaller of two probabilities,
        doubled: along what is not known, and beside it. NaN where there is no error, or what is not known is beyond
        numbers.
        """
        known = np.isfinite(error)
        if not known.any() or not self.left > 0.0:
            return float("nan")
        beyond = np.sign(error[known]) * np.maximum(np.abs(error[known]) - quantum / 2.0, 0.0)
        z, L = beyond / self.left, self.root[known] / self.left
        with np.errstate(over="ignore", invalid="ignore"):
            gram = L.T @ L
        if not np.isfinite(gram).all():
            return float("nan")
        squares, directions = np.linalg.eigh(gram)
        seen = squares > LEAST_SEEN**2
        unit = L @ (directions[:, seen] / np.sqrt(squares[seen]))
        along = unit.T @ z
        far = float(chdtrc(seen.sum(), np.sum(along**2 / (1.0 + squares[seen])))) if seen.any() else 1.0
        return min(1.0, 2.0 * min(far, _outside(z - unit @ along)))


def _outside(rest: np.ndarray) -> float:
    """How likely by chance as many of the rest (n,), of unit size, lie outside of 95 %."""
    outside = np.abs(rest) > WIDE
    own = len(rest) / _repeats(outside - outside.mean())
    return float(ndtr((OUTSIDE - outside.mean()) / np.sqrt(OUTSIDE * (1.0 - OUTSIDE) / own)))


def _repeats(values: np.ndarray) -> float:
    """How many samples (n,), of mean zero, say the same: 1 + twice their correlations, up to the first that is none."""
    size = next_fast_len(2 * len(values), real=True)
    products = irfft(np.abs(rfft(values, size)) ** 2, size)[: len(values)]
    if not products[0] > 0.0:
        return 1.0
    ends = np.flatnonzero(products <= 0.0)
    return float(1.0 + 2.0 * products[1 : ends[0] if len(ends) else None].sum() / products[0])
