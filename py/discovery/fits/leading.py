"""Which of several starts a fit begins at, and where it begins anew when that one led nowhere.

The cheapest start comes first. Where an effect does nothing, as a limit that nothing reaches, that costs as much as the
structure without it, often less than where the effect is too large, and no derivative leads on from there. From where
it hardly acts the first step may lead to such a place, too. So starts where all effects act come before others, and a
fit that ends where one acts nowhere begins anew from a dearer one.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np

from hydrotwin.identification.shooting import Linearisation, Shooting
from hydrotwin.models.language.errors import SolveError

COSTLY = 0.1  # of the seconds of a fit: what choosing its start may take
IDLE = 1e-6  # nats, twice what moving a scaled parameter by one changes: one that changes less does nothing
ANEW = 2  # starts from which a fit begins anew, at most
Ended = TypeVar("Ended")


def leading_first(
    shooting: Shooting, points: Sequence[np.ndarray], z: np.ndarray, effects: np.ndarray, until: float
) -> tuple[list[np.ndarray], Linearisation | None]:
    """Scaled parameters of starts, the cheapest from which derivatives lead on first; the expansion there.

    Far from the machine a free run may be so sensitive that its derivatives explode, though it ends nearby. z : scaled
    start states. effects : (np,) which parameters are those of effects. until : the end of the fit [s], as of
    `time.process_time`. Starts that are known to lack something are last, and where all do the one that lacks least
    is first. The expansion is None where only one start is given.
    """
    points = [q for k, q in enumerate(points) if not any(np.array_equal(q, other) for other in points[:k])]
    if len(points) == 1:
        return points, None
    began, costs = time.process_time(), []
    soon = began + COSTLY * (until - began)
    for q in points:
        costs.append(shooting.cost(q, z, min(costs, default=np.inf)))  # of the dearer ones no more need be known
        if time.process_time() > soon:
            break  # so stiff that the first few must do
    points = [points[k] for k in np.argsort(costs, kind="stable")]
    seen: list[tuple[tuple[int, int], Linearisation]] = []
    for q in points:
        if len(seen) > 1 and time.process_time() > soon:
            break
        at = shooting.linearise(q, z)
        seen.append(((int(at.diverged.sum()), idle(at, effects)), at))
        if seen[-1][0] == (0, 0):
            break
    first = min(range(len(seen)), key=lambda k: seen[k][0])
    ranked = [points[first], *points[len(seen) :], *(q for k, q in enumerate(points[: len(seen)]) if k != first)]
    return ranked, seen[first][1]


def idle(at: Linearisation, effects: np.ndarray) -> int:
    """How many of the parameters that ``effects`` (np,) names change nothing."""
    curvature = np.einsum("skk->k", at.hessian)[: len(effects)]
    return int((curvature[effects] < IDLE).sum())


def least(
    descents: Sequence[Callable[[], Ended]], acts: Callable[[Ended], bool], cost: Callable[[Ended], float]
) -> Ended:
    """Where a fit ends from the first of its starts, or anew from the next ones where an effect acts nowhere there."""
    best = descents[0]()
    if acts(best):
        return best
    for descend in descents[1 : 1 + ANEW]:
        with contextlib.suppress(SolveError):
            other = descend()
            best = min(best, other, key=cost)
            if acts(other):
                break
    return best
