"""What a Gaussian process costs: to train on 6000 samples, and per step once it is a block.

    python benchmarks/learned/gaussian_process.py

The rig's valve with a dead time and a deadband, sampled unevenly at 10 Hz, its position to a millimetre. The dual
process is trained as a user would, with its certificate. A step of the compiled block, mean and deviation, is timed
against GPyTorch's own prediction of the same quantities from the same data in the same run, with and without its fast
variances; without them it factorizes anew for every prediction, so the ratio to the fast ones is the fair one. Wall
clock throughout; the load of the machine is printed, for on a busy one the figures are too high.
"""

from __future__ import annotations

import os
import tempfile
import time
from pathlib import Path

import casadi as ca
import gpytorch
import numpy as np
import torch

from hydrotwin.export import export_fmu
from hydrotwin.learned.device import tensor
from hydrotwin.learned.gaussian import exact as exact_gp
from hydrotwin.learned.gaussian.delay_lines import input_scales, normalised, training_rows
from hydrotwin.learned.gaussian.dual import learn_dual_gp
from hydrotwin.learned.gaussian.single import learn_gaussian_process
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation.compiler import compile_library
from tests import rig

ROWS, PERIOD, LAGS = 6000, 0.1, 5
UNITS = {"current": "1", "position": "m", "spool": "1"}
HIDDEN = [("dead_time", {"seconds": 0.12}), ("command_deadband", {"width": 0.1})]
CURRENT, SPOOL, POSITION = (Signal(name, UNITS[name]) for name in ("current", "spool", "position"))


def main() -> None:
    print(f"load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores, {torch.get_num_threads()} threads")
    records = [recording(seed) for seed in (1, 2)]
    dual = trained("dual process", lambda: learn_dual_gp(records, [CURRENT], [POSITION], **options()))
    single = trained(
        "single process",
        lambda: learn_gaussian_process(records, [CURRENT], [POSITION], rate=True, **options()),
    )
    exact = trained(
        "single process, exact mean of 2000 points",
        lambda: learn_gaussian_process(
            records, [CURRENT], [POSITION], rate=True, **options() | {"compress": None, "samples": 2000}
        ),
    )
    own = gpytorchs_own(records)
    print(f"\n{'a step with mean and deviation':44}{'us':>9}{'C, kB':>9}{'FMU, kB':>9}")
    for name, block in (("dual", dual), ("single", single), ("single, exact mean of 2000", exact)):
        microseconds, source = step_time(block)
        print(f"{name:44}{microseconds:9.2f}{source / 1e3:9.0f}{fmu_size(block) / 1e3:9.0f}")
        if name == "single":
            ratios = ", ".join(f"{how} {took / microseconds:.0f} x" for how, took in own.items())
    for how, took in own.items():
        print(f"{f'GPyTorch, N = {ROWS}, {how}':44}{took:9.1f}")
    print(f"the single block is faster by: {ratios}")
    print(f"load {os.getloadavg()[0]:.1f} at the end")


def options() -> dict:
    return {"period": PERIOD, "lags": LAGS, "samples": ROWS}


def recording(seed: int) -> Record:
    """Steps of the current, ten minutes at 10 Hz."""
    t = rig.commands.jittered_time(0.5 * (ROWS + 50) * PERIOD, 1 / PERIOD, 0.2, seed=seed)
    u = rig.commands.steps(t, 1.0, seed=seed, hold=(0.4, 2.0), speed=(0.104, 0.099), room=(-0.25, 0.25))
    found = rig.record(
        "spool_valve", u, t, noise={"spool": 2e-3}, quantisation={"position": 1e-3}, seed=seed, effects=HIDDEN
    )
    return Record(t, {n: found[n] for n in UNITS}, UNITS, f"valve_{seed}")


def trained(name: str, learn):
    """Train, and print what it took and what the certificate says."""
    began, processor = time.perf_counter(), time.process_time()
    block = learn()
    told = block.provenance
    print(f"\n{name}: {time.perf_counter() - began:.1f} s wall, {time.process_time() - processor:.1f} s of processor")
    for process in told["processes"]:
        print(f"  {process['process']:16} {process['seconds']:6.1f} s, {process['iterations']} evaluations")
    print(f"  rows {told['rows']}; deviation " + ", ".join(f"{k} {v:.1e}" for k, v in told["deviation"].items()))
    known = block.certificate
    print(
        f"  certificate: {known.difference:.1e} of {known.tolerance:g}, {'holds' if known.holds else 'does not hold'}"
    )
    return block


def step_time(block, rounds: int = 200, calls: int = 100) -> tuple[float, int]:
    """Microseconds of one compiled step (the fastest round) and the bytes of its C."""
    generator = ca.CodeGenerator("block", {"with_header": False, "main": False})
    generator.add(block.step)
    source = '#define CASADI_SYMBOL_EXPORT __attribute__((visibility("default")))\n' + generator.dump()
    compiled = ca.external("step", str(compile_library(source, block.name, ("-O2",))))
    buffer, evaluate = compiled.buffer()
    x = np.concatenate([np.zeros(len(block.states) - LAGS + 1), np.linspace(-0.4, 0.3, LAGS - 1)])
    places = [x, np.array([0.2]), np.zeros_like(x), np.zeros(len(block.outputs))]
    for k in (0, 1):
        buffer.set_arg(k, memoryview(places[k]))
        buffer.set_res(k, memoryview(places[k + 2]))
    fastest = np.inf
    for _ in range(rounds):
        began = time.perf_counter()
        for _ in range(calls):
            evaluate()
        fastest = min(fastest, (time.perf_counter() - began) / calls)
    expected = block.step(x, 0.2, [])[1].full().ravel()
    if not np.allclose(places[3], expected, rtol=1e-9):
        raise AssertionError(f"the compiled step of {block.name} gives {places[3]}, CasADi {expected}")
    return 1e6 * fastest, len(source)


def gpytorchs_own(records) -> dict[str, float]:
    """Microseconds of GPyTorch's mean and variance of one delay line, its caches filled."""
    rows = training_rows(records, PERIOD, [CURRENT], [POSITION], LAGS, ROWS, np.random.default_rng(0))
    X, y = normalised(rows.features, input_scales(rows.features, 1)), rows.slopes[:, 0]
    process = exact_gp.train(
        X, (y - y.mean()) / y.std(), kernel="rbf", fit="default", points=200, rng=np.random.default_rng(0)
    )
    took, place = {}, tensor(X[:1] + 0.01)
    for how in (False, True):
        process.model.train()
        process.model.eval()  # drops the caches of the other way
        with torch.no_grad(), gpytorch.settings.max_cholesky_size(10**9), gpytorch.settings.fast_pred_var(how):
            times = []
            for _ in range(30 if how else 2):
                began = time.perf_counter()
                answer = process.model(place)
                _ = answer.mean, answer.variance
                times.append(time.perf_counter() - began)
        took["fast variances" if how else "exact variances"] = 1e6 * min(times[1:])
    return took


def fmu_size(block) -> int:
    """Bytes of the FMU for this machine."""
    with tempfile.TemporaryDirectory() as folder:
        return export_fmu(block, Path(folder) / "block.fmu").stat().st_size


if __name__ == "__main__":
    main()
