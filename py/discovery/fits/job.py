"""A structure to fit, what is the same for all of them, and what a fit answers. All of it can travel."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.identification.descent import Task
from hydrotwin.identification.horizon import measured_start
from hydrotwin.identification.loss import Loss
from hydrotwin.identification.noise import weights
from hydrotwin.identification.problem import FreeParameters, Prior, Recording, free_parameters
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.simulation import prepare
from hydrotwin.simulation.control import TOLERANCE

from ..evidence.score import Spectrum

KNOWN_TO = np.log(2.0)  # one sigma of what a model came with, of ln p
WINDOWS = 200  # of a length, at most
ROUGH = 10.0  # times the error in a step of a run that only tells candidates apart
BROAD = 0.05  # of the spread of an output: the error allowed before anything is known of it


@dataclass(frozen=True, eq=False)
class Question:
    """What is the same for every structure.

    fit : the recordings; select : those that judge, of a last fit only; noise : of the sensors (ny,), SI.
    usual : base parameters by path at the values that the model came with, known to a factor of two (one sigma).
    lengths : seconds [s] of the windows through which every fit is led, growing; none for what cannot start anywhere.
    windows : of a length, at most, evenly spread.
    """

    fit: tuple[Recording, ...]
    noise: np.ndarray
    select: tuple[Recording, ...] = ()
    initial_states: str = "auto"
    step: float | None = None
    usual: Mapping[str, float] = field(default_factory=dict)
    lengths: tuple[float, ...] = ()
    windows: int = WINDOWS

    @property
    def counts(self) -> np.ndarray:
        """Measured values of every output in the recordings that are fitted to, (ny,)."""
        return np.sum([np.isfinite(r.y).sum(axis=0) for r in self.fit], axis=0)


@dataclass(frozen=True, eq=False)
class Job:
    """One structure and where its fit begins.

    starts : values by path, of which the one that costs least is followed, and where that leads a fit to more than
    noise others, too. states : start states by name and recording, where they are known. course : states (n,) by name
    and recording, in which windows of its first length begin; states that are not in it start there. size : (ny,), SI,
    what a residual costs at first; None: a few percent of the spread.
    iterations, seconds : the most that each stage takes, [1] and [s] of all. stages : of the windows' lengths, from
    which one to before which one a look goes; (0, 0) for one at whole recordings, None for a fit to them. threads :
    over recordings. tells_courses : whether a look tells its own. tries : whether at whole recordings the
    first steps from every start choose it, or what it costs.
    """

    flat: FlatModel
    free: tuple[str, ...]
    question: Question
    starts: tuple[Mapping[str, float], ...] = ({},)
    states: tuple[Mapping[str, float], ...] = ()
    size: np.ndarray | None = None
    label: str = ""
    iterations: int = 15
    seconds: float = 60.0
    stages: tuple[int, int] | None = None
    threads: int = 1
    course: tuple[Mapping[str, np.ndarray], ...] = ()
    tells_courses: bool = False
    tries: bool = True

    def beginning(self) -> Job:
        """The same, whose seconds count from now: ``seconds`` becomes a time of `time.process_time`."""
        return dataclasses.replace(self, seconds=time.process_time() + self.seconds)


@dataclass(frozen=True, eq=False)
class Look:
    """Where the windows have led a structure.

    values : free parameters by path; squares, counts : (stages, ny), SI squared and [1], of what every length of
    windows left, the free start states taken from the numbers. size : (ny,), SI, what the last left. states : start
    states by name and recording. trail : values after the stages before. sigmas : of the values, by path, infinite
    where nothing shows. left : of whole recordings, where it looked at them. begin : of the lengths, the first that it
    went through. courses : by length, states (n,) by name and recording along its windows, where they were asked for.
    """

    values: Mapping[str, float]
    squares: np.ndarray
    counts: np.ndarray
    size: np.ndarray
    states: tuple[Mapping[str, float], ...] = ()
    trail: tuple[Mapping[str, float], ...] = ()
    sigmas: Mapping[str, float] = field(default_factory=dict)
    left: Spectrum | None = None
    seconds: float = 0.0
    begin: int = 0
    courses: tuple[tuple[Mapping[str, np.ndarray], ...], ...] = ()

    @property
    def end(self) -> int:
        """Of the lengths, that before which it ended."""
        return self.begin + len(self.squares)

    @property
    def shortest(self) -> Mapping[str, float]:
        """Values after the first length of windows."""
        return [*self.trail, self.values][0]

    def after_length(self, stage: int) -> Mapping[str, float]:
        """Values after one of the lengths."""
        return [*self.trail, self.values][stage - self.begin]

    def size_at(self, stage: int) -> np.ndarray:
        """(ny,), SI, what one of the lengths left."""
        return np.sqrt(self.squares[stage - self.begin] / np.maximum(self.counts[stage - self.begin], 1))

    def after(self, before: Look | None) -> Look:
        """The same with the lengths that were gone through before it; one that it went through again counts as now."""
        if before is None:
            return self
        kept = self.begin - before.begin
        squares, counts = (np.concatenate([getattr(before, n)[:kept], getattr(self, n)]) for n in ("squares", "counts"))
        return dataclasses.replace(
            self, squares=squares, counts=counts, begin=before.begin, seconds=before.seconds + self.seconds,
            trail=(*(*before.trail, before.values)[:kept], *self.trail),
            courses=(*before.courses[:kept], *self.courses),
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Fitted:
    """A structure fitted to whole recordings.

    values : free parameters by path; states : start states by name and recording; left : what it leaves. sigmas : of
    the values, by path, infinite where nothing shows.
    """

    values: Mapping[str, float]
    states: tuple[Mapping[str, float], ...]
    left: Spectrum
    at_bound: tuple[str, ...]
    converged: bool
    iterations: int
    seconds: float = 0.0
    sigmas: Mapping[str, float] = field(default_factory=dict)

    @property
    def rmse(self) -> np.ndarray:
        """Over all recordings (ny,), SI."""
        return self.left.rmse


def task_of(job: Job, start: Mapping[str, float], size: np.ndarray, states: Sequence[str], rough: bool = False) -> Task:
    """The task of a fit from one start, where a residual of ``size`` (ny,), SI, costs as much as noise does."""
    q = job.question
    free = free_parameters(job.flat, job.free, inside(job.flat, start))
    tolerance = ROUGH * TOLERANCE if rough else TOLERANCE
    propagator = prepare(
        job.flat, free_parameters=free.names, free_states=list(states), step=q.step, tolerance=tolerance
    )
    return Task(
        job.flat, free, propagator, q.fit, weights(size), Loss("linear", 1.0), q.initial_states, job.threads,
        _silent, q.noise, prior=prior_of(free, q),
    )  # fmt: skip


def point_of(free: FreeParameters, start: Mapping[str, float]) -> np.ndarray:
    """Scaled parameters of a start, clipped to the bounds; what it does not say is as ``free`` begins."""
    values = np.array([start.get(n, own) for n, own in zip(free.names, free.start.tolist(), strict=True)])
    return free.scaled(np.clip(values, free.lower, free.upper))


def moving_starts(job: Job) -> list[str]:
    """States whose starts a fit to whole recordings may move: those that are measured, unless told."""
    q = job.question
    if q.initial_states == "free" or job.flat.black_box or any(r.in_motion for r in (*q.fit, *q.select)):
        return [s.name for s in job.flat.states]
    return sorted(set().union(*(measured_start(job.flat, r) for r in (*q.fit, *q.select))))


def prior_of(free: FreeParameters, q: Question) -> Prior:
    """Positive base parameters are known to within a factor of two (one sigma); nothing is known of the others.

    A mode that the recordings barely show makes many minima. So weak a knowledge decides between those that are
    almost equal, and weighs nothing against data.
    """
    known = np.array([n in q.usual and positive for n, positive in zip(free.names, free.logarithmic, strict=True)])
    usual = np.array([q.usual[n] if k else 1.0 for n, k in zip(free.names, known, strict=True)])
    return Prior(np.log(usual), known / KNOWN_TO**2)


def broad(q: Question) -> np.ndarray:
    """A few percent of the spread of every output (ny,), SI, never less than the noise."""
    y = np.concatenate([r.y for r in q.fit])
    spread = np.array([np.nanstd(c) if np.isfinite(c).any() else np.nan for c in y.T])
    return not_below(q.noise, BROAD * spread)


def not_below(noise: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Sizes (ny,) of errors, never below the noise; nan where an output was not measured."""
    return np.where(np.isfinite(noise), np.fmax(noise, size), np.nan)


def apart(size: np.ndarray, other: np.ndarray) -> float:
    """The largest factor between two sizes (ny,), as its logarithm; infinite where one of them alone is nothing."""
    with np.errstate(divide="ignore", invalid="ignore"):
        factors = np.abs(np.log(size / other))
    return float(np.nanmax(np.where((size == 0) & (other == 0), 0.0, factors), initial=0.0))


def factor(noise: np.ndarray, size: np.ndarray, other: np.ndarray) -> float:
    """The largest factor between two sizes (ny,) of what is left, of which what lies below the noise tells nothing."""
    return float(np.exp(apart(not_below(noise, size), not_below(noise, other))))


def inside(flat: FlatModel, values: Mapping[str, float]) -> dict[str, float]:
    """Values clipped to the parameters' bounds."""
    known = {p.name: p.bounds for p in flat.parameters}
    return {name: float(np.clip(v, *known[name])) for name, v in values.items()}


def _silent(stage: str, number: int, cost: float) -> None:
    """A fit reports when it is done."""
