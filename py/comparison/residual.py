"""What a free run leaves unexplained: is the residual white, and which input does it still follow?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from hydrotwin.records import Record

MAX_SAMPLES = 20_000
LAGS = 25


@dataclass(frozen=True)
class Residual:
    """The error e = predicted - measured of one free run, looked at.

    noise        noise of the measured signal by itself, in ``unit`` (see `noise_floor`)
    times_noise  rmse over that noise: 1 when only noise is left; nan without noise
    explained_percent  share of the measured variance that the model explains, 100 (1 - var(e)/var(y))
    correlation_time   s until the autocorrelation of e first falls below 1/e
    white_percent      share of the first lags whose autocorrelation stays inside the 95 % band of white noise;
                       about 95 for white noise
    follows, strength, lag  signal that e correlates with most, the correlation, and how many s e comes after it;
                            empty when even that is within 4/sqrt(n), what chance gives over many lags
    """

    model: str
    record: str
    output: str
    unit: str
    noise: float
    times_noise: float
    explained_percent: float
    correlation_time: float
    white_percent: float
    follows: str
    strength: float
    lag: float

    @property
    def only_noise(self) -> bool:
        """Nothing is left but noise: the size is that of the noise, and neighbouring errors are not alike."""
        return self.times_noise < 1.2 and self.white_percent >= 80.0


def explain(record: Record, output: str, predicted: np.ndarray, *, model: str, noise: float = float("nan")) -> Residual:
    """Residual analysis of one output; ``predicted`` is (n,) at the times of ``record``, uniform or not, SI.

    Every signal of the recording may be what the error follows. Long recordings are looked at on at most MAX_SAMPLES
    uniform samples, so that lags and whiteness are those of that grid. Ljung, System Identification (1999), 16.6.
    """
    time, measured = record.time, record[output]
    known = np.isfinite(measured) & np.isfinite(predicted)
    grid, period = uniform(time[known])
    e = np.interp(grid, time[known], (predicted - measured)[known])
    variance = float(np.var(measured[known]))
    explained = 100.0 * (1.0 - float(np.var((predicted - measured)[known])) / variance) if variance > 0 else np.nan
    lags = max(1, min(LAGS, len(grid) // 4))
    r = _correlations(e, e[None])[0]
    band = 1.96 / np.sqrt(len(e))
    below = np.flatnonzero(r < np.exp(-1.0))
    follows, strength, lag = _strongest(grid, e, record, period)
    return Residual(
        model,
        record.name,
        output,
        record.units[output],
        noise=noise,
        times_noise=float(np.sqrt(np.mean((predicted - measured)[known] ** 2))) / noise if noise > 0 else np.nan,
        explained_percent=explained,
        correlation_time=float(below[0] * period) if len(below) else float(grid[-1] - grid[0]),
        white_percent=100.0 * float(np.mean(np.abs(r[1 : lags + 1]) <= band)),
        follows=follows,
        strength=strength,
        lag=lag,
    )


def uniform(time: np.ndarray, most: int = MAX_SAMPLES) -> tuple[np.ndarray, float]:
    """A uniform grid of as many samples as ``time`` (n,), at most ``most``, and its period, s."""
    count = max(2, min(len(time), most))
    grid = np.linspace(time[0], time[-1], count)
    return grid, float(grid[1] - grid[0])


def _correlations(e: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Normalised correlations (m, n) of ``e`` (n,) with ``others`` (m, n); e comes 0 to n-1 samples after them."""
    e, others = e - e.mean(), others - others.mean(axis=1, keepdims=True)
    size = next_fast_len(2 * len(e) - 1, real=True)
    found = irfft(rfft(e, size) * np.conj(rfft(others, size)), size)[:, : len(e)]
    scale = np.linalg.norm(e) * np.linalg.norm(others, axis=1, keepdims=True)
    return np.where(scale > 1e-300, found, 0.0) / np.where(scale > 1e-300, scale, 1.0)


def _strongest(grid: np.ndarray, e: np.ndarray, record: Record, period: float) -> tuple[str, float, float]:
    """Signal, correlation and lag [s] (0 to a quarter of the recording, at most 2 s) of the strongest link with e."""
    best = ("", 0.0, 0.0)
    if not period > 0:  # a single sample follows nothing
        return best
    reach = min(len(grid) // 4, int(2.0 / period)) + 1
    names = [name for name, values in record.signals.items() if np.isfinite(values).all()]
    if not names:
        return best
    signals = np.stack([np.interp(grid, record.time, record[name]) for name in names])
    for name, r in zip(names, _correlations(e, signals)[:, :reach], strict=True):
        k = int(np.argmax(np.abs(r)))
        if abs(r[k]) > abs(best[1]):
            best = (name, float(r[k]), k * period)
    return best if abs(best[1]) > 4.0 / np.sqrt(len(e)) else ("", 0.0, 0.0)
