"""A block that takes the mean of its inputs over a period, stepped many times in it; in CasADi, for kinds of NARX.

    y[k+1], x[k+1] = slow(y[k], x[k], mean of u over period k)

What an input does between two samples of a long period is lost where one of them stands for all of it: a jump counts as
if it came at the sample, and an output that integrates keeps the difference. Here the period is parted into n steps.
After j of them the output is on its way:

    y(t) = y[k] + j/n (slow(y[k], x[k], mean of the inputs of these j steps) - y[k])

After n of them it is exactly what the slow step gives. States: y(t) in place of y[k], x[k], what y moved since the
period began, the sum of the inputs since then, and j. A measured y(t) may stand in for the state: y[k] follows from it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal, StateVariable

from .steady_step import measured_states

STEPS = "substeps"  # in the counts of a block: steps of a period; none: one


def slow_structure(structure: Mapping[str, int]) -> dict[str, int]:
    """The counts of the slow step."""
    return {name: count for name, count in structure.items() if name != STEPS}


def substep_states(states: Sequence[StateVariable], inputs: Sequence[Signal]) -> tuple[StateVariable, ...]:
    """Those of the slow step and what is carried through a period."""
    own = [states[j] for j in measured_states(states)]
    more = [StateVariable(f"{s.name}.moved", s.unit, "since the period began") for s in own]
    more += [StateVariable(f"{s.name}.sum", s.unit, "of the inputs since the period began") for s in inputs]
    return (*states, *more, StateVariable("substep", "1", "steps since the period began"))


def with_substeps(
    step: ca.Function, start: ca.Function, states: Sequence[StateVariable], inputs: Sequence[Signal], steps: int
) -> tuple[ca.Function, ca.Function]:
    """Step and start of the block with ``steps`` in a period; ``states`` are all of `substep_states`."""
    nx, nu = step.size1_in(0), len(inputs)
    own = measured_states(states[:nx])
    if len(states) != nx + len(own) + nu + 1:
        raise DataError(
            f"block of {steps} steps in a period: {len(states)} states, not {nx + len(own) + nu + 1}. "
            "Write the block again with write_block."
        )
    x, u, p = (ca.SX.sym(name, n) for name, n in (("x", len(states)), ("u", nu), ("p", step.size1_in(2))))
    slow, moved, sums, done = ca.vertsplit(x, [0, nx, nx + len(own), nx + len(own) + nu, len(states)])
    begun = ca.vertsplit(slow)
    for n, j in enumerate(own):
        begun[j] -= moved[n]
    sums, done = sums + u, done + 1
    following = ca.vertsplit(step(ca.vertcat(*begun), sums / done, p)[0])
    ends = done > steps - 0.5
    way = [done / steps * (following[j] - begun[j]) for j in own]
    after = [ca.if_else(ends, new, old) for new, old in zip(following, ca.vertsplit(slow), strict=True)]
    for n, j in enumerate(own):
        after[j] = ca.if_else(ends, following[j], begun[j] + way[n])
    kept = [ca.if_else(ends, 0, value) for value in (*way, *ca.vertsplit(sums), done)]
    y = ca.vertcat(*(x[j] for j in own))
    stepped = ca.Function("step", [x, u, p], [ca.densify(ca.vertcat(*after, *kept)), y], ["x", "u", "p"],
                          ["x_next", "y"])  # fmt: skip
    y_first = ca.SX.sym("y", start.size1_in(1))
    first = ca.vertcat(start(u, y_first, p), ca.SX.zeros(len(states) - nx))
    return stepped, ca.Function("start", [u, y_first, p], [ca.densify(first)], ["u", "y", "p"], ["x"])
