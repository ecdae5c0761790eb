"""Whether a fit ended at a minimum that its derivatives describe: only there is (J^T J)^-1 an uncertainty.

    promise(d) small,   cost(q + d) + cost(q - d) - 2 cost(q) = d^T S d,   d along an axis of the ellipsoid

S is the information of the parameters once the start states have adapted. Where a run is chaotic, or derivatives
explode at a contact, the cost does not follow. A few such points are run, and nothing is believed that they refute.
Source: D. Bates & D. Watts, Nonlinear Regression, 1988, ch. 6 (how far a linear approximation holds).
"""

from __future__ import annotations

import numpy as np

from .descent import Task, undecided, whole_runs
from .fit import Finding
from .least_squares import DampedStep, Minimum, without_blocked
from .shooting import Shooting

AXES = 3  # of the ellipsoid that are run, the shortest and the longest among them
FARTHEST = 0.1  # of a parameter, or of its unit: what is known worse is tried nearer, where a parabola may still hold
TELLING = 0.02  # half a chi-square: what a point so near must still promise to tell anything
REACH = (1.0, 3.0)  # sigmas: a cost that is rough on the scale of one may follow further out
FOLLOWS = (0.04, 25.0)  # times what the derivatives say: within it a sigma is right within a factor of five
DAMPING = 1e-9  # of the diagonal of the information: lets a direction be solved for that nothing shows
SEEN = 100 * DAMPING  # of unit columns: an axis that is known no better is made of that damping
UNFINISHED = 2.0  # half a chi-square: what is still promised where the minimum is two sigmas away


def doubts(task: Task, best: Minimum, at_bound: np.ndarray) -> list[Finding]:
    """Why there is no minimum with a sigma here, in one finding; empty where there is one."""
    inside = np.flatnonzero(~at_bound)
    if not len(inside):
        return []
    shooting, _ = whole_runs(undecided(task))
    here = shooting.cost(best.q, best.z)
    unit = max(1.0, 2 * here / shooting.count)  # sigmas grow with what is left
    at = without_blocked(best.at, shooting, best.z)
    step = DampedStep(at, len(best.q), np.einsum("sii->si", at.hessian), DAMPING)
    promised = _promised(task, best, step, at.gradient)
    if promised > UNFINISHED * unit:
        return [_unfinished(np.sqrt(2 * promised / unit))]
    for axis in _axes(step.matrix[np.ix_(inside, inside)]):
        d = np.zeros(len(best.q))
        d[inside] = axis * np.sqrt(unit)
        ratios = [_followed(shooting, best, step, reach * d, here, unit) for reach in REACH]
        if not any(FOLLOWS[0] < ratio < FOLLOWS[1] for ratio in ratios):
            return [_not_followed(shooting.free.names, d, ratios[0])]
    return []


def _followed(shooting: Shooting, best: Minimum, step: DampedStep, d: np.ndarray, here: float, unit: float) -> float:
    """What the cost does along +-d, start states with it, over what the derivatives say; 1 where that tells nothing."""
    d = d * _room(shooting, best.q, d)
    said = 0.5 * float(d @ step.matrix @ d)
    if said < TELLING * unit:
        return 1.0
    dz = step.beside(d) if shooting.locals else 0.0
    ends = [shooting.cost(best.q + s * d, shooting.clip(best.z + s * dz)) for s in (1.0, -1.0)]
    return (sum(ends) - 2 * here) / 2 / said


def _promised(task: Task, best: Minimum, step: DampedStep, gradient: np.ndarray) -> float:
    """Decrease of cost that the derivatives promise inside the bounds of the parameters."""
    lower, upper = (task.free.scaled(b) - best.q for b in (task.free.lower, task.free.upper))
    dq, dz = step.towards(gradient, np.minimum(lower, 0.0), np.maximum(upper, 0.0))
    return step.promise(dq, dz)


def _axes(information: np.ndarray) -> np.ndarray:
    """Half-axes of the ellipsoid of one sigma, the shortest, some between and the longest that is seen."""
    size = np.sqrt(np.maximum(np.diag(information), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(information / np.outer(size, size))
    seen = np.flatnonzero(values > SEEN)[::-1]
    chosen = seen[np.unique(np.linspace(0, len(seen) - 1, AXES).round().astype(int))] if len(seen) else seen
    return (vectors[:, chosen] / size[:, None] / np.sqrt(values[chosen])).T


def _room(shooting: Shooting, q: np.ndarray, d: np.ndarray) -> float:
    """Share of a step that stays near and inside the bounds on both sides."""
    free = shooting.free
    near = FARTHEST * np.where(free.logarithmic, 1.0, np.maximum(np.abs(q), 1.0))
    room = np.minimum(near, np.minimum(q - free.scaled(free.lower), free.scaled(free.upper) - q))
    return float(np.min(np.where(np.abs(d) > room, room / np.where(d == 0, 1.0, np.abs(d)), 1.0)))


def _unfinished(sigmas: float) -> Finding:
    return Finding("no_minimum", (), (
        f"identify: this is no minimum. The derivatives still promise one {sigmas:.2g} sigmas away, and no step finds "
        "it: they may be wrong where a contact or a valve is steep, or the runs chaotic. No sigma is given. Start "
        "nearer, shorten the recordings, or give a smaller step."
    ))  # fmt: skip


def _not_followed(names, d: np.ndarray, ratio: float) -> Finding:
    most = int(np.argmax(np.abs(d)))
    return Finding("no_minimum", (names[most],), (
        f"identify: the runs do not follow their derivatives here. A change of {names[most]} by {abs(d[most]):.2g} of "
        f"it should cost what one sigma costs, and costs {ratio:.2g} times as much, as where a contact or a valve is "
        "steep or a run chaotic. No sigma is given. Shorten the recordings, give a smaller step, or fix the parameter."
    ))  # fmt: skip
