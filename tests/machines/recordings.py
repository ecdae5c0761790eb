"""Recordings of the independent rig, noise off, and how far a model is from them."""

from __future__ import annotations

import numpy as np

from hydrotwin.models import cehA, spool_valve
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests import rig

MODELS = {"cehA": cehA.model, "spool_valve": spool_valve.model}


def rig_record(machine: str, command: str = "drive", *, seed: int = 3, duration: float = 20.0, rate: float = 100.0,
               **truth) -> Record:  # fmt: skip
    """What the rig measures without noise; further arguments (``parameters``) go to the rig."""
    one = dict(seed=seed, duration=duration, rate=rate, noise={}, command=command, **truth)
    columns = rig.clean_recordings(machine, "train", 1, **one)[0]
    m = rig.MACHINES[machine]
    units = {m.input: m.input_unit, **dict(zip(m.outputs, m.units, strict=True))}
    return Record(columns["time"], {name: columns[name] for name in units}, units, f"rig {machine} {command}")


def held(machine: str, duration: float, command: float, rate: float = 200.0) -> Record:
    """A constant command, nothing measured."""
    m, time = rig.MACHINES[machine], np.arange(round(duration * rate) + 1) / rate
    return Record(time, {m.input: np.full(len(time), float(command))}, {m.input: m.input_unit}, "held")


def relative_error(model, record: Record, **options) -> dict[str, float]:
    """RMSE of a free run over the range of the recorded output."""
    y = simulate(model, record, **options)
    return {
        o.name: float(np.sqrt(np.mean((y[o.name] - record[o.name]) ** 2)) / np.ptp(record[o.name]))
        for o in model.flat.outputs
        if o.name in record
    }
