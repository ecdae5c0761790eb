"""Which of several starts a fit goes on from: the one whose first steps lead lowest.

What a start costs says little of where it leads. Where an effect does nothing, as a limit that nothing reaches, or
hardly anything, that costs as much as the structure without it, and no derivative leads on; where it acts the base,
which has bent to hide it, makes even its right size dear, until the first step moves both. Windows, whose start states
are free and beside which the base has hardly bent, and looks at what promises little go on from the cheapest one: steps
from all of them take as long as a look.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.identification.least_squares import Minimum, minimise
from hydrotwin.identification.shooting import Shooting
from hydrotwin.models.language.errors import SolveError

STEPS = 2  # of every start, after which the lowest goes on
DEAR = 10.0  # times what the cheapest start costs: from what costs more so few steps do not lead below the others
SHARE = 0.5  # of the seconds of a fit: what choosing its start may take
LOST = 0.1  # of the runs that may diverge at a start from which derivatives lead on


def lowest(
    shooting: Shooting,
    points: Sequence[np.ndarray],
    z: np.ndarray,
    rules: Mapping[str, float],
    until: float,
    tries: bool = True,
) -> Minimum:
    """The minimum to which that start leads whose first steps lead lowest.

    points : scaled parameters of the starts; z : scaled start states. rules : of `minimise`, its most iterations among
    them; until : the end of the fit [s], as of `time.process_time`. tries : False: from the cheapest start whose
    derivatives lead on. Raises SolveError where all runs of every start diverge.
    """
    points = [q for k, q in enumerate(points) if not any(np.array_equal(q, other) for other in points[:k])]
    if len(points) == 1:
        return minimise(shooting, points[0], z, **rules, until=until)
    found = _first_steps(shooting, points, z, {**rules, "most": STEPS if tries else 0}, until)
    left = rules["most"] - found.iterations
    if found.converged or left <= 0 or time.process_time() > until:
        return found
    return minimise(shooting, found.q, found.z, **{**rules, "most": left}, until=until, at=found.at)


def _first_steps(shooting: Shooting, points: list, z: np.ndarray, rules: Mapping, until: float) -> Minimum:
    """The lowest of where a few steps from the starts lead, the cheapest first while there is time.

    Far from the machine a free run may be so sensitive that its derivatives explode, though it ends nearby: from where
    they do so in fewer runs, more of them lead on.
    """
    now = time.process_time()
    soon = now + SHARE * (until - now)
    costs: list[float] = []
    for q in points:
        costs.append(shooting.cost(q, z, DEAR * min(costs, default=np.inf)))
        if time.process_time() > soon:
            break  # so stiff that the first few must do
    found, failed = [], None
    for k in np.argsort(costs, kind="stable"):
        if found and (time.process_time() > soon or costs[k] > DEAR * min(costs)):
            break
        try:
            found.append(minimise(shooting, points[k], z, **rules, until=until))
            if not rules["most"] and found[-1].at.diverged.mean() < LOST:
                break
        except SolveError as error:
            failed = error
    if not found:
        raise failed
    return min(found, key=lambda m: (m.at.diverged.sum(), m.cost))
