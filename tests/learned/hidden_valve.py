"""Recordings of a valve-driven cylinder with dead time, overlap, play and a coarse, unevenly sampled sensor."""

from __future__ import annotations

import numpy as np

from hydrotwin.records import Record
from tests import rig

DEAD_TIME, OVERLAP, PLAY = 0.08, 0.03, 0.06
SPOOL_DELAY = 2 * 0.8 / 120  # 2 D/w0 of the rig's spool
EFFECTS = (
    ("dead_time", {"seconds": DEAD_TIME}),
    ("valve_overlap", {"share": OVERLAP}),
    ("spool_hysteresis", {"width": PLAY}),
)
UNITS = {"current": "1", "position": "m", "velocity": "m/s"}


def valve_record(command, time, *, step=1e-3, noise=2e-4, seed=0, name="valve", effects=EFFECTS) -> Record:
    """Position quantised to ``step`` [m] after ``noise`` [m]; velocity as it truly is."""
    columns = rig.record(
        "spool_valve", command, time, effects=effects, noise={"position": noise}, quantisation={"position": step},
        seed=seed,
    )  # fmt: skip
    return Record(columns["time"], {n: columns[n] for n in UNITS}, UNITS, name, digest=f"{seed:064x}")


def steps_record(seed: int = 0, duration: float = 100.0, rate: float = 20.0, **sensor) -> Record:
    """Steps to random levels over the whole range, uneven times."""
    time = rig.commands.jittered_time(duration, rate, 0.2, seed)
    room = {"speed": (0.104, 0.099), "room": (-0.24, 0.24)}
    command = rig.commands.steps(time, 1.0, seed + 10, hold=(0.3, 1.6), **room)
    return valve_record(command, time, seed=seed, name=f"steps_{seed}", **sensor)


def ramps_record(seed: int = 5, duration: float = 48.0, rate: float = 20.0, top: float = 0.45, **sensor) -> Record:
    """Up and down ramps between -top and top, 12 s each way and back."""
    time = rig.commands.jittered_time(duration, rate, 0.2, seed)
    turn = (time / 12.0 + 0.25) % 1.0
    return valve_record(top * (1 - 4 * np.abs(turn - 0.5)), time, seed=seed, name="ramps", **sensor)
