"""A recording at a longer sample time: fewer of its samples, none of them changed."""

from __future__ import annotations

import dataclasses
import math

import numpy as np

from .record import Record
from .resampling import new_time_axis
from .steps import holes_at, usual
from .unbroken import OWN_STEP

SAME_PERIOD = 1e-9  # relative: two sample times that are one


def sampled_so(record: Record, period: float) -> bool:
    """Whether a recording has this sample time [s] as it is."""
    return record.uniform and math.isclose(record.period, period, rel_tol=SAME_PERIOD)


def thinned(record: Record, period: float | None) -> Record:
    """The recording at about another sample time [s]: those of its samples that lie nearest to such times.

    Values on the line between samples would have less noise, and a held input values that nobody had set. A signal on
    a slower raster keeps those of its own samples that lie nearest, in rows where the others are then unknown: in the
    rows of the others it may have none at all. A hole stays one, by a row in it without values: among longer steps it
    may not show.
    """
    if period is None or sampled_so(record, period):
        return record
    times = new_time_axis(record.time, period, None, record.name)
    shared = _nearest(record.time, times)
    rows = {n: _own_rows(record.time, values, times) for n, values in record.signals.items()}
    rows = {n: shared if own is None else own for n, own in rows.items()}
    kept = np.unique(np.concatenate([shared, *rows.values()]))
    signals = {n: np.where(np.isin(kept, rows[n]), values[kept], np.nan) for n, values in record.signals.items()}
    return _with_holes(dataclasses.replace(record, time=record.time[kept], signals=signals), record)


def _with_holes(found: Record, record: Record) -> Record:
    """What was thinned out with a row of unknown values in every hole that does not show any more."""
    before, behind = (record.time[holes_at(record.time) + k] for k in (0, 1))
    at = np.searchsorted(found.time, before, side="right")
    hidden = ~np.isin(at - 1, holes_at(found.time))
    at, middle = at[hidden], (before + behind)[hidden] / 2
    signals = {n: np.insert(values, at, np.nan) for n, values in found.signals.items()}
    return dataclasses.replace(found, time=np.insert(found.time, at, middle), signals=signals)


def _own_rows(time: np.ndarray, values: np.ndarray, times: np.ndarray) -> np.ndarray | None:
    """Samples of a signal on a slower raster that lie nearest to ``times``; None of one in the rows of all others."""
    known = np.flatnonzero(np.isfinite(values))
    if len(known) in (0, len(values)):
        return None
    steps = usual(np.diff(time[known]))
    if not len(steps) or np.median(steps) <= OWN_STEP * np.median(np.diff(time)):
        return None
    return known[_nearest(time[known], times)]


def _nearest(time: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Samples of a time axis that lie nearest to ``times``, each once."""
    at = np.searchsorted(time, times).clip(1, len(time) - 1)
    at -= times - time[at - 1] <= time[at] - times  # of two as near the first
    return np.unique(at)
