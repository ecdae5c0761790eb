"""The constant-speed friction test of the C-EHA paper (Section 4.1, Fig. 7)."""

from __future__ import annotations

import numpy as np

from .effects import named_effects
from .machines import parameter_values

SPEEDS = (0.0005, 0.001, 0.002, 0.004, 0.008, 0.015, 0.025, 0.04, 0.06, 0.075)


def friction_force(velocity, parameters=None, effects=None) -> np.ndarray:
    """True friction of the C-EHA cylinder in steady motion [N].

    F = (Fk + (Fs - Fk) exp(-(v/vs)^2)) sign(v) + Fv v, plus hidden dry friction.
    """
    p, v = parameter_values("cehA", parameters or {}), np.asarray(velocity, dtype=float)
    kinetic, static = p["cylinder.friction.kinetic"], p["cylinder.friction.static"]
    curve = kinetic + (static - kinetic) * np.exp(-((v / p["cylinder.friction.stribeck_velocity"]) ** 2))
    force = curve * np.sign(v) + p["cylinder.friction.viscous"] * v
    for name, options in named_effects("cehA", effects):
        if name == "coulomb_friction":
            force = force + options["force"] * np.sign(v)
    return force


def friction_test(
    speeds=SPEEDS,
    *,
    parameters=None,
    effects=None,
    rate: float = 100.0,
    plateau: float = 1.5,
    noise=(2e-4, 1.5),
    seed: int = 0,
) -> dict[str, np.ndarray]:
    """Pull the released cylinder at each speed, out and back: ``time``, ``velocity`` and ``force``, SI.

    Between plateaus (each ``plateau`` s) the speed ramps for 0.3 s through rest. ``noise``: velocity, force.
    """
    corners, levels, t = [0.0], [0.0], 0.0
    for v in (sign * s for s in speeds for sign in (1, -1)):
        corners += [t + 0.3, t + 0.6, t + 0.6 + plateau, t + 0.9 + plateau]
        levels += [0.0, v, v, 0.0]
        t += 0.9 + plateau
    time = np.arange(round(t * rate) + 1) / rate
    velocity = np.interp(time, corners, levels)
    force = friction_force(velocity, parameters, effects)
    random = np.random.default_rng([seed, 99])
    spread = random.standard_normal((2, len(time)))
    return {"time": time, "velocity": velocity + noise[0] * spread[0], "force": force + noise[1] * spread[1]}
