"""Make recordings as behind Table I of the dual-GP paper, with the truth rig: ``python make_recordings.py [FOLDER]``.

Ten minutes of steps to learn from and ten of ramps to judge by, at 10 Hz with jitter, the position in whole millimetres
(read from a sensor with noise).
"""

from __future__ import annotations

import argparse
import sys
from functools import cache
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

from tests import rig  # noqa: E402

RATE, JITTER, SECONDS = 10.0, 0.2, 600.0  # Hz, share of a period, s
NOISE = {"position": 3e-4, "spool": 2e-3}  # m, 1: before the position is quantised
QUANTUM = 1e-3  # m
ROOM = 0.2  # m on either side of the middle
TOP, WAY = 0.45, 8.0  # of the full current; s from none to the top of a ramp
HIDDEN = {
    "dead_time": {"seconds": 0.08},
    "null_bias": {"value": 0.02},
    "spool_hysteresis": {"width": 0.04},
    "valve_overlap": {"share": 0.03},
    "flow_saturation": {"knee": 0.5, "limit": 0.9},
}
COLUMNS = ("time", "current", "position", "spool")


def speed(command: float) -> float:
    """About how fast the rod moves under a held command [m/s]: what an operator knows of the machine."""
    opening = command + HIDDEN["null_bias"]["value"]
    flow = max(abs(opening) - HIDDEN["valve_overlap"]["share"], 0.0)
    knee, limit = HIDDEN["flow_saturation"]["knee"], HIDDEN["flow_saturation"]["limit"]
    if flow > knee:
        flow = knee + (limit - knee) * np.tanh((flow - knee) / (limit - knee))
    return flow * (0.104 if opening > 0 else -0.099)


def steps(time: np.ndarray, seed: int) -> np.ndarray:
    """Steps to random levels up to the full current, that keep the rod in the middle of its stroke."""
    random, command, at, t = np.random.default_rng(seed), np.zeros_like(time), 0.0, 0.5
    while t < time[-1]:
        length, level = random.uniform(0.4, 2.5), random.uniform(-1, 1)
        if abs(at + speed(level) * length) > ROOM:
            level = -level
        command[time >= t] = level
        at += speed(level) * length
        t += length
    return command


def ramps(time: np.ndarray, bottom: float) -> np.ndarray:
    """Up and down between ``bottom`` and TOP, at first up."""
    turn = (time / (4 * WAY) + 0.25) % 1.0
    wave = 1 - 4 * np.abs(turn - 0.5)
    return np.where(wave > 0, TOP, -bottom) * wave


@cache
def trimmed_bottom() -> float:
    """The lowest current of the ramps with which a round ends where it began, tried out on the machine."""
    from scipy.optimize import brentq

    time = np.arange(0, 8 * WAY + 0.05, 0.1)

    def drift(bottom):
        position = rig.record("spool_valve", ramps(time, bottom), time, effects=HIDDEN)["position"]
        return position[-1] - position[len(position) // 2]

    return float(brentq(drift, -1.3 * TOP, -0.7 * TOP, xtol=1e-3))


def record(kind: str, seed: int = 0, seconds: float = SECONDS) -> dict[str, np.ndarray]:
    """Columns of a recording, SI, and ``true_position``, which no sensor told. kind: "train" or "validate"."""
    shift = {"train": 0, "validate": 1000}[kind] + seed
    time = rig.commands.jittered_time(seconds, RATE, JITTER, shift)
    command = steps(time, shift) if kind == "train" else ramps(time, trimmed_bottom())
    columns = rig.record("spool_valve", command, time, effects=HIDDEN, seed=shift)
    random = np.random.default_rng([shift, 7])
    true = columns["position"]
    noisy = {name: columns[name] + sigma * random.standard_normal(len(time)) for name, sigma in NOISE.items()}
    noisy["position"] = QUANTUM * np.round(noisy["position"] / QUANTUM)
    return {name: {**columns, **noisy}[name] for name in COLUMNS} | {"true_position": true}


def make(folder: Path, seed: int = 0) -> list[Path]:
    """Write train_1.csv and validate_1.csv; returns their paths."""
    folder.mkdir(parents=True, exist_ok=True)
    units, paths = rig.file_units("spool_valve"), []
    for kind in ("train", "validate"):
        columns = record(kind, seed)
        told = {name: columns[name] for name in COLUMNS}
        paths.append(rig.write_csv(told, folder / f"{kind}_1.csv", units=units))
    return paths


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, nargs="?", default=Path(__file__).parent / "out")
    for path in make(parser.parse_args().folder):
        print(path)
