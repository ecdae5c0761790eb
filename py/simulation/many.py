"""Many parameter sets of one model over one recording: side by side in vector lanes, else one after the other.

Lanes take explicit steps. Sets that have to be integrated implicitly, FMUs and equations without a vector form are run
one by one, to the same results, and so is everything where there is no compiler.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from hydrotwin.models.language.errors import SolveError

from . import stiffness
from .control import Accuracy, Choice, compared
from .engines import lanes_of
from .machine import DEAR, DONE
from .stops import raise_stop

FEWEST = 2  # sets that are worth lanes: eight of them cost as much as two single runs
AT_ONCE = 16  # sets whose states and finer runs are kept at a time: those of the widest processors


class Ran(NamedTuple):
    """One set: outputs (n, ny), nan where it stopped, and then why; accuracy, where it was asked for."""

    y: np.ndarray
    stop: SolveError | None = None
    accuracy: Accuracy | None = None


def run_many(propagator, time, u, p, x0) -> tuple[np.ndarray, list[SolveError | None]]:
    """Outputs (sets, n, ny) of parameter vectors ``p`` (sets, np) from starts ``x0`` (sets, nx), and why sets stopped.

    All take the method and the step that `Propagator.run` takes for the first of them. A set that stops is nan from its
    first sample on, and costs only itself. time (n,), u (n, nu), everything SI.

    Raises SolveError for unusable arrays.
    """
    time, u, p, x0 = _checked(propagator, time, u, p, x0)
    y, stops = np.empty((len(p), len(time), len(propagator.flat.outputs))), [None] * len(p)
    choice, lanes = _chosen(propagator, time, u, p, x0)
    left = range(len(p))
    if lanes is not None:
        status, where, y, _ = lanes.propagate(time, u, p, choice.control, x0, with_states=False)
        stops = [_stop(propagator, *stop, time, u, q) for *stop, q in zip(status, where, p, strict=True)]
        left = np.flatnonzero(status == DEAR)
    for s in left:
        y[s], stops[s], _ = _alone(propagator, choice, time, u, p[s], x0[s])
    return y, stops


def squares_of_many(propagator, time, u, p, x0, measured) -> np.ndarray:
    """``sum (y - measured)^2`` by output (sets, ny) of what `run_many` runs; nan for a set that stopped.

    measured : (n, ny), nan where nothing was; it counts for nothing. Much cheaper than the outputs of many sets.
    """
    time, u, p, x0 = _checked(propagator, time, u, p, x0)
    measured = np.ascontiguousarray(measured, dtype=float)
    if measured.shape != (len(time), len(propagator.flat.outputs)):
        raise SolveError(
            f"{propagator.flat.name}: measured must have shape {(len(time), len(propagator.flat.outputs))} "
            f"(got {measured.shape}). Give a column for each output, nan where nothing was measured."
        )
    squares = np.empty((len(p), measured.shape[1]))
    choice, lanes = _chosen(propagator, time, u, p, x0)
    left = range(len(p))
    if lanes is not None:
        status, squares = lanes.squares(time, u, p, choice.control, x0, measured)
        left = np.flatnonzero(status == DEAR)
    known = np.isfinite(measured)
    for s in left:
        y, stop, _ = _alone(propagator, choice, time, u, p[s], x0[s])
        squares[s] = np.nan if stop else (np.where(known, y - measured, 0.0) ** 2).sum(axis=0)
    return squares


def controlled_many(propagator, time, u, p, x0) -> list[Ran]:
    """What `Propagator.controlled_run` gives of every set, decided for each by itself."""
    time, u, p, x0 = _checked(propagator, time, u, p, x0)
    found: dict[int, Ran] = {}
    for first in range(0, len(p), AT_ONCE):
        pending = np.arange(first, min(first + AT_ONCE, len(p)))
        lanes = _lanes(propagator, len(pending))
        for choice in propagator.explicit_choices() if lanes is not None else []:
            ran, pending = _tried(propagator, lanes, choice, time, u, p, x0, pending)
            found |= ran
            if not len(pending):
                break
    return [found[s] if s in found else _controlled(propagator, time, u, p[s], x0[s]) for s in range(len(p))]


def _tried(propagator, lanes, choice: Choice, time, u, p, x0, pending) -> tuple[dict[int, Ran], np.ndarray]:
    """Sets for which a choice is the one that a single run takes, and those that are to try the next."""
    flat, controlled = propagator.flat, choice.method == "explicit" and np.isfinite(choice.control.tolerance)
    status, where, y, x = lanes.propagate(time, u, p[pending], choice.control, x0[pending])
    step = choice.control.step
    will_do = [
        not controlled or stiffness.explicit_will_do(flat, step, time, u, p[s], x0[s], x[i])
        for i, s in enumerate(pending)
    ]
    taken = np.flatnonzero(np.array(will_do) & (status != DEAR))
    chosen = pending[taken]
    finer_status, _, finer, _ = lanes.propagate(time, u, p[chosen], choice.finer().control, x0[chosen], False)
    ran = {}
    for i, s, other, other_status in zip(taken, chosen, finer, finer_status, strict=True):
        if status[i] != DONE:
            ran[s] = Ran(y[i], _stop(propagator, status[i], where[i], time, u, p[s]))
        elif other_status != DEAR:
            other = other if other_status == DONE else np.full_like(other, np.inf)
            accuracy = compared(flat, time, y[i], other, choice.method, step)
            if accuracy.reached or not controlled:
                ran[s] = Ran(y[i], None, accuracy)
    return ran, pending[~np.array(will_do) & (status != DEAR)]


def _controlled(propagator, time, u, p, x0) -> Ran:
    try:
        y, _, accuracy = propagator.undecided().controlled_run(time, u, p, x0)
    except SolveError as stop:
        return Ran(_nothing(propagator, time), stop)
    return Ran(y, None, accuracy)


def _alone(propagator, choice: Choice | None, time, u, p, x0) -> Ran:
    if choice is None:
        try:
            return Ran(propagator.run(time, u, p, x0)[0])
        except SolveError as stop:
            return Ran(_nothing(propagator, time), stop)
    status, where, y, _ = propagator.chosen_run(choice, time, u, p, x0)
    stop = _stop(propagator, status, where, time, u, p)
    return Ran(_nothing(propagator, time) if stop else y, stop)


def _stop(propagator, status, where, time, u, p) -> SolveError | None:
    if status in (DONE, DEAR):
        return None
    try:
        raise_stop(propagator.flat, status, where, time, u, p)
    except SolveError as stop:
        return stop


def _nothing(propagator, time) -> np.ndarray:
    return np.full((len(time), len(propagator.flat.outputs)), np.nan)


def _chosen(propagator, time, u, p, x0):
    """How the first set with a start runs, None where only the propagator knows; the lanes for it, or None."""
    if propagator.flat.black_box:
        return None, None
    first = int(np.argmax(np.isfinite(x0).all(axis=1)))
    choice = propagator.decided(time, u, p[first], x0[first])
    return choice, None if choice.implicit else _lanes(propagator, len(p))


def _lanes(propagator, sets: int):
    if sets < FEWEST or propagator.flat.black_box or not propagator.explicit_choices() or propagator.engine != "c":
        return None
    return lanes_of(propagator.flat)


def _checked(propagator, time, u, p, x0):
    flat = propagator.flat
    p, x0 = (np.ascontiguousarray(a, dtype=float) for a in (p, x0))
    shapes = (len(p), len(flat.parameters)), (len(p), len(flat.states))
    if (p.shape, x0.shape) != shapes or not len(p):
        raise SolveError(
            f"{flat.name}: p and x0 must have shapes (sets, {shapes[0][1]}) and (sets, {shapes[1][1]}), with a set at "
            f"least (got {p.shape} and {x0.shape}). Give a row for each set."
        )
    if flat.black_box:
        return time, u, p, x0
    return *propagator.checked(time, u, p[0], x0[0])[:2], p, x0
