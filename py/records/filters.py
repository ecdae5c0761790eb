"""Filters of noisy channels on any time axis: one-euro (causal, online) and Savitzky-Golay (acausal, offline)."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.units import si_unit

from .record import Record

CHUNK = 2048  # windows per call of the linear algebra


def one_euro(
    record: Record,
    names: Sequence[str],
    *,
    min_cutoff: float = 1.0,
    beta: float = 0.0,
    derivative_cutoff: float = 1.0,
    derivative: int = 0,
) -> Record:
    """The record with the named signals low-passed by the one-euro filter, whose cut-off rises with the speed.

        a(f) = 1 / (1 + 1/(2 pi f dt_k))
        r_k  = r_{k-1} + a(derivative_cutoff) ((x_k - z_{k-1})/dt_k - r_{k-1}),      r_0 = 0
        z_k  = z_{k-1} + a(min_cutoff + beta |r_k|) (x_k - z_{k-1}),                  z_0 = x_0

    Causal: z_k knows no later sample, so it lags; a ramp of slope s by s/(2 pi f) where the cut-off is constant.

    min_cutoff, derivative_cutoff : Hz. beta : 1 per unit of the signal (SI), Hz gained per unit/s.
    derivative : 0 replaces the signals by z; 1 adds r as ``<name>.rate`` and leaves the signals as they are.

    Raises DataError for an unknown column, gaps or values that are not numbers; DeclarationError for the options.
    Source: Casiez, Roussel, Vogel, "1 euro filter", CHI 2012, pp. 2527-2530, algorithm 1.
    """
    for option, value in {"min_cutoff": min_cutoff, "derivative_cutoff": derivative_cutoff}.items():
        if not (math.isfinite(value) and value > 0):
            raise DeclarationError(
                f"one_euro: {option} must be positive (got {value} Hz). Give a frequency, such as 1."
            )
    if not (math.isfinite(beta) and beta >= 0):
        raise DeclarationError(f"one_euro: beta must not be negative (got {beta}). 0 keeps the cut-off constant.")
    if derivative not in (0, 1):
        raise DeclarationError(f"one_euro: derivative must be 0 or 1 (got {derivative}). savitzky_golay gives higher.")
    columns = {n: _whole_column(record, n, "one_euro") for n in _several(names, "one_euro")}
    steps = np.diff(record.time)
    passed = {n: _one_euro(steps, x, min_cutoff, beta, derivative_cutoff)[derivative] for n, x in columns.items()}
    return _with_derivatives(record, passed, derivative)


def savitzky_golay(
    record: Record, names: Sequence[str], window: int = 51, order: int = 11, derivative: int = 0
) -> Record:
    """The record with the named signals smoothed by a polynomial through each window, on any time axis.

    Around every sample a polynomial of degree ``order`` is fitted to the ``window`` nearest samples (the same number
    on each side) by least squares, and its value, or that derivative, at the sample is the answer. The fit is in
    Legendre polynomials over the window and by QR: powers of time of order 11 are numerically dependent (with 51
    samples, the weights of scipy 1.17's savgol_filter for even time add up to 0.001 in place of 1).

    Acausal, for offline use. The first and last ``window // 2`` samples have no whole window: **the record answered
    is shorter**, all its columns alike.

    derivative : 0 replaces the signals; d adds the d-th derivative as ``<name>.rate`` (``.rate.rate``, ...) and leaves
        the signals as they are. White noise of the signal comes out larger by about (order/window/dt)^d.

    Raises DataError for an unknown column, a record shorter than the window, gaps or values that are not numbers;
    DeclarationError for the options.
    Source: Savitzky, Golay, Analytical Chemistry 36 (1964) 1627-1639; Gorry, Analytical Chemistry 63 (1991) 534-536.
    """
    _check_window(window, order, derivative)
    columns = [_whole_column(record, n, "savitzky_golay") for n in _several(names, "savitzky_golay")]
    if len(record) < window:
        raise DataError(
            f"{record.source or record.name}: shorter than the window (got {len(record)} samples). "
            f"savitzky_golay needs {window}. Choose a smaller window or a longer record."
        )
    smooth = _local_polynomials(record.time, np.column_stack(columns), window, order, derivative)
    inner = slice(window // 2, len(record) - window // 2)
    kept = dataclasses.replace(
        record, time=record.time[inner], signals={n: v[inner] for n, v in record.signals.items()}
    )
    return _with_derivatives(kept, dict(zip(names, smooth.T, strict=True)), derivative)


def _one_euro(steps: np.ndarray, x: np.ndarray, min_cutoff: float, beta: float, derivative_cutoff: float):
    """Smoothed values and rates, each (n,)."""
    z, r = float(x[0]), 0.0
    values, rates = [z], [r]
    for dt, sample in zip(steps.tolist(), x[1:].tolist(), strict=True):
        apart, turns = sample - z, 2 * math.pi * dt
        r += (apart / dt - r) / (1 + 1 / (turns * derivative_cutoff))
        z += apart / (1 + 1 / (turns * (min_cutoff + beta * abs(r))))
        values.append(z)
        rates.append(r)
    return np.array(values), np.array(rates)


def _local_polynomials(t: np.ndarray, x: np.ndarray, window: int, order: int, derivative: int) -> np.ndarray:
    """Value or derivative of the polynomial through each window of x (n, m) at its middle sample, (n - w + 1, m)."""
    from numpy.polynomial import legendre

    slide = np.lib.stride_tricks.sliding_window_view
    times, values = slide(t, window), slide(x, window, axis=0)
    wanted = legendre.legder(np.eye(order + 1), derivative)  # column j: series of the derivative of P_j
    answer = np.empty((len(times), x.shape[1]))
    for first in range(0, len(times), CHUNK):
        part = slice(first, first + CHUNK)
        half = (times[part, -1] - times[part, 0]) / 2
        local = (times[part] - times[part, :1]) / half[:, None] - 1
        q, r = np.linalg.qr(legendre.legvander(local, order))
        coefficients = np.linalg.solve(r, np.einsum("kwj,kmw->kjm", q, values[part]))
        at_middle = legendre.legvander(local[:, window // 2], len(wanted) - 1) @ wanted
        answer[part] = np.einsum("kj,kjm->km", at_middle, coefficients) / half[:, None] ** derivative
    return answer


def _check_window(window, order, derivative) -> None:
    counts = {"window": (window, 1), "order": (order, 0), "derivative": (derivative, 0)}
    for option, (value, least) in counts.items():
        if int(value) != value or value < least:
            raise DeclarationError(f"savitzky_golay: {option} must be a whole number from {least} up (got {value}).")
    if window % 2 == 0 or window <= order:
        raise DeclarationError(
            f"savitzky_golay: the window must be odd and larger than the order (got {window} samples, order {order})."
        )
    if derivative > order:
        raise DeclarationError(
            f"savitzky_golay: derivative {derivative} of a polynomial of order {order} is zero. Raise the order."
        )


def _several(names: Sequence[str], verb: str) -> Sequence[str]:
    if isinstance(names, str) or not len(names):
        raise DataError(f"{verb}: names must be a list of columns (got {names!r}). Name at least one.")
    return names


def _whole_column(record: Record, name: str, verb: str) -> np.ndarray:
    values, where = record[name], record.source or record.name
    if not len(values):
        raise DataError(f"{where}: no samples (got an empty record). {verb} needs at least one.")
    bad = np.flatnonzero(~np.isfinite(values))
    if len(bad):
        raise DataError(
            f"{where}: column '{name}' has {len(bad)} values that are not numbers, the first at "
            f"{record.time[bad[0]]:g} s. {verb} needs every sample. Cut the record with window()."
        )
    if record.gaps:
        raise DataError(f"{where}: {record.gaps[0]}. {verb} does not filter across a gap. Cut it in two with window().")
    return values


def _with_derivatives(record: Record, columns: dict[str, np.ndarray], derivative: int) -> Record:
    """The columns put in place of the signals, or beside them as their derivatives with their units."""
    suffix, units = ".rate" * derivative, {}
    for name in columns:
        unit = record.units[name]
        for _ in range(derivative):
            over, _, under = unit.partition("/")
            unit = si_unit(f"{over}/({under.strip('()')}.s)" if under else f"{over}/s")
        units[name + suffix] = unit
    return record.with_signals({name + suffix: values for name, values in columns.items()}, units)
