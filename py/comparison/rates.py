"""Speeds of measured positions, as in Fig. 12 of the C-EHA paper: nobody recorded them, both sides get one filter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import si_unit
from hydrotwin.records import Record
from hydrotwin.records.steps import usual

WINDOW = 0.05  # s, over which a slope is taken
GAP = 3.0  # usual samples, or half windows: a longer stretch without a sample is a gap


def rate_signal(signal: Signal) -> Signal:
    """The output ``<name>.rate`` of a signal, in its unit per second.

    >>> rate_signal(Signal("arm_angle", "rad")).unit
    'rad/s'
    """
    over, _, under = signal.unit.partition("/")
    unit = si_unit(f"{over}/({under.strip('()')}.s)" if under else f"{over}/s")
    return Signal(rate_name(signal.name), unit, f"slope of {signal.name} over {1e3 * WINDOW:g} ms")


def rate_name(name: str) -> str:
    """Name of the rate of a signal."""
    return f"{name}.rate"


def with_rates(record: Record, signals: Sequence[Signal], measured: Record | None = None) -> Record:
    """The record with the rates of those signals that it holds.

        r(t) = (y(t + w/2) - y(t - w/2)) / w

    w is WINDOW, or two samples where these are longer; at the ends the window is cut. White noise of y comes out
    sqrt(2)/w times as large. A sensor with samples of its own, slower than the record, has its slope at those, and none
    where the window reaches into a gap; measured : the record whose samples count, by default this one.
    """
    measured, rates, units = measured or record, {}, {}
    for signal in (s for s in signals if s.name in record.signals):
        rate = rate_signal(signal)
        known = (
            np.isfinite(measured[signal.name]) if signal.name in measured.signals else np.ones(len(record.time), bool)
        )
        if known.sum() >= 3:
            rates[rate.name] = np.full(len(record.time), np.nan)
            rates[rate.name][known] = _slopes(record.time[known], record[signal.name][known])
            units[rate.name] = rate.unit
    return record.with_signals(rates, units) if rates else record


def _slopes(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Slopes (n,) at the samples; NaN where the window ends in a gap."""
    steps = np.diff(time)
    own = usual(steps)  # of a clock that turns slower what is usual there
    own = np.maximum(np.concatenate([own[:1], own]), np.concatenate([own, own[-1:]]))
    half = np.maximum(WINDOW / 2, own)
    after, before = np.minimum(time + half, time[-1]), np.maximum(time - half, time[0])
    slopes = (np.interp(after, time, values) - np.interp(before, time, values)) / (after - before)
    beside = [steps[np.clip(np.searchsorted(time, at) - 1, 0, len(steps) - 1)] for at in (after, before)]
    return np.where(np.maximum(*beside) <= GAP * np.maximum(own, WINDOW / 2), slopes, np.nan)
