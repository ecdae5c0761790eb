"""Whether a start makes most of an error: one that nobody measured, gave or estimated, or that one noisy sample tells.

To first order an error e of the first part of a run is that of a start which is off by dx where e = Z dx, Z = dy/dx0 of
the states that no sample tells, and of those that the first sample tells, by no more than its noise, or than it is off
the samples behind it. A run from there shows whether it is: where that leaves less than a third of the error, the
recording says more of where it began than of the model.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import lsq_linear
from scipy.stats import theilslopes

from hydrotwin.identification.descent import BEGINNING, FEWEST_SAMPLES
from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.records import NoiseFloor, Record
from hydrotwin.simulation import prepare
from hydrotwin.simulation.simulate import inputs_of, since_start, started

LEFT = 1 / 3  # of the error: a start elsewhere that leaves less matters; for a wrong model it seldom makes up so far
NOISES = 3.0  # of the sensor: what an error must be before anybody asks where it comes from
SIGMAS = 4.0  # of its noise, by which the first sample of a sensor may be off
TURNS = 3  # of a linear step: a start that is far off is not reached in one
HALF = 0.5  # of the squared error: a step that leaves more is the last
NEXT = 8  # samples behind it, whose line says where it should be: a bad reading is off by more than noise
FARTHER = 1.5  # times what it is off their line
FEW_LEFT = "less than a third of its error in the first part is left"
STEP = 1e-2  # of its nominal, by which a start state is moved for a derivative


def untold_start(
    contender, record: Record, predicted: Mapping[str, np.ndarray], noise: Mapping[str, NoiseFloor]
) -> str:
    """What is to be told of a start that no sample tells, of a free run as it was ``predicted``; "" where it does not
    matter, and of a model without equations.

    predicted : outputs (n,) at the times of the recording; noise : of its columns.
    """
    if not hasattr(contender, "untold_starts") or not hasattr(contender, "flat") or contender.flat.black_box:
        return ""
    names, count = contender.untold_starts(record), max(FEWEST_SAMPLES, int(BEGINNING * len(record)))
    sizes = {n: _size(record[n][:count] - y[:count], noise[n].white) for n, y in predicted.items() if n in noise}
    sizes = {n: size for n, size in sizes.items() if size}
    told = _told(contender, record, noise)
    if not (names or told) or not sizes or len(record) < FEWEST_SAMPLES:
        return ""
    part = record.window(end=record.time[count - 1])
    if names and _leaves_little(contender, part, dict.fromkeys(names, np.inf), sizes):
        return f"no sample tells where {', '.join(names)} began, and from another start {FEW_LEFT}"
    if told and _leaves_little(contender, part, dict.fromkeys(names, np.inf) | told, sizes):
        return (
            f"the first sample alone tells where {', '.join(told)} began, and from another start as near to it as its "
            f"sensor is sure {FEW_LEFT}"
        )
    return ""


def _told(contender, record: Record, noise: Mapping[str, NoiseFloor]) -> dict[str, float]:
    """States whose start is the first sample of a sensor, and by how much that may be off, SI."""
    given = {*contender.untold_starts(record), *(contender.start_of(record) or {})}
    by = {s.name: s.measured_by for s in contender.flat.states if s.measured_by in record.signals}
    off = {n: max(SIGMAS * noise[y].sigma, _beside(record, y)) for n, y in by.items() if n not in given and y in noise}
    return {n: most for n, most in off.items() if most > 0}


def _beside(record: Record, name: str) -> float:
    """How far a first sample may be off, as the line through the next ones says, which one of them does not bend."""
    time, values = record.time[: NEXT + 1], record[name][: NEXT + 1]
    known = np.flatnonzero(np.isfinite(values[1:])) + 1
    if not np.isfinite(values[0]) or len(known) < NEXT:
        return 0.0
    _, level, *_ = theilslopes(values[known], time[known] - time[0])
    return FARTHER * abs(float(values[0] - level))


def _leaves_little(contender, part: Record, off: Mapping[str, float], sizes: Mapping[str, float]) -> bool:
    try:
        return _left(contender, part, off, sizes) < LEFT
    except HydrotwinError:  # from there it does not run
        return False


def _size(miss: np.ndarray, noise: float) -> float:
    """The rms of an error; 0 where it is no more than noise."""
    known = miss[np.isfinite(miss)]
    rms = float(np.sqrt(np.mean(known**2))) if len(known) else 0.0
    return rms if rms > NOISES * noise else 0.0


def _left(contender, part: Record, off: Mapping[str, float], sizes: Mapping[str, float]) -> float:
    """The share of the error, in ``sizes`` of its outputs, that the best start leaves; ``off``: by state, how far."""
    flat, p = contender.flat, contender.flat.parameter_vector()
    at = [k for k, s in enumerate(flat.states) if s.name in off]
    columns = {s.name: k for k, s in enumerate(flat.outputs) if s.name in sizes}
    u, propagator = inputs_of(flat, part), prepare(flat, **contender.how)
    x0 = started(flat, part, u, p, contender.start_of(part))

    def misses(x: np.ndarray) -> np.ndarray:
        y = propagator.run(since_start(part), u, p, x)[0]
        return np.concatenate([(part[n] - y[:, k]) / sizes[n] for n, k in columns.items()])

    began = now = misses(x0)
    known, x = np.isfinite(now), x0
    steps = [np.eye(len(x0))[k] * STEP * flat.states[k].nominal for k in at]
    most = np.array([off[flat.states[k].name] / (STEP * flat.states[k].nominal) for k in at])
    total = np.zeros(len(at))
    for _ in range(TURNS):
        slopes = np.column_stack([now - misses(x + step) for step in steps])
        if not np.isfinite(slopes[known]).all():
            return np.inf
        moved = lsq_linear(slopes[known], now[known], bounds=(-most - total, most - total)).x
        total = total + moved
        x = x0 + sum(m * step for m, step in zip(total, steps, strict=True))
        before, now = now, misses(x)
        left = float(np.sqrt(np.mean(now[known] ** 2) / np.mean(began[known] ** 2)))
        if left < LEFT or not np.mean(now[known] ** 2) < HALF * np.mean(before[known] ** 2):
            break
    return left
