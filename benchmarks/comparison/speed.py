"""What a comparison costs: recordings of 40 s at 100 Hz under five models, in both modes, with the report.

``python -m benchmarks.comparison.speed --recordings 10 100``, from the root of the repository.

Recordings are runs of the C-EHA with sensor noise, each under its own command. Every count is a call of
`hydrotwin compare` of its own, nothing of an earlier call kept, and told are the processor seconds of all its processes
(on a machine that does other things these say more than the wall does), its largest memory and the size of the page.
``--profile FILE`` runs the largest count once more in one process and keeps what cProfile saw.
"""

from __future__ import annotations

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from hydrotwin import load
from hydrotwin.records import Record, write_record
from hydrotwin.simulation import simulate

SECONDS, PERIOD = 40.0, 0.01
NOISE = 1e-3  # of the range of each output
MODELS = (
    '"cehA"',
    '{model = "cehA:third_order", name = "third order"}',
    '{model = "eq17", name = "eq17"}',
    '{model = "cehA", name = "gain", set = {"motor.gain" = 118.0}}',
    '{model = "cehA", name = "oil", set = {"cylinder.oil.bulk_modulus" = 1.2e9}}',
)
HEAD = ("recordings", "models", "processor s", "s a recording", "wall s", "MB", "page MB")
LIMIT = 60.0  # s on two cores, for a hundred recordings


def recordings(count: int, folder: Path) -> list[Path]:
    """So many files, drawn from their number alone."""
    model, time_axis, paths = load("cehA"), np.arange(0.0, SECONDS, PERIOD), []
    for k in range(count):
        random = np.random.default_rng(k)
        waves, phases = random.uniform(0.05, 0.6, 5), random.uniform(0, 2 * np.pi, 5)
        command = 0.5 * sum(np.sin(2 * np.pi * f * time_axis + p) for f, p in zip(waves, phases, strict=True))
        run = simulate(model, Record(time_axis, {"command": np.round(command, 3)}, {"command": "V"}))
        noisy = {n: run[n] + NOISE * np.ptp(run[n]) * random.standard_normal(len(time_axis)) for n in run}
        signals = {"command": np.round(command, 3), **noisy}
        record = Record(time_axis, signals, {"command": "V", **run.units}, f"load{k % 4}_{k:03d}")
        paths.append(folder / f"{record.name}.csv")
        write_record(record, paths[-1])
    return paths


def scenario(paths: Sequence[Path], folder: Path, models: Sequence[str]) -> Path:
    """The scenario of a count, with tags and a criterion."""
    path = folder / f"scenario_{len(paths)}.toml"
    names = ", ".join(f'"{p.name}"' for p in paths)
    path.write_text(
        f'title = "speed"\nmodels = [{", ".join(models)}]\nvalidate = [{names}]\ntags = "load{{load}}_*"\n'
        'accept = ["arm_angle.rmse < 90 deg"]\n'
    )
    return path


def measured(words: Sequence[str]) -> tuple[float, float, float]:
    """Processor seconds of a call with all its children, wall seconds, and the largest memory of a process [MB]."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run([sys.executable, "-m", "hydrotwin", *words], check=True, stdout=subprocess.DEVNULL)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    spent = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return spent, time.perf_counter() - began, after.ru_maxrss / 1024


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure every count, smallest first, and print a table; 1 where half the processor time is above LIMIT."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--recordings", type=int, nargs="+", default=[10, 100])
    parser.add_argument("--executor", default="processes", help="as of hydrotwin compare")
    parser.add_argument("--model", action="append", help="further models, as in a scenario: model.toml has a band")
    parser.add_argument("--profile", type=Path, help="where the profile of the largest count is kept")
    options = parser.parse_args(arguments)
    models = [*MODELS, *(f'"{Path(m).resolve()}"' for m in options.model or ())]
    last = 0.0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = recordings(max(options.recordings), folder)
        print(f"| {' | '.join(HEAD)} |\n|{'---|' * len(HEAD)}")
        for count in sorted(options.recordings):
            asked, out = scenario(paths[:count], folder, models), folder / f"out_{count}"
            words = ["compare", str(asked), "--out", str(out), "--executor", options.executor, "--fresh"]
            last, wall, memory = measured(words)
            page = (out / "report.html").stat().st_size / 1e6
            told = f"{last:.1f} | {last / count:.2f} | {wall:.1f} | {memory:.0f} | {page:.1f}"
            print(f"| {count} | {len(models)} | {told} |", flush=True)
        if options.profile:
            words = ["compare", str(asked), "--out", str(folder / "profiled"), "--executor", "here", "--fresh"]
            profiled = [sys.executable, "-m", "cProfile", "-o", str(options.profile), "-m", "hydrotwin", *words]
            subprocess.run(profiled, check=True, stdout=subprocess.DEVNULL)
    return int(max(options.recordings) >= 100 and last / 2 > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
