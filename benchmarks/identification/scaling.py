"""Seconds per Gauss-Newton evaluation against samples and against free parameters: both should be straight lines.

python -m benchmarks.identification.scaling
"""

from __future__ import annotations

import time

import numpy as np

from benchmarks.identification.cases import recordings
from hydrotwin.identification.descent import Task, whole_runs
from hydrotwin.identification.loss import Loss
from hydrotwin.identification.noise import output_noise, weights
from hydrotwin.identification.problem import free_parameters
from hydrotwin.identification.problem import recordings as arrays
from hydrotwin.simulation import prepare
from tests.simulation.flat_cehA import flat_cehA

ORDER = [
    "motor.gain", "motor.time_constant", "cylinder.oil.bulk_modulus", "cylinder.friction.viscous",
    "cylinder.cap_dead_volume", "cylinder.rod_dead_volume", "arm.extra_mass", "pump.displacement",
    "cylinder.friction.static", "cylinder.friction.kinetic", "cylinder.cap_area", "cylinder.rod_area",
    "arm.length", "arm.pin_length", "arm.base_length", "precharge",
]  # fmt: skip


def evaluation_seconds(records, free: list[str], repeats: int = 5) -> float:
    """Best processor time of one evaluation of cost, gradient and Hessian, compiled, one thread [s]."""
    flat = flat_cehA()
    parameters = free_parameters(flat, free)
    measured = arrays(flat, records, None, "record")
    propagator = prepare(flat, free_parameters=parameters.names, free_states=[s.name for s in flat.states])
    noise = output_noise(flat, measured)
    task = Task(flat, parameters, propagator, measured, weights(noise), Loss(), "auto", 1, lambda *report: None, noise)
    shooting, z = whole_runs(task)
    q = parameters.scaled(parameters.start)
    shooting.linearise(q, z)
    taken = []
    for _ in range(repeats):
        began = time.process_time()
        shooting.linearise(q, z)
        taken.append(time.process_time() - began)
    return min(taken)


def main():
    print(f"{'samples':>9} {'s':>9} {'us/sample':>10}   (6 free parameters, 100 Hz, 10 steps per sample)")
    for duration in (10.0, 20.0, 40.0, 80.0):
        records = recordings(1, duration, 100.0)
        seconds = evaluation_seconds(records, ORDER[:6])
        samples = sum(len(r.time) for r in records)
        print(f"{samples:9d} {seconds:9.4f} {1e6 * seconds / samples:10.2f}")
    print(f"{'free':>9} {'s':>9} {'ms/column':>10}   (4001 samples; 5 start states ride along)")
    records = recordings(1, 40.0, 100.0)
    for count in (2, 4, 8, 16):
        seconds = evaluation_seconds(records, ORDER[:count])
        print(f"{count:9d} {seconds:9.4f} {1e3 * seconds / (count + 5):10.3f}")
    assert np.isfinite(seconds)


if __name__ == "__main__":
    main()
