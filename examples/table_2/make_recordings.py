"""Make recordings as in section 4 of the C-EHA paper, with the truth rig: ``python make_recordings.py [FOLDER]``.

Five runs of 80 s to learn from and three to judge by, 1 ms, open-loop commands of many frequencies and amplitudes.
Recorded is what the paper could record: command, motor speed (noisy) and arm angle (noisy, in steps of 14 bits).
"""

from __future__ import annotations

import argparse
import contextlib
import math
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tests import rig  # noqa: E402

RATE, SECONDS = 1000.0, 80.0  # Hz, s
SLOWER = 10  # samples for one of the slow recordings
QUANTUM = math.tau / 2**14  # rad
COLUMNS = ("time", "command", "motor_speed", "arm_angle")
KINDS = {  # of command, one recording each
    "train": ("drive", "steps", "ramps", "drive", "drive"),
    "validate": ("drive", "steps", "ramps"),
}
HIDDEN = {
    "dead_time": {"seconds": 0.012},  # of the motor controller
    "null_bias": {"value": 0.004},  # V
    "command_deadband": {"width": 0.03},  # V
    "motor_droop": {"resistance": 4.0},  # rad/s per N.m
    "pump_slip": {"conductance": 2e-14, "speed": 100.0},  # m3/(s.Pa) at rest, rad/s over which it falls
    "stribeck_friction": {"kinetic": 60.0, "extra": 40.0, "velocity": 0.005},  # N, N, m/s; it truly sticks
}


SPEED = 120 * 1.05e-7 / 8.042e-4  # m/s of the rod per volt, nominal
NEAR = 0.01  # m
TRIES, APART = 10, 20  # seeds for a command, and how far they lie apart


def command_of(shape: str, seed: int, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Time and a command that keeps the arm in its reach; where a seed has none, the next one is tried."""
    for own in range(seed, seed + TRIES * APART, APART):
        with contextlib.suppress(RuntimeError):  # of a path that leads out of reach
            time, command = rig.drive("cehA", seconds, RATE, kind=shape, seed=own)
            trimmed = _trimmed(time, command)
            if trimmed is not None:
                return time, trimmed
    raise RuntimeError(f"no {shape} command of seed {seed} keeps the arm in reach.")


def _trimmed(time: np.ndarray, command: np.ndarray) -> np.ndarray | None:
    """The command for the nominal machine, changed slowly until the real arm goes about the same way."""
    wanted = rig.record("cehA", command, time, step=2e-4)["rod_position"]
    for _ in range(8):
        seen = rig.record("cehA", command, time, effects=HIDDEN, step=2e-4, hold_after_loss=True)["rod_position"]
        if np.max(np.abs(wanted - seen)) < NEAR:
            return command
        more = np.gradient(rig.commands.smoothed(wanted - seen, RATE), time) / SPEED
        command = np.round(np.clip(command + more, -5.0, 5.0), 4)
    return None


def record(kind: str, number: int, seed: int = 0, seconds: float = SECONDS) -> dict[str, np.ndarray]:
    """Columns of recording ``number`` (from 1 on) of ``kind`` ("train" or "validate"), SI."""
    own = 1000 * seed + {"train": 0, "validate": 500}[kind] + number
    shape = KINDS[kind][number - 1]
    time, command = command_of(shape, own, seconds)
    columns = rig.record(
        "cehA",
        command,
        time,
        effects=HIDDEN,
        noise=rig.sensor_noise("cehA"),
        quantisation={"arm_angle": QUANTUM},
        seed=own,
    )
    return {name: columns[name] for name in COLUMNS}


def make(folder: Path, seed: int = 0, seconds: float = SECONDS) -> list[Path]:
    """Write train_1.csv ... train_5.csv and validate_1.csv ... validate_3.csv; returns their paths.

    Beside them slow_1.csv ... slow_5.csv: every tenth sample of the training recordings, for long searches.
    """
    folder.mkdir(parents=True, exist_ok=True)
    units, paths = rig.file_units("cehA"), []
    for kind, shapes in KINDS.items():
        for number in range(1, len(shapes) + 1):
            columns = record(kind, number, seed, seconds)
            paths.append(rig.write_csv(columns, folder / f"{kind}_{number}.csv", units=units))
            if kind == "train":
                few = {name: values[::SLOWER] for name, values in columns.items()}
                paths.append(rig.write_csv(few, folder / f"slow_{number}.csv", units=units))
    return paths


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parent / "out")
    for path in make(parser.parse_args().folder):
        print(path)
