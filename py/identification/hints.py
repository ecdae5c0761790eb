"""Hints: what would explain what a fit leaves and is only said, for it is to be corrected in the recordings.

A sensor or an input with its sign turned, input samples that stand alone, an offset of a sensor, an input that comes
late. Each is tried by a fit: far from the truth one linear step promises anything.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import Signal

from .descent import Task, whole_runs
from .directions import Seen, loads_of, period_of, seen_from, with_inputs
from .least_squares import Minimum
from .outliers import spikes
from .problem import Recording
from .trials import FAR_MORE, MOST_OF_IT, NEAR, explains_most, fitted, fitted_anew
from .weighing import Weighed, score

LONGEST_SHARE = 0.1  # of a recording: a delay that is longer is none


def hint(task: Task, found: Minimum) -> str:
    """What is only said: an input that is not to be changed, or is a dead time late, or an offset of a sensor."""
    try:
        seen = seen_from(task, found, inputs=True)
    except SolveError:
        return ""
    return _turned(task, found) or _spiked(task, found) or _offset(task, found, seen) or _late(task, found, seen)


def _offset(task: Task, found: Minimum, seen: Seen) -> str:
    """A constant offset of a sensor."""
    first = len(task.flat.inputs) + len(loads_of(task))
    for j, signal in enumerate(task.flat.outputs):
        step = seen.step((first + j,)) if task.weights[j] > 0 else None
        if step is None or step.gain <= FAR_MORE * seen.excess:
            continue
        offset = -float(step.others[0]) * abs(signal.nominal)
        if _explained_by(task, found, tuple(_without_offset(r, j, offset) for r in task.recordings)):
            of = f"{offset:.3g} {signal.unit} of {signal.name}"
            return f"a constant offset of {of} would explain most of what is left. Look at its zero."
    return ""


def _late(task: Task, found: Minimum, seen: Seen) -> str:
    """An input that comes later or earlier than it was taken for."""
    for j, signal in enumerate(task.flat.inputs):
        step = seen.step((j,))
        samples, share = float(step.others[0]) / 2, min(step.gain / seen.excess, 1.0)
        if share > FAR_MORE and abs(samples) > NEAR and _explains_late(task, found, signal, samples):
            by = f"{abs(samples) * period_of(task):.2g} s {'later' if samples > 0 else 'earlier'}"
            return (
                f"input {signal.name} coming about {by} than it was taken for would explain {100 * share:.0f} % of "
                "what is left. Look at its clock, its interpolation, or for a dead time (dead_time in hydrotwin gap)."
            )
    return ""


def _explains_late(task: Task, found: Minimum, signal: Signal, samples: float) -> bool:
    """Whether an input that is so late explains most by a fit: a linear step in time is only good for a short one."""
    seconds = samples * period_of(task)
    if abs(seconds) > LONGEST_SHARE * max(np.ptp(r.time) for r in task.recordings):
        return False
    before = Weighed(task, found, score(task, found))
    later = with_inputs(task, {signal.name: {"interpolation": signal.interpolation, "shift": seconds}})
    try:
        return explains_most(before, fitted(later, found, np.isfinite(task.noise)), MOST_OF_IT)
    except SolveError:
        return False


def _turned(task: Task, found: Minimum) -> str:
    """A sensor or an input with its sign turned, where a fit with the sign as it should be explains most."""
    columns = [("y", j, s.name) for j, s in enumerate(task.flat.outputs) if task.weights[j] > 0 and _against(task, j)]
    if not columns:
        return ""
    columns += [("u", j, s.name) for j, s in enumerate(task.flat.inputs)]
    for kind, j, name in columns:
        turned = tuple(_with_sign_turned(r, kind, j) for r in task.recordings)
        if _explained_by(task, found, turned):
            return (
                f"{name} with its sign turned would explain most of what is left: it moves against the model. Correct "
                f"the sign in the file, or read it with --scale {name}=-1."
            )
    return ""


def _against(task: Task, j: int) -> bool:
    """Whether an output moves against the model, as that is from its start values, in every recording."""
    shooting, z = whole_runs(task)
    q, alike = task.free.scaled(task.free.start), []
    for i, recording in enumerate(task.recordings):
        r = shooting.residuals(i, q, z[i])
        known = np.isfinite(recording.y[:, j]) & (r is not None)
        if known.any() and np.ptp(recording.y[known, j]) > 0:
            measured, run = recording.y[known, j], recording.y[known, j] + r[known, j] / task.weights[j]
            alike.append(float(np.corrcoef(measured, run)[0, 1]) if np.ptp(run) > 0 else 0.0)
    return bool(alike) and max(alike) < 0


def _without_offset(recording: Recording, j: int, offset: float) -> Recording:
    y = recording.y.copy()
    y[:, j] -= offset
    return dataclasses.replace(recording, y=y)


def _with_sign_turned(recording: Recording, kind: str, j: int) -> Recording:
    values = getattr(recording, kind).copy()
    values[:, j] *= -1
    return dataclasses.replace(recording, **{kind: values})


def _explained_by(task: Task, found: Minimum, recordings: tuple[Recording, ...]) -> bool:
    """Whether a fit to other recordings explains most."""
    try:
        anew = fitted_anew(dataclasses.replace(task, recordings=recordings), np.isfinite(task.noise))
    except SolveError:
        return False
    return explains_most(Weighed(task, found, score(task, found)), anew, FAR_MORE)


def _spiked(task: Task, found: Minimum) -> str:
    """Samples of a measured input that stand alone, where a fit with their neighbours in their place explains most."""
    for j, signal in enumerate(task.flat.inputs):
        masks = [spikes(r.u[:, j]) & (not signal.held) for r in task.recordings]
        if not any(mask.any() for mask in masks):
            continue
        pairs = list(zip(task.recordings, masks, strict=True))
        if _explained_by(task, found, tuple(_mended(r, j, mask) for r, mask in pairs)):
            first, mask = next((r, mask) for r, mask in pairs if mask.any())
            return (
                f"{sum(int(m.sum()) for m in masks)} samples of input {signal.name} stand alone, far from their "
                f"neighbours (the first in {first.name}, {first.time[np.argmax(mask)]:.6g} s from its start): without "
                "them most of what is left would be explained. Correct them in the file."
            )
    return ""


def _mended(recording: Recording, j: int, mask: np.ndarray) -> Recording:
    u = recording.u.copy()
    u[mask, j] = np.interp(recording.time[mask], recording.time[~mask], u[~mask, j])
    return dataclasses.replace(recording, u=u)
