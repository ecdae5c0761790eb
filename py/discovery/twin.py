"""Twin: what the softened signs of a named effect leave by themselves, so that no second effect is invented for it.

A smoothed sign creeps where the machine sticks, and bristles give a little. The structure is run once with signs as
good as exact, on an adaptive L-stable method, and the soft structure is fitted to that run: its RMSE is a floor that a
further effect must beat,

    s_j^2 <- s_j^2 + floor_j^2.

Source: D. Karnopp, Computer simulation of stick-slip friction, 1985 (what the exact form does at rest).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.identification.problem import Recording
from hydrotwin.models.effects import Candidate
from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.simulation import prepare

from .refit import Question, RefitJob, Refitted, refit

# Last word of a path -> the value at which its sign is as good as exact, SI; the lag only of what gives.
EXACT = {"smoothing_velocity": 1e-6, "give": 1e-8, "resolution": 1e-5}
MATTERS = 0.1  # of the noise: a smaller floor changes nothing


@dataclass(frozen=True, eq=False)
class TwinJob:
    """A fitted structure and the parameters that smooth its signs."""

    flat: FlatModel
    free: tuple[str, ...]
    question: Question
    fitted: Refitted
    smoothing: tuple[str, ...]
    label: str = ""
    threads: int = 1


def smoothed_signs(flat: FlatModel, members: Sequence[Candidate]) -> tuple[str, ...]:
    """Paths of the parameters that smooth a sign in the effects that were added."""
    own = {c.name for c in members if c.name}
    words: dict[str, list[str]] = {part: [] for part in own}
    for p in flat.parameters:
        part, _, word = p.name.rpartition(".")
        if part in own and word in EXACT:
            words[part].append(word)
    return tuple(f"{part}.{w}" for part, found in words.items() for w in found if w != "resolution" or "give" in found)


def floor_of(job: TwinJob) -> np.ndarray | str:
    """RMSE (ny,), SI, that the smooth structure leaves of its own run with exact signs; a sentence when it fails."""
    try:
        twins = tuple(_twin(job, i) for i in range(len(job.question.fit)))
    except SolveError as error:
        return str(error)
    q = dataclasses.replace(job.question, fit=twins, select=())
    start, states = (job.fitted.values,), job.fitted.states
    found = refit(RefitJob(job.flat, job.free, q, start, states, q.noise, label=job.label, threads=job.threads))
    return found if isinstance(found, str) else found.rmse


def _twin(job: TwinJob, index: int) -> Recording:
    """A recording with its measurements replaced by the run with exact signs."""
    flat, recording, states = job.flat, job.question.fit[index], job.fitted.states[index]
    exact = {name: EXACT[name.rpartition(".")[2]] for name in job.smoothing}
    p = flat.parameter_vector({**job.fitted.values, **exact})
    names = tuple(s.name for s in flat.states if s.name in states)
    x0 = flat.start_given(names)(recording.u[0], p, [states[n] for n in names]).full().ravel()
    y, _ = prepare(flat, method="rosenbrock").run(recording.time, recording.u, p, x0)
    return dataclasses.replace(recording, y=np.where(np.isfinite(recording.y), y, np.nan))


def with_floor(noise: np.ndarray, floor: np.ndarray) -> np.ndarray:
    """Noise (ny,) with the floor as part of it; the same where it does not matter."""
    floor = np.where(np.isfinite(floor), floor, 0.0)
    return np.where(floor > MATTERS * noise, np.hypot(noise, floor), noise)
