"""The CasADi functions of one model that the C driver and the virtual machine run."""

from __future__ import annotations

import functools
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel

RELATIVE_TOLERANCE, ABSOLUTE_TOLERANCE = 1e-9, 1e-10  # of its implicit method; states and time in nominal units
TANGENT_TOLERANCE = 1e-8  # of its sensitivities, in nominal units of states and parameters

_one_at_a_time = threading.RLock()


def alone(function: Callable) -> Callable:
    """``function`` while no other thread is in one that is marked so.

    CasADi releases the interpreter lock, and expressions that two threads build or drop at once crash the process.
    What is built already may be evaluated in any thread.
    """

    @functools.wraps(function)
    def one_at_a_time(*given, **named):
        with _one_at_a_time:
            return function(*given, **named)

    return one_at_a_time


@dataclass(frozen=True)
class Directions:
    """What the sensitivities are taken to: free parameters, then free start states.

    ``dead`` pairs every input whose dead time is free with the column of that dead time; ``zero`` are parameters at
    whose value 0 the sensitivities are taken: what they multiply is left out.
    """

    parameters: tuple[int, ...]
    states: tuple[int, ...]
    dead: tuple[tuple[int, int], ...]
    zero: tuple[int, ...] = ()

    @property
    def count(self) -> int:
        return len(self.parameters) + len(self.states)


def directions(
    flat: FlatModel, free_parameters: Sequence[str], free_states: Sequence[str], zero: Sequence[str] = ()
) -> Directions:
    """Positions of the free parameters and states; an unknown name raises with the nearest right one."""
    names = [s.name for s in flat.states]
    for name in free_states:
        if name not in names:
            raise DeclarationError(f"{flat.name}: no state '{name}'. {nearest(name, names)}")
    columns = tuple(flat.index_of(name) for name in free_parameters)
    dead = tuple(
        (j, columns.index(delay)) for j, delay in enumerate(delays(flat)) if delay is not None and delay in columns
    )
    return Directions(
        columns, tuple(names.index(name) for name in free_states), dead, tuple(flat.index_of(name) for name in zero)
    )


def delays(flat: FlatModel) -> list[int | None]:
    """Per input, the position of the parameter that is its dead time, or None."""
    return [None if s.dead_time is None else flat.index_of(s.dead_time) for s in flat.inputs]


def symbols(flat: FlatModel) -> list[ca.SX]:
    """Fresh ``t, x, u, p`` of the model's sizes."""
    sizes = {"t": 1, "x": len(flat.states), "u": len(flat.inputs), "p": len(flat.parameters)}
    return [ca.SX.sym(name, size) for name, size in sizes.items()]


def rate(flat: FlatModel, t, x, u, p) -> ca.SX:
    """Dense ``x' = f(t, x, u, p)``."""
    return ca.densify(flat.ode(t, x, u, p)[0])


def slopes(flat: FlatModel) -> ca.Function:
    """``(t, x, u, p) -> x'``."""
    arguments = symbols(flat)
    return _shared("slopes", arguments, [rate(flat, *arguments)])


def rk4_substep(flat: FlatModel) -> ca.Function:
    """``(t, x, u, p, h) -> x(t + h), roughness (nx,)``, the classical Runge-Kutta step, u constant inside.

    roughness : the squared sum of what separates steps of second order that the same four slopes make,

        h/6 (k1 - k2 - k3 + k4)   and   h/3 (k3 - k2).

    It is of third order in h, so the step's own error is far below it, but for a kink inside the step, of which the
    slopes know as much as the step does.
    """
    t, x, u, p = symbols(flat)
    h = ca.SX.sym("h")
    k1 = rate(flat, t, x, u, p)
    k2 = rate(flat, t + h / 2, x + h / 2 * k1, u, p)
    k3 = rate(flat, t + h / 2, x + h / 2 * k2, u, p)
    k4 = rate(flat, t + h, x + h * k3, u, p)
    following = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
    return _shared("rk4_substep", [t, x, u, p, h], [following, _roughness(h, k1, k2, k3, k4)])


def _roughness(h, k1, k2, k3, k4):
    return h * h / 36 * ((k1 - k2 - k3 + k4) ** 2 + (2 * (k3 - k2)) ** 2)


def output(flat: FlatModel) -> ca.Function:
    """``(t, x, u, p) -> y``."""
    arguments = symbols(flat)
    return _shared("output", arguments, [ca.densify(flat.ode(*arguments)[1])])


def linear_rate(flat: FlatModel, to: Directions) -> ca.Function:
    """``(t, x, u, p) -> x', df/dx, df/dp, df/du``; columns of dp: directions, of du: inputs with free dead time."""
    return _linear("linear_rate", flat, to, 0)


def linear_output(flat: FlatModel, to: Directions) -> ca.Function:
    """``(t, x, u, p) -> y, dh/dx, dh/dp, dh/du``, columns as in `linear_rate`."""
    return _linear("linear_output", flat, to, 1)


def _linear(name: str, flat: FlatModel, to: Directions, which: int) -> ca.Function:
    t, x, u, p = symbols(flat)
    value = ca.densify(flat.ode(t, x, u, p)[which])
    by_p = ca.jacobian(value, p)[:, list(to.parameters)]
    by_u = ca.jacobian(value, u)[:, [j for j, _ in to.dead]]
    results = [value, ca.jacobian(value, x), by_p, by_u]
    if to.zero:
        still = ca.vertcat(*(p[i] for i in to.zero))
        results = ca.substitute(results, [still], [ca.SX.zeros(len(to.zero))])
        results = [ca.densify(results[0]), *map(ca.sparsify, results[1:])]
    return _shared(name, [t, x, u, p], results)


def states_with_rows(flat: FlatModel, to: Directions) -> list[int]:
    """States whose sensitivities are computed: all, or, where parameters are zero, those that reach an output."""
    if not to.zero:
        return list(range(len(flat.states)))
    rows: dict[int, set[int]] = {}
    for i, j in zip(*linear_rate(flat, to).sparsity_out(1).get_triplet(), strict=True):
        rows.setdefault(i, set()).add(j)
    found, waiting = set(), set(linear_output(flat, to).sparsity_out(1).get_triplet()[1])
    while waiting:
        found |= waiting
        waiting = set().union(*(rows.get(i, set()) for i in waiting)) - found
    return sorted(found)


def rk4_tangent(flat: FlatModel, to: Directions) -> ca.Function:
    """``(t, x, u, p, h, dx, du) -> x, dx, roughness`` of the step: what the C driver does stage by stage."""
    t, x, u, p = symbols(flat)
    h, dx = ca.SX.sym("h"), ca.SX.sym("dx", x.numel(), to.count)
    du = ca.SX.sym("du", len(to.dead))
    rates = linear_rate(flat, to)

    def stage(time, state, tangent):
        xdot, fx, fp, fu = rates(time, state, u, p)
        return xdot, ca.densify(fx @ tangent + _placed(fp, fu, du, to))

    k1, d1 = stage(t, x, dx)
    k2, d2 = stage(t + h / 2, x + h / 2 * k1, dx + h / 2 * d1)
    k3, d3 = stage(t + h / 2, x + h / 2 * k2, dx + h / 2 * d2)
    k4, d4 = stage(t + h, x + h * k3, dx + h * d3)
    after = [x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4), dx + h / 6 * (d1 + 2 * d2 + 2 * d3 + d4)]
    return _shared("rk4_tangent", [t, x, u, p, h, dx, du], [*after, _roughness(h, k1, k2, k3, k4)])


def jump_tangent(flat: FlatModel, to: Directions) -> ca.Function:
    """``(t, x, p, behind, before, dx) -> dx``: a longer dead time means the slope of before the jump for a while.

    before (nu, columns): inputs before the jump of those with one dead time, a column for each of `dead_columns`.
    """
    t, x, behind, p = symbols(flat)
    dx = ca.SX.sym("dx", x.numel(), to.count)
    before = ca.SX.sym("before", behind.numel(), len(dead_columns(to)))
    rates, after = linear_rate(flat, to), ca.SX(dx)
    for m, column in enumerate(dead_columns(to)):
        after[:, column] += rates(t, x, before[:, m], p)[0] - rates(t, x, behind, p)[0]
    return _shared("jump_tangent", [t, x, p, behind, before, dx], [after])


def dead_columns(to: Directions) -> list[int]:
    """Columns of the free dead times, one for all inputs that share it."""
    return sorted({column for _, column in to.dead})


def output_tangent(flat: FlatModel, to: Directions) -> ca.Function:
    """``(t, x, u, p, dx, du) -> y, dy``."""
    t, x, u, p = symbols(flat)
    dx, du = ca.SX.sym("dx", x.numel(), to.count), ca.SX.sym("du", len(to.dead))
    y, hx, hp, hu = linear_output(flat, to)(t, x, u, p)
    return _shared("output_tangent", [t, x, u, p, dx, du], [y, ca.densify(hx @ dx + _placed(hp, hu, du, to))])


def _placed(by_p, by_u, du, to: Directions):
    """Direct derivative per direction: parameters, then zeros for start states; dead times through their inputs."""
    direct = ca.horzcat(by_p, type(by_p)(by_p.size1(), len(to.states)))
    for m, (_, column) in enumerate(to.dead):
        direct[:, column] += by_u[:, m] * du[m]
    return direct


def implicit_substep(flat: FlatModel) -> ca.Function:
    """``(t, x, u, p, h) -> x(t + h)`` by CasADi's Rosenbrock integrator: L-stable, order 5(4), adaptive inside h.

    Of the virtual machine; compiled runs have implicit steps of their own (``implicit.c``).
    It sees states in units of their nominal values and the time as a fraction of h, so one tolerance serves all.
    """
    t, x, u, p = symbols(flat)
    h, fraction = ca.SX.sym("h"), ca.SX.sym("fraction")
    scale = np.array([s.nominal for s in flat.states])
    slope = h * rate(flat, t + fraction * h, scale * x, u, p) / scale
    dae = {"t": fraction, "x": x, "p": ca.vertcat(t, u, p, h), "ode": slope}
    tolerances = {"reltol": RELATIVE_TOLERANCE, "abstol": ABSOLUTE_TOLERANCE}
    within = ca.integrator("implicit_within", "rosenbrock", dae, 0, 1, tolerances)
    T, X, U, P, H = (ca.MX.sym(n, s.numel()) for n, s in zip("txuph", (t, x, u, p, h), strict=True))
    after = within(x0=X / scale, p=ca.vertcat(T, U, P, H))["xf"] * scale
    return ca.Function("implicit_substep", [T, X, U, P, H], [after])


def implicit_tangent(flat: FlatModel, to: Directions) -> ca.Function:
    """``(t, x, u, p, h, dx, du) -> dx`` after the step: the variational equations in the same integrator,

        S' = df/dx S + df/dp + df/du du,

    so that its step control sees them: the derivative of a state at rest may ring.
    """
    t, x, u, p = symbols(flat)
    h, fraction, du = ca.SX.sym("h"), ca.SX.sym("fraction"), ca.SX.sym("du", len(to.dead))
    S = ca.SX.sym("S", x.numel(), to.count)
    scale = np.array([s.nominal for s in flat.states])
    units = units_of_sensitivities(flat, to, p)
    xdot, fx, fp, fu = linear_rate(flat, to)(t + fraction * h, scale * x, u, p)
    Sdot = fx @ (S * units) + _placed(fp, fu, du, to)
    slope = ca.vertcat(h * xdot / scale, ca.vec(h * Sdot / units))
    dae = {"t": fraction, "x": ca.vertcat(x, ca.vec(S)), "p": ca.vertcat(t, u, p, h, du), "ode": ca.densify(slope)}
    tolerances = {"reltol": TANGENT_TOLERANCE, "abstol": TANGENT_TOLERANCE}
    within = ca.integrator("implicit_tangent_within", "rosenbrock", dae, 0, 1, tolerances)
    T, X, U, P, H, dU = (ca.MX.sym(n, s.numel()) for n, s in zip("txuphd", (t, x, u, p, h, du), strict=True))
    dX = ca.MX.sym("dx", *S.shape)
    units = units_of_sensitivities(flat, to, P)
    after = within(x0=ca.vertcat(X / scale, ca.vec(dX / units)), p=ca.vertcat(T, U, P, H, dU))["xf"]
    tangent = ca.reshape(after[x.numel() :], *S.shape) * units
    return ca.Function("implicit_tangent", [T, X, U, P, H, dX, dU], [tangent])


def units_of_sensitivities(flat: FlatModel, to: Directions, p):
    """(nx, n_theta): nominal of the state over nominal + |value| of the parameter, over nominal of the start state."""
    scale = np.array([s.nominal for s in flat.states])
    columns = [flat.parameters[i].nominal + abs(p[i]) for i in to.parameters] + [scale[i] for i in to.states]
    return ca.DM(scale) @ (1 / ca.vertcat(*columns)).T


def _shared(name: str, arguments: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    """A function whose common sub-expressions are computed once."""
    return ca.Function(name, arguments, ca.cse(results))
