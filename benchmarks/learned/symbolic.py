"""Formulas: three static problems with a known law, and the experiment of the C-EHA paper on the rig.

The problems, by ours, the old operators, operon and gplearn in the same processor time: `symbolic_problems`.
The experiment: learn a formula from five recordings, judge it by free runs on three. Both fits of `learn_symbolic`,
with and without the measured motor speed, and plain operon on the same increments: error of the free runs, formula,
evaluations per processor second, and the time of a refit of all constants on all recordings.
``python benchmarks/learned/symbolic.py [SECONDS [SEEDS]]``: length of a recording, 80 s as in the paper unless said;
seeds of the problems, 5 unless said.
"""

from __future__ import annotations

import sys
import time
from dataclasses import fields

import numpy as np

from benchmarks.learned.symbolic_problems import OPERON, SAMPLES, best_found, problems
from hydrotwin.learned.block_file import assemble
from hydrotwin.learned.symbolic.block import SYMBOLIC, Formula
from hydrotwin.learned.symbolic.data import prepare
from hydrotwin.learned.symbolic.learn import learn_symbolic
from hydrotwin.learned.symbolic.refit import FreeRun, laid_out
from hydrotwin.records import Record
from hydrotwin.simulation import Block, simulate
from tests import rig

UNITS = {"command": "V", "motor_speed": "rad/s", "arm_angle": "rad"}
CPU_SECONDS = 5.0  # of every contender on a problem
NOISE = {"arm_angle": 2e-4, "motor_speed": 0.5}


def recording(seed: int, seconds: float, rate: float = 1000.0) -> Record:
    """One run of the arm under the smooth drive command, sampled as in the paper."""
    time_, command = rig.drive("cehA", seconds, 100.0, seed=seed)
    fine = np.arange(round(seconds * rate) + 1) / rate
    held = command[np.clip(np.searchsorted(time_, fine + 1e-9) - 1, 0, None)]
    columns = rig.record("cehA", held, fine, noise=NOISE, seed=seed)
    return Record(columns["time"], {n: columns[n] for n in UNITS}, UNITS, f"run_{seed}")


def main(seconds: float = 80.0, seeds: float = 5) -> None:
    problems(CPU_SECONDS, int(seeds))
    train = [recording(seed, seconds) for seed in range(5)]
    judge = [recording(seed, seconds) for seed in (500, 501, 503)]  # 502 has no command that stays in reach
    print(
        f"{len(train)} x {seconds:g} s to learn from, {len(judge)} x {seconds:g} s to judge; rms of the free run, deg"
    )
    for label, inputs, options in (
        ("paper", ["command", "motor_speed"], {"fit": "paper"}),
        ("paper, command only", ["command"], {"fit": "paper"}),
        ("default", ["command"], {}),
        ("default, with motor speed", ["command", "motor_speed"], {}),
    ):
        began, spent = time.perf_counter(), time.process_time()
        block = learn_symbolic(train, inputs, ["arm_angle"], **options)
        wall, cpu = time.perf_counter() - began, time.process_time() - spent
        errors = [_error(block, record) for record in judge]
        p = block.provenance
        print(f"\n{label}: {', '.join(f'{e:.3f}' for e in errors)}; mean {np.mean(errors):.3f}")
        print(f"  {p['equation']}")
        print(f"  {wall:.1f} s wall, {cpu:.1f} s of the processor, {p['evaluations_per_cpu_second']} evaluations/CPU-s")
        print(f"  period {block.period:g} s, certificate {block.certificate.difference:.1e}, {p['stopped']}")
        if "fit" not in options:
            print(
                f"  refit of all constants, each 5 % off, on all recordings: {_refit_seconds(block, train):.1f} CPU-s"
            )

    _plain_operon(train, judge)


def _plain_operon(train, judge) -> None:
    """The formula with the best one-step error that plain operon finds on the same features, run freely."""
    for inputs in (["command"], ["command", "motor_speed"]):
        block = learn_symbolic(train, inputs, ["arm_angle"], starts=1, generations=1, population=20)
        lags = block.structure["output_lags"], block.structure["input_lags"]
        data = prepare(train, [], block.inputs, block.outputs, block.period, lags, False)
        z, d = data.pairs(data.fit)
        chosen = np.sort(np.random.default_rng(0).permutation(len(z))[:SAMPLES])
        began = time.process_time()
        best = best_found(OPERON, z[chosen], d[chosen, 0], 0, CPU_SECONDS)
        arrays = {"tokens": np.array(best.tokens, float), "constants": np.array(best.constants)}
        counts = {"tokens": len(best.tokens), "constants": len(best.constants)}
        frame = {f.name: getattr(block, f.name) for f in fields(Block) if f.name not in ("step", "start")}
        plain = assemble(SYMBOLIC, data.scales | arrays, dict(block.structure) | counts, **frame)
        errors = [_error(plain, record) for record in judge]
        print(f"\nplain operon, {', '.join(inputs)}: {', '.join(f'{e:.3f}' for e in errors)}; "
              f"mean {np.mean(errors):.3f} ({time.process_time() - began:.1f} CPU-s)")  # fmt: skip


def _refit_seconds(block, train) -> float:
    lags = block.structure["output_lags"], block.structure["input_lags"]
    data = prepare(train, [], block.inputs, block.outputs, block.period, lags, False)
    off = tuple(1.05 * c for c in block.arrays["constants"])
    run = FreeRun(Formula(tuple(int(t) for t in block.arrays["tokens"]), off), [0], data.shape, data.bounds)
    spent = time.process_time()
    run.refit(laid_out(data.series, data.fit, [0], data.shape), 30)
    return time.process_time() - spent


def _error(block, record: Record) -> float:
    return float(np.degrees(np.sqrt(np.mean((simulate(block, record)["arm_angle"] - record["arm_angle"]) ** 2))))


if __name__ == "__main__":
    main(*(float(a) for a in sys.argv[1:]))
