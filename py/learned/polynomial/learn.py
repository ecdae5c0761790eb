"""Learn a polynomial NARX: terms by error reduction ratio, how many by BIC and by free run, refitted there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from time import monotonic, perf_counter

import numpy as np

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, noise_floor

from ..block_file import LearnedBlock
from ..linear.arx import Chosen, choose
from ..linear.orders import Asked
from ..needs import needed_to_train
from ..network.narx import NarxShape
from ..options import check_counts, check_lags, check_positive, check_tolerance
from ..steady import steady_where_it_integrates
from ..substeps import chosen_substeps, with_steps
from ..symbolic.data import Prepared, prepare
from ..training_data import checked_recordings, choose_period, named, on_period, usable
from .selection import Selected, select
from .terms import Term, candidates, factors_of, feature_names, polynomial, values, words

DEGREE = 3  # of the products: pump and level in a root, flow over a valve, friction bend that far
MOST_TERMS = 16  # of an equation: longer ones run away more often than they run better
COUNTS = (1, 2, 3, 4, 5, 6, 8, 10, 12, 16)  # numbers of terms that run freely
FEW, MANY = (2, 4, 6, 8), 8000  # of them, at a period at which the recordings are more samples than so many
GROWN = 4  # terms that are added at most where they surely help the free run
ROWS = 4000  # random rows that terms are selected on
PAST = 3  # past increments of an output, at most
SAMPLES = 8  # of an input behind its delay, at most
NOISY = 0.1  # noise of an increment over its spread: less bends least squares by a hundredth, smoothing by more
ROWS_PER_TERM = 15  # few rows get few terms
SELECTED_ON = "recordings, or parts of few, each with factors fitted on the others"


def learn_narx(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    period: float | None = None,
    degree: int = DEGREE,
    lags: tuple[int, int] | None = None,
    delay: int | None = None,
    substeps: int | None = None,
    terms: int = MOST_TERMS,
    tolerance: float = 0.05,
    select: Sequence[Record] = (),
    validate: Sequence[Record] = (),
    seed: int = 0,
    budget: float | None = None,
    name: str = "narx",
    progress: Callable | None = None,
) -> LearnedBlock:
    """Fit the increments of every output by a polynomial of past outputs and inputs; answer them as one Block.

    Period, lags and delay are those of the ARX equation that runs best on what is held out (`learn_arx`), and the
    longest period that loses nothing is tried beside it. Of all products of features up to every degree, terms are
    selected by error reduction ratio (`selection`), up to the number with the least BIC. Polynomials of every degree
    and number of terms are then refitted in short free runs, the best of them in whole ones; of those whose free run
    on parts held out is within ``tolerance`` of the best, or that the parts cannot tell from it, the shortest is
    kept, without the terms that it can do without (`symbolic.select`). The best get up to `GROWN` terms more that
    take most from the error of the free run and surely help there: one step ahead does not show what a run drifts by.

    Args:
        records: training recordings without gaps, of even or uneven times.
        period: s between steps; None: chosen. degree: of the products, 1 to 3.
        lags: (past increments of the outputs, samples of every input); None: chosen. delay: periods before an input
            acts; None: chosen. terms: selected for an equation, at most; free runs may add `GROWN` more.
        substeps: steps in a period, over which inputs are means; None: where the period is chosen and its samples do
            not show what the inputs do in between, those of the recordings (`substeps_step`).
        select: recordings that choose in place of parts held out; nothing is fitted to them.
        validate: checked, and used for nothing. seed: of the rows that terms are selected on, and of the short runs.
        budget: s; None: no limit. Fewer polynomials are refitted when it ends.
        progress: called with a `SelectionProgress` per refit.

    The same seed and data give the same block unless ``budget`` ends the work (``provenance["stopped"]``).
    ``provenance["narx"]`` tells by output the terms with their factors (over the scales of the block) and ERR (none of
    those added in free run) in the order in which they were selected, AIC and BIC by number of terms, and which terms
    are kept.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options, or SymPy
        is not installed.
    """
    began = perf_counter()
    with needed_to_train("learn_narx"):
        from ..symbolic import deploy
    check_counts(
        "learn_narx", {"degree": (degree, 1), "terms": (terms, 1), "delay": (delay, 0), "substeps": (substeps, 1)}
    )
    check_positive("learn_narx", period=period, budget=budget)
    check_tolerance("learn_narx", tolerance)
    check_lags("learn_narx", lags, "past increments", "1,3")
    if degree > DEGREE:
        raise DeclarationError(f"learn_narx: degree is {DEGREE} at most (got {degree}). Longer products run away.")
    inputs, outputs, records, validate = checked_recordings("learn_narx", records, inputs, outputs, validate)
    chosen_by = usable(select, (*inputs, *outputs)) if select else []
    asked = Asked(None, None, lags[1] if lags else None, delay)
    both = records, chosen_by
    found = _best(both, choose(both, inputs, outputs, period, asked, 0), (inputs, outputs),
                  _Options(period, substeps, degree, lags, terms, tolerance, seed, budget), progress)  # fmt: skip
    data, formula = found.data, found.formula
    block = deploy.formula_block(formula, data, records, inputs, outputs, found.period, name)
    told = _told(found, inputs, outputs)
    provenance = {
        "kind": "narx",
        "trained_on": named(records),
        "selected_on": named(chosen_by) or SELECTED_ON,
        "narx": told,
        "equation": deploy.equation(formula, data, inputs, outputs)[0],
        "latex": deploy.equation(formula, data, inputs, outputs)[1],
        "front": deploy.front(found.selection, data, inputs, outputs),
        "held_out_error": found.error,
        "seed": seed,
        "seconds": round(perf_counter() - began, 2),
        "stopped": found.selection.stopped or "finished",
        "versions": {package: metadata.version(package) for package in ("numpy", "scipy", "sympy", "casadi")},
    }
    block = replace(block, description=_describe(told), provenance=provenance)
    block = with_steps(replace(block, certificate=deploy.certify(block, formula)), found.data.steps)
    return steady_where_it_integrates(block, records, outputs)


@dataclass(frozen=True)
class _Options:
    """What was asked for."""

    period: float | None
    substeps: int | None
    degree: int
    lags: tuple[int, int] | None
    terms: int
    tolerance: float
    seed: int
    budget: float | None


@dataclass(frozen=True, eq=False)
class _Found:
    """A period with its data, the terms selected for every output and degree, and what free runs chose."""

    period: float
    data: Prepared
    paths: list[dict[int, tuple[list[Term], Selected]]]
    selection: object
    formula: object
    error: float


def _best(both, arx: Chosen, signals, options: _Options, progress) -> _Found:
    """The period at which the polynomials run best over what is held out."""
    records, _ = both
    periods = [arx.period] if options.period else list(dict.fromkeys([arx.period, choose_period(records)]))
    periods = [p for p in periods if p == max(periods) or _samples(records, p) <= MANY]
    began, found = monotonic(), []
    for k, period in enumerate(periods):
        until = np.inf if options.budget is None else began + options.budget * (k + 1) / len(periods)
        found.append(_at(period, both, arx, signals, options, until, progress))
    return min(found, key=lambda f: f.error)


def _at(period: float, both, arx: Chosen, signals, options: _Options, until: float, progress) -> _Found:
    """What free runs choose at a period, until a time on the monotonic clock."""
    from ..symbolic.select import Choice, Selection, judged_errors

    inputs, outputs = signals
    past, first, last = _lags(arx, period, options.lags)
    steps = chosen_substeps(options.substeps, options.period, [*both[0], *both[1]], inputs, period)
    how = {"smooth": _noisy(both[0], signals, period), "steps": steps}
    data = prepare(*both, inputs, outputs, period, (past, last), False, **how)
    rng = np.random.default_rng(options.seed)
    paths = [_selected(data, i, first, options, rng) for i in range(len(outputs))]
    counts = COUNTS if _samples(both[0], period) <= MANY else FEW
    formulas = [
        [polynomial(terms[:k], selected.factors[k - 1]) for terms, selected in by_degree.values()
         for k in counts if k <= selected.by_bic]
        for by_degree in paths
    ]  # fmt: skip
    names = [s.name for s in outputs]
    how = Choice(options.tolerance, GROWN, ("mul",), until, options.seed, progress)
    selection = Selection(data, names, how)
    formula = selection.choose(formulas)
    alone = len(selection.chosen) == 1
    error = selection.chosen[0].error if alone else judged_errors(data, formula)[0]
    return _Found(period, data, paths, selection, formula, float(error))


def _samples(records: Sequence[Record], period: float) -> float:
    return sum(r.duration for r in records) / period


def _noisy(records: Sequence[Record], signals, period: float) -> bool:
    """Whether the noise of an output is more than `NOISY` of its increments: then features are smoothed."""
    inputs, outputs = signals
    names = [s.name for s in outputs]
    floors = [noise_floor(r.select(names)) for r in records]
    moved = np.concatenate([np.diff(on_period(r, period, inputs).array(names), axis=0) for r in records]).std(axis=0)
    noise = np.array([np.median([f[name].sigma for f in floors]) for name in names])
    return bool(np.any(np.sqrt(2.0) * noise > NOISY * moved))


def _lags(arx: Chosen, period: float, lags) -> tuple[int, list[int], int]:
    """Past increments; first sample of every input, and samples of all inputs: as the ARX equations have them."""
    orders = [eq.order for eq in arx.equations]
    past = max(max(o.past if o.rate else o.past - 1 for o in orders), 1)
    share = arx.period / period
    windows = [[o.windows[i] for o in orders] for i in range(len(orders[0].windows))]
    first = [max(round((min(d for d, _ in part) - 1) * share), 0) for part in windows]
    ends = [max(round((max(d + n for d, n in part) - 2) * share), 0) for part in windows]
    last = max(min(end, start + SAMPLES - 1) for start, end in zip(first, ends, strict=True)) + 1
    if lags:
        past, last = lags[0], max(first) + lags[1]
    return min(past, PAST) if not lags else past, first, max(last, 1)


def _selected(data: Prepared, i: int, first: Sequence[int], options: _Options, rng) -> dict:
    """For every degree, the terms of an output in the order of their choice."""
    z, d = data.pairs(data.fit)
    some = np.sort(rng.permutation(len(z))[:ROWS])
    most = max(2, min(options.terms, len(z) // ROWS_PER_TERM))
    answer = {}
    for degree in range(1, options.degree + 1):
        known = candidates(data.shape, first, degree)
        found = select(values(known, z[some]), d[some, i], most)
        answer[degree] = [known[j] for j in found.columns], found
    return answer


def _told(found: _Found, inputs, outputs) -> dict:
    """By output: terms with ERR and factor, AIC and BIC, degree, lags and delay."""
    shape: NarxShape = found.data.shape
    names = feature_names(shape, [s.name for s in inputs], [s.name for s in outputs])
    kept = factors_of(found.formula, shape.features)
    answer = {}
    for output, own, by_degree in zip(outputs, kept, found.paths, strict=True):
        degree = max(1, *(len(term) for term in own), 1)
        terms, selected = by_degree[min(degree, max(by_degree))]
        ratios = dict(zip(terms, selected.ratios, strict=True))
        order = [*(t for t in terms if t in own), *(t for t in own if t not in ratios)]
        answer[output.name] = {
            "degree": degree,
            "past": shape.output_lags,
            "terms": [{"term": words(t, names), "factor": own[t], "err": ratios.get(t)} for t in order],
            "selected": [words(t, names) for t in terms],
            "err": selected.ratios,
            "aic": selected.aic,
            "bic": selected.bic,
            "terms_by_bic": selected.by_bic,
        }
    return answer


def _describe(told: dict) -> str:
    parts = [f"{name} from {len(t['terms'])} terms of degree {t['degree']}" for name, t in told.items()]
    return "polynomial NARX: " + "; ".join(parts)
