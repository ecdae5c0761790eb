"""Learn an ARX model: linear least squares, its order and period by free run, refined there."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import metadata
from time import perf_counter

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, tidy
from hydrotwin.simulation import simulate

from ..block_file import Certificate, LearnedBlock, assemble
from ..options import check_counts, check_lags, check_positive
from ..training_data import checked_recordings, finest_period, named, recorded_period, training_box, usable
from .arx_block import ARX, arx_states
from .orders import NOTHING, SIMPLER, Asked, Equation, Order, Search, fitted, free_run_of
from .output_error import refined
from .regressors import Rows, Sampled, Scales

FACTORS = (1, 2, 4, 8, 16, 32)  # of the sampling period that are tried
LONGER = 1.05  # times what a longer period leaves must be left by a shorter one, where only one part judges
LATEST = 40  # of the shortest period: a dead time is no longer because the period is
LEAST = 30  # samples over all recordings
SAMPLES = 40  # of the shortest recording that must be left at a longer period
TOLERANCE = 1e-9  # of an output's range: deployed free run against the fit's own
FINALISTS = 4  # equations per output that are refined before one is chosen


@dataclass(frozen=True, eq=False)
class Chosen:
    """The equations (one per output) at a period, their rows, and the RMS of each on held-out parts, SI."""

    period: float
    rows: Rows
    equations: list[Equation]
    errors: np.ndarray


def learn_arx(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    period: float | None = None,
    lags: tuple[int, int] | None = None,
    delay: int | None = None,
    rate: bool | None = None,
    refine: bool = True,
    select: Sequence[Record] = (),
    validate: Sequence[Record] = (),
    seed: int = 0,
    name: str = "arx",
    progress: Callable | None = None,
) -> LearnedBlock:
    """Fit an ARX equation to every output by linear least squares; answer them as one Block, see `arx_block`.

    Nothing about the machine is assumed. Sampling period, past values, samples and delay of every input, and whether
    the equation is that of an output or of its rate, are those that run best in free run over quarters of the
    recordings, each held out of its fit in turn; within 2 % the simplest is taken. An equation that is not stable (the
    integration apart) is none.

    Args:
        records: training recordings without gaps, of even or uneven times.
        period: s between steps; None: the sampling period times 1, 2, 4, ... 32.
        lags: (past values of the output, samples of every input); None: chosen. delay: periods before an input acts.
        rate: the increments of the outputs are modelled; None: chosen for every output.
        refine: the few best are fitted to their free runs too (output error), where that runs better on what is held
            out. False: least squares alone.
        select: recordings that choose in place of the parts; nothing is fitted to them.
        validate: checked, and used for nothing. seed: kept for the record; nothing here is random.
        progress: not called; it does not take long.

    ``provenance["arx"]`` tells by output the order, and the free-run error on what was held out (SI).

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move, no stable equation.
        DeclarationError: impossible options.
    """
    began = perf_counter()
    check_positive("learn_arx", period=period)
    check_counts("learn_arx", {"delay": (delay, 0)})
    check_lags("learn_arx", lags, "past values", "2,6")
    inputs, outputs, records, validate = checked_recordings("learn_arx", records, inputs, outputs, validate)
    asked = Asked(rate, *(lags or (None, None)), delay)
    select = usable(select, (*inputs, *outputs)) if select else []
    chosen = choose((records, select), inputs, outputs, period, asked, FINALISTS if refine else 0)
    scales = Scales.of(records, inputs, outputs)
    structure, arrays = _arrays(chosen.equations, scales)
    block = assemble(
        ARX,
        arrays,
        structure,
        name=name,
        inputs=inputs,
        outputs=outputs,
        states=arx_states(structure, inputs, outputs),
        parameters=(),
        period=chosen.period,
        domain=training_box(records, (*inputs, *outputs)),
        description=_describe(chosen, inputs, outputs),
        provenance=_provenance((records, select), chosen, inputs, outputs, seed, began),
    )
    return replace(block, certificate=certified(block, chosen, scales))


def choose(
    both: tuple[Sequence[Record], Sequence[Record]], inputs, outputs, period: float | None, asked: Asked, finalists: int
) -> Chosen:
    """The period and equations that run best on parts held out, fitted to all of the recordings.

    both : recordings to fit, and those that choose (none: parts of the former, held out in turn).
    finalists : how many per output are fitted to their free runs as well; 0: none.
    """
    records, _ = both
    _check_size(records, period)
    scales, best = Scales.of(records, inputs, outputs), None
    periods = [period] if period else periods_of(records)
    for candidate in periods:
        rows = rows_at(both, candidate, inputs, outputs, scales, asked.reach)
        latest = max(1, int(LATEST * periods[0] / candidate))
        searches = [Search(rows, j, replace(asked, latest=min(asked.latest, latest))) for j in range(len(outputs))]
        errors = np.array([s.by_fold(s.run()) for s in searches])
        if not np.isfinite(errors).all():
            continue
        errors = np.log(np.maximum(errors, NOTHING))
        if best is None or _surely_less(errors, best[0]):
            best = errors, candidate, rows, searches
    if best is None:
        raise DataError(
            "learn: no stable equation runs over what was held out "
            f"({sum(len(r) for r in records)} samples were given). Record longer, and move every input more often."
        )
    _, period, rows, searches = best
    found = [_equation(s, finalists) for s in searches]
    errors = np.sqrt([e for _, e in found]) * scales.output_scale
    return Chosen(period, rows, [eq for eq, _ in found], errors)


def _check_size(records: Sequence[Record], period: float | None) -> None:
    """DataError for fewer samples than `LEAST`, as recorded or at the period that is asked for."""
    samples = sum(len(r) if period is None else min(len(r), int(r.duration / period) + 1) for r in records)
    if samples < LEAST:
        at = "" if period is None else f" at {period:g} s"
        told = f"learn: too few samples to train on (got {samples}{at}). At least {LEAST} are needed. Record longer"
        raise DataError(f"{told}." if period is None else f"{told}, or choose a shorter period.")


def _surely_less(errors: np.ndarray, before: np.ndarray) -> bool:
    """Whether logarithms of errors (outputs, folds) are less by more than one standard error over the folds.

    A longer period sees less of the inputs, and of many that are tried one is best by chance.
    Source: L. Breiman and others, Classification and Regression Trees (1984), section 3.4.3.
    """
    gain = (before - errors).mean(axis=0)
    error = gain.std(ddof=1) / np.sqrt(len(gain)) if len(gain) > 1 else 2 * np.log(LONGER)
    return bool(gain.mean() > error)


def rows_at(both, period: float, inputs, outputs, scales: Scales, reach: int = 0) -> Rows:
    """The recordings to fit, and those that choose, at a period."""
    records, select = both
    return Rows.of([Sampled.of(r, period, inputs, outputs, scales) for r in (*records, *select)], reach, len(select))


def periods_of(records: Sequence[Record]) -> list[float]:
    """The sampling period and multiples, with neither too many samples over all recordings nor too few in one."""
    finest = finest_period(records, recorded_period(records))
    shortest = min(r.duration for r in records)
    return [tidy(finest * f) for f in FACTORS if f == 1 or shortest / (finest * f) >= SAMPLES]


def _equation(search: Search, finalists: int) -> tuple[Equation, float]:
    """The simplest of the best orders, or what is better on what is held out among the refined ones."""
    ranked = [order for order in search.ranked() if fitted(search.rows, search.rows.all, search.output, order).stable]
    if not ranked:
        raise DataError(
            "learn: no stable equation fits the recordings "
            f"(got {sum(len(p.y) for p in search.rows.parts)} samples). Record longer, and move every input more often."
        )
    order = ranked[0]
    best = fitted(search.rows, search.rows.all, search.output, order), search.error(order)
    for order in _apart(ranked)[:finalists]:
        tried = refined(search, order)
        if tried is not None and tried[1] < best[1] / SIMPLER:
            best = tried
    return best


def _apart(orders: Sequence[Order]) -> list[Order]:
    """The first of those with the same form and past."""
    first: dict = {}
    for order in orders:
        first.setdefault((order.rate, order.past), order)
    return list(first.values())


def _arrays(equations: Sequence[Equation], scales: Scales) -> tuple[dict[str, int], dict[str, np.ndarray]]:
    """Counts and arrays of the block, SI, from equations over scales that look at y[k] and u[k+1], u[k], ..."""
    ny, nu = len(equations), len(scales.input_scale)
    direct = int(any(lag == 0 for eq in equations for _, lag in eq.inputs))
    lags = max(lag for eq in equations for _, lag in eq.inputs) - 1
    gain = scales.output_scale[:, None] / scales.input_scale
    weights = np.zeros((max(lags, 0) + 2, ny, nu))  # of u[k+1], u[k], ...
    for j, eq in enumerate(equations):
        for (i, lag), value in eq.inputs.items():
            weights[lag, j, i] = value * gain[j, i]
    level = np.array([eq.level for eq in equations])
    increments = np.zeros((max(len(eq.increments) for eq in equations), ny))
    for j, eq in enumerate(equations):
        increments[: len(eq.increments), j] = eq.increments
    constant = np.array([eq.constant for eq in equations]) * scales.output_scale - level * scales.output_centre
    constant -= np.einsum("lji,i->j", weights, scales.input_centre)
    D = weights[0]
    driven = _behind(weights, D, level, increments)
    structure = {"increments": len(increments), "input_lags": len(driven) - 1, "direct": direct}
    return structure, {"constant": constant, "level": level, "increments": increments, "inputs": driven, "direct": D}


def _behind(weights: np.ndarray, D: np.ndarray, level: np.ndarray, increments: np.ndarray) -> np.ndarray:
    """Weights of u[k], u[k-1], ... in the equation of w = y - D u, whose own past stands for that of y."""
    if not D.any():
        return weights[1:]
    length = max(len(weights) - 1, len(increments) + 1)
    answer = np.zeros((length, *D.shape))
    answer[: len(weights) - 1] = weights[1:]
    answer[0] += (1 + level)[:, None] * D
    for i, factor in enumerate(increments):
        answer[i] += factor[:, None] * D
        answer[i + 1] -= factor[:, None] * D
    return answer


def certified(block: LearnedBlock, chosen: Chosen, scales: Scales) -> Certificate:
    """The largest |block - fit| over free runs with the inputs of the recordings, relative to the outputs' ranges."""
    worst, points = 0.0, 0
    for k, part in enumerate(chosen.rows.parts):
        runs = [free_run_of(chosen.rows, k, j, eq) for j, eq in enumerate(chosen.equations)]
        expected = np.vstack([part.y[:1], np.column_stack(runs)]) * scales.output_scale + scales.output_centre
        values = [*(part.u * scales.input_scale + scales.input_centre).T, *expected.T]
        signals = (*block.inputs, *block.outputs)
        columns = {s.name: v for s, v in zip(signals, values, strict=True)}
        drive = Record(block.period * np.arange(len(expected)), columns, {s.name: s.unit for s in signals})
        found = simulate(block, drive).array([s.name for s in block.outputs])
        worst = max(worst, float((np.abs(found - expected) / np.ptp(expected, axis=0).clip(1e-300)).max()))
        points += len(expected)
    return Certificate(worst, TOLERANCE, points, f"numpy {np.__version__} float64, the fit's own run")


def _told(order: Order, inputs: Sequence[Signal]) -> dict:
    """An order for the provenance."""
    windows = {s.name: {"delay": d, "samples": n} for s, (d, n) in zip(inputs, order.windows, strict=True)}
    return {"rate": order.rate, "past": order.past, "inputs": windows}


def _describe(chosen: Chosen, inputs, outputs) -> str:
    parts = []
    for signal, eq in zip(outputs, chosen.equations, strict=True):
        windows = ", ".join(
            f"{n} samples of {s.name} after {d} periods" for s, (d, n) in zip(inputs, eq.order.windows, strict=True)
        )
        form = "rate of " if eq.order.rate else ""
        parts.append(f"{form}{signal.name} from {eq.order.past} past values, {windows}")
    return "ARX: " + "; ".join(parts)


def _provenance(both, chosen: Chosen, inputs, outputs, seed: int, began: float) -> dict:
    told = {
        s.name: _told(eq.order, inputs) | {"held_out_error": float(e)}
        for s, eq, e in zip(outputs, chosen.equations, chosen.errors, strict=True)
    }
    return {
        "kind": "arx",
        "trained_on": named(both[0]),
        "selected_on": named(both[1]) or "parts of the training recordings, each held out in turn",
        "arx": told,
        "seed": seed,
        "seconds": round(perf_counter() - began, 2),
        "stopped": "finished",
        "versions": {package: metadata.version(package) for package in ("numpy", "scipy", "casadi")},
    }
