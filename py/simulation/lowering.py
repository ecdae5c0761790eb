"""`lower`: a model as a sampled Block, for those who need one CasADi function per period."""

from __future__ import annotations

import itertools
import math

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel, StateVariable
from hydrotwin.models.language.provenance import lasting

from . import equations, stiffness
from .block import Block

METHODS = ("explicit", "implicit")


def lower(model, period: float, method: str = "explicit") -> Block:
    """A model as a Block with the given sample period [s].

    One step of the block takes ceil(period / model.step) equal substeps, with every input held from one sample to the
    next: at the block's own samples it equals `simulate` on held inputs. An input with dead time becomes a delay
    line of past samples in the state, long enough for the upper bound of the dead time (for its value when there is
    no bound), exact for every dead time in between. States that an output measures start from that output; where
    its first sample is missing (nan) they start where the model's initialisation puts them.

    Nothing is refined inside a step: where contacts or steep valves matter, `simulate` is right.

    Raises DeclarationError for an unknown method, a period that is not positive, or explicit steps in which a mode
    grows that decays at the model's start.
    """
    flat = getattr(model, "flat", model)
    if method not in METHODS:
        raise DeclarationError(f"{flat.name}: no block method '{method}'. {nearest(method, METHODS)}")
    if not 0 < period < math.inf:
        raise DeclarationError(f"{flat.name}: the period must be positive (got {period} s). Give seconds, as 0.01.")
    if method == "explicit":
        _refuse_unstable(flat, period)
    delays = enumerate(equations.delays(flat))
    lines = {j: _line_length(flat, delay, period) for j, delay in delays if delay is not None}
    return Block(
        name=flat.name,
        inputs=flat.inputs,
        outputs=flat.outputs,
        states=flat.states + tuple(_line_states(flat, lines)),
        parameters=flat.parameters,
        step=_step(flat, lines, period, method),
        start=_start(flat, lines),
        period=period,
        description=flat.description,
        provenance=lasting(flat.provenance, f"stepped every {period:g} s as a block")
        | {"lowered_from": flat.name, "method": method, "step": flat.step},
    )


def _refuse_unstable(flat: FlatModel, period: float) -> None:
    h = period / _count(flat, period)
    u, p = np.array([s.default for s in flat.inputs]), flat.parameter_vector()
    x = flat.start_given(())(u, p, []).full().ravel()
    if not flat.states or not np.isfinite(x).all():
        return
    modes = stiffness.decaying_modes(flat, np.zeros(1), x[None], u[None], p)
    if (stiffness.growth(h * modes) > 1 + 1e-9).any():
        raise DeclarationError(
            f"{flat.name}: a mode that decays with {np.abs(modes).max():.3g} 1/s grows in steps of {h:.3g} s. "
            "Lower it with method='implicit', or give the model a smaller step."
        )


def _count(flat: FlatModel, period: float) -> int:
    return max(math.ceil(period / flat.step - 1e-6), 1)


def _line_length(flat: FlatModel, delay: int, period: float) -> int:
    parameter = flat.parameters[delay]
    longest = parameter.bounds[1] if math.isfinite(parameter.bounds[1]) else parameter.value
    return math.ceil(longest / period - 1e-9) + 1


def _line_states(flat: FlatModel, lines: dict[int, int]) -> list[StateVariable]:
    return [
        StateVariable(f"{s.name}.past[{back}]", s.unit, f"{s.name}, {back} samples ago", s.nominal)
        for s, length in ((flat.inputs[j], length) for j, length in lines.items())
        for back in range(1, length + 1)
    ]


def _step(flat: FlatModel, lines: dict[int, int], period: float, method: str) -> ca.Function:
    kind = ca.SX if method == "explicit" else ca.MX
    substep = equations.rk4_substep(flat) if method == "explicit" else equations.implicit_substep(flat)
    x, u, p, past = _symbols(kind, flat, lines)
    count = _count(flat, period) if method == "explicit" or lines else 1
    after = x
    for i in range(count):
        cuts = _cuts(flat, lines, p, i * period / count, (i + 1) * period / count, period)
        for begin, end in itertools.pairwise(cuts):
            seen = _delayed(flat, lines, u, past, p, 0.5 * (begin + end), period)
            after = substep.call([0, after, seen, p, end - begin])[0]
    seen = _delayed(flat, lines, u, past, p, 0.0, period)
    y = equations.output(flat)(0, x, seen, p)
    shifted = [ca.vertcat(u[j], past[j][:-1]) for j in lines]
    whole, following = ca.vertcat(x, *past.values()), ca.vertcat(after, *shifted)
    return ca.Function("block_step", [whole, u, p], [following, y], ["x", "u", "p"], ["x_next", "y"])


def _symbols(kind, flat: FlatModel, lines: dict[int, int]):
    x, u, p = (kind.sym(n, len(v)) for n, v in zip("xup", (flat.states, flat.inputs, flat.parameters), strict=True))
    return x, u, p, {j: kind.sym(f"past_{j}", length) for j, length in lines.items()}


def _cuts(flat, lines, p, begin: float, end: float, period: float) -> list:
    """Where a substep begins, where delayed inputs jump inside it, in order, and where it ends."""
    cuts = []
    for delay in sorted({equations.delays(flat)[j] for j in lines}):
        jump = p[delay] + period * (ca.ceil((end - p[delay]) / period) - 1)  # the last before the end
        cuts.append(ca.fmax(begin, jump))
    for last in range(len(cuts) - 1, 0, -1):
        for i in range(last):
            cuts[i : i + 2] = ca.fmin(*cuts[i : i + 2]), ca.fmax(*cuts[i : i + 2])
    return [begin, *cuts, end]


def _delayed(flat, lines, u, past, p, instant, period: float):
    """Inputs at an instant of this period, each delayed by its dead time; u[k] holds from 0 to period."""
    seen = []
    for j in range(len(flat.inputs)):
        if j not in lines:
            seen.append(u[j])
            continue
        held = [u[j], *ca.vertsplit(past[j])]
        seen.append(_value_at(instant - p[equations.delays(flat)[j]], held, period))
    return ca.vertcat(*seen)


def _value_at(instant, held, period: float):
    """The sample that holds at ``instant``; a sample instant is met within 1e-9 of the period."""
    back = ca.fmin(ca.fmax(ca.ceil(-instant / period - 1e-9), 0), len(held) - 1)
    return sum(ca.if_else(back == k, value, 0) for k, value in enumerate(held))


def _start(flat: FlatModel, lines: dict[int, int]) -> ca.Function:
    u, p = ca.SX.sym("u", len(flat.inputs)), ca.SX.sym("p", len(flat.parameters))
    y = ca.SX.sym("y", len(flat.outputs))
    outputs = [s.name for s in flat.outputs]
    measured = [s for s in flat.states if s.measured_by in outputs]
    names = [s.name for s in flat.states]
    seen = {s.name: y[outputs.index(s.measured_by)] for s in measured}
    plain = flat.start_given(())(u, p, ca.SX(0, 1))
    first = {name: _unless_nan(value, plain[names.index(name)]) for name, value in seen.items()}
    z = [_unless_nan(value, _without(flat, name, first, u, p)[names.index(name)]) for name, value in seen.items()]
    x = flat.start_given(tuple(seen))(u, p, ca.vertcat(*z))
    past = [ca.repmat(u[j], length, 1) for j, length in lines.items()]
    return ca.Function("block_start", [u, y, p], [ca.densify(ca.vertcat(x, *past))], ["u", "y", "p"], ["x"])


def _without(flat: FlatModel, name: str, given: dict, u, p):
    """The start when all measured states but ``name`` are given: what that state adapts to."""
    others = tuple(n for n in given if n != name)
    return flat.start_given(others)(u, p, ca.vertcat(*(given[n] for n in others)))


def _unless_nan(value, otherwise):
    """``value == value`` would be simplified to true."""
    return ca.if_else(ca.logic_or(value <= 0, value > 0), value, otherwise)
