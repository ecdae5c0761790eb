"""Which minimum: several starts, under weights that suit what the model can explain."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import SolveError

from . import horizon
from .answer import explains
from .descent import Task, descend
from .least_squares import Minimum
from .valley import BLIND, TROUBLE, along_the_valleys
from .weighing import WORTH_IT, Weighed, broadly_weighed, misses, runs_of, score, weighed_by_residual

SPREAD = 0.35  # of the other starts, in ln p or relative to p
LAST = 1e-6  # of the unexplained cost, what a free run need not gain ...
ON_THE_WAY = 1e-3  # ... and when its weights are about to change
SIMILAR = 2e-3  # the same as AGREEMENT between fits that leave more than noise
AGREEMENT = 1e-4  # of the cost: two starts that end so close leave nothing to gain from a third


@dataclass(frozen=True)
class Effort:
    """How hard to look: window lengths [s] (None: from the model's modes), most starts, most iterations of each."""

    windows: Sequence[float] | None
    starts: int
    iterations: int


def search(task: Task, effort: Effort, adaptable: np.ndarray) -> tuple[Task, list[Minimum]]:
    """The minima that the starts lead to, the lowest first, and the task with the weights they belong to.

    ``adaptable`` (ny,) marks outputs whose weight may follow what is left of them. A parameter without effect keeps the
    value it was given.
    """
    task, found = _searched(task, effort, adaptable)
    return task, [_undisturbed(task, minimum) for minimum in found]


def _undisturbed(task: Task, found: Minimum) -> Minimum:
    """Parameters that no output depends on go back to where they started, whichever start won."""
    information = np.diag(found.information())
    blind = information <= BLIND * information.max(initial=0.0)
    if not blind.any():
        return found
    return dataclasses.replace(found, q=np.where(blind, task.free.scaled(task.free.start), found.q))


def _searched(task: Task, effort: Effort, adaptable: np.ndarray) -> tuple[Task, list[Minimum]]:
    found, stopped = _first(task, effort, ON_THE_WAY if adaptable.any() else LAST)
    if found and adaptable.any() and np.any(misses(task, found[0])[adaptable] > WORTH_IT):
        best = _by_what_is_left(task, effort, adaptable, found[0])
        if best.task is not task:
            return best.task, [best.minimum]
        found = [best.minimum]
    if found and _fits(task, found[0]):
        found, settled = along_the_valleys(task, found[0])
        if settled and explains(task, found[0]):
            return task, found
    return task, _by_noise(task, effort, found, stopped)


def _first(task: Task, effort: Effort, relative: float) -> tuple[list[Minimum], SolveError | None]:
    try:
        return [_descent(task, effort, task.free.scaled(task.free.start), relative)], None
    except SolveError as error:
        return [], error


def _fits(task: Task, found: Minimum) -> bool:
    """What is left has the size of the noise."""
    return bool(np.all(misses(task, found) < WORTH_IT))


def _by_noise(task: Task, effort: Effort, found: list[Minimum], stopped) -> list[Minimum]:
    """More starts under the sensors' noise, until one explains the recordings or two agree."""
    for q in _others(task, effort.starts):
        try:
            latest = _descent(task, effort, q)
        except SolveError as error:
            stopped = stopped or error
            continue
        agree = bool(found) and abs(latest.cost - found[0].cost) < AGREEMENT * found[0].cost
        around, settled = _explored(task, latest, found)
        found = sorted([*found, *around], key=lambda m: m.cost)
        if agree or (settled and explains(task, around[0])):
            break
    if not found:
        raise stopped
    return found


def _explored(task: Task, latest: Minimum, found: Sequence[Minimum]) -> tuple[list[Minimum], bool]:
    """A minimum and its surroundings, unless a better one is known; whether it has settled."""
    if (found and latest.cost > found[0].cost) or not _fits(task, latest):
        return [latest], latest.iterations < TROUBLE
    return along_the_valleys(task, latest)


def _by_what_is_left(task: Task, effort: Effort, adaptable: np.ndarray, first: Minimum) -> Weighed:
    """The best of several starts under weights from what is left; the task itself once a start reaches the noise."""
    best = Weighed(task, first, score(task, first))
    with contextlib.suppress(SolveError):
        best = weighed_by_residual(task, first, adaptable, effort.iterations)
    broad = broadly_weighed(task, adaptable)
    for number, q in enumerate([task.free.scaled(task.free.start), *_others(task, effort.starts)]):
        if number + 1 >= max(effort.starts, 2):
            break
        try:
            reached = _descent(broad, effort, q, ON_THE_WAY, thorough=False)
            latest = weighed_by_residual(task, reached, adaptable, effort.iterations)
        except SolveError:
            continue
        if np.all(misses(latest.task, latest.minimum) < WORTH_IT):
            return Weighed(task, latest.minimum, score(task, latest.minimum))
        agree = abs(latest.score - best.score) < SIMILAR * max(best.minimum.cost, 1.0)
        best = min(best, latest, key=lambda w: w.score)
        if agree:
            break
    return best


def _descent(task: Task, effort: Effort, q: np.ndarray, relative: float = LAST, thorough: bool = True) -> Minimum:
    """Where a start leads. Raises SolveError where that is nowhere: it costs itself only."""
    lengths = effort.windows
    if lengths is None:
        lengths = horizon.horizons(task.flat, task.recordings, task.free.vector(q))
    try:
        found = descend(task, q, lengths, effort.iterations, relative, thorough)
    except np.linalg.LinAlgError as error:
        raise SolveError(f"identify: the derivatives of {task.flat.name} allow no step ({error}).") from None
    runs_of(task, found)
    return found


def _others(task: Task, starts: int) -> Iterator[np.ndarray]:
    """A scrambled Sobol sequence around the given start, inside the bounds."""
    q0 = task.free.scaled(task.free.start)
    lower, upper = task.free.scaled(task.free.lower), task.free.scaled(task.free.upper)
    if starts > 1:
        from scipy.stats import qmc  # takes most of a second, and few fits come here

        cube = qmc.Sobol(len(q0), seed=0).random_base2(int(np.ceil(np.log2(starts))))
        for point in cube[: starts - 1]:
            yield np.clip(q0 + SPREAD * (2 * point - 1), lower, upper)
