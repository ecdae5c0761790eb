"""One time axis to another: hold, anti-alias filter, even grids. Linear interpolation is `numpy.interp`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.errors import DataError

ROUNDING = 1e-5  # of a step: two times closer than this are the same instant
NEAR = 0.04  # of a step: as near to a sample is that sample, for times and periods are rounded
CLOCKS = 1e-3  # of a period: clocks that differ by no more tick alike, and their samples are counted
MOST_STEPS = 1e8  # of one run or one time axis: minutes of a fast model, 0.8 GB a column


def steps_over(span: float, step: float, where: str) -> float:
    """How many steps [s] a span [s] takes. Raises `DataError` where nobody would see their end."""
    steps = span / step
    if steps > MOST_STEPS:
        raise DataError(
            f"{where}: {span:.6g} s in steps of {step:.3g} s would be {steps:.3g} steps, at most {MOST_STEPS:.0e} are "
            "taken. Check the unit of the time axis (a logger counts in ms or ns), or take longer steps."
        )
    return steps


def new_time_axis(time: np.ndarray, period: float | None, times: Sequence[float] | None, name: str) -> np.ndarray:
    """The requested time axis [s], inside the recorded one: nothing is extrapolated."""
    if (period is None) == (times is None):
        raise DataError(
            f"{name}: resample needs either a period or times (got {'none' if period is None else 'both'})."
        )
    if times is None:
        if not (np.isfinite(period) and period > 0):
            raise DataError(f"{name}: the period must be positive (got {period} s). Give seconds, such as 0.01.")
        steps = int(np.floor(steps_over(time[-1] - time[0], period, name) * (1 + 1e-12) + ROUNDING))
        return np.minimum(time[0] + period * np.arange(steps + 1), time[-1])
    new_time = np.asarray(times, dtype=float)
    slack = NEAR * np.median(np.diff(time)) if len(time) > 1 else 0.0
    if len(new_time) and (new_time.min() < time[0] - slack or new_time.max() > time[-1] + slack):
        raise DataError(
            f"{name}: times outside the record (got {new_time.min():g} s to {new_time.max():g} s). "
            f"It covers {time[0]:g} s to {time[-1]:g} s; nothing is extrapolated."
        )
    return new_time


def hold(time: np.ndarray, values: np.ndarray, new_time: np.ndarray) -> np.ndarray:
    """The last sample at or before each new time (zero-order hold); what is early by a rounding (`NEAR`) is reached."""
    slack = NEAR * np.median(np.diff(time)) if len(time) > 1 else 0.0
    at = np.searchsorted(time, np.asarray(new_time) + slack, side="right") - 1
    return values[np.clip(at, 0, len(values) - 1)]


def low_pass(time: np.ndarray, values: np.ndarray, new_time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``(time, values)`` without what the rate of ``new_time`` cannot carry; unchanged when that rate is not lower.

    Zero-phase Kaiser-windowed sinc on an even grid at the recorded rate: pass band to 0.6 of the new Nyquist
    frequency, 60 dB down from the new Nyquist frequency on; the ends are continued by point reflection, so constants
    and ramps pass unchanged. Source: Oppenheim, Schafer, Discrete-Time Signal Processing, section 7.5.
    """
    from scipy.signal import firwin, kaiserord, oaconvolve

    if len(time) < 3 or len(new_time) < 2:
        return time, values
    steps = int(np.ceil(steps_over(time[-1] - time[0], np.median(np.diff(time)), "anti-alias filter") * (1 - 1e-9)))
    fine = np.linspace(time[0], time[-1], steps + 1)
    ratio = np.median(np.diff(new_time)) / (fine[1] - fine[0])
    if ratio <= 1.0 + ROUNDING:
        return time, values
    taps, beta = kaiserord(60.0, 0.4 / ratio)
    half = min(taps // 2, len(fine) - 1)
    kernel = firwin(2 * half + 1, 0.8 / ratio, window=("kaiser", beta))
    x = np.interp(fine, time, values)
    head, tail = 2 * x[0] - x[half:0:-1], 2 * x[-1] - x[-2 : -half - 2 : -1]
    return fine, oaconvolve(np.concatenate([head, x, tail]), kernel, mode="valid")
