"""Whole recordings: a structure fitted to free runs from where its windows ended.

Every output is weighed by what the structure leaves of it, never by less than the sensor's noise, in turns:

    min over p, x0, s   L = sum_j n_j (ln s_j + RMSE_j^2 / (2 s_j^2)),   s_j >= noise_j

so that structures which reach the noise and structures which do not are compared on one scale.
Source: Y. Bard, Nonlinear Parameter Estimation, 1974, ch. IV (unknown covariance).
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.identification.answer import answer
from hydrotwin.identification.descent import Task, held_out_run, undecided, whole_runs
from hydrotwin.identification.excitation import sigmas
from hydrotwin.identification.least_squares import Minimum, minimise
from hydrotwin.identification.noise import weights
from hydrotwin.identification.shooting import Shooting
from hydrotwin.models.language.errors import SolveError
from hydrotwin.simulation import prepare

from ..evidence.score import spectrum
from .first_steps import lowest
from .job import Fitted, Job, Look, apart, broad, moving_starts, not_below, point_of, task_of
from .windows import look

FEW = 8  # iterations of a look at whole recordings
ROUGHLY = {"absolute": 2.0, "relative": 0.02, "stalled": 10.0}  # of such a look: candidates must be told apart
ROUNDS = 5  # of weights and minimum
LONGEST = 30  # iterations in all rounds together
FAR = 3.0  # times the noise that a structure leaves of an output: precise runs tell it from none that leaves less
STEADY = 0.02  # relative change of the sizes that ends the rounds
TOLERANCE = {"absolute": 0.02, "relative": 1e-5, "stalled": 1.0}
FIRST = {"absolute": 0.5, "relative": 2e-3, "stalled": 5.0}  # while the weights are about to change


def step(job: Job) -> Look | Fitted | str:
    """The next step of a structure: longer windows, or whole recordings. Pure and picklable."""
    if job.stages is None:
        return fit(job)
    return glance(job) if job.stages == (0, 0) else look(job)


def fit(job: Job) -> Fitted | str:
    """Fit a structure to whole recordings; a sentence when it diverges. Pure and picklable."""
    began = time.perf_counter()
    try:
        task, found, left = _fitted(job.beginning())
    except SolveError as error:
        return str(error)
    return dataclasses.replace(concluded(task, found, left), seconds=time.perf_counter() - began)


def led(job: Job) -> Fitted | str:
    """Fit a structure to whole recordings from its start through all windows. Pure and picklable."""
    found = look(dataclasses.replace(job, stages=(0, len(job.question.lengths))))
    if isinstance(found, str):
        return found
    starts = (found.values, *found.trail[::-1], *job.starts)
    return fit(dataclasses.replace(job, starts=starts, states=found.states, size=found.size))


def glance(job: Job) -> Look | str:
    """A few steps over whole recordings, of what cannot begin in their middle; a sentence when it diverges.

    Pure and picklable.
    """
    began, few = time.perf_counter(), min(FEW, job.iterations)
    try:
        task, found = first(dataclasses.replace(job.beginning(), iterations=few), ROUGHLY, rough=True)
        runs = residuals_of(task, found)
    except SolveError as error:
        return str(error)
    return dataclasses.replace(as_look(concluded(task, found, runs)), seconds=time.perf_counter() - began)


def as_look(fitted: Fitted) -> Look:
    """A fit to whole recordings as a look at them."""
    left = fitted.left
    squares, counts = left.squares.sum(axis=0)[None], left.counts.sum(axis=0)[None]
    more = {"left": left, "sigmas": fitted.sigmas, "seconds": fitted.seconds}
    return Look(fitted.values, squares, counts, left.rmse, fitted.states, **more)


def _fitted(job: Job) -> tuple[Task, Minimum, list[np.ndarray]]:
    task, found = first(job, rough=True)
    return precisely(job, task, found)


def precisely(job: Job, task: Task, found: Minimum) -> tuple[Task, Minimum, list[np.ndarray]]:
    """Weights and minimum in turns from where rough runs led: in rough runs, then in precise ones.

    A derivative across a kink is as good as the time at which the run meets it, and precise runs search for that
    time: they are many times as dear. One that ran out of its seconds stays where rough runs led it, and one that
    leaves far more than noise: what is missing there is no error of runs.
    """
    task, found, left = settled(task, found, job.iterations, job.seconds)
    size = _size(task, left)
    if time.process_time() > job.seconds or np.nanmax(size / task.noise) > FAR:
        return task, found, left
    precise = task_of(job, job.starts[0], size, moving_starts(job))
    return settled(precise, found, job.iterations, job.seconds)


def first(job: Job, rules: Mapping[str, float] = FIRST, rough: bool = False) -> tuple[Task, Minimum]:
    """The task and its first minimum, from the start whose first steps lead lowest."""
    q = job.question
    size = broad(q) if job.size is None else not_below(q.noise, job.size)
    task = dataclasses.replace(task_of(job, job.starts[0], size, moving_starts(job), rough), until=job.seconds)
    runs, z = whole_runs(task)
    points, z = [point_of(task.free, start) for start in job.starts], given(runs, z, job.states)
    return task, lowest(runs, points, z, {**rules, "most": job.iterations}, job.seconds, job.tries)


def settled(task: Task, found: Minimum, most: int, until: float = np.inf) -> tuple[Task, Minimum, list[np.ndarray]]:
    """Weights and minimum in turns until they agree: the task, its minimum, and the residuals there."""
    left, further = residuals_of(undecided(task), found), LONGEST
    size = _size(task, left)
    for number in range(ROUNDS):
        task = dataclasses.replace(undecided(task), weights=weights(size))
        rules = TOLERANCE if number else FIRST
        found = minimise(whole_runs(task)[0], found.q, found.z, **rules, most=max(1, min(most, further)), until=until)
        further -= found.iterations
        left = residuals_of(task, found)
        before, size = size, _size(task, left)
        agreed = number and apart(size, before) < STEADY
        if agreed or further <= 0 or time.process_time() > until:
            break
    return task, found, left


def _size(task: Task, left: Sequence[np.ndarray]) -> np.ndarray:
    """Size (ny,), SI, of the errors left, never below the noise. Raises SolveError where a run diverges."""
    rmse = spectrum(left).rmse
    if np.isinf(rmse[task.weights > 0]).any():
        raise SolveError(f"{task.flat.name}: a run diverges where the fit ended. Start it elsewhere.")
    return not_below(task.noise, rmse)


def residuals_of(task: Task, found: Minimum) -> list[np.ndarray]:
    """Residuals (n, ny), SI, of free runs, infinite where one diverges."""
    return _runs(task, whole_runs(task)[0], found.q, found.z)


def _elsewhere(task: Task, q: np.ndarray, recordings: Sequence) -> tuple[np.ndarray, ...]:
    """The same of recordings that take no part, with starts estimated, at scaled parameters."""
    runs, task = [], undecided(task)
    for recording in recordings:
        shooting, z = held_out_run(task, q, recording)
        runs += _runs(task, shooting, q, z)
    return tuple(runs)


def _runs(task: Task, shooting: Shooting, q: np.ndarray, z: np.ndarray) -> list[np.ndarray]:
    unit = np.where(task.weights > 0, task.weights, np.nan)
    runs = [shooting.residuals(i, q, z[i]) for i in range(len(shooting.recordings))]
    seen = [np.isfinite(recording.y) for recording in shooting.recordings]
    return [np.where(s, np.inf, np.nan) if r is None else r / unit for r, s in zip(runs, seen, strict=True)]


def given(shooting: Shooting, z: np.ndarray, states: Sequence[Mapping[str, float]]) -> np.ndarray:
    """Scaled start states z with those put in that are known by name, one mapping per recording."""
    z = z.copy()
    for i, known in enumerate(states):
        for j, (name, nominal) in enumerate(zip(shooting.start.names, shooting.start.nominal, strict=True)):
            if np.isfinite(known.get(name, np.nan)):
                z[i, j] = known[name] / nominal
    return shooting.clip(z)


def concluded(task: Task, found: Minimum, left: Sequence[np.ndarray]) -> Fitted:
    """The answer of a fit that ended so; left: residuals (n, ny), SI."""
    free, start = task.free, whole_runs(task)[0].start
    values = free.values(found.q)
    near = 1e-6 * np.minimum(np.abs(free.upper - free.lower), np.abs(free.unit))
    bound = (values <= free.lower + near) | (values >= free.upper - near)
    return Fitted(
        values=dict(zip(free.names, values.tolist(), strict=True)),
        states=tuple(dict(zip(start.names, (z * start.nominal).tolist(), strict=True)) for z in found.z),
        left=spectrum(left),
        at_bound=tuple(n for n, at in zip(free.names, bound, strict=True) if at),
        converged=found.converged,
        iterations=found.iterations,
        sigmas=dict(zip(free.names, sigmas(found, free), strict=True)),
    )


@dataclass(frozen=True, eq=False)
class Concluded:
    """A structure fitted for good: the `Fit` with intervals, residuals (n, ny), SI, fitted to and of what judges."""

    fit: object
    fitted: Fitted
    residuals_fit: tuple[np.ndarray, ...]
    residuals_report: tuple[np.ndarray, ...]


def conclude(job: Job) -> Concluded | str:
    """The `Fit` of a structure where it stands, and what it leaves of what judges, which takes no part.

    It is fitted on only where it has not come to rest. No bit of what is fitted depends on what judges: not even the
    compiled equations know of it. A sentence when it diverges. Pure and picklable.
    """
    try:
        return _conclude(job.beginning())
    except SolveError as error:
        return str(error)


def _conclude(job: Job) -> Concluded:
    began, q = time.perf_counter(), job.question
    alone = dataclasses.replace(job, question=dataclasses.replace(q, select=()))
    task = task_of(alone, job.starts[0], not_below(q.noise, job.size), moving_starts(alone))
    shooting, z = whole_runs(task)
    start = task.free.scaled(task.free.start)
    found = minimise(
        shooting, start, given(shooting, z, job.states), **TOLERANCE, most=job.iterations, until=job.seconds
    )
    left = residuals_of(task, found)
    settings = {"weights": "residual", "initial_states": q.initial_states, "step": q.step}
    one = answer(task, [found], (), settings, began)
    judged = _elsewhere(_judging(task, job), found.q, q.select) if q.select else ()
    return Concluded(one, concluded(task, found, left), tuple(left), judged)


def judged(job: Job) -> tuple[np.ndarray, ...] | str:
    """What a structure leaves of what judges (n, ny), SI, where its fit ended; a sentence when it diverges.

    Pure and picklable.
    """
    try:
        task = task_of(job, job.starts[0], not_below(job.question.noise, job.size), moving_starts(job), rough=True)
        return _elsewhere(task, task.free.scaled(task.free.start), job.question.select)
    except SolveError as error:
        return str(error)


def _judging(task: Task, job: Job) -> Task:
    """The task of runs through the recordings that judge, whichever start states those measure."""
    states = moving_starts(job)
    if states == list(task.propagator.free_states):
        return task
    propagator = prepare(job.flat, free_parameters=task.free.names, free_states=states, step=job.question.step)
    return dataclasses.replace(task, propagator=propagator)


def trajectories(flat, question, fitted: Fitted) -> list[np.ndarray]:
    """State trajectories (n, nx), SI, of every recording along a fit. Raises SolveError where a run diverges."""
    propagator, p = prepare(flat, step=question.step), flat.parameter_vector(dict(fitted.values))
    found = []
    for recording, states in zip(question.fit, fitted.states, strict=True):
        names = tuple(s.name for s in flat.states if s.name in states)
        x0 = flat.start_given(names)(recording.u[0], p, [states[n] for n in names]).full().ravel()
        found.append(propagator.run(recording.time, recording.u, p, x0)[1])
    return found
