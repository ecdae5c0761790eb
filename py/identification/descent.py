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
    """Windows of ``seconds`` with all start states free, and their scaled start states from known trajectories."""
    start = StartStates(task.flat, [s.name for s in task.flat.states], task.free.index)
    segments = horizon.cut(task.recordings, seconds, horizon.longest_delay(task.flat, task.free.vector(q), seconds))
    z = horizon.window_starts(segments, states, start)
    shooting = Shooting(
        task.propagator, task.free, task.recordings, tuple(segments), task.weights, start, z, task.loss, task.threads
    )
    return shooting, shooting.clip(z)


def descend(task: Task, q: np.ndarray, lengths: Sequence[float], most: int) -> Minimum:
    """Minimise over windows of growing ``lengths`` [s], then over the whole recordings."""
    if lengths:
        states = horizon.first_guess(task.flat, task.recordings, task.propagator, task.free.vector(q), lengths[0])
    for seconds in lengths:
        shooting, z = windows(task, q, seconds, states)
        stage = f"windows of {seconds:.3g} s"
        task.report(stage, 0, np.nan)
        try:
            found = minimise(shooting, q, z, absolute=1.0, relative=0.01, most=12, on_step=task.step_report(stage))
        except SolveError:
            break
        q = found.q
        states = _filled(shooting.trajectories(q, found.z), states)
    shooting, z = whole_runs(task)
    if lengths and not shooting.start.held:
        first = np.array([x[0, shooting.start.columns] for x in states]).reshape(z.shape)
        z = shooting.clip(first / shooting.start.nominal)
    task.report("free run", 0, np.nan)
    return minimise(shooting, q, z, most=most, on_step=task.step_report("free run"))


def _filled(states: Sequence[np.ndarray], otherwise: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [np.where(np.isfinite(new), new, old) for new, old in zip(states, otherwise, strict=True)]
