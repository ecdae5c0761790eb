"""Recordings and models of the identification benchmarks: the C-EHA written out by hand and the truth rig."""

from __future__ import annotations

from hydrotwin.records.record import Record
from tests import rig
from tests.simulation.flat_cehA import flat_cehA

SIX = {
    "motor.gain": 1.1,
    "motor.time_constant": 0.9,
    "cylinder.friction.viscous": 1.1,
    "cylinder.oil.bulk_modulus": 0.9,
    "cylinder.cap_dead_volume": 1.1,
    "cylinder.rod_dead_volume": 0.9,
}
EIGHT = {**SIX, "pump.displacement": 1.05, "arm.extra_mass": 0.95}


def recordings(count: int, duration: float, rate: float, seed: int = 1) -> list[Record]:
    """Clean recordings of the C-EHA, all outputs with the usual sensor noise."""
    model = flat_cehA()
    units = {s.name: s.unit for s in (*model.inputs, *model.outputs)}
    made = []
    while len(made) < count:
        seed += 1
        try:
            time, command = rig.drive("cehA", duration, rate, seed=seed)
        except RuntimeError:  # this draw leaves the cylinder's stroke
            continue
        columns = rig.record("cehA", command, time, noise=rig.sensor_noise("cehA"), seed=seed)
        signals = {n: v for n, v in columns.items() if n != "time"}
        made.append(Record(columns["time"], signals, units, name=f"train_{len(made) + 1}"))
    return made


def off(factors: dict[str, float]) -> dict[str, float]:
    """Start values: the true ones times a factor each."""
    model = flat_cehA()
    return {name: model.parameter_vector()[model.index_of(name)] * factor for name, factor in factors.items()}
