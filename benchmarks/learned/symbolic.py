"""Formulas: three static problems with a known law, and the experiment of the C-EHA paper on the rig.

The problems, by ours, the old operators, operon and gplearn in the same processor time: `symbolic_problems`.
The experiment: learn a formula from five recordings, judge it by free runs on three. Both fits of `learn_symbolic`,
with and without the measured motor speed, and plain operon on the same increments: error of the free runs, formula,
evaluations per processor second, and the time of a refit of all constants on all recordings.
``python -m benchmarks.learned.symbolic [--seconds 80] [--seeds 5] [--problems] [--scoreboard docs/scoreboard.md]``:
length of a recording, as in the paper unless said; seeds of the problems. gplearn has no row here: it has no free run
of its own. `symbolic_arm` has all of them on the C-EHA, in the same processor time.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import fields
from pathlib import Path

import numpy as np

from benchmarks.learned.page import put_section
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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=80.0)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--problems", action="store_true", help="the static problems alone, a quarter of an hour")
    parser.add_argument("--scoreboard", type=Path, help="write the section 'Formulas' of this page")
    given = parser.parse_args()
    found = problems(CPU_SECONDS, given.seeds)
    arm = [] if given.problems else _arm(given.seconds)
    if given.scoreboard:
        written(given.scoreboard, given, found, arm)


LEAD = (
    "Static problems with a known law. Everybody is to end after {seconds:g} processor seconds in one thread, between "
    "two generations; the last column has what it took. NRMSE over the spread of samples that nobody learnt from, "
    "{seeds} seeds. `new`: `learn symbolic`; `old`: the paper's operators."
)
ARM = (
    "The rig's C-EHA arm: five recordings of {seconds:g} s to learn from, RMS of free runs over three others. gplearn "
    "has no free run, and no row."
)
MADE_BY = "Made by `python -m benchmarks.learned.symbolic {how}--scoreboard docs/scoreboard.md`."


def written(page: Path, given: argparse.Namespace, found: list[str], arm: list[str]) -> None:
    """The section of the page."""
    parts = [LEAD.format(seconds=CPU_SECONDS, seeds=given.seeds), "", *found, ""]
    parts += [ARM.format(seconds=given.seconds), "", *arm, ""] if arm else []
    how = f"--seeds {given.seeds} " + ("--problems " if given.problems else "")
    put_section(page, "Formulas", "\n".join([*parts, MADE_BY.format(how=how)]))


def _arm(seconds: float) -> list[str]:
    """The experiment of the paper: a table of who ran how far off, deg."""
    lines = ["| who | free run [deg] | each | CPU s |", "|---|---|---|---|"]
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
        spent = time.process_time()
        block = learn_symbolic(train, inputs, ["arm_angle"], **options)
        cpu = time.process_time() - spent
        lines.append(_line(label, block, judge, cpu))
        p = block.provenance
        print(f"  {p['equation']}\n  {p['evaluations_per_cpu_second']} evaluations/CPU-s, period {block.period:g} s, "
              f"certificate {block.certificate.difference:.1e}, {p['stopped']}")  # fmt: skip
        if "fit" not in options:
            print(
                f"  refit of all constants, each 5 % off, on all recordings: {_refit_seconds(block, train):.1f} CPU-s"
            )
    return lines + _plain_operon(train, judge)


def _line(label: str, block, judge, cpu: float) -> str:
    """A row of the table, printed too."""
    errors = [error_of(block, record) for record in judge]
    line = f"| {label} | {np.mean(errors):.3f} | {', '.join(f'{e:.3f}' for e in errors)} | {cpu:.1f} |"
    print(line, flush=True)
    return line


def _plain_operon(train, judge) -> list[str]:
    """The formula with the best one-step error that plain operon finds on the same features, run freely."""
    lines = []
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
        cpu = time.process_time() - began
        lines.append(_line(f"plain operon, {', '.join(inputs)}", plain, judge, cpu))
    return lines


def _refit_seconds(block, train) -> float:
    lags = block.structure["output_lags"], block.structure["input_lags"]
    data = prepare(train, [], block.inputs, block.outputs, block.period, lags, False)
    off = tuple(1.05 * c for c in block.arrays["constants"])
    run = FreeRun(Formula(tuple(int(t) for t in block.arrays["tokens"]), off), [0], data.shape, data.bounds)
    spent = time.process_time()
    run.refit(laid_out(data.series, data.fit, [0], data.shape), 30)
    return time.process_time() - spent


def error_of(block, record: Record) -> float:
    return float(np.degrees(np.sqrt(np.mean((simulate(block, record)["arm_angle"] - record["arm_angle"]) ** 2))))


if __name__ == "__main__":
    main()
