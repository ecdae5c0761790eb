"""How long an identification takes, beside other ways to do it.

    python -m benchmarks.identification.speed [--cap 120] [--only ours]

The compile cache is a fresh folder, so the figures include compilation. Rivals stop at the cap and the table says so.
"""

from __future__ import annotations

import argparse
import os
import tempfile
import time

import numpy as np

from benchmarks.identification.cases import EIGHT, SIX, off, recordings
from benchmarks.identification.rivals import casadi_multiple_shooting, scipy_finite_differences
from hydrotwin.identification import identify
from hydrotwin.identification.noise import output_noise
from hydrotwin.identification.problem import recordings as arrays
from tests.simulation.flat_cehA import flat_cehA

CASES = {
    "6 parameters, 3 x 40 s at 100 Hz": (SIX, 3, 40.0, 100.0, 3.0),
    "8 parameters, 5 x 80 s at 1 kHz": (EIGHT, 5, 80.0, 1000.0, 15.0),
}


def main():
    arguments = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    arguments.add_argument("--cap", type=float, default=120.0, help="seconds a rival may take")
    arguments.add_argument("--only", choices=["ours", "all"], default="all")
    chosen = arguments.parse_args()
    print(f"{'case':<34} {'method':<44} {'wall s':>8} {'cpu s':>8} {'off by':>9}  remark")
    for name, (factors, count, duration, rate, target) in CASES.items():
        records = recordings(count, duration, rate)
        for row in measure(records, factors, target, chosen.cap, chosen.only == "all" and rate <= 100):
            method, wall, cpu, error, remark = row
            print(f"{name:<34} {method:<44} {wall:8.2f} {cpu:8.2f} {error:9.2%}  {remark}", flush=True)


def measure(records, factors: dict, target: float, cap: float, rivals: bool):
    """One row per method: name, wall and processor seconds, largest error of gain and bulk modulus, remark."""
    flat, start = flat_cehA(), off(factors)
    noise = output_noise(flat, arrays(flat, records, None, "record"))
    with tempfile.TemporaryDirectory() as folder:
        os.environ["HYDROTWIN_CACHE"] = folder
        cpu = time.process_time()
        fit = identify(flat, records, free=list(start), start=start)
        cpu = time.process_time() - cpu
        del os.environ["HYDROTWIN_CACHE"]
    found = np.array([p.value for p in fit.parameters])
    names = [p.name for p in fit.parameters]
    remark = f"{fit.message}; chi2/dof {fit.chi2_per_dof:.3f}; target {target:g} s"
    yield "hydrotwin, with compilation", fit.seconds, cpu, _error(flat, names, found), remark
    if not rivals:
        return
    cpu = time.process_time()
    found, count, wall, done = casadi_multiple_shooting(flat, records, start, noise, cap, every=10)
    yield ("CasADi multiple shooting, IPOPT", wall, time.process_time() - cpu, _error(flat, names, found),
           f"{count} iterations, {'converged' if done else f'stopped, cap {cap:g} s'}")  # fmt: skip
    cpu = time.process_time()
    found, count, wall, done = scipy_finite_differences(flat, records, start, noise, cap)
    yield ("SciPy least_squares, differences on solve_ivp", wall, time.process_time() - cpu, _error(flat, names, found),
           f"{count} evaluations, {'converged' if done else f'stopped, cap {cap:g} s'}")  # fmt: skip


def _error(flat, names, found) -> float:
    truth = np.array([flat.parameter_vector()[flat.index_of(n)] for n in names])
    return float(np.max(np.abs(found / truth - 1)))


if __name__ == "__main__":
    main()
