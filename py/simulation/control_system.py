"""To python-control and back: a model or Block as a `control.NonlinearIOSystem`, a discrete controller as a Block."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence

import casadi as ca
import control
import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import Signal, StateVariable

from . import equations
from .block import Block

TRACE_POINTS = 3


def to_control(model) -> control.NonlinearIOSystem:
    """A model (continuous) or Block (discrete, ``dt`` its period) with its signal, state and parameter names, in SI.

    Parameters are those of python-control: ``control.input_output_response(..., params={"motor.gain": 110.0})``.
    Start states are not carried over: give ``X0``, for instance ``model.equilibrium()``.

    Raises
    ------
    DeclarationError : an input has a dead time, which a continuous system cannot hold.
    """
    if isinstance(model, Block):
        following, y = (lambda t, x, u, p, k=k: model.step(x, u, p)[k] for k in (0, 1))
        return _system(model, following, y, model.period)
    flat = getattr(model, "flat", model)
    for signal, position in zip(flat.inputs, equations.delays(flat), strict=True):
        if position is not None and flat.parameters[position].value > 0:
            raise DeclarationError(
                f"{flat.name}.{signal.name}: an input with dead time has no continuous state "
                f"(got {flat.parameters[position].value} s). Lower the model first: to_control(lower(model, period))."
            )
    t, x, u, p = equations.symbols(flat)
    rate = ca.Function("rate", [t, x, u, p], [equations.rate(flat, t, x, u, p)])
    return _system(flat, rate, equations.output(flat), 0)


def _system(source, update, output, dt: float) -> control.NonlinearIOSystem:
    names = [q.name for q in source.parameters]

    def evaluated(function):
        def call(t, x, u, params):
            values = [params[name] for name in names]
            found = function(t, ca.vertcat(*np.ravel(x)), ca.vertcat(*np.ravel(u)), ca.DM(values))
            return found.full().ravel() if isinstance(found, ca.DM) else np.array(ca.vertsplit(found), dtype=object)

        return call

    return control.NonlinearIOSystem(
        evaluated(update),
        evaluated(output),
        params={q.name: q.value for q in source.parameters},
        states=[s.name for s in source.states],
        inputs=[s.name for s in source.inputs],
        outputs=[s.name for s in source.outputs],
        name=source.name,
        dt=dt,
    )


def from_control(
    system,
    period: float | None = None,
    *,
    units: Mapping[str, str] | None = None,
    start: Mapping[str, float] | None = None,
) -> Block:
    """A controller of python-control as a Block.

    Discrete `StateSpace` and `TransferFunction` systems are taken over exactly; continuous ones are sampled with
    ``period`` for inputs that are held between samples (exact, too). A discrete `NonlinearIOSystem` becomes one
    expression when its functions can be called with symbols and give the same numbers.

    units : SI unit of signals and states by name, "1" where not given. start : start states by name, 0 where not given.

    Raises
    ------
    DeclarationError : no period, two different ones, an unknown name, or a function that does not take symbols.
    """
    if isinstance(system, (control.StateSpace, control.TransferFunction)):
        system, period = _sampled(system, period)
        x, u = ca.SX.sym("x", system.nstates), ca.SX.sym("u", system.ninputs)
        a, b, c, d = (ca.sparsify(ca.DM(m)) for m in (system.A, system.B, system.C, system.D))
        following, y = a @ x + b @ u, c @ x + d @ u
    elif isinstance(system, control.NonlinearIOSystem):
        period = _period(system, period)
        x, u, following, y = _traced(system)
    else:
        raise DeclarationError(
            f"from_control: {type(system).__name__} is no system with states. "
            "Give a control.StateSpace, control.TransferFunction or discrete control.NonlinearIOSystem."
        )
    return _block(system, period, (x, u, following, y), units or {}, start or {})


def _period(system, period: float | None) -> float:
    own = None if system.dt in (None, True) else float(system.dt)
    if own == 0:
        raise DeclarationError(
            f"{system.name}: the system is continuous. Write its functions as a difference equation and give dt."
        )
    if own and period and not math.isclose(own, period, rel_tol=1e-9):
        raise DeclarationError(f"{system.name}: the period is {period} s, the system's own dt is {own} s. Give one.")
    if not (own or period):
        raise DeclarationError(f"{system.name}: no period is known (got dt={system.dt}). Give period=... in s.")
    return own or float(period)


def _sampled(system, period: float | None):
    """The discrete state space of a linear system and its period."""
    if isinstance(system, control.TransferFunction):
        if not system.issiso():
            raise DeclarationError(
                f"{system.name}: a transfer function with {system.ninputs} inputs and {system.noutputs} outputs. "
                "Give its state space: control.ss(...)."
            )
        system = control.ss(system, inputs=system.input_labels, outputs=system.output_labels, name=system.name)
    if system.isctime(strict=True):
        if not period:
            raise DeclarationError(f"{system.name}: the system is continuous. Give period=... in s to sample it.")
        names = {"states": system.state_labels, "inputs": system.input_labels, "outputs": system.output_labels}
        system = control.sample_system(system, period, method="zoh", name=system.name, **names)
    return system, _period(system, period)


def _traced(system):
    """State, input, next state and output of a nonlinear system as expressions."""
    if not system.nstates and system.nstates != 0:
        raise DeclarationError(f"{system.name}: the number of states is not known. Give states=... to the system.")
    x, u = ca.SX.sym("x", system.nstates), ca.SX.sym("u", system.ninputs)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", FutureWarning)  # CasADi on NumPy functions of symbols, which are meant here
            following, y = (_column(f(system, 0.0, _objects(x), _objects(u))) for f in (_update, _output))
    except Exception as error:  # whatever the user's function raises when it is given symbols
        raise DeclarationError(
            f"{system.name}: its functions do not take symbols (got {type(error).__name__}: {error}). Write them with "
            "arithmetic and NumPy functions, casadi.if_else for a choice, casadi.fmin and fmax for limits."
        ) from error
    _check_trace(system, x, u, following, y)
    return x, u, following, y


def _update(system, t, x, u):
    return system.updfcn(t, x, u, system.params)


def _output(system, t, x, u):
    return x if system.outfcn is None else system.outfcn(t, x, u, system.params)


def _objects(symbols: ca.SX) -> np.ndarray:
    found = np.empty(symbols.shape[0], dtype=object)
    for k in range(symbols.shape[0]):
        found[k] = symbols[k]
    return found


def _column(values) -> ca.SX:
    if isinstance(values, ca.SX):
        return ca.vec(values)
    return ca.SX(ca.vertcat(*(e for v in np.atleast_1d(np.asarray(values, dtype=object)).ravel() for e in _parts(v))))


def _parts(value) -> Sequence:
    return ca.vertsplit(ca.vec(value)) if isinstance(value, ca.SX) else [float(value)]


def _check_trace(system, x, u, following, y) -> None:
    """The expressions must give the numbers of the functions: a trace cannot see time, memory or integer steps."""
    traced = ca.Function("traced", [x, u], [following, y])
    random = np.random.default_rng(0)
    for k in range(TRACE_POINTS):
        at, given = random.normal(size=x.shape[0]), random.normal(size=u.shape[0])
        wanted = (f(system, k * 0.7, at, given) for f in (_update, _output))
        for got, want in zip(traced(at, given), wanted, strict=True):
            if not np.allclose(np.array(got).ravel(), np.ravel(np.asarray(want, dtype=float)), rtol=1e-9, atol=1e-12):
                raise DeclarationError(
                    f"{system.name}: called with symbols its functions say something else than with numbers. "
                    "They must not depend on time, on earlier calls or on the type of their arguments."
                )


def _block(system, period: float, expressions, units: Mapping[str, str], start: Mapping[str, float]) -> Block:
    x, u, following, y = expressions
    labels = {"state": system.state_labels, "input": system.input_labels, "output": system.output_labels}
    known = [name for names in labels.values() for name in names]
    for given, allowed in ((units, known), (start, labels["state"])):
        for name in given:
            if name not in allowed:
                raise DeclarationError(f"{system.name}: no signal or state '{name}'. {nearest(name, allowed)}")
    first = ca.DM([start.get(name, 0.0) for name in labels["state"]])
    nothing = ca.SX.sym("p", 0)
    measured = ca.SX.sym("y", len(labels["output"]))
    return Block(
        name=system.name,
        inputs=tuple(Signal(n, units.get(n, "1")) for n in labels["input"]),
        outputs=tuple(Signal(n, units.get(n, "1")) for n in labels["output"]),
        states=tuple(StateVariable(n, units.get(n, "1")) for n in labels["state"]),
        parameters=(),
        step=ca.Function("block_step", [x, u, nothing], [ca.densify(following), ca.densify(y)], *_NAMES_OF_STEP),
        start=ca.Function("block_start", [u, measured, nothing], [ca.SX(first)], ["u", "y", "p"], ["x"]),
        period=period,
        provenance={"from": f"control.{type(system).__name__}"},
    )


_NAMES_OF_STEP = (["x", "u", "p"], ["x_next", "y"])
