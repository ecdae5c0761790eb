"""A linear state space as a Block.

    x[k+1] = A x[k] + B u[k-d] + b
    y[k]   = C x[k] + D u[k-d] + c
    x[0]   = K y[0] + L u[0] + l

d periods of delay are states of their own, as are the sums of outputs that integrate. Where no input acts at once the
first states are the outputs themselves, so that a measured y[k] in place of them gives a proper one-step prediction.
K, L and l are the start that is told in the description: y[0] is met. Source: Ljung, System Identification (1999), 4.3.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal, StateVariable

from ..block_file import LearnedKind, Shapes, register_kind
from .arx_block import delay_line
from .regressors import Scales
from .state_space import StateSpace
from .whole_runs import Way

CONDITION = 1e8  # of the outputs' rows among the states: beyond it the outputs are no states


def state_space_states(structure: Mapping[str, int], inputs: Sequence[Signal], outputs: Sequence[Signal]) -> tuple:
    """The named states: outputs where they are states, the others by number, past inputs."""
    states, measured = [], structure["measured"]
    if measured:
        states = [StateVariable(s.name, s.unit, s.description, s.nominal, measured_by=s.name) for s in outputs]
    own = range(len(states), structure["order"])
    states += [StateVariable(f"x_{k}", "1", "state of the linear model") for k in own]
    return (*states, *delay_line(inputs, structure["delay"]))


def state_space_arrays(model: StateSpace, way: Way, scales: Scales) -> tuple[dict[str, int], dict[str, np.ndarray]]:
    """Counts and arrays of the block, SI, from a model over scales and how its runs start."""
    rates, n, nu = np.array(model.form.rates), model.order, model.B.shape[1]
    ny, sums = len(rates), int(rates.sum())
    A = np.block([[model.A, np.zeros((n, sums))], [model.C[rates], np.eye(sums)]])
    B = np.vstack([model.B, model.D[rates]])
    b = np.concatenate([np.zeros(n), model.e[rates]])
    seen = (~rates) | model.form.direct  # outputs in which w is seen at once
    C = np.hstack([model.C * seen[:, None], np.eye(ny)[:, rates]])
    D, c = model.D * seen[:, None], model.e * seen
    # the start: x = settled + gain (target - w settled); sums such that y[0] is met
    steady = np.linalg.solve(np.eye(n) - model.A, model.B)
    gain = way.gain
    to_w = model.C @ steady + model.D
    K = np.vstack([gain * ~rates, np.zeros((sums, ny))])
    L = np.vstack([steady - gain @ to_w, np.zeros((sums, nu))])
    constant = np.concatenate([-gain @ model.e, np.zeros(sums)])
    left = [-(C @ part)[rates] for part in (K, L)]
    K[n:], L[n:] = np.eye(ny)[rates] + left[0], left[1] - D[rates]
    constant[n:] = -(C @ constant)[rates] - c[rates]
    return _in_si(A, B, b, C, D, c, (K, L, constant), model, scales)


def _in_si(A, B, b, C, D, c, start, model: StateSpace, scales: Scales) -> tuple[dict, dict]:
    """Over scales to SI, and to states that begin with the outputs where they can be."""
    so, co, si, ci = scales.output_scale, scales.output_centre, scales.input_scale, scales.input_centre
    B, D, C, c = B / si, D / si * so[:, None], C * so[:, None], c * so + co
    b, c = b - B @ ci, c - D @ ci
    K, L, constant = start
    K, L = K / so, L / si
    constant = constant - K @ co - L @ ci
    ny, n = len(C), len(A)
    measured = not D.any() and ny <= n and np.linalg.cond(C / np.linalg.norm(C, axis=1)[:, None]) < CONDITION
    if measured:  # z = T x + t
        T = np.vstack([C, np.linalg.svd(C)[2][ny:]])
        t, back = np.concatenate([c, np.zeros(n - ny)]), np.linalg.inv(T)
        A, B, b = T @ A @ back, T @ B, T @ b + t - T @ A @ back @ t
        C, c = np.eye(ny, n), np.zeros(ny)
        K, L, constant = T @ K, T @ L, T @ constant + t
    arrays = {"A": A, "B": B, "state_constant": b, "C": C, "D": D, "output_constant": c}
    arrays |= {"start_output": K, "start_input": L, "start_constant": constant}
    return {"order": n, "delay": model.form.delay, "measured": int(measured)}, arrays


def _shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    n, delay, measured = structure["order"], structure["delay"], structure["measured"]
    if len(structure) != 3 or n < 1 or delay < 0 or measured not in (0, 1):
        raise TypeError("no counts of states, delay and whether the outputs are states")
    return {
        "A": (n, n),
        "B": (n, inputs),
        "state_constant": (n,),
        "C": (outputs, n),
        "D": (outputs, inputs),
        "output_constant": (outputs,),
        "start_output": (n, outputs),
        "start_input": (n, inputs),
        "start_constant": (n,),
    }


def _functions(arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]) -> tuple[ca.Function, ca.Function]:
    a = {name: ca.DM(values) for name, values in arrays.items()}
    (n, nu), ny, delay = arrays["B"].shape, len(arrays["C"]), structure["delay"]
    z, u, p = ca.SX.sym("x", n + nu * delay), ca.SX.sym("u", nu), ca.SX.sym("p", 0)
    x, line = z[:n, :], ca.vertcat(u, z[n:, :])
    late = line[nu * delay :, :]
    read = ca.mtimes(a["C"], x) + ca.mtimes(a["D"], late) + a["output_constant"]
    y = x[:ny, :] if structure["measured"] else read
    moved = ca.mtimes(a["A"], x) + ca.mtimes(a["B"], late) + a["state_constant"]
    x_next = ca.vertcat(moved, line[: nu * delay, :])
    step = ca.Function("step", [z, u, p], [ca.densify(x_next), ca.densify(y)], ["x", "u", "p"], ["x_next", "y"])
    first = ca.SX.sym("y", ny)
    begin = ca.mtimes(a["start_output"], first) + ca.mtimes(a["start_input"], u) + a["start_constant"]
    if structure["measured"]:
        begin[:ny] = first
    start = ca.vertcat(begin, ca.repmat(u, delay, 1))
    return step, ca.Function("start", [u, first, p], [ca.densify(start)], ["u", "y", "p"], ["x"])


LINEAR = register_kind(LearnedKind("linear", 1, _shapes, _functions))
