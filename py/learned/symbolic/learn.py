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

from ..block_file import LearnedBlock
from ..interruption import INTERRUPTED
from ..linear.periods import affordable_period
from ..needs import needed_to_train
from ..options import check_counts, check_known, check_positive, check_tolerance
from ..steady import steady_where_it_integrates
from ..substeps import chosen_substeps, with_steps
from ..training_data import checked_recordings, named, recorded_period, usable
from .block import SUBTRACT, VARIABLE, Formula
from .data import Prepared, prepare, prepare_static
from .static_data import is_static

FITS = ("default", "paper")
NODES = {False: 20, True: 40}  # of a formula in the search, whether it is static: one that runs freely must be short
SELECTED_ON = "recordings, or parts of few, each with constants fitted on the others"
FEWEST_NODES, SAMPLES_PER_NODE = 5, 20  # few samples get short formulas
AFTER_CTRL_C = 5.0  # s for choosing among what was found


def learn_symbolic(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    fit: str = "default",
    static: bool | None = None,
    period: float | None = None,
    substeps: int | None = None,
    validate: Sequence[Record] = (),
    select: Sequence[Record] = (),
    lags: tuple[int, int | None] = (1, None),
    functions: Sequence[str] | str | None = None,
    nodes: int | None = None,
    terms: int = 8,
    seed: int = 0,
    starts: int = 3,
    population: int | None = None,
    generations: int = 100,
    tolerance: float = 0.05,
    budget: float | None = None,
    name: str = "formula",
    progress: Callable | None = None,
) -> LearnedBlock:
    """Find one formula per output by genetic programming and answer them as a Block.

    ``fit`` says what is searched for and what becomes of it:

    - ``"default"``: the increment of each output, from smoothed features; of static data the outputs themselves.
      pyoperon breeds, with least squares on the constants of every formula (`Rules`). The best of every length, over
      all generations and seeds, and linear formulas beside them, are refitted in short free runs, the best of these in
      whole ones, where they get the terms that they lack (`growth`); of the formulas whose free-run error on ``select``
      is within ``tolerance`` of the smallest, the shortest is kept. Without ``select``, recordings, or parts of them
      where they are fewer than five, judge constants that were fitted on the others, and what these cannot tell from
      the best is as good. A formula whose free run diverges where it is judged is not kept.
    - ``"paper"``: the operators of the C-EHA paper (`PAPER`), the next value from the present ones at the recorded
      period, sum of squared errors, no scaling, no refit, one seed: the formula with the smallest one-step error. It
      is the baseline, not the advice.

    Args:
        records: training recordings, uniform or not, without gaps.
        inputs, outputs: Signals, or names that take the unit of the recording.
        static: the outputs are functions of the inputs at the same moment; None: where `is_static` finds it.
        period: s between steps; None: the longest that loses nothing worth having and is neither too many nor too
            few samples (`affordable_period`).
        substeps: steps in a period, over which inputs are means; None: where the period is chosen and its samples do
            not show what the inputs do in between, those of the recordings (`substeps_step`).
        validate: checked, and nothing else: they judge, elsewhere. select: recordings that choose the formula.
        lags: past increments of the outputs, samples of the inputs (None: chosen, `choose_input_lags`).
        functions: of add, sub, mul, div, sin, cos, tanh, exp, log (of the absolute value), sqrt (as well), square.
        nodes: at most in a formula of the search; None: 20, 40 of static data, fewer of few samples.
        terms: at most added to a formula of the search, where each surely helps the free run; 0: none.
        starts: searches, with the seeds ``seed ... seed + starts - 1``. population, generations: of each; None: 250,
            of the paper 1000.
        tolerance: what simplicity may cost, as a share of the free-run error.
        budget: s, half of it for the searches; None: no limit. Fewer seeds or candidates are tried when it ends.
        progress: called with a `SearchProgress` per generation and a `SelectionProgress` per refit.

    The same seed and data give the same block unless ``budget`` ends the work (``provenance["stopped"]``). Ctrl-C
    ends it with the best so far. ``provenance["equation"]`` and ``["latex"]`` are the formula to read, ``["front"]``
    what shorter and longer ones would cost (`front_rows`).

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options, or
        pyoperon is not installed.
    """
    with needed_to_train("learn_symbolic"):
        from . import deploy
        from . import search as searching
        from . import select as selecting
        from . import text as printing
    counts = {"starts": starts, "population": population, "generations": generations, "nodes": nodes}
    counts |= {"substeps": substeps, "terms": terms}
    _check_options(fit, static, lags, counts, {"tolerance": tolerance, "budget": budget, "period": period})
    inputs, outputs, records, select = checked_recordings("learn_symbolic", records, inputs, outputs, select)
    if validate:
        usable(validate, (*inputs, *outputs))
    paper = fit == "paper"
    recorded = recorded_period(records)
    static = not paper and (is_static(records, inputs, outputs) if static is None else bool(static))
    if static:
        period, data = float(period or recorded), prepare_static(records, select, inputs, outputs)
    else:
        asked = period
        period = float(period or (recorded if paper else affordable_period((records, select), inputs, outputs)))
        steps = 1 if paper else chosen_substeps(substeps, asked, [*records, *select], inputs, period)
        data = prepare(records, select, inputs, outputs, period, (0, 1) if paper else lags, paper, steps=steps)
    started = time.monotonic()
    end = started + (np.inf if budget is None else budget)
    samples = sum(p.last - p.first for p in data.folds[0][0])
    if nodes is None and not paper:
        counts["nodes"] = max(FEWEST_NODES, min(NODES[static], samples // SAMPLES_PER_NODE))
    rules = _rules(searching, paper, functions, counts)
    names = [s.name for s in outputs]
    seeds = range(seed, seed + (1 if paper else starts))
    archives, stopped = _search(searching, data, rules, seeds, names, (started + end) / 2, progress)
    selection = None
    if paper:
        formula = _most_exact(archives)
    else:
        until = min(end, time.monotonic() + AFTER_CTRL_C) if stopped == INTERRUPTED else end
        how = selecting.Choice(tolerance, terms, rules.functions, until, seed, progress)
        selection = selecting.Selection(data, names, how)
        found = [archive.front() if static else archive.all() for archive in archives]
        formula = selection.choose([[f.formula for f in sorted(kept, key=lambda f: f.error)] for kept in found])
        stopped = stopped or selection.stopped
    formula = printing.simplified(formula, data.shape.features)
    block = deploy.formula_block(formula, data, records, inputs, outputs, period, name)
    told = _report(archives, stopped) | _judged(selecting, selection, data, formula)
    told |= {"functions": list(rules.functions), "static": static}
    if selection:
        told["front"] = deploy.front(selection, data, inputs, outputs)
    told["seconds"] = round(time.monotonic() - started, 2)
    text, latex = deploy.equation(formula, data, inputs, outputs, whole_value=paper)
    provenance = _provenance(fit, records, select, seed, told) | {"equation": text, "latex": latex}
    block = replace(block, description=text, provenance=provenance)
    block = with_steps(replace(block, certificate=deploy.certify(block, formula)), data.steps)
    return block if static else steady_where_it_integrates(block, records, outputs, published=paper)


def _rules(searching, paper: bool, functions, counts):
    """The rules of the search with what was asked for; raises `DeclarationError` for functions that are none."""
    rules = searching.PAPER if paper else searching.Rules()
    asked = {key: int(counts[key]) for key in ("population", "generations", "nodes") if counts[key] is not None}
    if functions is not None:
        wanted = [functions] if isinstance(functions, str) else list(functions)
        wanted = tuple(dict.fromkeys(word.strip() for part in wanted for word in str(part).split(",") if word.strip()))
        for word in wanted or ("",):
            if word not in searching.FUNCTIONS:
                raise DeclarationError(
                    f"learn_symbolic: functions: '{word}' is none. {nearest(word, searching.FUNCTIONS)} "
                    "Write functions=add,mul,div."
                )
        asked["functions"] = wanted
    return replace(rules, **asked)


def _search(searching, data: Prepared, rules, seeds, names, until: float, progress):
    """An archive per output, and what ended the searches before their time, empty when nothing did.

    Every seed leaves out what another fold judges, so that some judgement of every form is of samples it never saw.
    """
    archives = [searching.Archive() for _ in names]
    options = {"rules": rules, "until": until, "progress": progress}
    try:
        for turn, own in enumerate(seeds):
            z, d = data.pairs(data.folds[-1 - turn % len(data.folds)][0])
            chosen = np.sort(np.random.default_rng(seeds[0]).permutation(len(z))[: rules.rows])
            z, d = z[chosen], d[chosen]
            for i, archive in enumerate(archives):
                if archive.stopped == "good enough":
                    continue
                if turn and time.monotonic() > until:
                    return archives, "time budget of the search"
                target = d[:, i] if rules.scaled else d[:, i] + z[:, i]  # the paper's formula is the next value
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


def _judged(selecting, selection, data: Prepared, formula: Formula) -> dict:
    """The error of the chosen formula where formulas were judged, in output scales, and whether it diverges there."""
    alone = selection and len(selection.chosen) == 1
    error, rms = selecting.judged_errors(data, formula)
    told = {"held_out_error": selection.chosen[0].rms if alone else rms}
    return told | ({} if np.isfinite(error) else {"diverges": True})


def _check_options(fit, static, lags, counts: dict, amounts: dict) -> None:
    check_known("learn_symbolic", "fit", fit, FITS)
    if static and fit == "paper":
        raise DeclarationError("learn_symbolic: static data and fit paper do not go together (got static=True). "
                               "The paper learns the next value. Leave out one of the two.")  # fmt: skip
    n, m = lags
    least = {"lags[0]": 0, "lags[1]": 1, "starts": 1, "population": 20, "generations": 1, "nodes": 3, "substeps": 1}
    least["terms"] = 0
    given = {"lags[0]": n, "lags[1]": m, **counts}
    check_counts("learn_symbolic", {option: (value, least[option]) for option, value in given.items()})
    check_positive("learn_symbolic", budget=amounts["budget"], period=amounts["period"])
    check_tolerance("learn_symbolic", amounts["tolerance"])


def _provenance(fit: str, records, select, seed: int, found: dict) -> dict:
    return {
        "kind": "symbolic",
        "fit": fit,
        "trained_on": named(records),
        "selected_on": named(select) or SELECTED_ON,
        "seed": seed,
        **found,
        "versions": {package: metadata.version(package) for package in ("pyoperon", "sympy", "numpy", "casadi")},
    }
