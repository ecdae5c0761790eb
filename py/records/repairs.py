"""Repairs of a time axis that a person asks for. Nothing is repaired unasked."""

from __future__ import annotations

import numpy as np

REPAIRS = ("spread", "first", "last", "unwrap", "sort")
DAY, HALF_DAY, HOUR = 86_400.0, 43_200.0, 3_600.0  # s: a time of day begins anew after 24 hours, or after 12
LONG = 1.5  # steps between stamps: a longer one is a gap


def order_of(time: np.ndarray, clock: str | None, period: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Which samples stay, by index, and their times [s], after the repair that is asked for.

    ``spread``: stamps that stand several times are spread evenly until the next one; the first of them may have begun
    before the recording. ``first``, ``last``: of samples with the same stamp one stays. ``unwrap``: after a jump back
    a clock that begins anew after a ``period`` [s] is in the next one, a time of day in the afternoon, too; any other
    time goes on with its usual step. ``sort``:
    by time.
    """
    every = np.arange(len(time))
    if clock == "sort":
        order = np.argsort(time, kind="stable")
        return order, time[order]
    if clock in ("first", "last"):
        changes = np.flatnonzero(np.diff(time) != 0)
        kept = np.concatenate([[0], changes + 1]) if clock == "first" else np.concatenate([changes, [len(time) - 1]])
        return kept, time[kept]
    if clock == "spread":
        return every, _spread(time)
    if clock == "unwrap":
        return every, _unwrapped(time, period)
    return every, time


def _spread(time: np.ndarray) -> np.ndarray:
    begins = np.concatenate([[0], np.flatnonzero(np.diff(time) != 0) + 1])
    lengths = np.diff(np.concatenate([begins, [len(time)]]))
    stamps = time[begins].copy()
    steps = np.diff(stamps)
    if not len(steps):
        return time
    rates = steps / lengths[:-1]
    gaps = steps > LONG * np.quantile(steps, 0.25)  # nothing was recorded at their end
    whole = rates[1:][~gaps[1:]]  # the first may be cut
    usual = float(np.median(whole if len(whole) else rates[~gaps]))
    each = np.concatenate([np.where(gaps, np.fmin(rates, usual), rates), [usual]])
    if 0 < usual * lengths[0] < steps[0]:  # the recording began within this stamp: its samples lie at its end
        stamps[0] += steps[0] - usual * lengths[0]
        each[0] = usual
    within = np.arange(len(time)) - np.repeat(begins, lengths)
    return np.repeat(stamps, lengths) + within * np.repeat(each, lengths)


def _unwrapped(time: np.ndarray, period: float) -> np.ndarray:
    steps = np.diff(time)
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    later = np.full(len(steps), usual)
    if period:  # any other step back is no wrap and stays
        later = np.where(steps < -period / 2, steps + period, steps)
    if period == DAY:  # a clock of twelve hours
        later = np.where((later == steps) & (steps < -HALF_DAY + HOUR), steps + HALF_DAY, later)
    return time[0] + np.concatenate([[0.0], np.cumsum(np.where(steps < 0, later, steps))])
