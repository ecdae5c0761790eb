"""A small machine written in numpy alone, and a block that was never trained, for the tests of this room."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np

from hydrotwin.learned.block_file import Certificate, LearnedBlock, assemble
from hydrotwin.learned.network.narx import NETWORK, NarxShape, array_shapes, network_states
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation.block import TrainingDomain

PERIOD, FINE, NOISE = 0.02, 20, 1e-4
COMMAND = Signal("command", "V", "motor command", nominal=2.0)
ANGLE = Signal("arm_angle", "rad", "arm angle", nominal=0.5)
SPEED = Signal("motor_speed", "rad/s", "motor speed", nominal=200.0)


def drive_command(time: np.ndarray, seed: int) -> np.ndarray:
    """A smooth command: sines from 0.1 to 1.5 Hz, so strong that its integral spans 2.6 V.s."""
    rng = np.random.default_rng(seed)
    f, phase = np.geomspace(0.1, 1.5, 7), rng.uniform(0, 2 * np.pi, 7)
    u = np.sin(2 * np.pi * np.outer(time, f) + phase) @ (rng.uniform(0.5, 1.0, 7) / (1 + f))
    u = (u - u.mean()) * np.minimum(time, 1.0)
    return u * 2.6 / np.ptp(np.cumsum(u) * PERIOD)


def toy_record(seed: int, duration: float = 20.0, noise: float = NOISE, delay: int = 0, name: str = "") -> Record:
    """A motor with lag 50 ms turns an arm whose gearing changes with the angle; the command is held.

    tau w' = k u - w,   theta' = c w (1 + 0.4 sin 2 theta) - g cos(theta) w^2 sign(w),   command ``delay`` samples late
    """
    time = PERIOD * np.arange(round(duration / PERIOD) + 1)
    u = drive_command(time, seed)
    late = np.concatenate([np.full(delay, u[0]), u[: len(u) - delay]])
    travel = np.cumsum(u) * PERIOD
    w, theta, h = 0.0, 0.4 - 0.12 * (travel.max() + travel.min()), PERIOD / FINE
    w_seen, theta_seen = np.empty_like(time), np.empty_like(time)
    for k, command in enumerate(late):
        w_seen[k], theta_seen[k] = w, theta
        for _ in range(FINE):
            theta += h * (2e-3 * w * (1 + 0.4 * np.sin(2 * theta)) - 1e-6 * np.cos(theta) * w * abs(w))
            w += h * (120.0 * command - w) / 0.05
    rng = np.random.default_rng(1000 + seed)
    signals = {
        "command": u,
        "arm_angle": theta_seen + noise * rng.standard_normal(len(time)),
        "motor_speed": w_seen + 1000 * noise * rng.standard_normal(len(time)),
    }
    units = {"command": "V", "arm_angle": "rad", "motor_speed": "rad/s"}
    return Record(time, signals, units, name or f"toy_{seed}", digest=f"{seed:064x}")


def untrained_block(seed: int = 0, hidden: int = 4, outputs=(ANGLE, SPEED), output_lags: int = 2) -> LearnedBlock:
    """A network block with random weights: it predicts nothing, but it is a complete block."""
    shape = NarxShape(1, len(outputs), output_lags, 3, hidden)
    rng = np.random.default_rng(seed)
    arrays = {k: rng.normal(size=s) for k, s in array_shapes(shape.structure(), 1, len(outputs)).items()}
    for name in ("input_scale", "output_scale", "increment_scale", "increment_limit"):
        arrays[name] = 0.5 + rng.uniform(size=arrays[name].shape)
    arrays["feature_lower"], arrays["feature_upper"] = np.full(shape.features, -0.5), np.full(shape.features, 0.6)
    arrays["output_lower"], arrays["output_upper"] = np.full(len(outputs), -3.0), np.full(len(outputs), 4.0)
    return assemble(
        NETWORK,
        arrays,
        shape.structure(),
        name="untrained",
        inputs=(COMMAND,),
        outputs=outputs,
        states=network_states(shape, (COMMAND,), outputs),
        parameters=(),
        period=PERIOD,
        domain=TrainingDomain(("command", "arm_angle"), (-1.0, 0.0), (1.0, 2.0)),
        certificate=Certificate(1e-15, 1e-12, 100, "itself"),
        description="random weights",
        provenance={"kind": "network", "trained_on": [{"name": "none", "sha256": "0" * 64}], "seed": seed},
    )


def with_deviation(block):
    """The block with a constant standard deviation beside its output."""
    x, u, p = (ca.MX.sym(n, len(v)) for n, v in zip("xup", (block.states, block.inputs, block.parameters), strict=True))
    y = ca.MX.sym("y", 2)
    following, answered = block.step(x, u, p)
    deviation = dataclasses.replace(block.outputs[0], name="arm_angle.sd")
    return dataclasses.replace(
        block,
        outputs=(block.outputs[0], deviation),
        step=ca.Function("step", [x, u, p], [following, ca.vertcat(answered, 0.1)], ["x", "u", "p"], ["x_next", "y"]),
        start=ca.Function("start", [u, y, p], [block.start(u, y[0], p)], ["u", "y", "p"], ["x"]),
    )
