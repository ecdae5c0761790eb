"""What the digits of recorded inputs leave in the outputs: the machine felt the force, the model its rounded value.

    e = y(u + d) - y(u),   d uniform within half a step

A command that is held was written once for each of its values: d is the same wherever the recorded value is. What moves
between its samples passes through a step, and leaves each sample a d of its own.
A few draws tell how large that is, which counts as noise, and what the parameters make of it, which counts in a sigma.
Source: B. Widrow & I. Kollar, Quantization Noise, 2008, ch. 5 (rounding as a uniform error).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hydrotwin.records.noise import recorded_step

from .descent import Task, whole_runs
from .least_squares import Minimum

DRAWS = 4
FEWEST_LEVELS = 8  # of an input that was rounded: a relay has two
SHOWS = 0.25  # of what rounding would leave: less is left where the input was not rounded
MATTERS = 0.1  # of the noise: less changes nothing


def moved_by_rounding(task: Task, found: Minimum, rows: Sequence) -> list[list[np.ndarray]]:
    """Per draw, weighted changes (m,) of what was measured in the recordings that have ``rows`` (None: it has none).

    Empty where no input was rounded to matter.
    """
    steps = [np.array([_step(column) for column in r.u.T]) for r in task.recordings]
    if not any(step.any() for step in steps):
        return []
    random, draws, plain = np.random.default_rng(0), [], _runs(task, found)
    for _ in range(DRAWS):
        pairs = zip(task.recordings, steps, strict=True)
        held = [s.held for s in task.flat.inputs]
        shaken = tuple(dataclasses.replace(r, u=r.u + _taken(r.u, step, held, random)) for r, step in pairs)
        runs = _runs(dataclasses.replace(task, recordings=shaken), found)
        if any(row is not None and (a is None or b is None) for row, a, b in zip(rows, plain, runs, strict=True)):
            return []  # a run that diverges is told elsewhere
        draws.append([b - a for row, a, b in zip(rows, plain, runs, strict=True) if row is not None])
    size = _size(np.concatenate([run for draw in draws for run in draw]))
    if not np.any(size > MATTERS * np.nan_to_num(task.noise * task.weights)):
        return []
    used = task.weights > 0
    return [[run[np.isfinite(run) & used] for run in draw] for draw in draws]


def noise_of_rounding(task: Task, rows: Sequence, draws: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """Root mean square (ny,), SI, of what neither parameters nor start states absorb of the changes; 0 without any."""
    known = [(row, r) for row, r in zip(rows, task.recordings, strict=True) if row is not None]
    left = np.full((0, len(task.noise)), np.nan)
    for draw in draws:
        for (row, recording), moved in zip(known, draw, strict=True):
            answer = np.full(recording.y.shape, np.nan)
            answer[np.isfinite(recording.y) & (task.weights > 0)] = moved - row[1] @ np.linalg.lstsq(row[1], moved)[0]
            left = np.concatenate([left, answer])
    return np.where(task.weights > 0, _size(left) / np.where(task.weights > 0, task.weights, 1.0), 0.0)


def may_be_rounded(task: Task, found: Minimum, rounded: np.ndarray) -> bool:
    """Whether what is left can hold what rounding would leave (ny,), SI: the levels of a command are no digits."""
    left = _size(np.concatenate([run for run in _runs(task, found) if run is not None]))
    return bool(np.all(left >= SHOWS * rounded * task.weights))


def _step(column: np.ndarray) -> float:
    """The step in which an input was recorded; 0: none, or so few levels that they are those of a command."""
    return recorded_step(column) if len(np.unique(column)) >= FEWEST_LEVELS else 0.0


def _size(values: np.ndarray) -> np.ndarray:
    """Root mean square of every column, nan left out; 0 for an empty one."""
    counts = np.isfinite(values).sum(axis=0)
    return np.sqrt(np.nansum(values**2, axis=0) / np.maximum(counts, 1))


def _runs(task: Task, found: Minimum) -> list[np.ndarray | None]:
    shooting, _ = whole_runs(task)
    return [shooting.residuals(i, found.q, found.z[i]) for i in range(len(task.recordings))]


def _taken(u: np.ndarray, step: np.ndarray, held: Sequence[bool], random: np.random.Generator) -> np.ndarray:
    """What rounding may have taken off inputs (n, nu)."""
    taken = np.zeros(u.shape)
    for j in np.flatnonzero(step):
        levels, which = np.unique(u[:, j], return_inverse=True) if held[j] else (u[:, j], slice(None))
        taken[:, j] = (step[j] * random.uniform(-0.5, 0.5, len(levels)))[which]
    return taken
