"""A small linear machine for the tests: a motor with lag drives a pump that moves a piston.

tau w' = k u(t - T_d) - w,   x' = c w
"""

from __future__ import annotations

from functools import cache

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable, fixed_start
from hydrotwin.records.record import Record
from hydrotwin.simulation import prepare

TRUTH = {"motor.gain": 10.0, "motor.time_constant": 0.1, "pump.displacement": 0.2, "delay": 0.0}
INF = np.inf


@cache
def drive(dead_time: bool = False, positive: bool = True) -> FlatModel:
    """The machine; ``lamp`` is a parameter nothing depends on."""
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p", 5)
    k, tau, c, _, _ = ca.vertsplit(p)
    xdot = ca.vertcat((k * u - x[0]) / tau, c * x[0])
    low = 1e-3 if positive else -INF
    return FlatModel(
        name="drive",
        inputs=(Signal("command", "V", nominal=1.0, dead_time="delay" if dead_time else None),),
        outputs=(Signal("position", "m", nominal=1.0), Signal("motor_speed", "rad/s", nominal=10.0)),
        states=(
            StateVariable("motor.speed", "rad/s", nominal=10.0, measured_by="motor_speed"),
            StateVariable("piston.position", "m", nominal=1.0, measured_by="position"),
        ),
        parameters=(
            ParameterValue("motor.gain", 10.0, "rad/(s.V)", (low, 1e3), free=True),
            ParameterValue("motor.time_constant", 0.1, "s", (1e-3, 10.0), free=True),
            ParameterValue("pump.displacement", 0.2, "m/rad", (low, 10.0)),
            ParameterValue("delay", 0.0, "s", (0.0, 0.5), 0.1),
            ParameterValue("lamp", 1.0, "W", (0.0, 10.0)),
        ),
        ode=ca.Function("ode", [t, x, u, p], [xdot, ca.vertcat(x[1], x[0])], ["t", "x", "u", "p"], ["xdot", "y"]),
        initialisation=fixed_start([0.0, 0.0], ["motor.speed", "piston.position"], 1, 5),
        step=0.01,
    )


def recorded(
    model: FlatModel,
    seed: int,
    *,
    noise: dict[str, float] | None = None,
    parameters: dict[str, float] | None = None,
    start: tuple[float, float] = (0.0, 0.0),
    duration: float = 10.0,
    period: float = 0.02,
    outputs: tuple[str, ...] = ("position", "motor_speed"),
) -> Record:
    """A recording of the machine under a random staircase, white noise added."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, duration, period)
    u = np.repeat(random.normal(size=len(time) // 25 + 1), 25)[: len(time)]
    p = model.parameter_vector(parameters)
    y, _ = prepare(model).run(time, u[:, None], p, np.array(start))
    signals, units = {"command": u}, {"command": "V"}
    for j, signal in enumerate(model.outputs):
        if signal.name in outputs:
            signals[signal.name] = y[:, j] + (noise or {}).get(signal.name, 0.0) * random.normal(size=len(time))
            units[signal.name] = signal.unit
    return Record(time, signals, units, name=f"run_{seed}", digest=f"digest of {seed}")
