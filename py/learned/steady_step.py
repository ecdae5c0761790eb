"""The parts of a block's step that keep an integrating output from drifting; in CasADi, for every kind of block.

    y[k+1] = trained(x[k], u[k]) + T c(u[k])     c: 1, u and max(u - kink, 0) of every input, by their rates; 0 at rest
    y[k+1] = y[k]     where all inputs, delayed ones too, are those of a rest, and |y[k+1] - y[k]| <= increment

``increment`` is what the step drifts by at rest. A machine that still moves faster than that runs on.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal, StateVariable

KINKS, RATES = "drift_kinks", "drift_rates"
LEVELS, WIDTH, INCREMENT = "rest_levels", "rest_width", "rest_increment"
CURVE, REST = (KINKS, RATES), (LEVELS, WIDTH, INCREMENT)


def measured_states(states: Sequence[StateVariable]) -> list[int]:
    """The states that are outputs, where a measured value can stand in for them."""
    return [j for j, s in enumerate(states) if s.measured_by]


def bent(u, kinks: np.ndarray) -> list:
    """1, and u and max(u - kink, 0) of every input; ``kinks`` (n, nu), ``u`` a sequence of nu columns or symbols."""
    larger = ca.fmax if isinstance(u[0], ca.SX | ca.MX) else np.maximum
    columns = [part for i, column in enumerate(u) for part in (column, *(larger(column - k, 0) for k in kinks[:, i]))]
    return [0 * u[0] + 1, *columns]


def near_rest(arrays: Mapping[str, np.ndarray], u: np.ndarray) -> np.ndarray:
    """Whether inputs (n, nu) are those of a rest, (n,)."""
    if LEVELS not in arrays:
        return np.zeros(len(u), dtype=bool)
    return (np.abs(u[:, None, :] - arrays[LEVELS]) <= arrays[WIDTH]).all(axis=2).any(axis=1)


def steady_arrays(
    arrays: Mapping[str, np.ndarray], inputs: int, states: Sequence[StateVariable], where: str
) -> dict[str, np.ndarray]:
    """Those among ``arrays`` that `steadied` takes, with their shapes checked."""
    kept = [n for part in (CURVE, REST) if part[0] in arrays for n in part]
    found = {name: np.array(arrays.get(name, np.nan), dtype=float) for name in kept}
    kinks, levels = (len(np.atleast_1d(found.get(name, 0.0))) for name in (KINKS, LEVELS))
    outputs = len(measured_states(states))
    shapes = {KINKS: (kinks, inputs), RATES: (1 + inputs * (1 + kinks), outputs)}
    shapes |= {LEVELS: (levels, inputs), WIDTH: (inputs,), INCREMENT: (outputs,)}
    for name, array in found.items():
        if array.shape != shapes[name] or not np.isfinite(array).all():
            raise DataError(
                f"{where}: array '{name}' is not finite or has the wrong shape (got {array.shape}, not "
                f"{shapes[name]}). Write the block again with write_block."
            )
    return found


def steadied(
    step: ca.Function,
    arrays: Mapping[str, np.ndarray],
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    states: Sequence[StateVariable],
    period: float,
) -> ca.Function:
    """``step`` (x, u, p) -> (x_next, y) with what the arrays of `steady_arrays` say."""
    kind = ca.SX if step.is_a("SXFunction") else ca.MX
    x, u, p = (kind.sym(name, step.size1_in(k)) for k, name in enumerate("xup"))
    x_next, y = (ca.vertsplit(part) for part in step(x, u, p))
    rest = LEVELS in arrays
    now = _near(arrays, [(u[i], i) for i in range(len(inputs))]) if rest else 0
    resting = _near(arrays, _line(x, u, inputs, states)) if rest else None
    for n, j in enumerate(measured_states(states)):
        extra = ca.if_else(now, 0, _extra(arrays, u, n)) if KINKS in arrays else 0.0
        x_next[j] = _held(x_next[j] + period * extra - x[j], resting, arrays, n) + x[j]
        for k, state in enumerate(states):
            x_next[k] = x_next[j] if state.name == f"{states[j].name}.expected" else x_next[k]
        for k, output in enumerate(outputs):
            if output.name == f"{states[j].measured_by}.slope":
                y[k] = _held(period * (y[k] + extra), resting, arrays, n) / period
    following = [ca.densify(ca.vertcat(*part)) for part in (x_next, y)]
    return ca.Function("step", [x, u, p], following, ["x", "u", "p"], ["x_next", "y"])


def _extra(arrays, u, n: int):
    """The curve's rate for measured state number ``n``."""
    rates = arrays[RATES][:, n]
    return sum(float(c) * part for c, part in zip(rates, bent(ca.vertsplit(u), arrays[KINKS]), strict=True))


def _held(moved, resting, arrays, n: int):
    """What a state moves by, none where it rests."""
    if resting is None:
        return moved
    return ca.if_else(ca.logic_and(resting, ca.fabs(moved) <= float(arrays[INCREMENT][n])), 0, moved)


def _line(x, u, inputs: Sequence[Signal], states: Sequence[StateVariable]) -> list[tuple]:
    """Every input, now and at its delays, with its number."""
    line = [(u[i], i) for i in range(len(inputs))]
    for i, signal in enumerate(inputs):
        line += [(x[j], i) for j, s in enumerate(states) if s.name.startswith(f"{signal.name}.lag_")]
    return line


def _near(arrays, values: Sequence[tuple]):
    """Whether all of (value, number of its input) are near one of the levels."""
    answer = 0
    for level in arrays[LEVELS]:
        together = 1
        for value, i in values:
            together = ca.logic_and(together, ca.fabs(value - float(level[i])) <= float(arrays[WIDTH][i]))
        answer = ca.logic_or(answer, together)
    return answer
