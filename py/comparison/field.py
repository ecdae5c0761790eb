"""Metrics of the field: what standards and papers ask of a free run, beside the errors of `metrics`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.records import NoiseFloor, Record

from .rating import LONGEST, SHIFT, rating
from .residual import uniform
from .rest import at_rest, settling
from .shift import lag

NAN = float("nan")


@dataclass(frozen=True, kw_only=True)
class FieldMetrics:
    """Metrics of one prediction p of a measurement y; NaN where one is not defined.

    r2        1 - sum((y - p)^2) / sum((y - mean y)^2)
    theil     Theil's inequality coefficient rms(y - p) / (rms y + rms p), 0 to 1
    lag       s that p comes after y, where they correlate most; repeats: s more or less that fit as well, if any
    settling  s that p takes longer than y to settle after the inputs have moved: mean size over the moves, sign of the
              mean
    steady    mean(p - y) of every rest of inputs and y: mean size over the rests, sign of the mean; unit of the signal
    u_val     rms of the standard deviation of the model's band, in the unit of the signal (ASME V&V 20)
    vv20      rmse over u_val
    iso18571  overall rating of ISO/TS 18571, 0 to 1; corridor, phase, magnitude, slope : what it is made of.
              Free run only
    """

    r2: float = NAN
    theil: float = NAN
    lag: float = NAN
    repeats: float = NAN
    settling: float = NAN
    steady: float = NAN
    u_val: float = NAN
    vv20: float = NAN
    iso18571: float = NAN
    corridor: float = NAN
    phase: float = NAN
    magnitude: float = NAN
    slope: float = NAN


@dataclass(frozen=True)
class Predicted:
    """One output as predicted: values (n,) at the times of the recording, standard deviation (n,) if it has one."""

    output: str
    values: np.ndarray
    deviation: np.ndarray | None = None


def field_metrics(
    record: Record, found: Predicted, inputs: Sequence[str], noise: Mapping[str, NoiseFloor], *, rated: bool = True
) -> FieldMetrics:
    """Metrics of what was predicted.

    inputs : names of what must rest for ``steady`` and ``settling``; rated : with ISO/TS 18571.

    Samples that were not measured are left out; lag and rating see uniform grids with lines between the samples, and
    nothing across a hole.
    """
    measured = record[found.output]
    known = np.isfinite(measured) & np.isfinite(found.values)
    time, y, p = record.time[known], measured[known], found.values[known]
    inputs = [n for n in inputs if n in record.signals]
    late, repeats = _lag(time, y, p)
    u_val, rmse = _validation_uncertainty(found.deviation, known), _rms(p - y)
    return FieldMetrics(
        r2=r_squared(y, p),
        theil=theil(y, p),
        lag=late,
        repeats=repeats,
        settling=settling(record, found.output, found.values, inputs, noise) if inputs else NAN,
        steady=at_rest(record, found.output, found.values, inputs, noise),
        u_val=u_val,
        vv20=rmse / u_val if u_val > 0 else NAN,
        **(_rated(time, y, p) if rated else {}),
    )


def r_squared(measured: np.ndarray, predicted: np.ndarray) -> float:
    """Coefficient of determination of p as a prediction of y, at most 1; NaN for a measurement that does not move.

    Source: Nash, Sutcliffe, J. Hydrology 10 (1970) 282-290.

    >>> r_squared(np.array([0.0, 1.0, 2.0]), np.array([0.0, 1.0, 1.0]))
    0.5
    """
    if not len(measured) or not np.ptp(measured):
        return NAN
    return float(1.0 - np.sum((measured - predicted) ** 2) / np.sum((measured - measured.mean()) ** 2))


def theil(measured: np.ndarray, predicted: np.ndarray) -> float:
    """Theil's inequality coefficient U: 0 for no error, 1 for the worst; it sees where the unit has its zero.

    Source: Theil, Economic Forecasts and Policy, 2nd ed. (1961), section 2.5.

    >>> theil(np.array([1.0, -1.0]), np.array([-1.0, 1.0]))
    1.0
    """
    size = _rms(measured) + _rms(predicted)
    return _rms(measured - predicted) / size if size > 0 and np.ptp(measured) else NAN


def _lag(time: np.ndarray, y: np.ndarray, p: np.ndarray) -> tuple[float, float]:
    if len(time) < 3:
        return NAN, NAN
    grids, period = uniform(time)
    return lag([np.interp(g, time, y) for g in grids], [np.interp(g, time, p) for g in grids], period, SHIFT)


def _rated(time: np.ndarray, y: np.ndarray, p: np.ndarray) -> dict[str, float]:
    if len(time) < 2:
        return {}
    grids, _ = uniform(time, LONGEST)
    found = rating([np.interp(g, time, y) for g in grids], [np.interp(g, time, p) for g in grids])
    parts = {name: getattr(found, name) for name in ("corridor", "phase", "magnitude", "slope")}
    return {"iso18571": found.overall, **parts}


def _validation_uncertainty(deviation: np.ndarray | None, known: np.ndarray) -> float:
    if deviation is None:
        return NAN
    told = np.asarray(deviation, float)[known]
    return _rms(told) if len(told) and np.isfinite(told).all() else NAN


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else NAN
