"""Refit: one structure fitted to the recordings from given starts, and what it leaves there and elsewhere.

Every output is weighed by what the structure leaves of it, never by less than the sensor's noise, in turns:

    min over p, x0, s   L = sum_j n_j (ln s_j + RMSE_j^2 / (2 s_j^2)),   s_j >= noise_j

so that structures which reach the noise and structures which do not are compared on one scale.
Source: Y. Bard, Nonlinear Parameter Estimation, 1974, ch. IV (unknown covariance).
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.identification.answer import answer
from hydrotwin.identification.descent import Task, descend, held_out_run, through_windows, undecided, whole_runs
from hydrotwin.identification.horizon import horizons, measured_start
from hydrotwin.identification.least_squares import Minimum, minimise
from hydrotwin.identification.loss import Loss
from hydrotwin.identification.noise import weights
from hydrotwin.identification.problem import FreeParameters, Recording, free_parameters
from hydrotwin.identification.shooting import Prior
from hydrotwin.identification.valley import along_the_valleys
from hydrotwin.identification.weighing import broadly_weighed
from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.simulation import prepare

from .starts import by_cost, given, inside

ROUNDS = 5
LONGEST = 30  # iterations in all rounds together: a cost with kinks can take every one of them and gain nothing
FAR = 2.0  # times the noise: beyond it what may be left weighs a first fit, too
FEWEST = 3  # iterations of the slowest structures
LEADING = 2  # lengths of windows that tell which of several starts lead elsewhere
IMPLICIT = 10  # times an explicit run: an implicit one
LAST_WORD = 40  # iterations of a fit that is reported
KNOWN_TO = np.log(2.0)
STEADY = 0.02  # relative change of the sizes that ends the rounds
TOLERANCE = {"absolute": 0.02, "relative": 1e-5, "stalled": 1.0}
FIRST = {"absolute": 0.5, "relative": 2e-3, "stalled": 5.0}  # while the weights are about to change


@dataclass(frozen=True, eq=False)
class Question:
    """What is the same for every structure: the recordings, the noise (ny,) SI, what is estimated of the starts.

    usual : base parameters by path at the values that the model came with, from which they do not go far unasked.
    inexact : what is named so far stands for the machine's own law but roughly, and the noise holds what it leaves.
    """

    fit: tuple[Recording, ...]
    select: tuple[Recording, ...]
    noise: np.ndarray
    initial_states: str = "auto"
    step: float | None = None
    usual: Mapping[str, float] = field(default_factory=dict)
    inexact: bool = False

    @property
    def held_out(self) -> bool:
        """Whether those that select are others than those that are fitted to."""
        return not {r.name for r in self.select} <= {r.name for r in self.fit}

    @property
    def counts(self) -> np.ndarray:
        """Measured values of every output in the fit recordings, (ny,)."""
        return np.sum([np.isfinite(r.y).sum(axis=0) for r in self.fit], axis=0)


@dataclass(frozen=True, eq=False)
class RefitJob:
    """One structure to fit.

    starts : parameter values by path, the first for the rest; the best few by cost are followed, equal ones once.
    states : start states by name per fit recording, where known.
    size : (ny,) what a residual may cost at first, SI; None: a few percent of the spread of each output.
    coarse : lead the first start through short windows first; ``led``: where the first of them have led it.
    valley : look along the valleys of the minimum for a lower one, residuals averaged over so many periods; unless it
        is stiff there.
    threads : over recordings and windows; the answer does not depend on it.
    held : of ``free``, those that stay at the first start until the others have come to rest beside them.
    """

    flat: FlatModel
    free: tuple[str, ...]
    question: Question
    starts: tuple[Mapping[str, float], ...] = ({},)
    states: tuple[Mapping[str, float], ...] = ()
    size: np.ndarray | None = None
    coarse: bool = False
    follow: int = 1
    iterations: int = 15
    label: str = ""
    valley: float | None = None
    threads: int = 1
    led: Led | None = None
    held: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Led:
    """Where the first windows of a coarse refit ended: scaled parameters q, state trajectories (n, nx) by recording."""

    q: np.ndarray
    states: tuple[np.ndarray, ...] | None


@dataclass(frozen=True, eq=False)
class Refitted:
    """A fitted structure.

    values : free parameters by path; states : start states by name per fit recording; size (ny,) as in L.
    residuals_fit, residuals_select : (n, ny) per recording, simulated minus measured, SI, nan where not measured.
    likelihood : L, with its constant chosen so that a structure that leaves s_j = noise_j everywhere has n/2, and what
        unusual base parameters cost.
    """

    values: Mapping[str, float]
    states: tuple[Mapping[str, float], ...]
    size: np.ndarray
    residuals_fit: tuple[np.ndarray, ...]
    residuals_select: tuple[np.ndarray, ...]
    likelihood: float
    parameters: int
    at_bound: tuple[str, ...]
    converged: bool
    iterations: int
    seconds: float = 0.0

    @property
    def rmse(self) -> np.ndarray:
        """RMSE over the fit recordings, (ny,), SI."""
        return pooled_rmse(self.residuals_fit)


def pooled_rmse(residuals: Sequence[np.ndarray]) -> np.ndarray:
    """Root mean square of every column over recordings: nan where nothing was measured, inf where one diverged."""
    stacked = np.concatenate(residuals)
    seen = ~np.isnan(stacked)
    counts = np.where(seen.any(axis=0), seen.sum(axis=0), np.nan)
    return np.sqrt(np.square(np.where(seen, stacked, 0.0)).sum(axis=0) / counts)


def refit(job: RefitJob) -> Refitted | str:
    """Fit a structure; a sentence when every start diverges. Pure and picklable: it runs on any executor."""
    began = time.perf_counter()
    try:
        return dataclasses.replace(_refit(job), seconds=time.perf_counter() - began)
    except SolveError as error:
        return str(error)


def lead(job: RefitJob) -> Led | str:
    """The first windows of a coarse refit; a sentence when the model diverges there. Pure and picklable."""
    try:
        task, lengths = _coarse(job)
        q, states = through_windows(task, task.free.scaled(task.free.start), lengths[:LEADING], thorough=False)
        return Led(q, states and tuple(states))
    except SolveError as error:
        return str(error)


def _refit(job: RefitJob) -> Refitted:
    job = _beside_the_held(job) if job.held else job
    q, iterations = job.question, job.iterations
    if job.coarse:
        task, lengths = _coarse(job)
        led = job.led or Led(task.free.scaled(task.free.start), None)
        lengths = lengths[LEADING:] if job.led else lengths
        found = descend(task, led.q, lengths, job.iterations, 1e-3, thorough=False, states=led.states)
    else:
        task = weighed(job, q.noise)
        found, iterations = _from_starts(task, job)
    best = _settled(task, q, found, iterations)
    if job.valley and best[0].propagator.method != "rosenbrock":  # a look costs a hundred runs, of a stiff one minutes
        lower = along_the_valleys(best[0], best[1], rounds=1, averaged=[job.valley])[0][0]
        best = min(best, _settled(best[0], q, lower, iterations), key=lambda answer: answer[-1])
    return _answer(q, *best)


def _beside_the_held(job: RefitJob) -> RefitJob:
    """The job from where the others come to rest while the held ones stay."""
    (start, *_), free = job.starts, tuple(n for n in job.free if n not in job.held)
    others = _refit(dataclasses.replace(job, free=free, held=()))
    starts = ({**start, **others.values},)
    return dataclasses.replace(job, held=(), coarse=False, starts=starts, states=others.states, size=others.size)


def _coarse(job: RefitJob) -> tuple[Task, list[float]]:
    """The task of a descent through windows and how long [s] they are."""
    noise = job.question.noise
    task = weighed(job, noise if job.size is None else np.fmax(job.size, noise))
    lengths = horizons(task.flat, task.recordings, task.free.vector(task.free.scaled(task.free.start)))
    return broadly_weighed(task, np.isfinite(noise)) if job.size is None else task, lengths


def weighed(job: RefitJob, size: np.ndarray) -> Task:
    """The task of a refit from its first start, where a residual (ny,) of ``size`` SI costs as much as noise does."""
    flat, q = job.flat, job.question
    free = free_parameters(flat, job.free, inside(flat, job.starts[0]))
    propagator = prepare(flat, free_parameters=free.names, free_states=_starting(job), step=q.step)
    return Task(
        flat, free, propagator, q.fit, weights(size), Loss("linear", 1.0), q.initial_states, job.threads, _silent,
        q.noise, prior=_prior(free, q),
    )  # fmt: skip


def _starting(job: RefitJob) -> list[str]:
    """States whose starts a fit may move: in windows all, in whole runs those that are measured unless told."""
    states, q = job.flat.states, job.question
    if job.coarse or q.initial_states == "free" or job.flat.black_box:
        return [s.name for s in states]
    return sorted(set().union(*(measured_start(job.flat, r) for r in (*q.fit, *q.select))))


def _judging(task: Task, job: RefitJob) -> Task:
    """The task of runs through the recordings of ``job`` that select, whichever start states those measure."""
    states, q = _starting(job), job.question
    if not q.select or states == list(task.propagator.free_states):
        return task
    propagator = prepare(job.flat, free_parameters=task.free.names, free_states=states, step=q.step)
    return dataclasses.replace(task, propagator=propagator)


def _prior(free: FreeParameters, q: Question) -> Prior:
    """Positive base parameters are known to within a factor of two (one sigma); nothing is known of the others.

    A mode that the recordings barely show makes many minima; the lowest of them may lie far from the machine, follow
    the noise and miss every other recording. So weak a knowledge decides between those that are almost equal.
    """
    known = np.array([n in q.usual and positive for n, positive in zip(free.names, free.logarithmic, strict=True)])
    usual = np.array([q.usual[n] if k else 1.0 for n, k in zip(free.names, known, strict=True)])
    return Prior(np.log(usual), known / KNOWN_TO**2)


def _silent(stage: str, number: int, cost: float) -> None:
    """A refit reports when it is done."""


def _from_starts(task: Task, job: RefitJob) -> tuple[Minimum, int]:
    """The likeliest of the minima from the most promising starts, and how many iterations each turn may take.

    A structure that makes the equations stiff costs ten or a hundred times the base; it gets fewer of them.
    """
    task, points = by_cost(task, job.starts, job.states, job.question.usual)
    slower = task.flat.step / task.propagator.step * (IMPLICIT if task.propagator.method == "rosenbrock" else 1)
    most = max(FEWEST, min(job.iterations, int(2 * job.iterations / max(slower, 1.0))))
    shooting, z = whole_runs(task)
    z = given(shooting, z, job.states)
    found, stopped = [], None
    for q in points[: job.follow]:
        try:
            found.append(_first(task, job, q, z, most))
        except SolveError as error:
            stopped = error
    if not found:
        raise stopped
    return min(found, key=lambda f: _likelihood(task, job.question, f)), most


def _first(task: Task, job: RefitJob, q: np.ndarray, z: np.ndarray, most: int) -> Minimum:
    """A first minimum from one start: weighed by what may be left, or by the noise, whichever the likelihood prefers.

    Far from the noise its weights sacrifice every output to the best sensor; near it they see all that there is to see.
    """
    noise, found, tasks = job.question.noise, [], [task]
    if job.size is not None and np.nanmax(job.size / noise) > FAR:
        tasks.append(dataclasses.replace(task, weights=weights(np.fmax(job.size, noise))))
    for one in tasks:
        found.append(minimise(whole_runs(one)[0], q, z, **FIRST, most=most))
    return min(found, key=lambda f: _likelihood(task, job.question, f)) if len(found) > 1 else found[0]


def _settled(task: Task, q: Question, found: Minimum, most: int):
    """Weights and minimum in turns until they agree: ``(task, minimum, its residuals, likelihood)``."""
    size, further = _size(undecided(task), q, found), max(LONGEST, 2 * most)
    for number in range(ROUNDS):
        task = dataclasses.replace(undecided(task), weights=weights(size))
        shooting, _ = whole_runs(task)
        found = minimise(shooting, found.q, found.z, **(TOLERANCE if number else FIRST), most=min(most, further))
        further -= found.iterations
        before, size = size, _size(task, q, found)
        if further <= 0 or (number and np.nanmax(np.abs(np.log(size / before))) < STEADY):
            break
    return task, found, residuals_of(task, found), _likelihood(task, q, found)


def _size(task: Task, q: Question, found: Minimum) -> np.ndarray:
    """Size (ny,) of the errors that a minimum leaves, SI. Raises SolveError where a run diverges: it weighs nothing."""
    size = np.fmax(_rmse(task, found), q.noise)
    if np.isinf(size[task.weights > 0]).any():
        raise SolveError(f"{task.flat.name}: a run diverges where the fit ended. Start it elsewhere.")
    return size


def residuals_of(task: Task, found: Minimum, recordings: Sequence[Recording] | None = None) -> list[np.ndarray]:
    """Residuals (n, ny), SI, of free runs, infinite where one diverges.

    On other recordings than those of the fit the start states are estimated.
    """
    if recordings is None:
        return _runs(task, whole_runs(task)[0], found.q, found.z)
    runs = []
    task = undecided(task)
    for recording in recordings:
        shooting, z = held_out_run(task, found.q, recording)
        runs += _runs(task, shooting, found.q, z)
    return runs


def _runs(task: Task, shooting, q: np.ndarray, z: np.ndarray) -> list[np.ndarray]:
    unit = np.where(task.weights > 0, task.weights, np.nan)
    runs = [shooting.residuals(i, q, z[i]) for i in range(len(shooting.recordings))]
    shapes = [recording.y.shape for recording in shooting.recordings]
    return [np.full(s, np.inf) if r is None else r / unit for r, s in zip(runs, shapes, strict=True)]


def _rmse(task: Task, found: Minimum) -> np.ndarray:
    """RMSE (ny,) over the fit recordings, SI, from what the minimum summed there where it did; nan: not measured."""
    squares = found.at.squares
    if squares is None or not np.isfinite(squares).all():  # a run may have been given up that is finite
        return pooled_rmse(residuals_of(task, found))
    counts = np.sum([np.isfinite(r.y).sum(axis=0) for r in task.recordings], axis=0)
    with np.errstate(invalid="ignore"):
        rmse = np.sqrt(squares.sum(axis=0) / counts)
    return np.where((task.weights > 0) & (counts > 0), rmse, np.nan)


def _likelihood(task: Task, q: Question, found: Minimum) -> float:
    return likelihood(_rmse(task, found), q) + task.prior.cost(found.q)


def likelihood(rmse: np.ndarray, q: Question) -> float:
    """L of an RMSE per output, (ny,)."""
    return float(likelihood_by_output(rmse, q).sum())


def likelihood_by_output(rmse: np.ndarray, q: Question) -> np.ndarray:
    """The terms of L, (ny,), 0 where nothing was measured."""
    size = np.fmax(rmse, q.noise)
    used = np.isfinite(q.noise) & (q.counts > 0)
    with np.errstate(invalid="ignore"):
        return np.where(used, q.counts * (np.log(size / q.noise) + 0.5 * (rmse / size) ** 2), 0.0)


def _answer(q: Question, task: Task, found: Minimum, left: Sequence[np.ndarray], value: float) -> Refitted:
    free, shooting = task.free, whole_runs(task)[0]
    values = free.values(found.q)
    names = shooting.start.names
    near = 1e-6 * np.maximum(np.abs(free.upper - free.lower), 0)
    near = np.where(np.isfinite(near), near, 0.0)
    low = values <= free.lower + np.minimum(near, 1e-6 * np.abs(free.unit))
    high = values >= free.upper - np.minimum(near, 1e-6 * np.abs(free.unit))
    return Refitted(
        values=dict(zip(free.names, values.tolist(), strict=True)),
        states=tuple(dict(zip(names, (z * shooting.start.nominal).tolist(), strict=True)) for z in found.z),
        size=np.fmax(pooled_rmse(left), q.noise),
        residuals_fit=tuple(left),
        residuals_select=tuple(residuals_of(task, found, q.select)) if q.select else (),
        likelihood=value,
        parameters=len(free.names),
        at_bound=tuple(n for n, at in zip(free.names, low | high, strict=True) if at),
        converged=found.converged,
        iterations=found.iterations,
    )


@dataclass(frozen=True, eq=False)
class Concluded:
    """A structure fitted to all training recordings: the `Fit` with intervals, and residuals (n, ny), SI, by role."""

    fit: object
    refitted: Refitted
    residuals_report: tuple[np.ndarray, ...]


def conclude(job: RefitJob) -> Concluded | str:
    """Fit a structure to ``question.fit`` for good, and judge it on ``question.select``, which takes no part.

    No bit of what is fitted depends on what judges: not even the compiled equations know of it. A sentence when every
    start diverges. Pure and picklable.
    """
    try:
        return _conclude(job)
    except SolveError as error:
        return str(error)


def _conclude(job: RefitJob) -> Concluded:
    began, q = time.perf_counter(), job.question
    alone = dataclasses.replace(job, question=dataclasses.replace(q, select=()))
    task = weighed(alone, np.fmax(q.noise if job.size is None else job.size, q.noise))
    found = _from_starts(task, alone)[0]
    task, found, left, value = _settled(task, q, found, LAST_WORD)
    settings = {"weights": "residual", "initial_states": q.initial_states, "step": q.step}
    fit = answer(task, [found], (), settings, began)
    refitted = _answer(q, _judging(task, job), found, left, value)
    return Concluded(fit, refitted, refitted.residuals_select)
