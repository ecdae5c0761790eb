"""Learn a formula from recordings: genetic programming finds its form, free runs choose it and fit its constants."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import metadata

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..block_file import Certificate, LearnedBlock, assemble
from ..interruption import INTERRUPTED
from ..needs import needed_to_train
from ..network.narx import network_states, random_steps
from ..steady import steady_where_it_integrates
from ..training_data import HELD_OUT, checked_recordings, choose_period, named, training_box
from .block import SUBTRACT, SYMBOLIC, VARIABLE, Formula, formula_shape
from .data import Prepared, prepare

FITS = ("default", "paper")
TOLERANCE = 1e-12  # of the outputs' scale: deployed against trained
ROWS = 3000  # samples, drawn at random, that a search judges its formulas on
AFTER_CTRL_C = 5.0  # s for choosing among what was found


def learn_symbolic(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    fit: str = "default",
    period: float | None = None,
    validate: Sequence[Record] = (),
    lags: tuple[int, int | None] = (1, None),
    seed: int = 0,
    starts: int = 3,
    population: int = 1000,
    generations: int = 100,
    tolerance: float = 0.05,
    budget: float = 120.0,
    name: str = "formula",
    progress: Callable | None = None,
) -> LearnedBlock:
    """Find one formula per output by genetic programming and answer them as a Block.

    The form {+, -, *, cos, sin, tanh, constants}, at most 20 nodes, comes from a search with the operators of the
    C-EHA paper (`symbolic_search`). ``fit`` says what is searched for and what becomes of it:

    - ``"default"``: the increment of each output, from smoothed features. The best of every length, over all
      generations and seeds, and linear formulas beside them, are refitted by least squares in short free runs, the
      best of these in whole ones; of the formulas whose free-run error on ``validate`` (or on the last fifth of every
      recording) is within ``tolerance`` of the smallest, the shortest is kept.
    - ``"paper"``: the next value from the present ones at the recorded period, sum of squared errors, no scaling, no
      refit, one seed: the formula with the smallest one-step error. It is the baseline, not the advice.

    Args:
        records: training recordings, uniform or not, without gaps.
        inputs, outputs: Signals, or names that take the unit of the recording.
        period: s between steps; None: the longest that loses nothing worth having (`choose_period`).
        lags: past increments of the outputs, samples of the inputs (None: chosen, `choose_input_lags`).
        starts: searches, with the seeds ``seed ... seed + starts - 1``. population, generations: of each.
        tolerance: what simplicity may cost, as a share of the free-run error.
        budget: s, half of it for the searches. Fewer seeds or candidates are tried when it ends.
        progress: called with a `SearchProgress` per generation and a `SelectionProgress` per refit.

    The same seed and data give the same block unless the budget ends the work (``provenance["stopped"]``). Ctrl-C
    ends it with the best so far. ``provenance["equation"]`` and ``["latex"]`` are the formula to read.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options, or
        pyoperon is not installed.
    """
    with needed_to_train("learn_symbolic"):
        from . import search as searching
        from . import select as selecting
        from . import text as printing
    _check_options(fit, lags, starts, population, generations, tolerance, budget, period)
    inputs, outputs, records, validate = checked_recordings("learn_symbolic", records, inputs, outputs, validate)
    paper = fit == "paper"
    recorded = float(f"{max(r.period for r in records):.9g}")  # the median of printed times carries rounding
    period = float(period or (recorded if paper else choose_period(records)))
    data = prepare(records, validate, inputs, outputs, period, (0, 1) if paper else lags, paper)
    started = time.monotonic()
    rules = searching.Rules(population=int(population), generations=int(generations))
    names = [s.name for s in outputs]
    seeds = range(seed, seed + (1 if paper else starts))
    archives, stopped = _search(searching, data, rules, seeds, paper, names, started + budget / 2, progress)
    if paper:
        formula = _most_exact(archives)
    else:
        until = min(started + budget, time.monotonic() + AFTER_CTRL_C) if stopped == INTERRUPTED else started + budget
        options = {"tolerance": tolerance, "until": until, "seed": seed, "progress": progress}
        selection = selecting.Selection(data, names, **options)
        formula = selection.choose([[f.formula for f in archive.all()] for archive in archives])
        stopped = stopped or selection.stopped
    formula = printing.simplified(formula, data.shape.features)
    block = _block(formula, data, records, inputs, outputs, period, name)
    found = _report(archives, stopped)
    found["held_out_error"] = selecting.free_run_error(data, formula)
    found["seconds"] = round(time.monotonic() - started, 2)
    text, latex = printing.equation_text(formula, inputs, outputs, data.shape, data.scales, whole_value=paper)
    provenance = _provenance(fit, records, validate, seed, found) | {"equation": text, "latex": latex}
    block = replace(block, description=text, provenance=provenance)
    block = replace(block, certificate=certify(block, formula))
    return steady_where_it_integrates(block, records, outputs, published=paper)


def _search(searching, data: Prepared, rules, seeds, paper: bool, names, until: float, progress):
    """An archive per output, and what ended the searches before their time, empty when nothing did."""
    z, d = data.pairs()
    chosen = np.sort(np.random.default_rng(seeds[0]).permutation(len(z))[:ROWS])
    z, d = z[chosen], d[chosen]
    archives = [searching.Archive() for _ in names]
    options = {"rules": rules, "scaled": not paper, "until": until, "progress": progress}
    try:
        for turn, own in enumerate(seeds):
            for i, archive in enumerate(archives):
                if turn and time.monotonic() > until:
                    return archives, "time budget of the search"
                target = d[:, i] + z[:, i] if paper else d[:, i]
                searching.search(z, target, archive, seed=own, output=names[i], **options)
    except KeyboardInterrupt:
        return archives, INTERRUPTED
    return archives, ""


def _most_exact(archives) -> Formula:
    """The formulas with the smallest error one step ahead, as increments."""
    whole = Formula((), ())
    for i, archive in enumerate(archives):
        best = min(archive.all(), key=lambda f: (f.error, f.nodes), default=None)
        best = best.formula if best else Formula((VARIABLE + i,), ())
        whole += Formula((SUBTRACT, *best.tokens, VARIABLE + i), best.constants)
    return whole


def _report(archives, stopped: str) -> dict:
    seconds, evaluations = sum(a.seconds for a in archives), sum(a.evaluations for a in archives)
    return {
        "evaluations": int(evaluations),
        "evaluations_per_cpu_second": round(evaluations / seconds) if seconds else 0,
        "ended_by": sorted({a.stopped for a in archives}),
        "stopped": stopped or "finished",
    }


def _block(formula: Formula, data: Prepared, records, inputs, outputs, period: float, name: str) -> LearnedBlock:
    shape = data.shape
    counts = {"tokens": len(formula.tokens), "constants": len(formula.constants)}
    return assemble(
        SYMBOLIC,
        data.scales | {"tokens": np.array(formula.tokens, float), "constants": np.array(formula.constants, float)},
        {"output_lags": shape.output_lags, "input_lags": shape.input_lags} | counts,
        name=name,
        inputs=inputs,
        outputs=outputs,
        states=network_states(shape, inputs, outputs),
        parameters=(),
        period=period,
        domain=training_box(records, (*inputs, *outputs)),
    )


def certify(block: LearnedBlock, formula: Formula, points: int = 20_000) -> Certificate:
    """The largest |deployed - trained| of one step over `random_steps`, relative to the outputs' scale.

    The trained formula is evaluated by SymPy's NumPy printer.
    """
    import sympy

    from .text import as_expressions

    a, shape = block.arrays, formula_shape(block.structure, len(block.inputs), len(block.outputs))
    states, inputs, z = random_steps(a, shape, points)
    deployed = np.array(block.step.map(points)(states.T, inputs.T, np.zeros((0, points)))[0]).T
    symbols = sympy.symbols(f"z:{shape.features}", real=True)
    functions = [sympy.lambdify(symbols, e, "numpy") for e in as_expressions(formula, symbols)]
    f = np.column_stack([np.broadcast_to(g(*z.T), points) for g in functions])
    f = np.clip(f, -a["increment_limit"], a["increment_limit"]) * a["increment_scale"]
    trained = np.clip(states[:, : shape.outputs] + f, a["output_lower"], a["output_upper"])
    difference = float(np.abs((deployed[:, : shape.outputs] - trained) / a["output_scale"]).max())
    return Certificate(difference, TOLERANCE, points, f"sympy {sympy.__version__} float64")


def _check_options(fit, lags, starts, population, generations, tolerance, budget, period) -> None:
    if fit not in FITS:
        raise DeclarationError(f"learn_symbolic: no fit '{fit}'. {nearest(str(fit), FITS)}")
    n, m = lags
    counts = {
        "lags[0]": (n, 0),
        "lags[1]": (1 if m is None else m, 1),
        "starts": (starts, 1),
        "population": (population, 20),
        "generations": (generations, 1),
    }
    for option, (value, least) in counts.items():
        if int(value) != value or value < least:
            raise DeclarationError(f"learn_symbolic: {option} must be a whole number from {least} up (got {value}).")
    for option, value in {"budget": budget, "period": 1.0 if period is None else period}.items():
        if not value > 0:
            raise DeclarationError(f"learn_symbolic: {option} must be positive (got {value}).")
    if not 0 <= tolerance < np.inf:
        raise DeclarationError(f"learn_symbolic: tolerance must be 0 or more (got {tolerance}). 0.05 is 5 %.")


def _provenance(fit: str, records, validate, seed: int, found: dict) -> dict:
    return {
        "kind": "symbolic",
        "fit": fit,
        "trained_on": named(records),
        "selected_on": named(validate) or f"last {HELD_OUT:.0%} of every training recording",
        "seed": seed,
        **found,
        "versions": {package: metadata.version(package) for package in ("pyoperon", "sympy", "numpy", "casadi")},
    }
