"""The noise floor of a measured channel, from the channel alone."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from hydrotwin.models.language.units import parse_unit

from .record import Record

_BLOCK = 64  # differences per block
_MEDIAN = 0.4549  # of a squared normal variable
_CONTAMINATED = 0.6  # median over mean below this: some differences are no noise
_OUTLYING = 16.0  # variances: beyond four sigmas
_MOST_DIGITS, _MOST_DECIMALS = 8, 12  # significant ones, and of the largest value: finer rounding nobody sees
_ON_GRID, _ROUNDING = 1e-6, 4e-15  # of a step, and of a value: how near to a multiple of its step it must be ...
_OF_VALUES, _CERTAIN = 0.95, 1e-2  # ... for so many of the values; of a step: what double precision must tell apart
_FEWEST_LEVELS, _LOOKED_AT = 20, 4000  # different values that show their digits; samples that are looked at
_NEARLY_ALL = 0.8  # of the samples: a channel with more different values shows no grid of its own
_WRITTEN_IN = ("m", "deg", "rpm", "rev", "psi", "L/min", "gpm", "h", "in", "ft", "lbf", "kgf")  # up to powers of ten
_CORRELATION = 2.626  # sum over all lags of the squared autocorrelation of 4th differences of white noise


@dataclass(frozen=True)
class NoiseFloor:
    """Standard deviation of the noise of one channel, SI: ``sigma = sqrt(white^2 + quantum^2 / 12)``.

    ``white`` is what 4th differences see beyond rounding, ``quantum`` the step of the sensor, the converter or the
    digits that were written (0: none found). A channel that never moves has sigma 0.
    """

    sigma: float
    white: float
    quantum: float


def noise_floor(record: Record) -> dict[str, NoiseFloor]:
    """Noise floor of every signal of the record."""
    return {name: channel_noise(record.time, values) for name, values in record.signals.items()}


def channel_noise(time: np.ndarray, values: np.ndarray) -> NoiseFloor:
    """Noise floor of one channel, (n,) on ``time`` (n,) s, uniform or not; samples that are nan are left out.

    A 4th divided difference over five neighbours, scaled to unit weights, removes any local cubic and leaves white
    noise with its own variance, so the mean of its square in a block of a quiet stretch is the noise variance. The
    lower quartile over the blocks, corrected for the quartile of a pure noise record, ignores up to three quarters of
    blocks with fast motion; the mean of the blocks that it makes plausible is the answer. Where steps of the signal
    stand in every block, the median tells, and what lies beyond four sigmas is left out.
    Rounding to a step q adds q^2/12, which the differences do not see where the signal rests, or is so small that a
    few digits say it finely.

    Valid for noise that is white at the sampling rate; noise that a filter has smoothed is underestimated.
    Source: Gasser, Sroka, Jennen-Steinmetz, Biometrika 73 (1986) 625-633 (difference-based variance); Widrow, Kollar,
    Quantization Noise (2008), chapter 5 (q^2/12).
    """
    known = np.isfinite(values)
    time, values = np.asarray(time)[known], np.asarray(values)[known]
    q = recorded_step(values)
    if len(values) < 6:
        return NoiseFloor(float(q / np.sqrt(12)), 0.0, q)
    seen = _quiet_variance(_fourth_differences(time, values) ** 2)
    white = max(seen - q**2 / 12, 0.0)
    return NoiseFloor(float(np.sqrt(white + q**2 / 12)), float(np.sqrt(white)), q)


def recorded_step(values: np.ndarray) -> float:
    """The step in which finite values (n,) were recorded, of the sensor or of the digits written; 0: none found.

    The step of a number of significant digits grows with the value: then it is the root mean square over the samples.
    """
    return max(quantisation_step(values), _step_of_digits(np.asarray(values, dtype=float)))


def _step_of_digits(values: np.ndarray) -> float:
    """Root mean square of the step of the last digit, in whatever unit the values were written; 0: too many digits."""
    signed = np.unique(values[:: max(1, len(values) // _LOOKED_AT)])
    values = np.abs(values[:: max(1, len(values) // _LOOKED_AT)])
    values = values[values > 0]
    levels = np.unique(values)
    if len(levels) < _FEWEST_LEVELS:
        return 0.0
    coarsest = 0.0
    for unit in _mantissas():  # an inch is a rounder number of inches than of metres
        digits = _coarsest(levels / unit, _decade(levels / unit), _MOST_DIGITS)
        decimals = _coarsest(levels / unit, _decade(levels[-1:] / unit), _MOST_DECIMALS)
        decimals *= _in_common(signed / unit, decimals * _decade(levels[-1:] / unit))
        steps = np.maximum(digits * _decade(values / unit), decimals * _decade(levels[-1:] / unit))
        coarsest = max(coarsest, float(unit * np.sqrt(np.mean(steps**2))))
    return coarsest


def _decade(written: np.ndarray) -> np.ndarray:
    return 10.0 ** np.floor(np.log10(written))


def _coarsest(written: np.ndarray, decade: np.ndarray, most: int) -> float:
    """The largest power of ten, as a part of the decade, of which nearly all values are multiples; 0: none."""
    found = 0.0
    for k in range(most - 1, -1, -1):
        multiple = written / (decade * 10.0**-k)
        tolerance = _ON_GRID + _ROUNDING * multiple
        off = np.abs(multiple - np.round(multiple))
        if np.mean((off < tolerance) & (tolerance < _CERTAIN)) < _OF_VALUES:
            break
        found = 10.0**-k
    return found


def _in_common(written: np.ndarray, step: np.ndarray) -> int:
    """How many of its last digit a value moves at least: a sensor of 0.5 mm written in tenths of one."""
    return int(np.gcd.reduce(np.diff(np.round(written / step).astype(np.int64)))) if step[0] > 0 else 1


@cache
def _mantissas() -> tuple[float, ...]:
    """What one of each unit is in SI, powers of ten apart."""
    factors = [parse_unit(unit).factor for unit in _WRITTEN_IN]
    return tuple(factor / 10.0 ** np.floor(np.log10(factor)) for factor in factors)


def quantisation_step(values: np.ndarray) -> float:
    """The step of a quantised channel: the largest q of which all differences are multiples; 0 when there is none.

    Values on a grid repeat: a channel with nearly as many different values as samples is not called quantised.
    """
    values = np.asarray(values, dtype=float)
    levels = np.unique(values)
    if len(levels) < 2 or len(levels) > _NEARLY_ALL * len(values):
        return 0.0
    resolution = max(1e-7 * (levels[-1] - levels[0]), 4 * np.spacing(np.abs(levels).max()))  # single precision
    steps = np.diff(levels)
    steps = steps[steps > 8 * resolution]
    if not len(steps):
        return 0.0
    smallest = float(np.median(steps[steps <= 1.2 * steps.min()]))
    fitting = (q for q in (smallest / part for part in range(1, 9)) if _all_multiples(steps, q, resolution))
    return float(next(fitting, 0.0))


def _all_multiples(steps: np.ndarray, q: float, resolution: float) -> bool:
    """Whether the steps are multiples of q, as far as their resolution lets one tell (half of them must)."""
    tolerance = 0.05 + steps / q * resolution / q
    telling = tolerance < 0.2
    off = np.abs(steps / q - np.round(steps / q))
    return telling.mean() >= 0.5 and np.mean(off[telling] < tolerance[telling]) > 0.95


def _fourth_differences(t: np.ndarray, x: np.ndarray) -> np.ndarray:
    """4th divided differences of x(t), each scaled to weights of unit length; shape (n - 4,)."""
    five_t = np.lib.stride_tricks.sliding_window_view(t, 5)
    five_x = np.lib.stride_tricks.sliding_window_view(x, 5)
    apart = (five_t[:, :, None] - five_t[:, None, :]) / (five_t[:, -1] - five_t[:, 0])[:, None, None]
    apart[:, np.arange(5), np.arange(5)] = 1.0
    weights = 1.0 / apart.prod(axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    return (weights * (five_x - five_x[:, 2:3])).sum(axis=1)


def _quiet_variance(squares: np.ndarray) -> float:
    """Mean over the blocks that are no louder than white noise of the variance that the lower quartile tells."""
    from scipy.special import gammaincinv

    size = min(_BLOCK, len(squares))
    blocks = squares[: len(squares) // size * size].reshape(-1, size).mean(axis=1)
    half_freedom = size / _CORRELATION / 2
    expected = gammaincinv(half_freedom, 0.25) / half_freedom if len(blocks) > 1 else 1.0  # of chi-square / freedom
    first = np.quantile(blocks, 0.25) / expected
    loudest = gammaincinv(half_freedom, 0.999) / half_freedom
    quiet = blocks <= max(first * loudest, blocks.min())
    inside = squares[: len(blocks) * size].reshape(-1, size)[quiet].ravel()
    typical = float(np.median(inside)) / _MEDIAN
    if not typical > 0 or typical > _CONTAMINATED * inside.mean():  # a resting encoder has a median of 0
        return float(inside.mean())
    return float(inside[inside < _OUTLYING * typical].mean())  # every block holds steps of the signal itself
