"""Identified physics on the recordings that learned models are measured on, under the same official protocol.

``make scoreboard`` or ``python -m benchmarks.learned.physical [--data NAME...] [--scoreboard docs/scoreboard.md]``: a
row for what a user writes first, and one for it with effects of the catalogue, one more each time. Fitted to the
training files alone; run freely over the test files. Of what no sensor shows at the start, the first samples of a test
file tell it, as many as the protocol of the data allows (`FIRST`); all samples are scored, those too.
Every result is kept in ``--out`` and not made twice. Effects were named by people who had seen the data: this says how
far such a model goes, not that it would be found. `hydrotwin gap` is what finds; benchmarks/gap measures it.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

import hydrotwin as ht
from benchmarks.learned.foreign import EXAMPLES, Task, tasks
from benchmarks.learned.page import put_section
from hydrotwin.identification import Fit, identify
from hydrotwin.identification.beginning import BEGINNING, estimate_start
from hydrotwin.models.effects import candidates
from hydrotwin.models.language.errors import SolveError
from hydrotwin.records import Record
from hydrotwin.simulation import simulate

HEADING = "Identified physics"
FIRST = 50  # samples of a test file that may tell its start: what the tanks' benchmark allows; ten of them make a tenth
TANKS, AXIS, BENCH = "cascaded_tanks/model.py:model", "emps/model.py", "eha_bench/model.py:model"
OVERFLOW, CURVED = ("overflow", "upper.level-lower.level"), ("sensor_curvature", "level")
DIRECTION = ("displacement_asymmetry", "pump")
LINES = ("line_compliance", "lines")

STARTS = {  # how runs over the test files start
    "tanks": f"Tanks: the level of the upper tank comes from the first {FIRST} samples of the test file.",
    "emps": "EMPS: runs start at rest, at the first sample.",
    "eha_bench": "Bench: loads 1 and 3 to fit, load 2 to test; the load comes from the first tenth of each file.",
}


@dataclass(frozen=True)
class Physics:
    """A model of an example: what is added to it, (effect, site), and how `identify` is asked.

    at_rest : runs start from the first sample; else what no sensor measures is estimated from the first samples.
    """

    task: str
    label: str
    spec: str
    effects: tuple[tuple[str, str], ...] = ()
    how: Mapping = field(default_factory=dict)
    at_rest: bool = False

    @property
    def file(self) -> str:
        """Where its answer is kept."""
        return f"physical_{self.task}_{self.label}.json".replace(" ", "_").replace(",", "")


@dataclass(frozen=True)
class Row:
    """RMS errors of free runs in the task's unit, processor seconds of the fit, and what was found of the effects."""

    task: str
    label: str
    error: float
    train: float
    seconds: float
    found: Mapping[str, float]


def rows_wanted() -> list[Physics]:
    """What is measured, in the order of the table."""
    free = {"initial_states": "free"}
    rest = {"initial_states": "fixed", "noise": {"position": 1e-3}}
    second = ("asymmetric_viscous_friction", "carriage.flange")
    dry = f"{AXIS}:axis_with_coulomb"
    return [
        Physics("tanks", "Torricelli twice", TANKS, (), free),
        Physics("tanks", "with overflow", TANKS, (OVERFLOW,), free),
        Physics("tanks", "with overflow, curved sensor", TANKS, (OVERFLOW, CURVED), free),
        Physics("tanks", "with overflow of both, curved sensor", TANKS, (OVERFLOW, CURVED, ("overflow", "lower.level")),
                free),
        Physics("emps", "mass, viscous friction, offset", f"{AXIS}:axis", (), rest, at_rest=True),
        Physics("emps", "with dry friction", dry, (), rest, at_rest=True),
        Physics("emps", "with dry friction, viscous by direction", dry, (second,), rest, at_rest=True),
        Physics("eha_bench", "stiff oil, constant efficiency", BENCH, (), free),
        Physics("eha_bench", "with compliance of the lines", BENCH, (LINES,), free),
        Physics("eha_bench", "with compliance, delivery by direction", BENCH, (LINES, DIRECTION), free),
    ]  # fmt: skip


def fitted(physics: Physics, records: Sequence[Record]) -> tuple[object, Fit]:
    """The model with its effects, fitted: one more each time, from what was found before and the effect's probes."""
    model = ht.load(str(EXAMPLES / physics.spec))
    free = [p.name for p in model.flat.parameters if p.free]
    best = identify(model, records, **physics.how)
    for effect, site in physics.effects:
        one = next(c for c in candidates(model, [effect], merged=False) if c.site.name == site)
        model, free = model.plus([one.addition]), [*free, *one.free]
        known = {n: best.values[n] for n in free if n in best.values}
        tries = []
        for probe in one.probes:
            with contextlib.suppress(SolveError):  # a start that diverges costs only itself
                tries.append(identify(model, records, free=free, start={**known, **probe}, starts=1, **physics.how))
        best = min(tries, key=_left)
    return model, best


def _left(fit: Fit) -> float:
    """What a fit leaves of the training files: squares over all outputs, each in units of its nominal value."""
    nominal = {s.name: s.nominal for s in fit.flat.outputs}
    return sum((error / nominal[name]) ** 2 for name, error in fit.rmse["train"].items())


def made(physics: Physics, task: Task) -> Row:
    """Fit to the training files, run over the test files."""
    began = time.process_time()
    records = _read(physics, task.train)
    _, fit = fitted(physics, records)
    seconds = time.process_time() - began
    tests = _read(physics, task.test)
    misses = [simulate(fit.flat, r, start=_start(physics, fit, r))[task.output] - r[task.output] for r in tests]
    error = float(np.sqrt(np.mean(np.concatenate(misses) ** 2))) * task.per_si
    added = {n: v for n, v in fit.values.items() if any(n.startswith(e) for e, _ in physics.effects)}
    return Row(physics.task, physics.label, error, fit.rmse["train"][task.output] * task.per_si, seconds, added)


def _read(physics: Physics, paths: Sequence[Path]) -> list[Record]:
    """Recordings with all that the model knows."""
    flat = ht.load(str(EXAMPLES / physics.spec)).flat
    names = [s.name for s in (*flat.inputs, *flat.outputs)]
    return [ht.read_record(p).select(names) for p in paths]


def _start(physics: Physics, fit: Fit, record: Record) -> dict[str, float] | None:
    """Start states of a test file, from its first samples."""
    if physics.at_rest:
        return None
    first = record.window(end=record.time[round(FIRST / BEGINNING) - 1]) if _few(physics) else record
    return estimate_start(fit.flat, first, "free").values


def _few(physics: Physics) -> bool:
    """Whether a protocol says how many; the load of the bench shows only once it is driven: a tenth of a recording."""
    return physics.task == "tanks"


def section(rows: Sequence[Row], found: Mapping[str, Task]) -> str:
    """The rows in Markdown, and how they were made."""
    lines = ["| data | model | test | training | fit |", "|---|---|---|---|---|"]
    for r in rows:
        unit = found[r.task].unit
        lines.append(f"| {r.task} | {r.label} | {r.error:.3g} {unit} | {r.train:.3g} {unit} | {r.seconds:.0f} s |")
    told = [STARTS[name] for name in dict.fromkeys(r.task for r in rows)]
    lead = (
        "The models of `examples/`, as a user writes them first, and with effects of the catalogue, one more each "
        "time. Fitted to the training files alone, run freely over the test files, all samples scored; processor "
        f"seconds. Who named the effects had seen the data. {' '.join(told)}"
    )
    made_by = "Made by `make scoreboard`, with the measurements in the folder that HYDROTWIN_MEASURED_DATA names."
    return "\n".join([lead, "", *lines, "", made_by])


def main() -> None:
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    known = {t.name: t for t in tasks()}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", nargs="+", choices=known, default=list(known))
    parser.add_argument("--out", type=Path, default=Path("out/learned"))
    parser.add_argument("--scoreboard", type=Path, help="put the table into this page, beside what it holds")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for physics in (p for p in rows_wanted() if p.task in given.data):
        path = given.out / physics.file
        if not path.exists():
            path.write_text(json.dumps(asdict(made(physics, known[physics.task]))), encoding="utf-8")
        rows.append(Row(**json.loads(path.read_text(encoding="utf-8"))))
        print(f"   {rows[-1].task}, {rows[-1].label}: {rows[-1].error:.3g}, {rows[-1].seconds:.0f} s", flush=True)
    text = section(rows, known)
    if given.scoreboard:
        put_section(given.scoreboard, HEADING, text)
    print(text)


if __name__ == "__main__":
    main()
