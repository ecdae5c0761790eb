"""Three static problems with a known law, and who searches for it: ours, the old operators, plain operon, gplearn.

Friedman, Annals of Statistics 19 (1991) 1-67, its first function without noise (five of ten inputs matter); Feynman
I.13.4 and I.18.4 of Udrescu, Tegmark, Science Advances 6 (2020). 1000 samples to learn from, 1000 to judge.
Everybody gets the same processor time, in one thread; NRMSE over the spread of the judged samples.
"""

from __future__ import annotations

import contextlib
import time
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from hydrotwin.learned.symbolic.block import Formula, evaluate
from hydrotwin.learned.symbolic.learn import learn_symbolic
from hydrotwin.learned.symbolic.search import PAPER, Archive, Rules, search
from hydrotwin.records import Record
from hydrotwin.simulation import simulate

SAMPLES = 1000
OPERON = Rules(population=1000, local=5, nodes=50, rows=SAMPLES, generations=10_000, patience=10_000)
FOR_CHOOSING = 0.25  # of the time: what ours keeps for choosing among what it found
FOR_ENDING = 0.1  # of the time: for what comes after the choice, the text and the certificate
SYMBOLS = "add,sub,mul,sin,cos,tanh"  # those of the paper, for the rows that say "same functions"
Answer = Callable[[np.ndarray], np.ndarray]


def friedman(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Ten inputs from 0 to 1, five of which matter."""
    x = rng.uniform(0, 1, (SAMPLES, 10))
    return x, 10 * np.sin(np.pi * x[:, 0] * x[:, 1]) + 20 * (x[:, 2] - 0.5) ** 2 + 10 * x[:, 3] + 5 * x[:, 4]


def feynman_i_13_4(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Kinetic energy in three directions."""
    x = rng.uniform(1, 5, (SAMPLES, 4))
    return x, 0.5 * x[:, 0] * (x[:, 1] ** 2 + x[:, 2] ** 2 + x[:, 3] ** 2)


def feynman_i_18_4(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Centre of mass of two."""
    x = rng.uniform(1, 5, (SAMPLES, 4))
    return x, (x[:, 0] * x[:, 2] + x[:, 1] * x[:, 3]) / (x[:, 0] + x[:, 1])


PROBLEMS = {"Friedman-1": friedman, "Feynman I.13.4": feynman_i_13_4, "Feynman I.18.4": feynman_i_18_4}


def ours(x: np.ndarray, y: np.ndarray, seed: int, seconds: float, functions: str | None = None) -> Answer:
    """`learn_symbolic` of static data, ended by the processor's clock."""
    names, began = [f"x{i}" for i in range(x.shape[1])], time.process_time()

    def record(values: np.ndarray, target: np.ndarray) -> Record:
        columns = dict(zip(names, values.T, strict=True)) | {"y": target}
        return Record(np.arange(len(values)) * 1.0, columns, dict.fromkeys(columns, "1"), "problem")

    def end(step) -> None:
        searching = hasattr(step, "generation")
        if time.process_time() - began > (1 - FOR_ENDING - FOR_CHOOSING * searching) * seconds:
            raise KeyboardInterrupt

    block = learn_symbolic([record(x, y)], names, ["y"], static=True, seed=seed, starts=1, generations=10_000,
                           functions=functions, progress=end)  # fmt: skip
    return lambda values: simulate(block, record(values, np.zeros(len(values))))["y"]


def old(x: np.ndarray, y: np.ndarray, seed: int, seconds: float) -> Answer:
    """The paper's operators with a factor and a shift, the default of before."""
    rules = replace(PAPER, scaled=True, generations=10_000, patience=10_000)
    return _searched(rules, x, y, seed, seconds)


def operon(x: np.ndarray, y: np.ndarray, seed: int, seconds: float, functions: str = SYMBOLS) -> Answer:
    """pyoperon by the settings of its own regressor, with least squares on constants (5 steps); all samples judge.

    Its regressor itself can be ended by the wall clock only, which is unfair on a busy machine.
    """
    return _searched(replace(OPERON, functions=tuple(functions.split(","))), x, y, seed, seconds)


def best_found(rules: Rules, x: np.ndarray, y: np.ndarray, seed: int, seconds: float) -> Formula:
    """The formula with the smallest error that a search finds in some processor time."""
    archive, began = Archive(), time.process_time()

    def end(step) -> None:
        if time.process_time() - began > seconds:
            raise KeyboardInterrupt

    with contextlib.suppress(KeyboardInterrupt):
        search(x, y, archive, seed=seed, rules=rules, progress=end)
    return min(archive.all(), key=lambda f: f.error).formula


def _searched(rules: Rules, x: np.ndarray, y: np.ndarray, seed: int, seconds: float) -> Answer:
    best = best_found(rules, x, y, seed, seconds)
    return lambda values: evaluate(best.tokens, best.constants, values.T)[0]


def gplearn(x: np.ndarray, y: np.ndarray, seed: int, seconds: float) -> Answer:
    """gplearn's answer after some processor time."""
    return gplearn_model(x, y, seed, seconds).predict


def gplearn_model(x: np.ndarray, y: np.ndarray, seed: int, seconds: float):
    """gplearn with its defaults and the paper's functions, generation by generation until the time is over."""
    from gplearn.functions import make_function
    from gplearn.genetic import SymbolicRegressor

    began = time.process_time()
    tanh = make_function(function=np.tanh, name="tanh", arity=1)
    model = SymbolicRegressor(function_set=("add", "sub", "mul", "sin", "cos", tanh), generations=1, warm_start=True,
                              random_state=seed)  # fmt: skip
    while time.process_time() - began < seconds:
        model.fit(x, y)
        model.set_params(generations=model.generations + 1)
    return model


CONTENDERS: dict[str, Callable] = {
    "new": ours,
    "new, same functions": lambda *a: ours(*a, functions=SYMBOLS),
    "old": old,
    "operon, same functions": operon,
    "operon, functions of new": lambda *a: operon(*a, functions="add,sub,mul,div,sin,cos,tanh,square"),
    "gplearn": gplearn,
}


def problems(seconds: float, seeds: int) -> list[str]:
    """Print and answer, as a table, the medians of NRMSE, all figures, and the processor time that was really taken."""
    lines = ["| problem | who | median NRMSE | all | CPU s of the slowest |", "|---|---|---|---|---|"]
    print(f"{seeds} seeds, {seconds:g} CPU-s each")
    for problem, made in PROBLEMS.items():
        for label, contender in CONTENDERS.items():
            errors, spent = [], []
            for seed in range(seeds):
                rng = np.random.default_rng(100 + seed)
                (x, y), (unseen, truth) = made(rng), made(rng)
                began = time.process_time()
                try:
                    with warnings.catch_warnings():
                        warnings.simplefilter("ignore")
                        answer = contender(x, y, seed, seconds)
                        spent.append(time.process_time() - began)
                        errors.append(float(np.sqrt(np.mean((answer(unseen) - truth) ** 2)) / np.std(truth)))
                except ModuleNotFoundError as missing:
                    print(f"  {label}: {missing.name} is not installed: pip install 'hydrotwin[bench]'")
                    break
            if errors:
                every = ", ".join(f"{e:.2g}" for e in errors)
                lines.append(f"| {problem} | {label} | {np.median(errors):.2g} | {every} | {max(spent):.1f} |")
                print(lines[-1], flush=True)
    return lines
