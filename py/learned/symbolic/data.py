"""Recordings made ready for a formula: over scales short enough to print, with smoothed features and increments."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..network.narx import NarxShape
from ..training_data import HELD_OUT, choose_input_lags, free_run_bounds, increment_spread, on_period, smoothed
from .refit import Bounds, Piece, Series

LEAST_SAMPLES = 50


@dataclass(frozen=True)
class Prepared:
    """Series with the pieces to fit and to judge on, the scales of the block, and the lags."""

    shape: NarxShape
    scales: dict[str, np.ndarray]
    series: list[Series]
    fit: list[Piece]
    judged: list[Piece]

    @property
    def bounds(self) -> Bounds:
        """The bounds of a free run, normalised."""
        s = self.scales
        lower, upper = ((s[f"output_{side}"] - s["output_centre"]) / s["output_scale"] for side in ("lower", "upper"))
        return Bounds(s["increment_scale"] / s["output_scale"], s["increment_limit"], lower, upper)

    def pairs(self) -> tuple[np.ndarray, np.ndarray]:
        """Features (n, nf) and increments to the next sample (n, ny), over the increment scale, of the fitted part."""
        ratio, y = self.bounds.ratio, range(self.shape.outputs)
        z = [self.series[p.series].z[p.first : p.last] for p in self.fit]
        return np.concatenate([v[:-1] for v in z]), np.concatenate([np.diff(v[:, y], axis=0) for v in z]) / ratio


def prepare(
    records: Sequence[Record],
    validate: Sequence[Record],
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    period: float,
    lags: tuple[int, int | None],
    next_value: bool,
) -> Prepared:
    """Bring recordings onto one period and scale them.

    next_value : features as measured and the next value as target, as in the C-EHA paper; else smoothed features
    (a local parabola over 7 samples) and increments.
    """
    u, y = zip(*(_columns(r, inputs, outputs, period) for r in records), strict=True)
    judged = [_columns(r, inputs, outputs, period) for r in validate]
    scales = _scales(np.concatenate(u), list(y), next_value)

    def normal(part: str, values: np.ndarray) -> np.ndarray:
        return (values - scales[f"{part}_centre"]) / scales[f"{part}_scale"]

    m = lags[1] or choose_input_lags([normal("input", v) for v in u], [normal("output", v) for v in y], lags[0])
    shape = NarxShape(len(inputs), len(outputs), int(lags[0]), int(m), 0)
    ratio = scales["increment_scale"] / scales["output_scale"]
    all_runs = [*zip(u, y, strict=True), *judged]
    series = [_series(normal("input", a), normal("output", b), shape, ratio, next_value) for a, b in all_runs]
    whole = [Piece(i, 0, len(s.y), True) for i, s in enumerate(series)]
    if judged:
        return Prepared(shape, scales, series, whole[: len(u)], whole[len(u) :])
    cuts = [round((1 - HELD_OUT) * p.last) for p in whole]
    fit = [Piece(p.series, 0, k, True) for p, k in zip(whole, cuts, strict=True)]
    tails = [Piece(p.series, k, p.last, False) for p, k in zip(whole, cuts, strict=True)]
    return Prepared(shape, scales, series, fit, [*tails, *whole])


def _columns(record: Record, inputs, outputs, period: float) -> tuple[np.ndarray, np.ndarray]:
    even = on_period(record, period, inputs)
    if len(even) < LEAST_SAMPLES:
        raise DataError(
            f"{record.source or record.name}: too few samples (got {len(even)} at {period:g} s). "
            f"At least {LEAST_SAMPLES} are needed. Leave the recording out or choose a shorter period."
        )
    return even.array([s.name for s in inputs]), even.array([s.name for s in outputs])


def _scales(u: np.ndarray, runs: Sequence[np.ndarray], next_value: bool) -> dict[str, np.ndarray]:
    input_centre, input_scale = _readable(u)
    output_centre, output_scale = _readable(np.concatenate(runs))
    return {
        "input_centre": input_centre,
        "input_scale": input_scale,
        "output_centre": output_centre,
        "output_scale": output_scale,
        **free_run_bounds(runs, output_scale if next_value else _one_digit(increment_spread(runs))),
    }


def _readable(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and scale of each column: one digit of the spread; no centre unless the mean is beyond the spread."""
    scale = _one_digit(np.where(values.std(axis=0) > 0, values.std(axis=0), 1.0))
    mean = values.mean(axis=0)
    centre = np.where(np.abs(mean) > scale, scale * np.round(mean / scale), 0.0)
    return np.array([float(f"{c:.6g}") for c in centre]), scale


def _one_digit(values: np.ndarray) -> np.ndarray:
    return np.array([float(f"{v:.0e}") for v in values])


def _series(u: np.ndarray, y: np.ndarray, shape: NarxShape, ratio: np.ndarray, next_value: bool) -> Series:
    """Features at every sample; before the first one the machine stands and the input is what it is there."""
    seen = y if next_value else smoothed(y)
    d = np.vstack([np.zeros((1, seen.shape[1])), np.diff(seen, axis=0)]) / ratio
    lagged = [_delayed(d, lag, 0.0) for lag in range(shape.output_lags)]
    return Series(np.hstack([seen, *lagged, *(_delayed(u, lag, u[0]) for lag in range(shape.input_lags))]), y)


def _delayed(values: np.ndarray, lag: int, before) -> np.ndarray:
    return np.vstack([np.broadcast_to(before, (lag, values.shape[1])), values[: len(values) - lag]])
