"""A valve's characteristic in six numbers, as a Block: deadband, two slopes, two saturations; after a dead time.

    f(u) = low  clip((b - u)/(b - a), 0, 1)  +  high clip((u - c)/(d - c), 0, 1),      a < b <= c < d

Between b and c nothing moves; below a and above d the rate stays at ``low`` and ``high``.

    y' = f(u(t - T_d))   (integrating)      or      y = f(u(t - T_d))

A dead time that ends inside a step mixes the two samples it lies between; for a held input the integral is exact.
Source: Aranovskiy, Proc. 21st Mediterranean Conf. Control Automation (2013) 82-87; Nurmi, Mattila (2017).
"""

from __future__ import annotations

from collections.abc import Mapping

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal, StateVariable

from ..block_file import LearnedKind, Shapes, register_kind


def whole_and_share(dead_time: float, period: float) -> tuple[int, float]:
    """Whole periods of a dead time, and the share of a period that is left."""
    steps = dead_time / period
    whole = int(np.floor(steps + 1e-9))
    return whole, max(steps - whole, 0.0)


def piecewise_states(structure: Mapping[str, int], input_: Signal, output: Signal) -> tuple[StateVariable, ...]:
    """The named states: the output where it integrates, and the delay line."""
    first = StateVariable(output.name, output.unit, output.description, output.nominal, measured_by=output.name)
    lags = range(1, structure["delay"] + 1)
    line = [StateVariable(f"{input_.name}.lag_{k}", input_.unit, f"input {k} periods ago") for k in lags]
    return tuple([first, *line] if structure["integrating"] else line)


def _shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    _ = structure["delay"], structure["integrating"]
    return {"edges": (4,), "rates": (2,), "dead_time": (1,), "period": (1,)}


def _functions(arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]) -> tuple[ca.Function, ca.Function]:
    a, b, c, d = (float(edge) for edge in arrays["edges"])
    low, high = (float(rate) for rate in arrays["rates"])
    h, lags, integrating = float(arrays["period"][0]), structure["delay"], bool(structure["integrating"])
    whole, share = whole_and_share(float(arrays["dead_time"][0]), h)

    def f(u):
        down, up = ((b - u) / (b - a), (u - c) / (d - c))
        return low * ca.fmin(ca.fmax(down, 0), 1) + high * ca.fmin(ca.fmax(up, 0), 1)

    x, u, p = ca.SX.sym("x", integrating + lags), ca.SX.sym("u"), ca.SX.sym("p", 0)
    late = ca.vertcat(u, x[int(integrating) :])
    now = (1 - share) * f(late[whole]) + share * f(late[whole + 1])
    moved, y = ([x[0] + h * now], x[0]) if integrating else ([], now)
    step = ca.Function("step", [x, u, p], [ca.vertcat(*moved, late[:-1]), y], ["x", "u", "p"], ["x_next", "y"])
    first = ca.SX.sym("y")
    begin = ca.vertcat(*([first] if integrating else []), ca.repmat(u, lags, 1))
    return step, ca.Function("start", [u, first, p], [begin], ["u", "y", "p"], ["x"])


PIECEWISE = register_kind(LearnedKind("piecewise", 1, _shapes, _functions))
