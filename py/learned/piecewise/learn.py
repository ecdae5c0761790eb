"""Learn a valve's piecewise linear characteristic, six numbers and a dead time, from command and position or speed."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import metadata
from time import perf_counter

import numpy as np

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..block_file import LearnedBlock, assemble
from ..grey_box.data import FitProgress, Watch, block_period, certify, falls, one_in_one_out, run_of, seen_late
from ..integrating import integration, one_form, told_forms
from ..options import check_counts, check_known
from ..steady import Steady, steady_block
from ..training_data import named, training_box
from .block import PIECEWISE, piecewise_states, whole_and_share
from .fit import Curve, CurveProblem, fit_curve, output_of

FITS = ("default", "paper")
SIDES = ("saturated below", "deadband from", "deadband to", "saturated above")


def learn_piecewise(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    fit: str = "default",
    period: float | None = None,
    validate: Sequence[Record] = (),
    select: Sequence[Record] = (),
    dead_time: float | None = None,
    integrating: bool | None = None,
    starts: int = 3,
    seed: int = 0,
    name: str = "piecewise",
    progress: Callable[[FitProgress], None] | None = None,
) -> LearnedBlock:
    """Fit the characteristic of `piecewise_block` to recordings of one command and one output; answer it as a Block.

    The two slopes are linear least squares for given edges and dead time, which the outer solver moves. What is left
    of an integrating output is taken as sensor noise on a random walk (`grey_box_data.Whitening`).

    Args:
        records: training recordings without gaps, of even or uneven times. inputs, outputs: one each.
        fit: "default"; "paper": the dual-GP paper's six parameters, which have no dead time.
        period: s between steps of the block; None: as `grey_box_data.block_period` finds it.
        validate: checked, and nothing else. select: recordings that choose among the starts; none: the training loss
            does.
        dead_time: s; None: found with the rest; 0: none.
        integrating: the characteristic gives the rate of the output (a position); False: the output itself (a speed);
            None: what the recordings tell (`integration`).
        starts: curves refined, from the best of a scan. seed: kept for the record; nothing here is random.
        progress: called with a `FitProgress` after every evaluation.

    ``provenance["identified"]`` holds the edges, slopes, saturations and the machine's dead time. An edge at the end
    of the inputs seen means that no saturation was. Ctrl-C ends the fit with the best so far.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options.
    """
    began = perf_counter()
    _check_options(fit, starts, dead_time)
    dead_time = 0.0 if fit == "paper" else dead_time
    records, select, input_, output = one_in_one_out("learn_piecewise", records, inputs, outputs, validate, select)
    period = block_period("learn_piecewise", records, period)
    forms = integration(records, (input_,), (output,))
    integrating = one_form("learn_piecewise", "integrating", integrating, forms)
    runs, judges = ([run_of(r, period, input_, output) for r in part] for part in (records, select))
    sign = -1.0 if falls(runs, integrating) else 1.0
    runs, judges = ([replace(r, output=sign * r.output) for r in part] for part in (runs, judges))
    problem = CurveProblem(runs, period, integrating, dead_time, 1.0 if integrating else None)
    watch = Watch(progress)
    curve = fit_curve(problem, judges, starts, watch)
    curve = replace(curve, rates=sign * curve.rates)
    block = _block(curve, integrating, period, name, records, input_, output)
    provenance = {
        "kind": "piecewise",
        "fit": fit,
        "trained_on": named(records),
        "selected_on": named(select) or "the training loss",
        "integrating": integrating,
        "integration": told_forms(forms),
        "identified": _identified(curve, seen_late(records, period, input_) if dead_time is None else 0.0),
        "seed": seed,
        "evaluations": watch.evaluations,
        "seconds": round(perf_counter() - began, 2),
        "stopped": watch.stopped or "finished",
        "versions": {package: metadata.version(package) for package in ("numpy", "scipy", "casadi")},
    }
    expected = [output_of(problem, curve, run) + sign * run.output[0] * integrating for run in runs]
    block = replace(block, provenance=provenance, certificate=certify(block, runs, expected))
    return steady_block(block, records, Steady((output,) if integrating and fit != "paper" else ()))


def _identified(curve: Curve, late: float) -> dict[str, float]:
    a, b, c, d = curve.edges
    low, high = curve.rates
    return dict(zip(SIDES, map(float, curve.edges), strict=True)) | {
        "slope below": float(-low / (b - a)),
        "slope above": float(high / (d - c)),
        "saturation below": float(low),
        "saturation above": float(high),
        "dead_time": curve.dead_time + late,
    }


def _block(curve: Curve, integrating, period, name, records, input_: Signal, output: Signal) -> LearnedBlock:
    structure = {"delay": whole_and_share(curve.dead_time, period)[0] + 1, "integrating": int(integrating)}
    arrays = {"edges": curve.edges, "rates": curve.rates, "dead_time": [curve.dead_time], "period": [period]}
    return assemble(
        PIECEWISE,
        arrays,
        structure,
        name=name,
        inputs=(input_,),
        outputs=(output,),
        states=piecewise_states(structure, input_, output),
        parameters=(),
        period=period,
        domain=training_box(records, (input_, output)),
        description=(
            f"piecewise linear, nothing from {curve.edges[1]:.3g} to {curve.edges[2]:.3g} {input_.unit}, "
            f"dead time {1e3 * curve.dead_time:.3g} ms"
        ),
        provenance={},
    )


def _check_options(fit, starts, dead_time) -> None:
    check_known("learn_piecewise", "fit", fit, FITS)
    check_counts("learn_piecewise", {"starts": (starts, 1)})
    if fit == "paper" and dead_time:
        raise DeclarationError(
            f"learn_piecewise: fit='paper' has no dead time (got {dead_time} s). Leave one of them out."
        )
    if dead_time is not None and not (np.isfinite(dead_time) and dead_time >= 0):
        raise DeclarationError(f"learn_piecewise: dead_time must not be negative (got {dead_time} s).")
