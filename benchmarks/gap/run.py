"""The hidden-effect benchmark on the command line: ``python -m benchmarks.gap --help``.

Rows are appended to OUT/rows.jsonl as they come; finished ones are skipped when it is started again.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import os
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path

THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
BATCH = 40  # cases after which fresh processes take over
METHODS = ("discover", "narrow", "plain", "sindy", "gp")
LIMIT = 300.0  # s of a search
QUICK = {"seconds": 20.0, "severities": (5.0, 30.0)}


def rows_of(
    name: str, methods: Sequence[str], with_oracle: bool, memory: Path | None = None, settings: Mapping | None = None
) -> list[dict]:
    """Every row of one case; its own process, so that nothing it does is left behind.

    memory : a folder for the fits of ``plain``. settings : of `discover`.
    """
    from benchmarks.gap.cases import Case, Unreachable, make

    try:
        made = make(Case.from_name(name))
    except Unreachable as reason:
        return [{"case": name, "method": method, "unreachable": str(reason)} for method in methods]
    except Exception as error:
        return [{"case": name, "method": m, "failed": f"{type(error).__name__}: {error}"} for m in methods]
    return _judged(made, methods, with_oracle, memory, settings or {})


def _judged(made, methods, with_oracle, memory, settings) -> list[dict]:
    from benchmarks.gap.refits import Bench, oracle
    from benchmarks.gap.score import row_of

    bench, rows, best, lacking = Bench(made), [], None, ()
    if with_oracle and made.case.kind != "out_of_library":
        try:
            best = oracle(bench)
            if made.case.kind == "pairs" and best:
                lacking = [oracle(bench, without=h) for h in range(len(made.hidden))]
        except Exception as error:
            rows.append({"case": made.case.name, "method": "oracle", "failed": f"{type(error).__name__}: {error}"})
    for method in methods:
        if method == "narrow" and made.case.kind not in ("single", "pairs"):
            continue  # nothing is hidden that a catalogue could be narrowed to
        try:
            answer = _answer(method, made, bench, memory, settings)
            rows.append(row_of(made, answer, method=method, oracle=best, lacking=lacking))
        except Exception as error:
            rows.append({"case": made.case.name, "method": method, "failed": f"{type(error).__name__}: {error}"})
    return rows


def _answer(method, made, bench, memory, settings):
    if method in ("discover", "narrow"):
        from benchmarks.gap.score import answer_of
        from hydrotwin.discovery.discover import discover

        if method == "narrow":
            settings = {**settings, "effects": [name for name, _ in made.hidden]}
        found = discover(made.model, made.fit, validate=made.held_out, executor="here", **settings)
        return answer_of(found, settings)
    if method == "plain":
        from benchmarks.gap.plain import plain

        return plain(made, memory)
    if method == "sindy":
        from benchmarks.gap.sindy import sparse_regression

        return sparse_regression(bench)
    from benchmarks.gap.baselines import gaussian_process

    return gaussian_process(bench)


def read_rows(path: Path) -> list[dict]:
    """Finished rows; a last line that was cut off is passed over."""
    rows = []
    for line in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            rows.append(json.loads(line))
        except json.JSONDecodeError:
            continue
    return rows


def chosen_cases(options) -> list:
    """The cases the command line asks for, in an order whose every beginning is a fair sample."""
    import dataclasses

    from benchmarks.gap.cases import cases, grid

    severities = options.severities or (QUICK["severities"] if options.quick else None)
    asked = dict(which_grid=options.grid, machines=options.machine, kinds=options.kinds, severities=severities)
    found = cases(options.seeds, **asked)
    found = [c for c in found if (not options.effects or set(c.effects) & set(options.effects))]
    found = [c for c in found if (not options.sensors or c.sensors in options.sensors)]
    seeds = (grid() if options.grid == "narrow" else grid()[options.grid])["seeds"][options.seeds]
    seed = options.seed or (seeds["single"][0] if options.quick else None)
    found = [c for c in found if (not options.excitation or c.excitation in options.excitation)]
    found = [c for c in found if seed in (None, c.seed)]
    if options.quick:
        found = [dataclasses.replace(c, seconds=QUICK["seconds"]) for c in found]
    return found[: options.limit]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the cases that are missing, then write OUT/table.md. Returns 0, or 1 when a case failed."""
    for name in THREADS:
        os.environ[name] = "1"
    options = _options(arguments)
    options.out.mkdir(parents=True, exist_ok=True)
    path, wanted = options.out / "rows.jsonl", [c.name for c in chosen_cases(options)]
    if options.list:
        print("\n".join(wanted))
        return 0
    if not options.table:
        _run(wanted, options, path)
    rows = [r for r in read_rows(path) if r["case"] in set(wanted)]
    from benchmarks.gap.tables import markdown

    table = markdown(rows)
    (options.out / "table.md").write_text(table, encoding="utf-8")
    print(table)
    return int(any("failed" in r for r in rows))


def _run(wanted, options, path):
    done = {(r["case"], r["method"]) for r in read_rows(path) if "failed" not in r}
    jobs = [(name, left) for name in wanted if (left := [m for m in options.methods if (name, m) not in done])]
    print(f"{len(wanted)} cases, {len(jobs)} to do, {options.processes} at a time", flush=True)
    began, verdicts = time.perf_counter(), Counter()
    with open(path, "a", encoding="utf-8") as file:
        for number, rows in enumerate(_finished(jobs, options), 1):
            for row in rows:
                file.write(json.dumps(row) + "\n")
                file.flush()
                verdicts[row.get("verdict") or next(k for k in ("unreachable", "failed") if k in row)] += 1
                _tell(row, number, len(jobs), time.perf_counter() - began)
    print(", ".join(f"{n} {v}" for v, n in verdicts.most_common()))


def _finished(jobs, options):
    """Rows of every case as they come. Processes are replaced now and then: compiled models stay loaded in them."""
    context = multiprocessing.get_context("spawn")
    for batch in [jobs[i : i + BATCH] for i in range(0, len(jobs), BATCH)]:
        with ProcessPoolExecutor(options.processes, mp_context=context) as pool:
            settings = {"effort": options.effort, "time_limit": options.time_limit}
            asked = not options.no_oracle, options.out / "fits", settings
            futures = [pool.submit(rows_of, name, left, *asked) for name, left in batch]
            for future in as_completed(futures):
                yield future.result()


def _tell(row, number, count, elapsed):
    if "verdict" not in row:
        what = row.get("unreachable") or row["failed"]
    else:
        named = " + ".join(f"{e} at {s}" for e, s, _, _ in row["named"])
        mark = "ok " if row["in_class"] and all(row["in_class"]) else "   "
        what = f"{mark}{row['verdict']} {named} ({row['seconds']:.0f} s)"
    left = elapsed / number * (count - number) / 60
    print(f"[{number}/{count}, {left:.0f} min left] {row['case']} {row['method']}: {what}", flush=True)


def _options(arguments):
    from benchmarks.gap.cases import GRIDS, KINDS, SEEDS, machines_of
    from hydrotwin.discovery.structures.jobs import EFFORTS

    p = argparse.ArgumentParser(prog="python -m benchmarks.gap", description=__doc__.splitlines()[0])
    p.add_argument("--grid", choices=GRIDS, default="narrow", help="wide: every style, five machines; further: 3 more")
    p.add_argument("--machine", nargs="+", choices=machines_of("wide"), help="all of the grid, if not given")
    p.add_argument("--kinds", nargs="+", choices=KINDS, default=KINDS)
    p.add_argument("--severities", nargs="+", type=float)
    p.add_argument("--sensors", nargs="+", help="only cases with one of these sets")
    p.add_argument("--excitation", nargs="+", help="only cases with one of these styles of command")
    p.add_argument("--effects", nargs="+", help="only cases that hide one of these")
    p.add_argument("--seeds", choices=SEEDS, default="tuning")
    p.add_argument("--seed", type=int, help="only this one of them; with --quick the first, if not given")
    p.add_argument("--methods", nargs="+", choices=METHODS, default=["discover"])
    p.add_argument("--effort", choices=EFFORTS, default="normal", help="of discover")
    p.add_argument("--time-limit", type=float, default=LIMIT, help=f"seconds of discover on a case ({LIMIT:g})")
    p.add_argument("--processes", type=int, default=2)
    p.add_argument("--out", type=Path, default=Path("out/gap"))
    p.add_argument("--limit", type=int, help="the first so many: a fair sample")
    p.add_argument("--quick", action="store_true", help="one seed, two severities, recordings of 20 s")
    p.add_argument("--no-oracle", action="store_true", help="do not refit the true structure")
    p.add_argument("--list", action="store_true", help="print the names of the cases and stop")
    p.add_argument("--table", action="store_true", help="only write the table of the rows that are there")
    return p.parse_args(arguments)
