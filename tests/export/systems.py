"""Small systems to export, and records to drive them with."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable, fixed_start
from hydrotwin.records import Record
from hydrotwin.simulation import Block, TrainingDomain


def delayed_mass() -> FlatModel:
    """A damped mass pushed by a delayed, linearly moving force and a held feed-through; reads the time."""
    t, x = ca.SX.sym("t"), ca.SX.sym("x", 2)
    u, p = ca.SX.sym("u", 2), ca.SX.sym("p", 4)
    m, d, c, _ = ca.vertsplit(p)
    xdot = ca.vertcat(x[1], (u[0] - d * x[1] - c * x[0]) / m)
    y = ca.vertcat(x[0], u[0] + 0.5 * u[1], 0.01 * t + x[1])
    return FlatModel(
        name="delayed mass",
        inputs=(
            Signal("force", "N", "push", 10.0, interpolation="linear", dead_time="force_delay"),
            Signal("extra", "N", "held", 10.0, default=1.0),
        ),
        outputs=(Signal("place", "m"), Signal("seen_force", "N"), Signal("clock", "1")),
        states=(StateVariable("mass.s", "m", measured_by="place"), StateVariable("mass.v", "m/s")),
        parameters=(
            ParameterValue("mass.m", 2.0, "kg", (0.1, 100.0)),
            ParameterValue("mass.d", 3.0, "N.s/m", (0.0, 100.0), sigma=0.125, source="weighed <twice>"),
            ParameterValue("mass.c", 50.0, "N/m", (0.0, 1e4)),
            ParameterValue("force_delay", 0.037, "s", (0.0, 1.0)),
        ),
        ode=ca.Function("ode", [t, x, u, p], [xdot, y], ["t", "x", "u", "p"], ["xdot", "y"]),
        initialisation=fixed_start([0.1, 0.0], ["mass.s", "mass.v"], 2, 4),
        step=1e-3,
        description="A damped mass.",
    )


def clocked_mass() -> FlatModel:
    """The same mass without dead time, pushed by its input and by the clock."""
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p", 3)
    m, d, c = ca.vertsplit(p)
    xdot = ca.vertcat(x[1], (u + ca.sin(3.0 * t) - d * x[1] - c * x[0] ** 3) / m)
    return FlatModel(
        name="clocked mass",
        inputs=(Signal("force", "N", "push", 10.0),),
        outputs=(Signal("place", "m"), Signal("power", "W"), Signal("clock", "1")),
        states=(
            StateVariable("mass.s", "m", nominal=0.2, measured_by="place"),
            StateVariable("mass.v", "m/s", nominal=3.0),
        ),
        parameters=(
            ParameterValue("mass.m", 2.0, "kg", (0.1, 100.0)),
            ParameterValue("mass.d", 3.0, "N.s/m", (0.0, 100.0)),
            ParameterValue("mass.c", 50.0, "N/m3", (0.0, 1e4)),
        ),
        ode=ca.Function(
            "ode", [t, x, u, p], [xdot, ca.vertcat(x[0], u * x[1], t * x[0])], ["t", "x", "u", "p"], ["xdot", "y"]
        ),
        initialisation=fixed_start([0.1, 0.0], ["mass.s", "mass.v"], 1, 3),
        step=1e-3,
        description="A mass, and a clock.",
    )


def tank_in_volts() -> FlatModel:
    """A tank that empties, its level counted by its sensor: no state of it is a position or an angle."""
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("p")
    ode = ca.Function("ode", [t, x, u, p], [0.1 * u - p * x, x], ["t", "x", "u", "p"], ["xdot", "y"])
    return FlatModel(
        name="tank",
        inputs=(Signal("pump", "V"),),
        outputs=(Signal("level", "V"),),
        states=(StateVariable("level", "V", measured_by="level"),),
        parameters=(ParameterValue("rate", 0.2, "1/s", (0.0, 10.0)),),
        ode=ode,
        initialisation=fixed_start([1.0], ["level"], 1, 1),
        step=1e-2,
    )


def stiff_oscillator() -> FlatModel:
    """Van der Pol's equation at mu = 1000, driven: no explicit step of 10 ms survives it."""
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p")
    xdot = ca.vertcat(x[1], p * (1 - x[0] ** 2) * x[1] - x[0] + u)
    return FlatModel(
        name="stiff",
        inputs=(Signal("drive", "1", nominal=0.1),),
        outputs=(Signal("level", "1"),),
        states=(StateVariable("x", "1"), StateVariable("v", "1/s")),
        parameters=(ParameterValue("mu", 1000.0, "1", (0.0, 1e6)),),
        ode=ca.Function("ode", [t, x, u, p], [xdot, x[0]], ["t", "x", "u", "p"], ["xdot", "y"]),
        initialisation=fixed_start([2.0, 0.0], ["x", "v"], 1, 1),
        step=1e-2,
    )


def lag_block(symbols=ca.SX, domain: TrainingDomain | None = None) -> Block:
    """A sampled second-order recursion with feed-through that starts from its measured output."""
    x, u, p = symbols.sym("x", 2), symbols.sym("u", 1), symbols.sym("p", 2)
    y = ca.vertcat(x[0] + 0.1 * p[0] * u, ca.tanh(x[1] + u))
    after = ca.vertcat(p[1] * x[0] + (1 - p[1]) * ca.tanh(p[0] * u), x[0])
    y0 = symbols.sym("y", 2)
    return Block(
        name="lag",
        inputs=(Signal("command", "V", nominal=2.0),),
        outputs=(Signal("angle", "rad"), Signal("rate", "rad/s")),
        states=(StateVariable("angle", "rad", measured_by="angle"), StateVariable("before", "rad")),
        parameters=(ParameterValue("gain", 0.8, "rad/V"), ParameterValue("memory", 0.9, "1", (0.0, 1.0))),
        step=ca.Function("step", [x, u, p], [after, y], ["x", "u", "p"], ["x_next", "y"]),
        start=ca.Function("start", [u, y0, p], [ca.vertcat(y0[0], y0[0])], ["u", "y", "p"], ["x"]),
        period=0.02,
        domain=domain,
        description="A learned lag.",
        provenance={"record": "train.csv"},
    )


def network_block(width: int = 24) -> Block:
    """A recurrent network of two dense layers as a trainer would write it: constant matrices, MX."""
    rng = np.random.default_rng(7)
    x, u, p = ca.MX.sym("x", 3), ca.MX.sym("u", 1), ca.MX.sym("p", 0)
    first, second = (ca.DM(rng.normal(0.0, 0.3, shape)) for shape in ((width, 4), (width, width)))
    hidden = ca.tanh(second @ ca.tanh(first @ ca.vertcat(x, u)))
    y = ca.DM(rng.normal(0.0, 0.2, (1, width))) @ hidden
    y0 = ca.MX.sym("y", 1)
    return Block(
        name="network",
        inputs=(Signal("command", "V"),),
        outputs=(Signal("angle", "rad"),),
        states=tuple(StateVariable(f"angle_{k}", "rad") for k in range(3)),
        parameters=(),
        step=ca.Function("step", [x, u, p], [ca.vertcat(y, x[0], x[1]), y], ["x", "u", "p"], ["x_next", "y"]),
        start=ca.Function("start", [u, y0, p], [ca.repmat(y0, 3, 1)], ["u", "y", "p"], ["x"]),
        period=0.02,
    )


def arm_record(duration: float = 5.0, period: float = 0.01) -> Record:
    """A smooth command for the C-EHA, and the angle at which its arm starts."""
    t = np.arange(0.0, duration, period)
    signals = {"command": 2.0 * np.sin(0.8 * t) * np.sin(2.3 * t), "arm_angle": np.full(len(t), 0.1)}
    return Record(t, signals, {"command": "V", "arm_angle": "rad"}, "smooth")


def mass_record(duration: float = 3.0) -> Record:
    """Uneven samples of a moving force."""
    t = np.cumsum(np.r_[0.0, np.tile([0.01, 0.013, 0.007], int(duration / 0.03))])
    signals = {"force": 5.0 * np.sin(7.0 * t), "extra": np.sign(np.sin(3.0 * t)) + 0.1}
    return Record(t, signals, {"force": "N", "extra": "N"}, "pushes")


def command_record(period: float = 0.02, duration: float = 2.0) -> Record:
    """A command with a measured start for the lag."""
    t = np.arange(0.0, duration, period)
    signals = {"command": 2.0 * np.sin(4.0 * t), "angle": np.full(len(t), 0.3)}
    return Record(t, signals, {"command": "V", "angle": "rad"}, "command")
