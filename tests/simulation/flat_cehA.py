"""The compact electrohydraulic actuator with its arm, written out by hand as a FlatModel.

An independent statement of the equations of the paper: the tests of the methods use it, and the component model
must agree with it.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable

INF = np.inf
PIN_LENGTH, RETRACTED_LENGTH = 0.225, 0.3055

PARAMETERS = (  # path, value, unit, bounds, nominal, free
    ("motor.gain", 120.0, "rad/(s.V)", (1.0, 1e4), 100.0, True),
    ("motor.time_constant", 0.03, "s", (1e-3, 1.0), 0.03, True),
    ("pump.displacement", 1.05e-7, "m3/rad", (1e-9, 1e-4), 1e-7, False),
    ("cylinder.cap_area", 8.042e-4, "m2", (1e-6, 1.0), 1e-3, False),
    ("cylinder.rod_area", 6.319e-4, "m2", (1e-6, 1.0), 1e-3, False),
    ("cylinder.cap_dead_volume", 8e-5, "m3", (1e-6, 1e-2), 1e-4, True),
    ("cylinder.rod_dead_volume", 8e-5, "m3", (1e-6, 1e-2), 1e-4, True),
    ("cylinder.oil.bulk_modulus", 1.747e9, "Pa", (1e8, 1e10), 1e9, True),
    ("cylinder.friction.kinetic", 1.87, "N", (0.0, INF), 10.0, False),
    ("cylinder.friction.static", 13.15, "N", (0.0, INF), 10.0, False),
    ("cylinder.friction.viscous", 741.36, "N.s/m", (0.0, 1e6), 1000.0, True),
    ("cylinder.friction.stribeck_velocity", 0.0028, "m/s", (1e-6, 1.0), 1e-3, False),
    ("cylinder.friction.smoothing_velocity", 1e-3, "m/s", (1e-6, 1.0), 1e-3, False),
    ("arm.extra_mass", 46.7, "kg", (0.0, 1e4), 10.0, False),
    ("arm.arm_mass", 1.64, "kg", (0.0, 1e4), 1.0, False),
    ("arm.length", 0.488, "m", (1e-3, 10.0), 0.1, False),
    ("arm.pin_length", PIN_LENGTH, "m", (1e-3, 10.0), 0.1, False),
    ("arm.base_length", float(np.sqrt(RETRACTED_LENGTH**2 - PIN_LENGTH**2)), "m", (1e-3, 10.0), 0.1, False),
    ("arm.retracted_length", RETRACTED_LENGTH, "m", (1e-3, 10.0), 0.1, False),
    ("precharge", 2e6, "Pa", (0.0, 1e8), 1e6, False),
)

OUTPUTS = (
    Signal("arm_angle", "rad", "angle of the arm above the horizontal", 1.0),
    Signal("motor_speed", "rad/s", "speed of motor and pump", 100.0),
    Signal("rod_position", "m", "extension of the rod", 0.1),
    Signal("pressure_cap", "Pa", "pressure, cap side", 1e6),
    Signal("pressure_rod", "Pa", "pressure, rod side", 1e6),
    Signal("piston_force", "N", "hydraulic force on the piston", 1000.0),
)

STATES = (
    StateVariable("motor.speed", "rad/s", "speed of motor and pump", 100.0, measured_by="motor_speed"),
    StateVariable("cylinder.cap_pressure", "Pa", "pressure, cap side", 1e6, measured_by="pressure_cap"),
    StateVariable("cylinder.rod_pressure", "Pa", "pressure, rod side", 1e6, measured_by="pressure_rod"),
    StateVariable("arm.angle", "rad", "angle of the arm above the horizontal", 1.0, (-1.4, 1.4), "arm_angle"),
    StateVariable("arm.angular_velocity", "rad/s", "angular velocity of the arm", 0.1),
)

G = 9.80665


def flat_cehA() -> FlatModel:
    """The actuator at the values of Table 1; input ``command`` [V], held between samples."""
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x", 5), ca.SX.sym("u"), ca.SX.sym("p", len(PARAMETERS))
    xdot, y = _equations(x, u, p)
    return FlatModel(
        name="cehA",
        inputs=(Signal("command", "V", "motor command", 5.0),),
        outputs=OUTPUTS,
        states=STATES,
        parameters=tuple(
            ParameterValue(name, value, unit, bounds, nominal, source="Table 1", free=free)
            for name, value, unit, bounds, nominal, free in PARAMETERS
        ),
        ode=ca.Function("ode", [t, x, u, p], [xdot, y], ["t", "x", "u", "p"], ["xdot", "y"]),
        initialisation=_initialisation,
        step=1e-3,
    )


def _equations(x, u, p):
    w, p1, p2, theta, omega = ca.vertsplit(x)
    (k, tau, c_p, A1, A2, V01, V02, beta, Fk, Fs, Fv, vs, v0, m1, m2, L, l, d, x0, _) = ca.vertsplit(p)  # noqa: E741
    s = ca.sqrt(l**2 + d**2 + 2 * l * d * ca.sin(theta))
    lever = l * d * ca.cos(theta) / s
    stroke, v = s - x0, lever * omega
    q1, q2 = c_p * w, c_p * w * A2 / A1
    V1, V2 = V01 + A1 * stroke, V02 - A2 * stroke
    F = p1 * A1 - p2 * A2
    Ff = (Fk + (Fs - Fk) * ca.exp(-((v / vs) ** 2))) * ca.tanh(v / v0) + Fv * v
    xdot = ca.vertcat(
        (k * u - w) / tau,
        beta / V1 * (q1 - A1 * v),
        beta / V2 * (A2 * v - q2),
        omega,
        (lever * (F - Ff) - (m1 + m2 / 2) * G * L * ca.cos(theta)) / (m1 * L**2 + m2 * L**2 / 3),
    )
    return xdot, ca.vertcat(theta, w, stroke, p1, p2, F)


def _initialisation(given: tuple[str, ...]) -> ca.Function:
    """At rest on the given angle (0 else); rod side at precharge, cap side from static equilibrium."""
    u, p, z = ca.SX.sym("u"), ca.SX.sym("p", len(PARAMETERS)), ca.SX.sym("z", len(given))
    of = {name: value for (name, *_), value in zip(PARAMETERS, ca.vertsplit(p), strict=True)}

    def state(name, otherwise):
        return z[given.index(name)] if name in given else otherwise

    theta = state("arm.angle", 0)
    p2 = state("cylinder.rod_pressure", of["precharge"])
    l, d = of["arm.pin_length"], of["arm.base_length"]  # noqa: E741
    weight_moment = (of["arm.extra_mass"] + of["arm.arm_mass"] / 2) * G * of["arm.length"]
    F = weight_moment * ca.sqrt(l**2 + d**2 + 2 * l * d * ca.sin(theta)) / (l * d)
    p1 = state("cylinder.cap_pressure", (F + p2 * of["cylinder.rod_area"]) / of["cylinder.cap_area"])
    x = ca.vertcat(state("motor.speed", 0), p1, p2, theta, state("arm.angular_velocity", 0))
    return ca.Function("start", [u, p, z], [ca.SX(x)], ["u", "p", "z"], ["x"])
