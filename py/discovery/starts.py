"""Where the fits of a structure begin: its starts by cost, and those of stiff equations brought within reach.

A probe has a size that is usual for its effect. Beside a lightly damped oscillation that may be a thousand times what
the recordings leave room for, and make the equations so stiff that one sensitivity run takes minutes: play through
which a rod swings at every period. Such a structure gets few iterations, and none of them would come back from there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hydrotwin.identification.descent import Task, undecided, whole_runs
from hydrotwin.identification.shooting import Shooting
from hydrotwin.models.language.flat import FlatModel

REACH = 10.0  # times the cost without the effect
SHORTER, TIMES = 4.0, 5


def by_cost(
    task: Task, starts: Sequence[Mapping[str, float]], states: Sequence[Mapping[str, float]], base: Mapping[str, float]
) -> tuple[Task, list[np.ndarray]]:
    """Scaled parameters of the starts in order of cost, and the task that integrates them as they need.

    What a start does not say is as in the task. ``states`` as in `given`; ``base``: parameters of no effect, by path.
    """
    free = task.free
    first = dict(zip(free.names, free.start.tolist(), strict=True))
    starts = [{**first, **inside(task.flat, start)} for start in starts]

    def point(task: Task, values: Mapping[str, float]) -> tuple[float, np.ndarray]:
        shooting, z = whole_runs(task)
        q = free.scaled(np.array([values[n] for n in free.names]))
        return shooting.cost(q, given(shooting, z, states)), q

    points = [point(task, values) for values in starts]
    own = {p.name: p.value for p in task.flat.parameters if p.name in first and p.name not in base}
    if own and task.propagator.method == "rosenbrock":
        neutral = inside(task.flat, own)
        starts = [within_reach(lambda v: point(undecided(task), v)[0], values, neutral) for values in starts]
        task = undecided(task)
        points = [point(task, values) for values in starts]
    return task, different(points)


def within_reach(
    cost: Callable[[Mapping[str, float]], float], start: Mapping[str, float], neutral: Mapping[str, float]
) -> Mapping[str, float]:
    """``start`` with the effect's parameters moved to their ``neutral`` values until it costs no more than `REACH`."""
    limit = REACH * cost({**start, **neutral})
    for _ in range(TIMES):
        if cost(start) <= limit:
            break
        start = {**start, **{n: v + (start[n] - v) / SHORTER for n, v in neutral.items()}}
    return start


def different(points: Sequence[tuple[float, np.ndarray]]) -> list[np.ndarray]:
    """The points of (cost, point) in order of cost, each cost once.

    Stops and opening pressures that nothing reaches all cost what the base does, often less than a start that does
    something: all of them together are one start, or none of the others would be followed.
    """
    kept: list[tuple[float, np.ndarray]] = []
    for cost, q in sorted(points, key=lambda pair: pair[0]):
        if not kept or not np.isclose(cost, kept[-1][0], rtol=1e-9, atol=0.0):
            kept.append((cost, q))
    return [q for _, q in kept]


def given(shooting: Shooting, z: np.ndarray, states: Sequence[Mapping[str, float]]) -> np.ndarray:
    """Scaled start states z with those put in that are known by name, one mapping per recording."""
    z = z.copy()
    for i, known in enumerate(states):
        for j, (name, nominal) in enumerate(zip(shooting.start.names, shooting.start.nominal, strict=True)):
            if name in known:
                z[i, j] = known[name] / nominal
    return z


def inside(flat: FlatModel, values: Mapping[str, float]) -> dict[str, float]:
    """Values clipped to the parameters' bounds."""
    known = {p.name: p.bounds for p in flat.parameters}
    return {name: float(np.clip(v, *known[name])) for name, v in values.items()}
