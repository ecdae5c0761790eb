"""Speeds of measured positions, as in Fig. 12 of the C-EHA paper: nobody recorded them, both sides get one filter."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import si_unit
from hydrotwin.records import Record

WINDOW = 0.05  # s, over which a slope is taken


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


def with_rates(record: Record, signals: Sequence[Signal]) -> Record:
    """The record with the rates of those signals that it holds.

        r(t) = (y(t + w/2) - y(t - w/2)) / w

    w is WINDOW, or two samples where these are longer; at the ends the window is cut. White noise of y comes out
    sqrt(2)/w times as large.
    """
    held = [s for s in signals if s.name in record.signals]
    if not held or len(record.time) < 3:
        return record
    half = max(WINDOW / 2, record.period)
    after = np.minimum(record.time + half, record.time[-1])
    before = np.maximum(record.time - half, record.time[0])
    rates, units = {}, {}
    for signal in held:
        values = record[signal.name]
        rate = rate_signal(signal)
        rates[rate.name] = (np.interp(after, record.time, values) - np.interp(before, record.time, values)) / (
            after - before
        )
        units[rate.name] = rate.unit
    return record.with_signals(rates, units)
