"""Every kind of learned model by its defaults on recordings that nobody here made, beside two of the project's own.

``make bench-learned`` or ``python -m benchmarks.learned.foreign [--data NAME...] [--kinds KIND...] [--seeds N]
[--refit] [--made] [--scoreboard docs/scoreboard.md]``: a
table with the error of the free run over the official test files, from their official start, the median over seeds and
its range, the processor seconds of one training (of ``auto`` of all of them), and two yardsticks: the first sample
held, and ARX by least squares. A kind that is no better than a yardstick on the test and did not say so, nor that its
recordings cannot tell, is marked. The last line says how well the report cards, made of training files alone, foresaw
the order of the kinds on the test.
Measurements are looked for in the folder that HYDROTWIN_MEASURED_DATA names; data sets that are not there are left out.
Every result is kept in ``--out`` and not made twice. Nothing is chosen on test files: they are read after the training.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from scipy.stats import kendalltau

from benchmarks.learned.page import put_first
from hydrotwin.learned import learn, learn_best, refitted
from hydrotwin.learned.learning import KINDS, takes
from hydrotwin.learned.ranking import ALONE
from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.records import Record, read_record
from hydrotwin.simulation import simulate

EXAMPLES = Path(__file__).parents[2] / "examples"
HOLD, ARX, AUTO = "hold", "arx", "auto"
SEEDS = 5
AGAIN = " (when judged, again on all that they hold)"
PUBLISHED = """\
Published, with the same files and the same free run: cascaded tanks 0.33 to 0.75 V by black boxes, down to 0.18 V with
physics (data: Schoukens and Noel, Three benchmarks addressing open challenges in nonlinear system identification,
2017); EMPS 74 to 220 mm by black boxes (data: Janot, Gautier and Brunot, Data set and reference models of EMPS, 2019),
4.6 mm by a continuous-time encoder network (Beintema, Schoukens and Toth, 2023). The bench has no published result.
"""


@dataclass(frozen=True)
class Task:
    """Recordings to train on and to test on, and in which unit the error of the output is told."""

    name: str
    train: tuple[Path, ...]
    test: tuple[Path, ...]
    inputs: tuple[str, ...]
    output: str
    unit: str
    per_si: float

    def read(self, paths: Sequence[Path]) -> list[Record]:
        return [read_record(p).select([*self.inputs, self.output]) for p in paths]


@dataclass(frozen=True)
class Row:
    """One training: error on the test files in the task's unit, of the block and of the first sample held.

    carded : error of the free run on what was held out, in the same unit. said : yardsticks that the card says the
    block is no better than; unsure : those of which it says that it cannot tell. tried : of ``auto``, what became of
    every kind (`learn_best`). seconds : of the processor, in all processes; clock : from beginning to end.
    """

    task: str
    kind: str
    seed: int
    error: float
    held: float
    seconds: float
    said: tuple[str, ...] = ()
    chosen: str = ""
    failed: str = ""
    unsure: tuple[str, ...] = ()
    carded: float = float("nan")
    tried: tuple[dict, ...] = ()
    clock: float = float("nan")


def tasks() -> list[Task]:
    """Those whose recordings are there."""
    measured = Path(os.environ.get("HYDROTWIN_MEASURED_DATA", "."))
    valve, arm = EXAMPLES / "spool_valve" / "recordings", EXAMPLES / "cehA" / "recordings"
    tanks, emps, bench = (measured / name for name in ("cascaded_tanks", "emps", "eha_bench"))
    known = [
        Task("tanks", (tanks / "train.csv",), (tanks / "validate.csv",), ("pump",), "level", "V", 1.0),
        Task("emps", (emps / "train.csv",), (emps / "test_pulses.csv",), ("force",), "position", "mm", 1e3),
        Task("eha_bench", tuple(sorted(bench.glob("load[13]_*.csv"))), tuple(sorted(bench.glob("load2_*.csv"))),
             ("motor_speed", "valve_direction"), "position", "mm", 1e3),
        Task("cehA", *_own(arm), ("command",), "arm_angle", "deg", float(np.degrees(1.0))),
        Task("spool_valve", *_own(valve), ("current",), "position", "mm", 1e3),
    ]  # fmt: skip
    return [t for t in known if t.train and t.test and all(p.exists() for p in (*t.train, *t.test))]


def _own(folder: Path) -> tuple[tuple[Path, ...], tuple[Path, ...]]:
    return tuple(sorted(folder.glob("train_*.csv"))), tuple(sorted(folder.glob("validate_*.csv")))


def made(task: Task, kind: str, seed: int, refit: bool = False, options: Mapping | None = None) -> Row:
    """Train one kind by its defaults, where asked for again on all that was given, and run it over the test files.

    options : of the trainer, in place of its defaults.
    """
    os.environ["OMP_NUM_THREADS"] = "1"
    began, clock, chosen, tried = time.process_time(), time.perf_counter(), "", ()
    records, names = task.read(task.train), (list(task.inputs), [task.output])
    seeded = {"seed": seed} if kind == AUTO or takes(kind, "seed") else {}
    seeded |= options or {}
    try:
        if kind == AUTO:
            block = learn_best(records, *names, **seeded)
            tried = tuple(block.provenance["ranking"])
            chosen = next(row["kind"] for row in tried if row["chosen"])
        else:
            block = learn(kind, records, *names, **seeded)
        if refit or kind == AUTO:  # as the command does
            own = chosen or kind
            block = refitted(block, own, records, *names, **{k: v for k, v in seeded.items() if takes(own, k)})
    except HydrotwinError as error:
        return Row(task.name, kind, seed, float("nan"), float("nan"), time.process_time() - began, failed=str(error))
    seconds = time.process_time() - began + sum(one["seconds"] for one in tried)  # those of other processes
    card, tests = block.provenance["free_run"], task.read(task.test)
    told = {
        "chosen": chosen,
        "tried": tried,
        "clock": time.perf_counter() - clock,
        "said": tuple(card["no_better_than"]),
        "unsure": tuple(card["cannot_tell"]),
        "carded": task.per_si * card["outputs"].get(task.output, {}).get("rmse", float("nan")),
    }
    held = _rms([np.full(len(r), r[task.output][0]) for r in tests], tests, task)
    try:
        error = _rms([simulate(block, r)[task.output] for r in tests], tests, task)
    except HydrotwinError as failed:
        return Row(task.name, kind, seed, float("inf"), held, seconds, failed=str(failed), **told)
    return Row(task.name, kind, seed, error, held, seconds, **told)


def _rms(runs: Sequence[np.ndarray], tests: Sequence[Record], task: Task) -> float:
    miss = np.concatenate([run - r[task.output] for run, r in zip(runs, tests, strict=True)])
    return float(np.sqrt(np.mean(miss**2))) * task.per_si


def table(rows: Sequence[Row], found: Sequence[Task]) -> str:
    """Markdown: a line per kind, a column per task; the yardsticks first."""
    lines = ["| kind | " + " | ".join(f"{t.name} [{t.unit}]" for t in found) + " |"]
    lines.append("|---|" + "---|" * len(found))
    held = [next((r.held for r in rows if r.task == t.name and np.isfinite(r.held)), float("nan")) for t in found]
    lines.append("| first sample held | " + " | ".join(f"{v:.3g}" for v in held) + " |")
    for kind in dict.fromkeys(r.kind for r in rows):
        limits = [h if kind == ARX else _limit(rows, t, h) for t, h in zip(found, held, strict=True)]
        own = [[r for r in rows if (r.task, r.kind) == (t.name, kind)] for t in found]
        cells = [_cell(part, limit) for part, limit in zip(own, limits, strict=True)]
        lines.append(f"| {kind} | " + " | ".join(cells) + " |")
    lines.append("| order of the cards | " + " | ".join(_foreseen(rows, t) for t in found) + " |")
    return "\n".join(lines)


def _foreseen(rows: Sequence[Row], task: Task) -> str:
    """Kendall's tau of the errors on the cards and on the test, over the kinds (medians over seeds)."""
    own = [r for r in rows if r.task == task.name and r.kind != AUTO and np.isfinite([r.error, r.carded]).all()]
    kinds = list(dict.fromkeys(r.kind for r in own))
    if len(kinds) < 3:
        return ""
    both = [[np.median([getattr(r, of) for r in own if r.kind == k]) for k in kinds] for of in ("carded", "error")]
    return f"tau {kendalltau(*both).statistic:.2f} over {len(kinds)} kinds"


def scoreboard(text: str, found: Sequence[Task], given: argparse.Namespace) -> str:
    """The page that holds the table, with what it is and what others reached."""
    protocol = (
        f"Seeds: {'up to ' if given.made else ''}{given.seeds} (median, and range of several; empty: not run), all "
        "kinds by their defaults; processor seconds of one training, of `auto` of all trainings, "
        "on a machine that may have been shared. "
        f"Trained on the training files alone{AGAIN if given.refit else ''}, run freely over the test files from their "
        "first sample; no training chooses on test files; who develops this has seen such figures. `worse`: than ARX "
        "or than holding the first sample; `silent`: and the report card did not say so; `doubted`: it said that the "
        "recordings cannot tell. Order of the cards: Kendall's tau between the errors on what was held out of training "
        "and those on the test."
    )
    names = " ".join(t.name for t in found) + f" --kinds {' '.join(given.kinds)}" + (" --refit" if given.refit else "")
    made_by = (
        f"Made by `make bench-learned LEARNED='--seeds {given.seeds} --data {names} --scoreboard docs/scoreboard.md'`, "
        "with the measurements in the folder that HYDROTWIN_MEASURED_DATA names."
    )
    return f"# Learned models on recordings of others\n\n{protocol}\n\n{text}\n\n{PUBLISHED}\n{made_by}\n"


def _limit(rows: Sequence[Row], task: Task, held: float) -> float:
    """What a block must stay under on the test to be better than both yardsticks."""
    arx = [r.error for r in rows if (r.task, r.kind) == (task.name, ARX)]
    return min([held, *arx])


def _cell(rows: Sequence[Row], limit: float) -> str:
    done = [r.error for r in rows if not np.isnan(r.error)]
    if not done:
        return "refused" if rows else ""
    text = f"{np.median(done):.3g}"
    text += f" ({min(done):.3g} to {max(done):.3g})" if len(done) > 1 else ""
    text += f", {np.median([r.seconds for r in rows]):.0f} s"
    worse = [r for r in rows if not r.error < limit]
    silent = [r for r in worse if not r.said and not r.unsure and r.kind != ARX]
    doubted = [r for r in worse if r.unsure and not r.said]
    chosen = ", ".join(dict.fromkeys(r.chosen for r in rows if r.chosen))
    verdict = ", worse and silent" if silent else ", worse, doubted" if doubted else ", worse" if worse else ""
    return text + (f", {chosen}" if chosen else "") + verdict


def main() -> None:
    known = {t.name: t for t in tasks()}
    kinds = [k for k in KINDS if k not in ALONE]
    kinds.sort(key=lambda kind: kind != ARX)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", nargs="+", choices=known, default=list(known))
    parser.add_argument("--kinds", nargs="+", choices=[*kinds, AUTO], default=[*kinds, AUTO])
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=Path("out/learned"))
    parser.add_argument("--refit", action="store_true", help="train again on all that was given, when judged")
    parser.add_argument("--made", action="store_true", help="train nothing: the table of what --out holds already")
    parser.add_argument("--scoreboard", type=Path, help="write the table with its protocol to this page, too")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    wanted = [(known[name], kind, seed) for seed in range(given.seeds) for name in given.data for kind in given.kinds
              if seed == 0 or kind == AUTO or takes(kind, "seed")]  # fmt: skip
    rows = _rows(wanted, given)
    text = table(rows, [known[name] for name in given.data])
    (given.out / "table.md").write_text(text + "\n", encoding="utf-8")
    if given.scoreboard:
        page = scoreboard(text, [known[name] for name in given.data], given)
        put_first(given.scoreboard, page)
    print(text)


def _rows(wanted: Sequence[tuple[Task, str, int]], given: argparse.Namespace) -> list[Row]:
    """Every training that is wanted; those made before are read."""
    again = "_refit" if given.refit else ""
    files = {one: given.out / f"{one[0].name}_{one[1]}_{one[2]}{again}.json" for one in wanted}
    missing = [] if given.made else [one for one in wanted if not files[one].exists()]
    alone = [one for one in missing if one[1] == AUTO]  # it has processes of its own
    with ProcessPoolExecutor(given.processes, mp_context=get_context("spawn")) as pool:
        jobs = {pool.submit(made, *one, given.refit): one for one in missing if one not in alone}
        for job in as_completed(jobs):
            _keep(job.result(), files[jobs[job]])
    for one in alone:
        _keep(made(*one, given.refit), files[one])
    return [Row(**json.loads(file.read_text(encoding="utf-8"))) for file in files.values() if file.exists()]


def _keep(row: Row, file: Path) -> None:
    file.write_text(json.dumps(asdict(row)), encoding="utf-8")
    found = row.failed or f"{row.error:.4g}"
    seconds = f"{row.seconds:.0f} s of the processor, {row.clock:.0f} s on the clock"
    print(f"   {row.task}, {row.kind}, seed {row.seed}: {found}, {seconds}", flush=True)


if __name__ == "__main__":
    main()
