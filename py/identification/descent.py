"""One descent: from one start through growing windows to the free runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, SolveError, nearest
from hydrotwin.models.language.flat import FlatModel

from . import horizon
from .fit import Iteration
from .least_squares import Minimum, minimise
from .loss import Loss
from .problem import FreeParameters, Recording
from .shooting import Shooting, StartStates

INITIAL_STATES = ("auto", "free", "fixed")
ENOUGH = 400  # windows in a stage
WINDOW_STAGE = {"absolute": 0.1, "relative": 1e-5, "most": 12}
SLOW = 6  # iterations
SLIDES = 4
SLIDE_LENGTHS = (-0.4, -0.2, -0.1, 0.1, 0.2, 0.4)  # in q of the parameter that moves most


@dataclass(frozen=True, eq=False)
class Task:
    """Everything that stays the same over all descents."""

    flat: FlatModel
    free: FreeParameters
    propagator: object
    recordings: tuple[Recording, ...]
    weights: np.ndarray
    loss: Loss
    initial_states: str
    threads: int
    report: Callable[[str, int, float], None]
    history: list[Iteration] = field(default_factory=list)

    def step_report(self, stage: str):
        """What the solver calls after each accepted step."""

        def on_step(number: int, cost: float, damping: float):
            self.history.append(Iteration(stage, number, cost, damping))
            self.report(stage, number, cost)

        return on_step


def whole_runs(task: Task, recordings: Sequence[Recording] | None = None) -> tuple[Shooting, np.ndarray]:
    """One segment per recording under the chosen start states, and the scaled start states from the first samples."""
    if task.initial_states not in INITIAL_STATES:
        raise DeclarationError(
            f"identify: no initial_states '{task.initial_states}'. {nearest(task.initial_states, INITIAL_STATES)}"
        )
    recordings = task.recordings if recordings is None else tuple(recordings)
    flat, p = task.flat, task.free.vector(task.free.scaled(task.free.start))
    measured = [set(horizon.measured_start(flat, r)) for r in recordings]
    everywhere = set.intersection(*measured)
    names = [s.name for s in flat.states] if task.initial_states == "free" else sorted(everywhere)
    start = StartStates(flat, names, task.free.index, held=task.initial_states == "fixed")
    guess = [horizon.start_from_measured(flat, r, p) for r in recordings]
    z = np.array([x[start.columns] for x in guess]).reshape(len(recordings), -1) / start.nominal
    segments = horizon.cut(recordings, np.inf)
    shooting = Shooting(
        task.propagator, task.free, recordings, tuple(segments), task.weights, start, z, task.loss, task.threads
    )
    return shooting, z


def windows(task: Task, q: np.ndarray, seconds: float, states: Sequence[np.ndarray]) -> tuple[Shooting, np.ndarray]:
    """Windows of ``seconds`` with all start states free, and their scaled start states from known trajectories.

    At most ENOUGH of them, evenly spread: the early stages need a direction, not the last digit.
    """
    start = StartStates(task.flat, [s.name for s in task.flat.states], task.free.index)
    delay = horizon.longest_delay(task.flat, task.free.vector(q), seconds)
    segments = horizon.cut(task.recordings, seconds, delay)
    segments = segments[:: int(np.ceil(len(segments) / ENOUGH))]
    z = horizon.window_starts(segments, states, start)
    shooting = Shooting(
        task.propagator, task.free, task.recordings, tuple(segments), task.weights, start, z, task.loss, task.threads
    )
    return shooting, shooting.clip(z)


def descend(task: Task, q: np.ndarray, lengths: Sequence[float], most: int) -> Minimum:
    """Minimise over windows of growing ``lengths`` [s], then over the whole recordings."""
    states = None
    for seconds in lengths:
        guess = horizon.first_guess(task.flat, task.recordings, task.propagator, task.free.vector(q), lengths[0])
        shooting, z = windows(task, q, seconds, guess if states is None else _filled(states, guess))
        stage = f"windows of {seconds:.3g} s"
        task.report(stage, 0, np.nan)
        try:
            found = _settled(task, shooting, q, z, stage)
        except SolveError:
            break
        q, states = found.q, shooting.trajectories(found.q, found.z)
    shooting, z = whole_runs(task)
    if states is not None and not shooting.start.held:
        first = np.array([x[0, shooting.start.columns] for x in states]).reshape(z.shape) / shooting.start.nominal
        z = shooting.clip(np.where(np.isfinite(first), first, z))
    task.report("free run", 0, np.nan)
    return minimise(shooting, q, z, most=most, on_step=task.step_report("free run"))


def _settled(task: Task, shooting: Shooting, q: np.ndarray, z: np.ndarray, stage: str) -> Minimum:
    """A minimum over windows; one that was slow to find is looked past along the weakest direction."""
    found = minimise(shooting, q, z, **WINDOW_STAGE, on_step=task.step_report(stage))
    for _ in range(SLIDES):
        if found.iterations < SLOW:
            return found
        further = _slide(task, shooting, found, stage)
        if further.cost > found.cost - 1.0:
            return found
        found = further
    return found


def _slide(task: Task, shooting: Shooting, found: Minimum, stage: str) -> Minimum:
    """The best minimum reached from points along the direction the windows say least about.

    A lightly damped mode sampled near its own frequency makes the cost rough on a small scale and the valley long: a
    descent comes to rest on the way, while the cost a few tenths further along the valley is lower.
    """
    information = found.information()
    size = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    _, vectors = np.linalg.eigh(information / np.outer(size, size))
    weakest = vectors[:, 0] / size
    weakest = weakest / np.abs(weakest).max()
    lower, upper = (task.free.scaled(b) for b in (task.free.lower, task.free.upper))
    best = found
    for length in SLIDE_LENGTHS:
        q = np.clip(found.q + length * weakest, lower, upper)
        try:
            tried = minimise(shooting, q, found.z, **{**WINDOW_STAGE, "most": 3})
        except SolveError:
            continue
        best = min(best, tried, key=lambda m: m.cost)
    task.report(f"{stage}, along the valley", 0, best.cost)
    return minimise(shooting, best.q, best.z, **WINDOW_STAGE, on_step=task.step_report(stage))


def _filled(states: Sequence[np.ndarray], otherwise: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [np.where(np.isfinite(new), new, old) for new, old in zip(states, otherwise, strict=True)]
