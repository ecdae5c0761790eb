"""Learn a linear state space: begun by a subspace, its order and form by free run, refined on whole recordings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import metadata
from time import perf_counter

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate

from ..block_file import Certificate, LearnedBlock, assemble
from ..options import check_counts, check_positive
from ..training_data import checked_recordings, named, training_box, usable
from .arx import Chosen, choose, periods_of, rows_at
from .candidates import ORDERS, Candidate, candidates, forms_of, ranked
from .orders import Asked
from .regressors import Rows, Scales
from .state_space_block import LINEAR, state_space_arrays, state_space_states
from .whole_runs import Fitted, Way, WholeRuns

MOST = 8_000  # samples over all recordings that runs are fitted on; longer ones are taken at a longer period
NEAR = (0.24, 2.1)  # of the period of the ARX equations: those that are tried
FINALISTS = 3  # candidates that are refined before one is chosen
ITERATIONS = (15, 40)  # of a refinement: to choose, and the last
TOLERANCE = 1e-7  # of an output's range: deployed free run against the fit's own


def learn_linear(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    period: float | None = None,
    order: int | None = None,
    rate: bool | None = None,
    refine: bool = True,
    select: Sequence[Record] = (),
    validate: Sequence[Record] = (),
    seed: int = 0,
    name: str = "linear",
    progress: Callable | None = None,
) -> LearnedBlock:
    """Fit a discrete linear state space to free runs over whole recordings; answer it as a Block.

    Dynamics of several orders, at several periods, with and without a sum behind the outputs, come from a subspace
    (`subspace`), the rest by linear least squares of the runs. Each is run freely over parts of the recordings that
    were held out of its fit in turn; the best few are refined there (`whole_runs`), and the best of all is fitted to
    all recordings. Start states of the recordings are fitted along where outputs settle. The block itself starts from
    the first outputs and inputs alone, in the way of `WholeRuns.ways` with which the recordings run best.

    Args:
        records: training recordings without gaps, of even or uneven times.
        period: s between steps; None: chosen. order: states, without sums and delays; None: 1 to 8 are tried.
        rate: all outputs integrate, or none does; None: chosen.
        refine: False: the subspace and linear least squares alone.
        select: recordings that choose in place of parts held out; nothing is fitted to them.
        validate: checked, and used for nothing. seed: kept for the record; nothing here is random.
        progress: called with every `Candidate` that was tried, and the least error so far.

    ``provenance["linear"]`` tells order, form, delay, start and the free-run error on what was held out.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options.
    """
    began = perf_counter()
    check_positive("learn_linear", period=period)
    check_counts("learn_linear", {"order": (order, 1)})
    inputs, outputs, records, validate = checked_recordings("learn_linear", records, inputs, outputs, validate)
    scales = Scales.of(records, inputs, outputs)
    select = usable(select, (*inputs, *outputs)) if select else []
    chosen = choose((records, select), inputs, outputs, period, Asked(rate=rate), 0)
    rows = _rows((records, select), inputs, outputs, scales, chosen, period)
    best, evaluations = _best(rows, chosen, (order,) if order else ORDERS, (rate, refine), progress)
    fitted = best.fit(best.runs.rows.never, ITERATIONS[1])
    way = best.runs.best_way(fitted.model, best.runs.rows.never)
    structure, arrays = state_space_arrays(fitted.model, way, scales)
    block = assemble(
        LINEAR,
        arrays,
        structure,
        name=name,
        inputs=inputs,
        outputs=outputs,
        states=state_space_states(structure, inputs, outputs),
        parameters=(),
        period=best.period,
        domain=training_box(records, (*inputs, *outputs)),
        description=_describe(best),
    )
    error = float(np.sqrt(best.error))
    provenance = {
        "kind": "linear",
        "trained_on": named(records),
        "selected_on": named(select) or "parts of the training recordings, each held out in turn",
        "linear": _told(best, outputs) | {"held_out_error_over_spread": error},
        "seed": seed,
        "evaluations": evaluations + fitted.evaluations,
        "seconds": round(perf_counter() - began, 2),
        "stopped": "finished",
        "versions": {package: metadata.version(package) for package in ("numpy", "scipy", "casadi")},
    }
    return replace(block, provenance=provenance, certificate=_certified(block, best.runs, fitted, way, scales))


def _rows(both, inputs, outputs, scales: Scales, chosen: Chosen, period: float | None) -> dict[float, Rows]:
    """Rows at the periods that are tried."""
    if period:
        return {period: chosen.rows}
    records, _ = both
    low, high = (share * chosen.period for share in NEAR)
    tried = [p for p in periods_of(records) if low < p < high and sum(r.duration for r in records) <= MOST * p]
    answer = {p: rows_at(both, p, inputs, outputs, scales) for p in tried}
    return answer or {chosen.period: chosen.rows}


def _best(rows: dict[float, Rows], chosen: Chosen, orders, asked, progress) -> tuple[Candidate, int]:
    """The candidate that runs best where it was held out, refined or not, and the evaluations that it took."""
    rate, refine = asked
    tried: dict[tuple, list[Candidate]] = {}
    for period, at in rows.items():
        for form in forms_of(chosen, period):
            if rate is not None and any(r != rate for r in form.rates):
                continue
            equations = chosen if period == chosen.period else None
            for candidate in candidates(at, period, form, equations, orders):
                tried.setdefault((period, form), []).append(candidate.tried())
                if progress:
                    progress(tried[period, form][-1], min(c.error for group in tried.values() for c in group))
    first = [ranked(group)[0] for group in tried.values() if ranked(group)]
    if not first:
        raise DataError(
            "learn_linear: no linear model runs over what was held out "
            f"(got {max(sum(len(p.y) for p in r.parts) for r in rows.values())} samples). Record longer, move every "
            "input more often, or take learn arx."
        )
    first.sort(key=lambda c: c.error)
    evaluations = 0
    for candidate in first[:FINALISTS] if refine else ():
        better = replace(candidate, refined=True).tried(ITERATIONS[0])
        evaluations += better.evaluations
        first.append(better)
        if progress:
            progress(better, min(c.error for c in first))
    return min(first, key=lambda c: c.error), evaluations


def _certified(block: LearnedBlock, runs: WholeRuns, fitted: Fitted, way: Way, scales: Scales) -> Certificate:
    """The largest |block - fit| over free runs with the inputs of the recordings, relative to the outputs' ranges."""
    worst, points, signals = 0.0, 0, (*block.inputs, *block.outputs)
    starts = runs.started(fitted.model, way)
    for part, late, first, start in zip(runs.rows.parts, runs.inputs, runs.first, starts, strict=True):
        expected = fitted.model.run(late, first, start) * scales.output_scale + scales.output_centre
        driven = np.array(expected)
        driven[0] = first * scales.output_scale + scales.output_centre
        values = [*(part.u * scales.input_scale + scales.input_centre).T, *driven.T]
        columns = {s.name: v for s, v in zip(signals, values, strict=True)}
        drive = Record(block.period * np.arange(len(expected)), columns, {s.name: s.unit for s in signals})
        found = simulate(block, drive).array([s.name for s in block.outputs])
        worst = max(worst, float((np.abs(found - expected) / np.ptp(expected, axis=0).clip(1e-300)).max()))
        points += len(expected)
    return Certificate(worst, TOLERANCE, points, f"numpy {np.__version__} float64, the fit's own run")


def _told(best: Candidate, outputs) -> dict:
    form = best.runs.form
    return {
        "order": best.order,
        "rates": [s.name for s, r in zip(outputs, form.rates, strict=True) if r],
        "direct": form.direct,
        "delay": form.delay,
        "subspace": best.source,
        "refined": best.refined,
    }


def _describe(best: Candidate) -> str:
    form = best.runs.form
    sums = f", {sum(form.rates)} sums" if any(form.rates) else ""
    how = "refined in free run" if best.refined else "from a subspace and least squares of the run"
    late = f", inputs {form.delay} periods late" if form.delay else ""
    return f"linear state space, {best.order} states{sums}{late}, {how}"
