"""Delay lines of recordings: what a Gaussian process learns from, and what its certificate is taken on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import Record

from ..training_data import choose_period, on_period

FEWEST = 50  # rows to learn from
PAUSE = 2.0  # periods; a delay line does not reach over a longer one


@dataclass(frozen=True, eq=False)
class Rows:
    """What a process learns from: delay lines (n, lags nu) and what was measured with them, SI.

    levels : output at the line's newest sample (n, ny). ahead : output one sample later. slopes : raw rates to it.
    """

    features: np.ndarray
    levels: np.ndarray
    ahead: np.ndarray
    slopes: np.ndarray

    def __len__(self) -> int:
        return len(self.features)

    @classmethod
    def joined(cls, parts: Sequence[Rows]) -> Rows:
        """The rows of several recordings."""
        return cls(*(np.concatenate([getattr(p, key) for p in parts]) for key in cls.__dataclass_fields__))

    def taken(self, index) -> Rows:
        """Only these rows."""
        return Rows(*(part[index] for part in (self.features, self.levels, self.ahead, self.slopes)))


def even_period(records: Sequence[Record]) -> float:
    """The longest period [s] that loses nothing worth having (`choose_period`); of uneven recordings their own."""
    if all(r.uniform for r in records):
        return choose_period(records)
    return float(f"{max(r.period for r in records):.2g}")


def training_rows(records, period, inputs, outputs, lags, samples, rng) -> Rows:
    """The rows of all recordings, at most ``samples`` of them."""
    parts = [delayed_rows(r, period, inputs, outputs, lags) for r in records]
    rows = Rows.joined(parts)
    if len(rows) < FEWEST:
        raise DataError(
            f"{records[0].source or records[0].name}: too few samples to train on (got {len(rows)} with {lags} lags at "
            f"{period:g} s). At least {FEWEST} are needed. Record longer, or choose a shorter period or fewer lags."
        )
    return rows if len(rows) <= samples else rows.taken(np.sort(rng.permutation(len(rows))[:samples]))


def delayed_rows(record: Record, period: float, inputs, outputs, lags: int) -> Rows:
    """Delay lines of a recording; those that reach over a pause of two periods are left out."""
    near = abs(record.period - period) <= 0.1 * period
    even = record if near else on_period(record, period, inputs)
    u, y = (even.array([s.name for s in part]) for part in (inputs, outputs))
    k = np.arange(lags - 1, len(even) - 1)
    paused = np.concatenate([[0], np.cumsum(np.diff(even.time) > PAUSE * period)])
    k = k[paused[k + 1] == paused[k - lags + 1]] if len(k) else k
    line = np.hstack([u[k - i] for i in range(lags)])
    slopes = (y[k + 1] - y[k]) / (even.time[k + 1] - even.time[k])[:, None]
    return Rows(line, y[k], y[k + 1], slopes)


def input_scales(features: np.ndarray, inputs: int) -> dict[str, np.ndarray]:
    """Centre, spread and range of every input over its lags; the range over the spread, as the block clips."""
    values = features.reshape(-1, inputs)
    centre, scale = values.mean(axis=0), values.std(axis=0)
    scale = np.where(scale > 0, scale, 1.0)
    low, high = ((side(values, axis=0) - centre) / scale for side in (np.min, np.max))
    return {"input_centre": centre, "input_scale": scale, "input_lower": low, "input_upper": high}


def normalised(features: np.ndarray, scales: Mapping[str, np.ndarray]) -> np.ndarray:
    """Features (n, lags nu) over the spread of their input."""
    repeats = features.shape[1] // len(scales["input_centre"])
    return (features - np.tile(scales["input_centre"], repeats)) / np.tile(scales["input_scale"], repeats)


def certification_grid(parts: Sequence[Rows], inputs: int, lags: int, rng, most: int = 300) -> np.ndarray:
    """Delay lines to compare on: rows of the recordings, steady inputs, and steps between 9 levels of every input."""
    lines = [p.features[rng.permutation(len(p))[:most]] for p in parts if len(p)]
    values = parts[0].features.reshape(-1, inputs)
    centre, low, high = values.mean(axis=0), values.min(axis=0), values.max(axis=0)
    for j in range(inputs):
        steady = np.tile(centre, (201, 1))
        steady[:, j] = np.linspace(low[j], high[j], 201)
        lines.append(np.tile(steady, lags))
        before, after = (side.ravel() for side in np.meshgrid(steady[::25, j], steady[::25, j]))
        for since in range(1, lags):
            line = np.tile(centre, (len(before), lags, 1))
            line[:, :since, j], line[:, since:, j] = after[:, None], before[:, None]
            lines.append(line.reshape(len(before), -1))
    return np.concatenate(lines)
