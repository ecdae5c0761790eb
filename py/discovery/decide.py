"""Decide: is one structure better than another, by evidence on the fit recordings and on those held out?

BIC counts what the samples are worth: a residual that is coloured repeats itself, so n becomes n / tau, tau the
integrated correlation time of what the better structure leaves,

    gain = 2 sum_j (n_j / tau_j) (l_j(before) - l_j(after)) - dk ln n_eff,   l_j = ln s_j + RMSE_j^2 / (2 s_j^2).

On held-out recordings the logarithms of block errors are compared in pairs: a mean would be ruled by one bad block.
Source: G. Schwarz, Annals of Statistics 1978 (BIC); A. Sokal 1997 (integrated correlation time).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from hydrotwin.identification.whiteness import SIGNIFICANCE, ljung_box

from .refit import Question, Refitted, pooled_rmse

BLOCKS = 40  # over all held-out recordings
SHORTEST = 25  # samples of a block
BIC_NEEDED = 10.0
FEWEST_BLOCKS = 4  # that leave more than noise
FEWEST_TOGETHER = 2  # the same where all is fitted to: one at each end of a stop
NOISY = 4.0  # sigmas of the mean square of noise: what a block must leave to count
MOST_SAY = np.log(2)  # of one block: its mean square halved
LEAST_SPREAD = 0.03  # between blocks
T_NEEDED = 2.0
WORTH = 0.05  # of the gap that is left: what an effect must close to be worth a name
TOGETHER = 10.0  # BIC within which two structures are as good
INEXACT = 0.002  # of the gap: what the equation of the right effect may leave, its friction's sign being smooth
PART = 0.05  # of the gap: a law that is a fifth off leaves less
MEASURABLE = 1.02  # MSE over noise^2
HUGE = 1e6  # times the noise: a run that diverged
DIVERGED = 700.0  # logarithm of the error of a run that diverged
LARGE = 1.2  # MSE over noise^2: no error of a noise estimate ...
CHANCE = 1e-3  # ... nor, more seldom than this, of few samples
SHOWN = 0.1  # of the most that any recording leaves beyond the noise: less shows nothing of the gap
CLEARLY = 1.1  # MSE over noise^2: a gap that asks for a reason


@dataclass(frozen=True)
class Evidence:
    """One structure against another: positive means the first is better."""

    bic_gain: float
    paired_t: float
    closed: float

    def passes(self, library: int) -> bool:
        """Whether it may be named out of a library of so many candidates."""
        return self.bic_gain > bic_needed(library) and self.paired_t > T_NEEDED and self.closed > WORTH


def bic_needed(library: int) -> float:
    """10 + 2 ln(number of candidates)."""
    return BIC_NEEDED + 2 * np.log(max(library, 1))


def compared(better: Refitted, other: Refitted, q: Question) -> Evidence:
    """Evidence for ``better`` over ``other``."""
    return Evidence(
        bic_gain(better, other, q),
        paired_t(
            better.residuals_select,
            other.residuals_select,
            other.size,
            q.noise,
            FEWEST_BLOCKS if q.held_out else FEWEST_TOGETHER,
        ),
        closed(better, other, q),
    )


def bic_gain(better: Refitted, other: Refitted, q: Question) -> float:
    """BIC of ``other`` minus BIC of ``better``, with effective sample sizes."""
    after, before = better.rmse, other.rmse
    used = np.isfinite(q.noise) & (q.counts > 0)
    tau = correlation_times(better.residuals_fit)
    worth = np.where(used, q.counts / tau, 0.0)
    size_after, size_before = np.fmax(after, q.noise), np.fmax(before, q.noise)
    with np.errstate(invalid="ignore"):
        drop = np.log(size_before / size_after) + 0.5 * ((before / size_before) ** 2 - (after / size_after) ** 2)
    extra = better.parameters - other.parameters
    return float(2 * np.nansum(worth[used] * drop[used]) - extra * np.log(max(worth.sum(), 2.0)))


def correlation_times(residuals: Sequence[np.ndarray]) -> np.ndarray:
    """Integrated correlation time in samples, (ny,), at least 1, averaged over recordings."""
    times = []
    for r in residuals:
        times.append([_correlation_time(column[np.isfinite(column)]) for column in r.T])
    return np.maximum(np.nanmean(np.array(times), axis=0), 1.0) if times else np.ones(0)


def _correlation_time(r: np.ndarray) -> float:
    n = len(r)
    if n < 8 or not np.ptp(r) > 0:
        return 1.0
    r = r - 0.0  # a bias is structure, not noise: the mean stays in
    size = 1 << int(np.ceil(np.log2(2 * n)))
    spectrum = np.abs(np.fft.rfft(r, size)) ** 2
    rho = np.fft.irfft(spectrum, size)[: n // 2]
    rho = rho / rho[0]
    tau = 1 + 2 * np.cumsum(rho[1:])
    window = np.arange(1, len(tau) + 1)
    stop = np.argmax(window >= 5 * tau) if np.any(window >= 5 * tau) else len(tau) - 1
    return float(max(tau[stop], 1.0))


def blocks(residuals: Sequence[np.ndarray], unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean square of every output in every block, in ``unit`` (ny,), nan where not measured, and how many samples."""
    length = max(SHORTEST, sum(len(r) for r in residuals) // BLOCKS)
    squares, counts = [], []
    for r in residuals:
        for piece in np.array_split(r, max(1, len(r) // length)):
            known = ~np.isnan(piece) & np.isfinite(unit)
            count = known.sum(axis=0)
            square = np.square(np.where(known, piece / unit, 0.0)).sum(axis=0)
            squares.append(np.where(count > 0, square / np.maximum(count, 1), np.nan))
            counts.append(count)
    return np.array(squares), np.array(counts)


def block_errors(residuals: Sequence[np.ndarray], size: np.ndarray) -> np.ndarray:
    """Logarithm of the mean square of every block that holds a measurement, outputs in units of ``size`` averaged."""
    squares, counts = blocks(residuals, size)
    rows = squares[(counts > 0).any(axis=1)]
    finite = ~np.isinf(rows).any(axis=1)
    mean = np.nanmean(np.where(finite[:, None], rows, 1.0), axis=1)
    return np.where(finite, np.log(np.maximum(mean, 1e-300)), DIVERGED)


def paired_t(
    better: Sequence[np.ndarray],
    other: Sequence[np.ndarray],
    size: np.ndarray,
    noise: np.ndarray,
    fewest: int = FEWEST_BLOCKS,
) -> float:
    """t of the paired differences of log block errors; positive when ``better`` is. nan without held-out recordings.

    A block in which both leave but noise says nothing about either, and fifty of them would hide what a few say: where
    at least the ``fewest`` leave more than noise (ny,), they decide. How much better they are may be ruled by few of
    them, how often by those that hardly differ: the clearer counts of all as they are and of all with no more say than
    a halved error.
    """
    if not better:
        return np.nan
    difference = block_errors(other, size) - block_errors(better, size)
    telling = _more_than_noise(better, noise) | _more_than_noise(other, noise)
    difference = difference[telling] if telling.sum() >= fewest else difference
    return max(_t(difference), _t(np.clip(difference, -MOST_SAY, MOST_SAY)), key=abs)


def _t(difference: np.ndarray) -> float:
    """Student's t of these numbers, 0 for fewer than two."""
    if len(difference) < 2:
        return 0.0
    return float(np.mean(difference) / max(np.std(difference, ddof=1), LEAST_SPREAD) * np.sqrt(len(difference)))


def _more_than_noise(residuals: Sequence[np.ndarray], noise: np.ndarray) -> np.ndarray:
    """Blocks that hold a measurement: whether an output leaves more in it than noise does."""
    squares, counts = blocks(residuals, noise)
    known = (counts > 0).any(axis=1)
    with np.errstate(invalid="ignore"):
        return (squares > 1 + NOISY * np.sqrt(2 / np.maximum(counts, 1)))[known].any(axis=1)


def closed(better: Refitted, other: Refitted, q: Question) -> float:
    """Share of the reducible gap on held-out recordings (on the fit ones without any), outputs pooled.

    Outputs count by their share of the gap in units of what ``other`` leaves, so that the best sensor does not rule.
    No noise is larger than what the better one leaves, whatever was estimated.
    """
    after = pooled_rmse(better.residuals_select or better.residuals_fit)
    before = pooled_rmse(other.residuals_select or other.residuals_fit)
    return gap_closed(before, after, np.where(np.isfinite(q.noise), np.fmin(q.noise, after), q.noise))


def share_closed(base: Refitted, now: Refitted, best: Refitted, q: Question) -> float:
    """Share of the gap of ``base`` that ``now`` closes, no noise being larger than what ``best`` leaves.

    Of outputs with a clear gap, where there are any: of a gap that is hardly one no share is known to a five-hundredth.
    """
    before, left, least = (pooled_rmse(f.residuals_select or f.residuals_fit) for f in (base, now, best))
    noise = np.fmin(q.noise, least)
    with np.errstate(invalid="ignore"):
        clear = (before / noise) ** 2 > CLEARLY
    return gap_closed(before, left, np.where(clear, noise, np.inf) if clear.any() else noise)


def gap_closed(before: np.ndarray, after: np.ndarray, noise: np.ndarray) -> float:
    """``1 - sum (MSE_after - s^2) / sum (MSE_before - s^2)`` over outputs with a gap, each in units of its own."""
    with np.errstate(invalid="ignore"):
        ratio = before / noise
    has = (ratio**2 > MEASURABLE) & ~np.isnan(after)
    if not has.any():
        return 0.0
    ratio, left = np.minimum(ratio[has], HUGE), np.minimum(after[has] / noise[has], HUGE)
    weight = np.log(ratio)
    share = 1 - (left**2 - 1) / (ratio**2 - 1)
    return float(weight @ np.clip(share, -10.0, 1.0) / weight.sum())


def has_gap(residuals: Sequence[np.ndarray], noise: np.ndarray, clearly: float = MEASURABLE) -> np.ndarray:
    """Outputs (ny,) that leave more than noise: mean square above ``clearly`` noise^2, and not white unless large.

    A noise that is estimated is uncertain by a few percent, a bias is white, and few samples are large by chance.
    """
    counts = np.maximum(np.sum([np.isfinite(r).sum(axis=0) for r in residuals], axis=0), 1)
    large = np.maximum(LARGE, chdtri(counts, CHANCE) / counts)
    with np.errstate(invalid="ignore"):
        square = (pooled_rmse(residuals) / noise) ** 2
    return (np.nan_to_num(square) > large) | ((np.nan_to_num(square) > clearly) & coloured(residuals))


def beyond_noise(residuals: Sequence[np.ndarray], noise: np.ndarray) -> list[float]:
    """Per recording, the mean square beyond noise^2, in units of it, of the output that leaves most."""
    with np.errstate(invalid="ignore"):
        return [float(np.nanmax((pooled_rmse([r]) / noise) ** 2)) - 1 for r in residuals]


def coloured(residuals: Sequence[np.ndarray]) -> np.ndarray:
    """Outputs (ny,) whose residual is no white noise in some recording."""
    columns = range(residuals[0].shape[1])
    return np.array([any(ljung_box(r[:, j])[1] < SIGNIFICANCE for r in residuals) for j in columns])


def output_gap_closed(before: float, after: float, noise: float) -> float:
    """The same for one output; nan when there is no measurable gap, and where what is left diverges."""
    if not before**2 > MEASURABLE * noise**2 or np.isinf(after):
        return float("nan")
    return float(min(1.0, 1 - (after**2 - noise**2) / (before**2 - noise**2)))
