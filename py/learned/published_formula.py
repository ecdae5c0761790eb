"""The formula that genetic programming found for the C-EHA, Eq. 17 of the paper, as a Block.

    y = x1 + a x3 + a tanh(cos x2) - a tanh(x2 (x1 + 8.97)) - b tanh(cos(cos x2)) + b x2 cos(cos x3)
        + b x2 + b x2 tanh(x1 + 8.97) + c x1 cos(2 cos x3) + e

    a = 0.002027, b = 0.004659, c = 0.0001014, e = 0.00214;   y is x1 one step of 1 ms later

x1 "current motor position", x2 "voltage input", x3 "motor velocity". **The paper gives no unit for any of them**, nor
the range of the command. What can be inferred, and what this block assumes:

- x1 is the arm angle in degrees. Only then does the formula rest anywhere near the experiments: at zero input it
  settles at 32.8 deg. It drifts at rest, from 30 deg to 30.5 deg in 5 s, because its constant terms do not cancel; in
  radians the same terms would turn the arm at 78 deg/s. The drift is the paper's, and a test keeps it.
- x3 is in thousands of revolutions per minute. The data sheet's 0.08 m/s are about 600 rad/s; `a x3` then moves the arm
  at 12 deg/s in krpm, but at 194 deg/s in rev/s and 1200 deg/s in rad/s.
- x2 is in volts, as printed. The voltage terms alone turn the arm at about 12 deg/s per volt, so the full speed of the
  data sheet is reached at 2 to 3 V. A rig that needs 5 V for it has another amplifier: set ``voltage_unit``.

All three units are parameters of the block. `published_formula(voltage_unit=2.5)` reads x2 in units of 2.5 V.
The formula takes the *measured* motor speed as an input: it is told the result of the motor's dynamics, where other
models are told the command only. Source: "Comparison between Genetic Programming and Dynamic Models for Compact
Electrohydraulic Actuators" (2022), Eq. 17 and section 4.4.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import ParameterValue, Signal, StateVariable

from .block_file import LearnedBlock, LearnedKind, Shapes, assemble, register_kind

PERIOD = 1e-3
COEFFICIENTS = (0.002027, 0.004659, 0.0001014, 0.00214, 8.97)
DEGREE = math.pi / 180
KILO_RPM = 1000 * math.tau / 60


def next_position(x1, x2, x3, coefficients=COEFFICIENTS):
    """Eq. 17 as printed, in the paper's units; numbers or CasADi expressions.

    >>> round(float(next_position(30.0, 0.0, 0.0)), 6)
    30.00012
    """
    a, b, c, e, shift = coefficients
    return (
        x1
        + a * x3
        + a * ca.tanh(ca.cos(x2))
        - a * ca.tanh(x2 * (x1 + shift))
        - b * ca.tanh(ca.cos(ca.cos(x2)))
        + b * x2 * ca.cos(ca.cos(x3))
        + b * x2
        + b * x2 * ca.tanh(x1 + shift)
        + c * x1 * ca.cos(2 * ca.cos(x3))
        + e
    )


def published_formula(
    *, voltage_unit: float = 1.0, speed_unit: float = KILO_RPM, angle_unit: float = DEGREE
) -> LearnedBlock:
    """Eq. 17 as a Block: inputs ``command`` [V] and ``motor_speed`` [rad/s], output ``arm_angle`` [rad], 1 ms.

    voltage_unit [V], speed_unit [rad/s], angle_unit [rad] : what one unit of x2, x3 and x1 is; see the module.
    """
    units = {
        "angle_unit": (angle_unit, "rad"),
        "voltage_unit": (voltage_unit, "V"),
        "speed_unit": (speed_unit, "rad/s"),
    }
    for name, (value, unit) in units.items():
        if not (math.isfinite(value) and value > 0):
            raise DeclarationError(
                f"published_formula: {name} must be positive (got {value} {unit}). Leave it out for the default."
            )
    speed = Signal("motor_speed", "rad/s", "measured motor speed", nominal=300.0, interpolation="linear")
    return assemble(
        FORMULA,
        {"coefficients": np.array(COEFFICIENTS)},
        {},
        name="published_formula",
        inputs=(Signal("command", "V", "motor command", nominal=5.0), speed),
        outputs=(Signal("arm_angle", "rad", "arm angle", nominal=0.5),),
        states=(StateVariable("arm_angle", "rad", "arm angle", nominal=0.5, measured_by="arm_angle"),),
        parameters=tuple(
            ParameterValue(name, value, unit, (1e-9, math.inf), value, source="assumed; the paper gives no unit")
            for name, (value, unit) in units.items()
        ),
        period=PERIOD,
        description="Eq. 17 of the C-EHA paper as printed; its units are assumptions",
        provenance={"kind": "formula", "source": "C-EHA paper (2022), Eq. 17", "period": "1 ms (section 4.4)"},
    )


def _shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    return {"coefficients": (len(COEFFICIENTS),)}


def _functions(arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]) -> tuple[ca.Function, ca.Function]:
    x, u, p, y = ca.SX.sym("x"), ca.SX.sym("u", 2), ca.SX.sym("p", 3), ca.SX.sym("y")
    degrees, volts, speed = x / p[0], u[0] / p[1], u[1] / p[2]
    x_next = p[0] * next_position(degrees, volts, speed, [float(k) for k in arrays["coefficients"]])
    step = ca.Function("step", [x, u, p], [x_next, x], ["x", "u", "p"], ["x_next", "y"])
    start = ca.Function("start", [u, y, p], [y], ["u", "y", "p"], ["x"])
    return step, start


FORMULA = register_kind(LearnedKind("published_formula", 1, _shapes, _functions))
