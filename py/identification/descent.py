"""One descent: from one start through growing windows to the free runs."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, SolveError, nearest
from hydrotwin.models.language.flat import FlatModel

from . import horizon
from .fit import Iteration
from .least_squares import Minimum, minimise
from .loss import Loss
from .problem import FreeParameters, Prior, Recording
from .shooting import Segment, Shooting
from .start_states import StartStates

INITIAL_STATES = ("auto", "free", "fixed")
ENOUGH_WINDOWS, ENOUGH_SAMPLES, FEWEST_WINDOWS = 400, 40_000, 6  # in a stage
WINDOW_STAGE = {"absolute": 0.3, "relative": 1e-3, "most": 10}
BEGINNING, FEWEST_SAMPLES = 0.1, 50  # of a recording that takes no part: what tells first how it starts
HELD = 15  # iterations for its start states
SLOW = 7  # iterations
SLIDES = 3
SCATTER = 0.5  # in q
SETTLED = 1000.0  # one over the sigma of q, all else known
SLIDE_LENGTHS = (-0.4, -0.2, -0.1, 0.1, 0.2, 0.4)  # in q of the parameter that moves most


@dataclass(frozen=True, eq=False)
class Task:
    """What stays the same over a descent; noise (ny,) is the sensors', weights (ny,) what a residual costs.

    prior : what is known of the parameters beforehand.
    rounded : (ny,), SI, what of the noise is the rounding of the inputs; None where it does not matter.
    until : the processor time [s], as of `time.process_time`, at which every minimisation of it stops.
    """

    flat: FlatModel
    free: FreeParameters
    propagator: object
    recordings: tuple[Recording, ...]
    weights: np.ndarray
    loss: Loss
    initial_states: str
    threads: int
    report: Callable[[str, int, float], None]
    noise: np.ndarray
    history: list[Iteration] = field(default_factory=list)
    prior: Prior | None = None
    rounded: np.ndarray | None = None
    until: float = np.inf

    def step_report(self, stage: str):
        """What the solver calls after each accepted step."""

        def on_step(number: int, cost: float, damping: float):
            self.history.append(Iteration(stage, number, cost, damping))
            self.report(stage, number, cost)

        return on_step


def whole_runs(task: Task, recordings: Sequence[Recording] | None = None) -> tuple[Shooting, np.ndarray]:
    """One segment per recording under the chosen start states, and the scaled start states from the first samples.

    Where one begins in motion, all start states are estimated.
    """
    if task.initial_states not in INITIAL_STATES:
        raise DeclarationError(
            f"identify: no initial_states '{task.initial_states}'. {nearest(task.initial_states, INITIAL_STATES)}"
        )
    recordings = task.recordings if recordings is None else tuple(recordings)
    flat, p = task.flat, task.free.vector(task.free.scaled(task.free.start))
    measured = [set(horizon.measured_start(flat, r)) for r in recordings]
    everywhere = set.intersection(*measured)
    free = task.initial_states == "free" or any(r.in_motion for r in recordings)
    names = [s.name for s in flat.states] if free else sorted(everywhere)
    start = StartStates(flat, names, task.free.index, held=task.initial_states == "fixed" and not free)
    guess = [horizon.start_from_measured(flat, r, p) for r in recordings]
    z = np.array([x[start.columns] for x in guess]).reshape(len(recordings), -1) / start.nominal
    segments = horizon.cut(recordings, np.inf)
    shooting = Shooting(
        task.propagator, task.free, recordings, tuple(segments), task.weights, start, z, task.loss, task.threads,
        prior=task.prior, until=task.until,
    )  # fmt: skip
    return shooting, z


def held_out_run(task: Task, q: np.ndarray, recording: Recording) -> tuple[Shooting, np.ndarray]:
    """One segment of a recording that takes no part, and its scaled start states as the recording tells them.

    Bounces at a stop move with the start, and a descent from one noisy sample rests between them. The beginning, of
    which that is not true, is asked first; where it leads to more than the sample did, the sample stands.
    """
    shooting, z = whole_runs(task, [recording])
    if not shooting.locals:
        return shooting, z
    samples = max(FEWEST_SAMPLES, int(BEGINNING * len(recording.time)))
    beginning = {name: getattr(recording, name)[:samples] for name in ("time", "u", "y")}
    with contextlib.suppress(SolveError):
        first, _ = whole_runs(task, [dataclasses.replace(recording, **beginning)])
        z = min(z, minimise(first, q, z, hold=True, most=HELD).z, key=lambda z: shooting.cost(q, z))
    with contextlib.suppress(SolveError):
        z = minimise(shooting, q, z, hold=True, most=HELD).z
    return shooting, z


def windows(task: Task, q: np.ndarray, seconds: float, states: Sequence[np.ndarray]) -> tuple[Shooting, np.ndarray]:
    """Windows of ``seconds`` with all start states free, and their scaled start states from known trajectories.

    Only as many as give a direction, evenly spread: the last digits come from the whole recordings.
    """
    delay = horizon.longest_delay(task.flat, task.free.vector(q), seconds)
    segments = horizon.cut(task.recordings, seconds, delay)
    samples = sum(s.last - s.begin for s in segments)
    stride = int(np.ceil(max(len(segments) / ENOUGH_WINDOWS, samples / ENOUGH_SAMPLES)))
    return freely(task, segments[:: min(stride, max(1, len(segments) // FEWEST_WINDOWS))], states)


def freely(task: Task, segments: Sequence[Segment], states: Sequence[np.ndarray]) -> tuple[Shooting, np.ndarray]:
    """Segments with all start states free, and their scaled start states from known trajectories (n, nx)."""
    start = StartStates(task.flat, [s.name for s in task.flat.states], task.free.index)
    z = horizon.window_starts(segments, states, start)
    shooting = Shooting(
        task.propagator, task.free, task.recordings, tuple(segments), task.weights, start, z, task.loss, task.threads,
        prior=task.prior, until=task.until,
    )  # fmt: skip
    return shooting, shooting.clip(z)


def undecided(task: Task, method: str | None = None) -> Task:
    """How it is integrated is decided again, or told: what was easy at one point may be stiff at another."""
    return task if task.flat.black_box else dataclasses.replace(task, propagator=task.propagator.undecided(method))


def descend(
    task: Task,
    q: np.ndarray,
    lengths: Sequence[float],
    most: int,
    relative: float = 1e-6,
    thorough: bool = True,
    states: Sequence[np.ndarray] | None = None,
) -> Minimum:
    """Minimise over windows of growing ``lengths`` [s], then over the whole recordings.

    ``relative``: of the unexplained cost, what a free run need not gain; others as in `through_windows`.
    """
    q, states = through_windows(task, q, lengths, thorough, states)
    task = undecided(task)
    shooting, z = whole_runs(task)
    if states is not None and not shooting.start.held:
        first = np.array([x[0, shooting.start.columns] for x in states]).reshape(z.shape) / shooting.start.nominal
        z = shooting.clip(np.where(np.isfinite(first), first, z))
    task.report("free run", 0, np.nan)
    return minimise(shooting, q, z, most=most, relative=relative, on_step=task.step_report("free run"))


def through_windows(
    task: Task,
    q: np.ndarray,
    lengths: Sequence[float],
    thorough: bool = True,
    states: Sequence[np.ndarray] | None = None,
) -> tuple[np.ndarray, Sequence[np.ndarray] | None]:
    """Minimise over windows of growing ``lengths`` [s]: q and state trajectories (n, nx) per recording.

    ``thorough``: doubt slow windows; ``states``: trajectories where shorter windows have been gone through before.
    """
    for seconds in lengths:
        task, known = undecided(task), states
        if known is None or not all(np.isfinite(x).all() for x in known):
            guess = horizon.first_guess(task.flat, task.recordings, task.propagator, task.free.vector(q), lengths[0])
            known = guess if known is None else _filled(known, guess)
        shooting, z = windows(task, q, seconds, known)
        stage = f"windows of {seconds:.3g} s"
        task.report(stage, 0, np.nan)
        try:
            found = _settled(task, shooting, q, z, stage, first=seconds == lengths[0], thorough=thorough)
        except SolveError:
            break
        q, states = found.q, shooting.trajectories(found.q, found.z)
    return q, states


def _settled(
    task: Task, shooting: Shooting, q: np.ndarray, z: np.ndarray, stage: str, first: bool, thorough: bool
) -> Minimum:
    """A minimum over windows. One that is not found in a few steps is doubted: other points are tried.

    A lightly damped mode sampled near twice its frequency makes the cost rough on a small scale, gives it more than
    one valley, and makes the valleys long: a descent comes to rest on the way or in the wrong one.
    """
    on_step = task.step_report(stage)
    found = minimise(shooting, q, z, **WINDOW_STAGE, on_step=on_step)
    if not thorough:
        return found
    if first and (not found.converged or found.iterations >= SLOW):
        task.report(f"{stage}, other valleys", 0, found.cost)
        found = _best_from(task, shooting, found, _scattered(task, found), 6)
    for _ in range(SLIDES):
        if found.converged:
            break
        task.report(f"{stage}, along the valley", 0, found.cost)
        best = _best_from(task, shooting, found, along_valleys(found), 3)
        if best.cost > found.cost - 1.0:
            break
        found = minimise(shooting, best.q, best.z, **WINDOW_STAGE, on_step=on_step)
    return found


def _best_from(task: Task, shooting: Shooting, found: Minimum, points: Sequence[np.ndarray], most: int) -> Minimum:
    """The lowest of ``found`` and a few steps from each of ``points``."""
    lower, upper = (task.free.scaled(b) for b in (task.free.lower, task.free.upper))
    best = found
    for point in points:
        try:
            tried = minimise(shooting, np.clip(point, lower, upper), found.z, **{**WINDOW_STAGE, "most": most})
        except SolveError:
            continue
        best = min(best, tried, key=lambda m: m.cost)
    return best if best is found else dataclasses.replace(best, converged=False)


def along_valleys(found: Minimum, lengths: Sequence[float] = SLIDE_LENGTHS, directions: int = 1) -> list[np.ndarray]:
    """Points beside a minimum along the ``directions`` that the recordings say least about.

    lengths : how far, in q of the parameter that moves most.
    """
    information = found.information()
    size = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    _, vectors = np.linalg.eigh(information / np.outer(size, size))
    weak = (vectors[:, k] / size for k in range(min(directions, len(size))))
    return [found.q + length * one / np.abs(one).max() for one in weak for length in lengths]


def _scattered(task: Task, found: Minimum) -> list[np.ndarray]:
    """Points around the start of the task in the parameters that the windows do not settle at once."""
    from scipy.stats import qmc  # takes most of a second, and few fits come here

    settled = np.sqrt(np.maximum(np.diag(found.information()), 0.0)) > SETTLED
    cube = 2 * qmc.Sobol(len(found.q), seed=0).random_base2(3) - 1
    start = task.free.scaled(task.free.start)
    return [np.where(settled, found.q, start + SCATTER * point) for point in cube]


def _filled(states: Sequence[np.ndarray], otherwise: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [np.where(np.isfinite(new), new, old) for new, old in zip(states, otherwise, strict=True)]
