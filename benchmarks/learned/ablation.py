"""What each default of the learned kinds brings, on recordings of others: one default less at a time.

``make bench-ablation`` or ``python -m benchmarks.learned.ablation [--kinds KIND...] [--data NAME...]
[--scoreboard docs/scoreboard.md]``: every kind by its defaults, and again with one of them replaced by what one would
write without it; error of the free run over the official test files. Trained on the training files alone; no default
was changed for this table. Results are kept in ``--out`` and not made twice.
"""

from __future__ import annotations

import argparse
import json
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.learned.foreign import Row, Task, made, tasks
from benchmarks.learned.page import put_section
from hydrotwin.models.language.units import si_unit

DATA = ("tanks", "emps")
MOVES = ("m", "rad")  # units of what one would take for an output that integrates
ALL = "all defaults"


@dataclass(frozen=True)
class Without:
    """A default, what one would write without it, and that as options for recordings."""

    default: str
    instead: str
    options: Callable[[Task], Mapping]


def _recorded(task: Task) -> dict:
    return {"period": float(f"{max(r.period for r in task.read(task.train)):.9g}")}


def _by_unit(option: str) -> Callable[[Task], dict]:
    def options(task: Task) -> dict:
        return {option: si_unit(task.read(task.train[:1])[0].units[task.output]) in MOVES}

    return options


def _always(**options) -> Callable[[Task], dict]:
    return lambda task: options


PERIOD = Without("sampling period chosen", "that of the recording", _recorded)
FORM = "whether the output integrates, found"
BY_UNIT = "told by its unit"
ONE_SEED = Without("several seeds", "one", _always(starts=1))
WITHOUT: Mapping[str, Sequence[Without]] = {
    "arx": (
        PERIOD,
        Without(FORM, BY_UNIT, _by_unit("rate")),
        Without("orders chosen", "2 past values, 3 samples", _always(lags=(2, 3))),
        Without("delay chosen", "none", _always(delay=0)),
        Without("refined in free run", "least squares alone", _always(refine=False)),
    ),
    "linear": (
        PERIOD,
        Without(FORM, BY_UNIT, _by_unit("rate")),
        Without("order chosen", "2", _always(order=2)),
        Without("refined in free run", "subspace alone", _always(refine=False)),
    ),
    "narx": (
        PERIOD,
        Without("lags chosen", "1 past increment, 3 samples", _always(lags=(1, 3))),
        Without("delay chosen", "none", _always(delay=0)),
        Without("products up to the third degree", "up to the second", _always(degree=2)),
    ),
    "gp": (
        PERIOD,
        Without("fed back its own outputs, fitted in free run", "delayed inputs alone", _always(feedback=False)),
        ONE_SEED,
    ),
    "symbolic": (PERIOD, Without("samples of the inputs chosen", "3", _always(lags=(1, 3))), ONE_SEED),
    "state_nn": (PERIOD, Without("hidden states chosen", "1", _always(hidden_states=1)), ONE_SEED),
    "nn": (
        PERIOD,
        Without(FORM, BY_UNIT, _by_unit("integrates")),
        Without("lags chosen", "2 past increments, 3 samples", _always(lags=(2, 3))),
        Without("a network only where it beats the linear model", "8 units", _always(hidden=8)),
        ONE_SEED,
    ),
}


def wanted(kinds: Sequence[str], known: Sequence[Task]) -> list[tuple[Task, str, int, Mapping]]:
    """Every training: task, kind, number of what is left out (0: nothing), options."""
    answer = []
    for kind in kinds:
        for task in known:
            answer.append((task, kind, 0, {}))
            answer += [(task, kind, k + 1, one.options(task)) for k, one in enumerate(WITHOUT[kind])]
    return answer


def rows(jobs: Sequence[tuple[Task, str, int, Mapping]], out: Path, processes: int) -> dict[tuple[str, str, int], Row]:
    """What became of every training, by task, kind and number; those made before are read."""
    files = {(t.name, kind, k): out / f"ablation_{t.name}_{kind}_{k}.json" for t, kind, k, _ in jobs}
    with ProcessPoolExecutor(processes, mp_context=get_context("spawn")) as pool:
        missing = [job for job in jobs if not files[job[0].name, job[1], job[2]].exists()]
        futures = {pool.submit(made, task, kind, 0, False, options): (task.name, kind, k)
                   for task, kind, k, options in missing}  # fmt: skip
        for future in as_completed(futures):
            row = future.result()
            files[futures[future]].write_text(json.dumps(asdict(row)), encoding="utf-8")
            found = row.failed or f"{row.error:.4g}"
            print(f"   {', '.join(map(str, futures[future]))}: {found}, {row.seconds:.0f} s", flush=True)
    return {key: Row(**json.loads(file.read_text(encoding="utf-8"))) for key, file in files.items()}


def table(found: Mapping[tuple[str, str, int], Row], kinds: Sequence[str], known: Sequence[Task]) -> list[str]:
    """Markdown: a line per default that was left out, behind that of all defaults."""
    lines = ["| kind | default | instead | " + " | ".join(f"{t.name} [{t.unit}]" for t in known) + " |"]
    lines.append("|---|---|---|" + "---|" * len(known))
    for kind in kinds:
        for k, (default, instead) in enumerate([(ALL, ""), *((o.default, o.instead) for o in WITHOUT[kind])]):
            cells = [_cell(found[t.name, kind, k], found[t.name, kind, 0]) for t in known]
            lines.append(f"| {kind} | {default} | {instead} | " + " | ".join(cells) + " |")
    return lines


def _cell(row: Row, whole: Row) -> str:
    """The error, and what it is times that of all defaults."""
    if np.isnan(row.error):
        return "refused"
    told = "diverges" if np.isinf(row.error) else f"{row.error:.3g}"
    if row is whole or not np.isfinite([row.error, whole.error]).all():
        return told
    return f"{told}, x {row.error / whole.error:.2g}"


LEAD = (
    "One default less at a time, all others as they are; seed 0. RMS error of the free run over the official test "
    "files, and what it is times that of all defaults: above 1 the default helped on this file. Trained on the "
    "training files alone; no default was changed for this table."
)
MADE_BY = "Made by `make bench-ablation ABLATION='--kinds {kinds} --data {data}'`."


def main() -> None:
    known = {t.name: t for t in tasks()}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kinds", nargs="+", choices=list(WITHOUT), default=list(WITHOUT))
    parser.add_argument("--data", nargs="+", choices=list(known), default=[n for n in DATA if n in known])
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--out", type=Path, default=Path("out/learned"))
    parser.add_argument("--scoreboard", type=Path, help="write the section 'What each default brings' of this page")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    chosen = [known[name] for name in given.data]
    found = rows(wanted(given.kinds, chosen), given.out, given.processes)
    lines = table(found, given.kinds, chosen)
    print("\n".join(lines))
    if given.scoreboard:
        made_by = MADE_BY.format(kinds=" ".join(given.kinds), data=" ".join(given.data))
        put_section(given.scoreboard, "What each default brings", "\n".join([LEAD, "", *lines, "", made_by]))


if __name__ == "__main__":
    main()
