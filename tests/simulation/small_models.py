"""Small models with closed-form answers."""

from __future__ import annotations

import casadi as ca

from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable, fixed_start


def small_model(name, states, parameters, equations, *, inputs=(), outputs=None, start=None, step=1e-3, measured=None):
    """A flat model from ``equations(t, x, u, p) -> (xdot, y)``; states and parameters by name, outputs are the states.

    ``parameters`` maps names to values, ``inputs`` is a tuple of Signals, ``start`` the start values (zeros else).
    """
    sizes = {"t": 1, "x": len(states), "u": len(inputs), "p": len(parameters)}
    t, x, u, p = (ca.SX.sym(letter, size) for letter, size in sizes.items())
    xdot, y = equations(t, x, u, p)
    outputs = outputs or tuple(f"{s}_seen" for s in states)
    measured = measured or {}
    return FlatModel(
        name=name,
        inputs=tuple(inputs),
        outputs=tuple(Signal(o, "1") for o in outputs),
        states=tuple(StateVariable(s, "1", measured_by=measured.get(s)) for s in states),
        parameters=tuple(ParameterValue(n, v, "1") for n, v in parameters.items()),
        ode=ca.Function("ode", [t, x, u, p], [ca.SX(xdot), ca.SX(y)], ["t", "x", "u", "p"], ["xdot", "y"]),
        initialisation=fixed_start(start or [0.0] * len(states), states, len(inputs), len(parameters)),
        step=step,
    )


def oscillator(frequency=20.0):
    """x'' = -w^2 x, started at x = 1."""

    def equations(t, x, u, p):
        return ca.vertcat(x[1], -(p[0] ** 2) * x[0]), x

    return small_model("oscillator", ["x", "v"], {"w": frequency}, equations, start=[1.0, 0.0])


def lag(interpolation="hold", dead_time=None, time_constant=0.05):
    """tau x' + x = k u(t - Td); the second output is the input as the output equations see it."""

    def equations(t, x, u, p):
        return (p[1] * u[0] - x[0]) / p[0], ca.vertcat(x[0], u[0])

    parameters = {"tau": time_constant, "k": 2.0, "Td": dead_time or 0.0}
    signal = Signal("u", "1", interpolation=interpolation, dead_time=None if dead_time is None else "Td")
    return small_model(
        "lag", ["x"], parameters, equations, inputs=(signal,), outputs=("x_seen", "u_seen"), measured={"x": "x_seen"}
    )


def integrator(interpolation="hold", dead_time=None, step=1e-3):
    """x' = u(t - Td)."""
    signal = Signal("u", "1", interpolation=interpolation, dead_time=None if dead_time is None else "Td")
    return small_model(
        "integrator", ["x"], {"Td": dead_time or 0.0}, lambda t, x, u, p: (u, x), inputs=(signal,), step=step
    )


def stiff_pair(fast=1e5, idle=0):
    """A fast state that follows a slow oscillator: x' = -fast (x - cos t) - sin t, so x = cos t from x(0) = 1.

    ``idle``: so many states beside it that do nothing.
    """

    def equations(t, x, u, p):
        fast = -p[0] * (x[0] - ca.cos(p[1] * t)) - p[1] * ca.sin(p[1] * t)
        return ca.vertcat(fast, *[-x[k] for k in range(1, 1 + idle)]), x

    names = ["x", *(f"idle{k}" for k in range(idle))]
    return small_model("stiff", names, {"fast": fast, "w": 1.0}, equations, start=[1.0] + [0.0] * idle)


def explosion():
    """Three states; only 'bang' runs away: x' = x^2 from 1 reaches infinity at t = 1 / rate."""

    def equations(t, x, u, p):
        return ca.vertcat(-x[0], p[0] * x[1] ** 2, -x[2] + 1e-3 * x[1]), x

    return small_model("explosion", ["calm", "bang", "dragged"], {"rate": 2.0}, equations, start=[1.0, 1.0, 1.0])


def pressed_slide(interpolation="hold"):
    """A mass on dry friction, pressed by oil that a late flow brings and a relief valve lets go."""

    def equations(t, x, u, p):
        C, opening, steepness, friction, _ = ca.vertsplit(p)
        speed, pressure, place = ca.vertsplit(x)
        relief = steepness * ca.fmax(pressure - opening, 0)
        force = pressure - friction * ca.tanh(speed / 0.02) - 0.5 * speed
        return ca.vertcat(force, (u[0] - speed - relief) / C, speed), ca.vertcat(pressure, place, u[0])

    parameters = {"C": 0.02, "opening": 1.5, "steepness": 4.0, "friction": 0.6, "Td": 0.013}
    flow = Signal("flow", "1", interpolation=interpolation, dead_time="Td")
    outputs, states = ("pressure_seen", "place_seen", "flow_seen"), ["speed", "pressure", "place"]
    return small_model("pressed slide", states, parameters, equations, inputs=(flow,), outputs=outputs)
