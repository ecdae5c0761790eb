"""Design a position controller for the C-EHA with python-control and try it on the rig.

``python examples/cehA/closed_loop/design.py`` prints the margins and writes measured.csv beside this file: the truth
rig (another simulator, with leaking piston and sensor noise) under the same controller. scenario.toml holds
the coefficients; ``hydrotwin compare examples/cehA/closed_loop/scenario.toml`` compares models in the loop.
"""

from __future__ import annotations

import sys
from pathlib import Path

import control
import numpy as np

import hydrotwin
from hydrotwin.models.language.linearisation import linearise

HERE = Path(__file__).resolve().parent
PERIOD = 0.01  # s
LIMITS = (-5.0, 5.0)  # V
GAIN, RESET_TIME = 40.0, 4.0  # V/rad, s


def controller() -> control.TransferFunction:
    """PI controller from the error [rad] to the command [V], sampled by Tustin's rule."""
    continuous = control.tf([GAIN * RESET_TIME, GAIN], [RESET_TIME, 0])
    return control.sample_system(continuous, PERIOD, method="tustin")


def open_loop(angle: float = 0.2) -> control.StateSpace:
    """Controller and linearised machine in series, sampled with the command held."""
    plant = linearise(hydrotwin.load("cehA"), {"arm.angle": angle})
    held = control.sample_system(plant["arm_angle", "command"], PERIOD, method="zoh")
    return control.series(control.ss(controller()), held)


def reference(time: np.ndarray) -> np.ndarray:
    """Moves between rests, each with zero speed at its ends [rad]."""
    corners, angles = [0, 1, 3, 5, 8, 9, 12, 14, 18, 20], np.deg2rad([5, 5, 20, 20, -5, -5, 25, 25, 10, 10])
    k = np.clip(np.searchsorted(corners, time, side="right") - 1, 0, len(corners) - 2)
    share = (time - np.take(corners, k)) / np.diff(corners)[k]
    return angles[k] + (angles[k + 1] - angles[k]) * (10 * share**3 - 15 * share**4 + 6 * share**5)


def measured() -> dict[str, np.ndarray]:
    """The rig under the controller: columns in SI."""
    sys.path.insert(0, str(HERE.parents[2]))
    from tests import rig

    law = control.ss(controller())
    time = np.arange(0, 20 + PERIOD / 2, PERIOD).round(6)
    wanted = reference(time)
    memory = np.zeros(law.nstates)

    def command(k: int, outputs) -> float:
        nonlocal memory
        error = np.array([wanted[k] - outputs["arm_angle"]])
        answer = float((law.C @ memory + law.D @ error)[0])
        memory = law.A @ memory + law.B @ error
        return float(np.clip(answer, *LIMITS))

    columns = rig.record_closed_loop(
        "cehA", command, time, effects={"internal_leakage": {"conductance": 1e-14}}, noise=rig.sensor_noise("cehA"),
        seed=5, start=float(wanted[0]),
    )  # fmt: skip
    return {"time": columns["time"], "reference": wanted, **{k: v for k, v in columns.items() if k != "time"}}


def main() -> None:
    loop = open_loop()
    gain_margin, phase_margin, _, crossover = control.margin(loop)
    print(f"gain margin {gain_margin:.2f}, phase margin {phase_margin:.0f} deg, crossover {crossover:.2f} rad/s")
    print(f"numerator {controller().num[0][0].tolist()}, denominator {controller().den[0][0].tolist()}")
    columns = measured()
    units = {"time": "s", "reference": "rad", "command": "V", "arm_angle": "rad", "motor_speed": "rad/s",
             "rod_position": "m", "pressure_cap": "Pa", "pressure_rod": "Pa", "piston_force": "N"}  # fmt: skip
    signals = {k: v for k, v in columns.items() if k != "time"}
    record = hydrotwin.Record(columns["time"], signals, {k: units[k] for k in signals}, "closed loop")
    shown = {"reference": "deg", "arm_angle": "deg", "rod_position": "mm", "pressure_cap": "bar", "pressure_rod": "bar"}
    hydrotwin.write_record(record, HERE / "measured.csv", units=shown)


if __name__ == "__main__":
    main()
