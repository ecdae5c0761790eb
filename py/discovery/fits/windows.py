"""Windows: a structure led from the start through short windows to longer ones, every start state free.

A free run from a wrong start leaves the recording, and an effect that is missing bends the base to its bounds; over a
fraction of a second neither happens. What a structure leaves there tells soon what it promises.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Sequence

import numpy as np

from hydrotwin.identification import horizon
from hydrotwin.identification.descent import Task, freely, undecided
from hydrotwin.identification.excitation import sigmas
from hydrotwin.identification.least_squares import Minimum
from hydrotwin.identification.noise import weights
from hydrotwin.identification.shooting import Segment, Shooting
from hydrotwin.models.language.errors import SolveError

from .first_steps import lowest
from .job import Job, Look, Question, apart, broad, not_below, point_of, task_of

STAGE = {"absolute": 0.5, "relative": 3e-3, "stalled": 10.0, "most": 12}  # of a minimisation over windows
TO_ITS_END = {**STAGE, "most": 100}  # of one along whose course others begin: short of a minimum all of them do much
TURNS = 2  # of weights and minimum at every length
MOST_TURNS = 10  # of one along whose course others begin: what its own next turn would bring, every one of them brings
CHANGED = np.log(1.5)  # of the sizes that are left, from which on another turn is worth it


def look(job: Job) -> Look | str:
    """Lead a structure through some lengths of windows; a sentence when it diverges there. Pure and picklable."""
    began = time.perf_counter()
    try:
        return dataclasses.replace(_led(job.beginning()), seconds=time.perf_counter() - began)
    except SolveError as error:
        return str(error)


def _led(job: Job) -> Look:
    q, (begin, end) = job.question, job.stages
    size = broad(q) if job.size is None else not_below(q.noise, job.size)
    names = [s.name for s in job.flat.states]
    task = task_of(job, job.starts[0], size, names, rough=True)
    points = [point_of(task.free, start) for start in job.starts]
    states = _begun(task, job, points[0])
    squares, counts, trail, courses = [], [], [], []
    rules, turns = (TO_ITS_END, MOST_TURNS) if job.tells_courses else (STAGE, TURNS)
    for seconds in q.lengths[begin:end]:
        shooting, z = _cut(undecided(task), points, seconds, states, q)
        if trail:
            z = _nearer(task, shooting, points[0], z, q.lengths[0])
        for _ in range(turns):
            found = lowest(shooting, points, z, rules, job.seconds, tries=False)
            points, z = [found.q], found.z
            left, count = _left(shooting, found)
            if not np.isfinite(left).all():
                break
            before, size = size, not_below(q.noise, np.sqrt(left / np.maximum(count, 1)))
            shooting = dataclasses.replace(shooting, weights=weights(size))
            if time.process_time() > job.seconds or not apart(size, before) > CHANGED:
                break
        task, known = dataclasses.replace(task, weights=shooting.weights), shooting.trajectories(found.q, z)
        states = [np.where(np.isfinite(new), new, old) for new, old in zip(known, states, strict=True)]
        courses.append(tuple(dict(zip(names, x.T.copy(), strict=True)) for x in states) if job.tells_courses else ())
        squares.append(left)
        counts.append(count)
        trail.append(dict(zip(task.free.names, task.free.values(found.q).tolist(), strict=True)))
    first = tuple(dict(zip(names, x[0].tolist(), strict=True)) for x in states)
    known_to = dict(zip(task.free.names, sigmas(found, task.free), strict=True))
    return Look(
        trail[-1], np.array(squares), np.array(counts), size, first, tuple(trail[:-1]), known_to,
        begin=begin, courses=tuple(courses) if job.tells_courses else (),
    )  # fmt: skip


def _nearer(task: Task, shooting: Shooting, q: np.ndarray, z: np.ndarray, seconds: float) -> np.ndarray:
    """Scaled start states from the shorter windows, or from a new run where these lead to less."""
    p = task.free.vector(q)
    guess = horizon.first_guess(task.flat, task.recordings, task.propagator, p, seconds)
    other = shooting.clip(horizon.window_starts(shooting.segments, guess, shooting.start))
    return min(z, other, key=lambda each: shooting.cost(q, each))


def _begun(task: Task, job: Job, q: np.ndarray) -> list[np.ndarray]:
    """State trajectories (n, nx) in which windows begin: along the course that the job knows, else as a run guesses."""
    p, seconds = task.free.vector(q), job.question.lengths[job.stages[0]]
    if job.course:
        return _along(job, p)
    return horizon.first_guess(task.flat, task.recordings, task.propagator, p, seconds)


def _along(job: Job, p: np.ndarray) -> list[np.ndarray]:
    """State trajectories (n, nx) along the course that a job knows; states that are not in it start in every window."""
    names, found = [state.name for state in job.flat.states], []
    for recording, known in zip(job.question.fit, job.course, strict=True):
        states = np.column_stack([known.get(name, np.zeros(len(recording.time))) for name in names])
        if further := [k for k, name in enumerate(names) if name not in known]:
            for place in horizon.cut([recording], job.question.lengths[0]):
                start = horizon.start_from_measured(job.flat, recording, p, place.first)
                states[place.first : place.last, further] = start[further]
        found.append(states)
    return found


def _cut(
    task: Task, points: Sequence[np.ndarray], seconds: float, states: Sequence[np.ndarray], question: Question
) -> tuple[Shooting, np.ndarray]:
    """Windows of ``seconds`` with all start states free, and their scaled start states from known trajectories.

    points : scaled parameters from which they are led. They begin where shorter ones began, so that these have found
    the states there, and do not overlap.
    """
    delay = max(horizon.longest_delay(task.flat, task.free.vector(q), seconds) for q in points)
    places = horizon.cut(task.recordings, question.lengths[0])
    segments: list[Segment] = []
    for place in places[:: int(np.ceil(len(places) / question.windows))]:
        time = task.recordings[place.recording].time
        end = int(np.searchsorted(time, time[place.first] + seconds - 1e-9))
        free = not segments or segments[-1].recording != place.recording or segments[-1].last <= place.first
        if free and time[-1] - time[place.first] > 0.5 * seconds:
            lead_in = int(np.searchsorted(time, time[place.first] - delay, side="right")) - 1
            segments.append(Segment(place.recording, max(lead_in, 0), place.first, min(end, len(time))))
    return freely(task, segments, states)


def _left(shooting: Shooting, found: Minimum) -> tuple[np.ndarray, np.ndarray]:
    """Sums of squares (ny,), SI, of all windows, and how many values they are worth beside the free start states."""
    squares = found.at.squares
    counts = shooting.counts.astype(float)
    with np.errstate(invalid="ignore"):
        total = np.where(np.isfinite(squares), squares, np.inf).sum(axis=0)
    spent = shooting.locals * len(shooting.segments)
    return np.where(counts > 0, total, 0.0), counts * max(1 - spent / max(counts.sum(), 1), 0.1)
