"""Formulas for the rig's C-EHA arm from its command: ours, the old operators, operon and gplearn in the same time.

``python -m benchmarks.learned.symbolic_arm [--seconds 80] [--cpu 30] [--seeds 3] [--scoreboard docs/scoreboard.md]``:
five recordings of `--seconds` to learn from, three others to judge; everybody gets `--cpu` processor seconds in one
thread, from several seeds. `new` searches, chooses and refits in free run within that time. The others know increments
alone: they get the features, period and scales that `new` begins with, and their formula with the least error one step
ahead is run freely.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.learned.page import put_section
from benchmarks.learned.symbolic import error_of, recording
from benchmarks.learned.symbolic_problems import (
    FOR_CHOOSING,
    FOR_ENDING,
    OPERON,
    SAMPLES,
    SYMBOLS,
    best_found,
    gplearn_model,
)
from hydrotwin.learned.block_file import LearnedBlock
from hydrotwin.learned.symbolic.block import (
    ADD,
    CONSTANT,
    COSINE,
    MULTIPLY,
    SINE,
    SUBTRACT,
    TANH,
    VARIABLE,
    Formula,
)
from hydrotwin.learned.symbolic.data import Prepared, prepare
from hydrotwin.learned.symbolic.deploy import formula_block
from hydrotwin.learned.symbolic.learn import learn_symbolic
from hydrotwin.learned.symbolic.search import PAPER
from hydrotwin.learned.training_data import as_signals, choose_period, usable
from hydrotwin.records import Record

INPUTS, OUTPUTS = ["command"], ["arm_angle"]
LAGS = (1, None)  # the defaults of `learn_symbolic`
CPU_SECONDS = 30.0
TOKENS = {"add": ADD, "sub": SUBTRACT, "mul": MULTIPLY, "sin": SINE, "cos": COSINE, "tanh": TANH}


@dataclass(frozen=True, eq=False)
class Features:
    """What searches one step ahead are told: recordings and period, their features, and some rows of them."""

    records: Sequence[Record]
    period: float
    data: Prepared
    z: np.ndarray
    d: np.ndarray

    @classmethod
    def of(cls, train: Sequence[Record]) -> Features:
        """Features, period and scales that `learn_symbolic` begins with."""
        inputs, outputs = (as_signals(names, train[0], "signals") for names in (INPUTS, OUTPUTS))
        records = usable(train, (*inputs, *outputs))
        period = choose_period(records)
        data = prepare(records, [], inputs, outputs, period, LAGS, False)
        z, d = data.pairs(data.fit)
        some = np.sort(np.random.default_rng(0).permutation(len(z))[:SAMPLES])
        return cls(records, period, data, z[some], d[some, 0])

    def deployed(self, formula: Formula) -> LearnedBlock:
        """A block that runs a formula of the increments."""
        inputs, outputs = (as_signals(names, self.records[0], "signals") for names in (INPUTS, OUTPUTS))
        return formula_block(formula, self.data, self.records, inputs, outputs, self.period, "formula")


def new(train: Sequence[Record], features: Features, seed: int, cpu: float) -> LearnedBlock:
    """`learn symbolic`, ended by the processor's clock."""
    began = time.process_time()

    def end(step) -> None:
        if time.process_time() - began > (1 - FOR_ENDING - FOR_CHOOSING * hasattr(step, "generation")) * cpu:
            raise KeyboardInterrupt

    return learn_symbolic(train, INPUTS, OUTPUTS, seed=seed, progress=end)


def old(train: Sequence[Record], features: Features, seed: int, cpu: float) -> LearnedBlock:
    """The paper's operators with a factor and a shift."""
    rules = replace(PAPER, scaled=True, generations=10_000, patience=10_000)
    return features.deployed(best_found(rules, features.z, features.d, seed, cpu))


def operon(train: Sequence[Record], features: Features, seed: int, cpu: float) -> LearnedBlock:
    """pyoperon by the settings of its own regressor."""
    rules = replace(OPERON, functions=tuple(SYMBOLS.split(",")), generations=10_000, patience=10_000)
    return features.deployed(best_found(rules, features.z, features.d, seed, cpu))


def gplearn(train: Sequence[Record], features: Features, seed: int, cpu: float) -> LearnedBlock:
    """gplearn with its defaults; its program is in prefix order, too."""
    program = gplearn_model(features.z, features.d, seed, cpu)._program.program
    tokens, constants = [], []
    for node in program:
        if isinstance(node, (int, np.integer)):
            tokens.append(VARIABLE + int(node))
        elif isinstance(node, (float, np.floating)):
            tokens.append(CONSTANT)
            constants.append(float(node))
        else:
            tokens.append(TOKENS[node.name])
    return features.deployed(Formula(tuple(tokens), tuple(constants)))


CONTENDERS: dict[str, Callable] = {"new": new, "old": old, "operon, same functions": operon, "gplearn": gplearn}


def contest(seconds: float, seeds: int, cpu: float) -> list[str]:
    """Print and answer the table."""
    train = [recording(seed, seconds) for seed in range(5)]
    judge = [recording(seed, seconds) for seed in (500, 501, 503)]  # as in `symbolic`
    features = Features.of(train)
    lines = ["| who | median free run [deg] | all | CPU s of the slowest |", "|---|---|---|---|"]
    for label, contender in CONTENDERS.items():
        errors, spent = [], []
        for seed in range(seeds):
            began = time.process_time()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                block = contender(train, features, seed, cpu)
            spent.append(time.process_time() - began)
            errors.append(float(np.mean([error_of(block, record) for record in judge])))
            print(f"   {label}, seed {seed}: {errors[-1]:.3g} deg, {spent[-1]:.1f} CPU-s", flush=True)
        every = ", ".join(f"{e:.2g}" for e in errors)
        lines.append(f"| {label} | {np.median(errors):.2g} | {every} | {max(spent):.1f} |")
        print(lines[-1], flush=True)
    return lines


LEAD = (
    "The rig's C-EHA arm from its command alone: five recordings of {seconds:g} s to learn from; mean over three "
    "others of the RMS error of the free run. Everybody is to end after {cpu:g} processor seconds in one thread; "
    "{seeds} seeds. `new`: `learn symbolic`, which chooses and refits in free run. The others minimise the error one "
    "step ahead on the features that `new` begins with, and their best formula is run freely."
)
MADE_BY = "Made by `python -m benchmarks.learned.symbolic_arm --seconds {seconds:g} --cpu {cpu:g} --seeds {seeds}`."


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=80.0)
    parser.add_argument("--cpu", type=float, default=CPU_SECONDS)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--scoreboard", type=Path, help="write the section 'Formulas of the C-EHA' of this page")
    given = parser.parse_args()
    lines = contest(given.seconds, given.seeds, given.cpu)
    if given.scoreboard:
        said = {name: getattr(given, name) for name in ("seconds", "cpu", "seeds")}
        text = "\n".join([LEAD.format(**said), "", *lines, "", MADE_BY.format(**said)])
        put_section(given.scoreboard, "Formulas of the C-EHA", text)


if __name__ == "__main__":
    main()
