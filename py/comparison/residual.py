"""What a free run leaves unexplained: is the residual white, and which input does it still follow?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from hydrotwin.records import Record
from hydrotwin.records.steps import holes_at

MAX_SAMPLES = 20_000
LAGS = 25
ON_IT = 1e-6  # of a period: a grid that ends there ends with the samples


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
    uniform samples, so that lags and whiteness are those of that grid, and nothing is looked at across a hole. Ljung,
    System Identification (1999), 16.6.
    """
    time, measured = record.time, record[output]
    known = np.isfinite(measured) & np.isfinite(predicted)
    grids, period = uniform(time[known])
    e = _on(grids, time[known], (predicted - measured)[known])
    variance = float(np.var(measured[known]))
    explained = 100.0 * (1.0 - float(np.var((predicted - measured)[known])) / variance) if variance > 0 else np.nan
    longest = max(map(len, grids))
    lags = max(1, min(LAGS, longest // 4))
    r = _correlations(e, [part[None] for part in e])[0]
    band = 1.96 / np.sqrt(sum(map(len, e)))
    below = np.flatnonzero(r < np.exp(-1.0))
    follows, strength, lag = _strongest(grids, e, record, period)
    return Residual(
        model,
        record.name,
        output,
        record.units[output],
        noise=noise,
        times_noise=float(np.sqrt(np.mean((predicted - measured)[known] ** 2))) / noise if noise > 0 else np.nan,
        explained_percent=explained,
        correlation_time=float(below[0] * period) if len(below) else float((longest - 1) * period),
        white_percent=100.0 * float(np.mean(np.abs(r[1 : lags + 1]) <= band)),
        follows=follows,
        strength=strength,
        lag=lag,
    )


def uniform(time: np.ndarray, most: int = MAX_SAMPLES) -> tuple[list[np.ndarray], float]:
    """Uniform grids between the holes of ``time`` (n,), of one period [s]: with as many samples, at most ``most``."""
    parts = [time[a:b] for a, b in pairwise([0, *(holes_at(time) + 1), len(time)])]
    spans = [float(part[-1] - part[0]) for part in parts]
    period = sum(spans) / max(1, min(len(time), most) - len(parts))
    counts = [int(span / period + ON_IT) + 1 if period else 2 for span in spans]
    return [np.linspace(p[0], p[0] + (n - 1) * period, n) for p, n in zip(parts, counts, strict=True)], period


def _on(grids: Sequence[np.ndarray], time: np.ndarray, values: np.ndarray) -> list[np.ndarray]:
    return [np.interp(grid, time, values) for grid in grids]


def _correlations(e: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> np.ndarray:
    """Normalised correlations (m, n) of ``e`` with ``others``, in parts (n,) and (m, n) between holes.

    e comes 0 to n - 1 samples after them, n of the longest part.
    """
    middle, middles = np.concatenate(e).mean(), np.concatenate(others, axis=1).mean(axis=1, keepdims=True)
    e, others = [part - middle for part in e], [part - middles for part in others]
    found = np.zeros((len(middles), max(map(len, e))))
    for one, other in zip(e, others, strict=True):
        size = next_fast_len(2 * len(one) - 1, real=True)
        found[:, : len(one)] += irfft(rfft(one, size) * np.conj(rfft(other, size)), size)[:, : len(one)]
    size_of = np.linalg.norm(np.concatenate(others, axis=1), axis=1, keepdims=True)
    scale = np.linalg.norm(np.concatenate(e)) * size_of
    return np.where(scale > 1e-300, found, 0.0) / np.where(scale > 1e-300, scale, 1.0)


def _strongest(
    grids: Sequence[np.ndarray], e: Sequence[np.ndarray], record: Record, period: float
) -> tuple[str, float, float]:
    """Signal, correlation and lag [s] (0 to a quarter of the recording, at most 2 s) of the strongest link with e."""
    best = ("", 0.0, 0.0)
    if not period > 0:  # a single sample follows nothing
        return best
    reach = min(max(map(len, grids)) // 4, int(2.0 / period)) + 1
    names = [name for name, values in record.signals.items() if np.isfinite(values).all()]
    if not names:
        return best
    signals = [np.stack([np.interp(grid, record.time, record[name]) for name in names]) for grid in grids]
    for name, r in zip(names, _correlations(e, signals)[:, :reach], strict=True):
        k = int(np.argmax(np.abs(r)))
        if abs(r[k]) > abs(best[1]):
            best = (name, float(r[k]), k * period)
    return best if abs(best[1]) > 4.0 / np.sqrt(sum(map(len, e))) else ("", 0.0, 0.0)
