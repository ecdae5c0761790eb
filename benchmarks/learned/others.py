"""Other tools by their own defaults on the official files of tanks and EMPS: SysIdentPy and deepSI.

    python -m benchmarks.learned.others [--seeds N] [--scoreboard docs/scoreboard.md]

Trained on the training file alone, run freely over the test file. A tool begins with as many measured outputs as its
own defaults ask for; the error is that of all samples after them. Nothing is chosen on test files.

    sysidentpy   FROLS, terms by AIC, two lags, polynomial of degree 2: the defaults of its class. The estimator is
                 least squares as in its guide, and the default one (recursive least squares) beside it
    deepSI       SUBNET with its default networks and lags, Adam, batches and sections as `fit` has them; how many
                 iterations the user must say (`ITERATIONS`); the last fifth of the training file is its validation

SysIdentPy asks for NumPy 2.3.5 or older, which constraints.txt does not have: ``make bench-others`` has an environment
of its own for this script. Measurements: in the folder that HYDROTWIN_MEASURED_DATA names.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import os
import tempfile
import time
import warnings
from collections.abc import Callable
from importlib import metadata
from pathlib import Path

import numpy as np

from benchmarks.learned.foreign import Task, tasks
from benchmarks.learned.page import put_section

DATA = ("tanks", "emps")
ITERATIONS = 1500  # of deepSI; it keeps the one of every 250 that runs best over its validation part
SEEDS = 3  # of what is random
VALIDATION = 0.2  # of the training file
Answer = tuple[np.ndarray, int]  # free run over the test file, and measured outputs that it began with


def sysidentpy(train, test, period: float, seed: int, recursive: bool = False) -> Answer:
    """FROLS of polynomials."""
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    (u, y), (u_test, y_test) = train, test
    own = {} if recursive else {"estimator": LeastSquares()}
    model = FROLS(basis_function=Polynomial(degree=2), **own)
    model.fit(X=u, y=y[:, None])
    return model.predict(X=u_test, y=y_test[: model.max_lag, None])[:, 0], int(model.max_lag)


def deepsi(train, test, period: float, seed: int) -> Answer:
    """SUBNET: a network with hidden states, started by an encoder."""
    import deepSI
    import torch

    torch.manual_seed(seed)
    torch.set_num_threads(1)
    whole, unseen = (deepSI.Input_output_data(u[:, 0].astype(np.float32), y.astype(np.float32), sampling_time=period)
                     for u, y in (train, test))  # fmt: skip
    cut = round((1 - VALIDATION) * len(whole))
    nu, ny, norm = deepSI.get_nu_ny_and_auto_norm(whole[:cut])
    model = deepSI.SUBNET(nu, ny, norm)
    with tempfile.TemporaryDirectory() as home, contextlib.redirect_stderr(io.StringIO()):
        before, os.environ["HOME"] = os.environ.get("HOME", ""), home  # it keeps its checkpoints there
        model = deepSI.fit(model, whole[:cut], whole[cut:], n_its=ITERATIONS)["best_model"]
        os.environ["HOME"] = before
    run = model.simulate(unseen)
    return np.asarray(run.y, dtype=float), int(run.state_initialization_window_length)


TOOLS: dict[str, tuple[str, Callable, bool]] = {  # package, how it is called, whether it is random
    "SysIdentPy FROLS, least squares": ("sysidentpy", sysidentpy, False),
    "SysIdentPy FROLS, its default estimator": ("sysidentpy", lambda *a: sysidentpy(*a, recursive=True), False),
    f"deepSI SUBNET, {ITERATIONS} iterations": ("deepSI", deepsi, True),
}


def arrays(task: Task, paths) -> tuple[np.ndarray, np.ndarray, float]:
    """Inputs (n, nu), output (n,) in the unit of the task, and the sampling period, of one file."""
    (record,) = task.read(paths)
    return record.array(list(task.inputs)), task.per_si * record[task.output], record.period


def row(tool: str, task: Task, seeds: int = SEEDS) -> str:
    """A line of the table: the median over seeds and its range, processor seconds of one training."""
    package, call, random = TOOLS[tool]
    (u, y, period), (u_test, y_test, _) = arrays(task, task.train), arrays(task, task.test)
    errors, spent, first, failed = [], [], 0, ""
    for seed in range(seeds if random else 1):
        began = time.process_time()
        with warnings.catch_warnings(), np.errstate(all="ignore"), contextlib.redirect_stdout(io.StringIO()):
            warnings.simplefilter("ignore")
            try:
                run, first = call((u, y), (u_test, y_test), period, seed)
            except (ValueError, ArithmeticError) as error:  # a tool whose run leaves the finite numbers
                failed = f"{type(error).__name__}: {error}"
                continue
        spent.append(time.process_time() - began)
        error = float(np.sqrt(np.mean((run[first:] - y_test[first:]) ** 2)))
        errors.append(error if np.isfinite(error) else np.inf)
    cells = f"{tool} ({package} {metadata.version(package)}) | {task.name}"
    if not errors:
        return f"| {cells} | failed: {failed} | | |"
    shown = "diverges" if np.isinf(np.median(errors)) else f"{np.median(errors):.3g} {task.unit}"
    shown += f" ({min(errors):.3g} to {max(errors):.3g})" if len(errors) > 1 else ""
    return f"| {cells} | {shown} | {first} | {np.median(spent):.0f} s |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scoreboard", type=Path, help="write the section 'Other tools' of this page")
    parser.add_argument("--seeds", type=int, default=SEEDS)
    parser.add_argument("--tools", nargs="+", choices=list(TOOLS), default=list(TOOLS))
    given = parser.parse_args()
    lines = ["| tool | data | test | measured outputs it begins with | training |", "|---|---|---|---|---|"]
    for tool in given.tools:
        for task in (t for t in tasks() if t.name in DATA):
            lines.append(row(tool, task, given.seeds))
            print(lines[-1], flush=True)
    if given.scoreboard:
        put_section(
            given.scoreboard, "Other tools", "\n".join([LEAD.format(seeds=given.seeds), "", *lines, "", MADE_BY])
        )


LEAD = (
    "By their own defaults, on the training file alone; free run over the test file, all samples scored after the "
    "measured outputs that the tool begins with (ours begin with one). Seeds of what is random: {seeds} (median, and "
    "range); processor "
    "seconds of one training in one thread. How many iterations deepSI takes its user must say. Beside NumPy 2.3.5, "
    "the newest that SysIdentPy allows, and torch 2.13.0."
)
MADE_BY = "Made by `make bench-others`, with the measurements in the folder that HYDROTWIN_MEASURED_DATA names."

if __name__ == "__main__":
    main()
