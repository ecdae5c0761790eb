"""An ARX equation per output as a Block, free-running.

    w[k+1] = w[k] + c + F0 w[k] + sum_i Fi (w[k-i+1] - w[k-i]) + sum_j Bj u[k-j]
    y[k]   = w[k] + D u[k]

F0 and the Fi are diagonal: each output has its own past and all inputs. An output with F0 = 0 integrates, exactly. D is
zero unless an input acts at once; then w is the output without what acts at once, else the output itself. Past
increments of w are states, so that a measured y[k] in place of the state gives a proper one-step prediction. Before the
run all was as in its first sample. Source: Ljung, System Identification (1999), section 4.2.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal, StateVariable

from ..block_file import LearnedKind, Shapes, register_kind


def delay_line(inputs: Sequence[Signal], lags: int) -> list[StateVariable]:
    """Past inputs as named states, the latest first."""
    return [
        StateVariable(f"{s.name}.lag_{lag}", s.unit, f"input {lag} periods ago")
        for lag in range(1, lags + 1)
        for s in inputs
    ]


def arx_states(structure: Mapping[str, int], inputs: Sequence[Signal], outputs: Sequence[Signal]) -> tuple:
    """The named states: outputs, or what of them does not act at once; past increments; past inputs."""
    if structure["direct"]:
        states = [StateVariable(f"{s.name}.before_input", s.unit, "without what acts at once") for s in outputs]
    else:
        states = [StateVariable(s.name, s.unit, s.description, s.nominal, measured_by=s.name) for s in outputs]
    for lag in range(1, structure["increments"] + 1):
        states += [StateVariable(f"{s.name}.increment_{lag}", s.unit, f"increment {lag} periods ago") for s in outputs]
    return (*states, *delay_line(inputs, structure["input_lags"]))


def _shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    increments, lags, direct = structure["increments"], structure["input_lags"], structure["direct"]
    if len(structure) != 3 or min(increments, lags) < 0 or direct not in (0, 1):
        raise TypeError("no counts of increments, lags of the inputs and what acts at once")
    return {
        "constant": (outputs,),
        "level": (outputs,),
        "increments": (increments, outputs),
        "inputs": (lags + 1, outputs, inputs),
        "direct": (outputs, inputs),
    }


def _functions(arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]) -> tuple[ca.Function, ca.Function]:
    ny, nu = arrays["direct"].shape
    increments, lags = structure["increments"], structure["input_lags"]
    x, u, p = ca.SX.sym("x", ny * (1 + increments) + nu * lags), ca.SX.sym("u", nu), ca.SX.sym("p", 0)
    w, past, late = ca.vertsplit(x, [0, ny, ny * (1 + increments), x.numel()])
    line = ca.vertcat(u, late)
    moved = ca.DM(arrays["constant"]) + ca.DM(arrays["level"]) * w
    for i in range(increments):
        moved += ca.DM(arrays["increments"][i]) * past[i * ny : (i + 1) * ny]
    for j in range(lags + 1):
        moved += ca.mtimes(ca.DM(arrays["inputs"][j]), line[j * nu : (j + 1) * nu])
    direct = ca.DM(arrays["direct"])
    kept = ca.vertcat(moved, past)[: ny * increments, :]  # two indices: [:0] of a scalar is (1, 0)
    x_next = ca.vertcat(w + moved, kept, line[: nu * lags, :])
    y = w + ca.mtimes(direct, u) if structure["direct"] else w
    step = ca.Function("step", [x, u, p], [ca.densify(x_next), ca.densify(y)], ["x", "u", "p"], ["x_next", "y"])
    first = ca.SX.sym("y", ny)
    w_first = first - ca.mtimes(direct, u) if structure["direct"] else first
    begin = ca.vertcat(w_first, ca.SX.zeros(ny * increments), ca.repmat(u, lags, 1))
    return step, ca.Function("start", [u, first, p], [ca.densify(begin)], ["u", "y", "p"], ["x"])


ARX = register_kind(LearnedKind("arx", 1, _shapes, _functions))
