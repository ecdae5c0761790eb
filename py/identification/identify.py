"""identify: the parameters of a model from recordings, by nonlinear least squares with exact derivatives."""

from __future__ import annotations

import dataclasses
import os
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import fitted_beside
from hydrotwin.models.language.provenance import refitted
from hydrotwin.records import cuts, distinct, require_unseen
from hydrotwin.records.between import settled
from hydrotwin.simulation import prepare

from .answer import answer
from .assumptions import PATIENCE, doubted
from .descent import Task, undecided
from .evidence import provenance_of_fit
from .fit import Finding, Fit
from .loss import Loss
from .noise import output_noise
from .noise import weights as by_noise
from .outliers import spared
from .problem import free_parameters, recordings, unbroken_for
from .progress import reporting
from .search import Effort, search
from .weighing import WEIGHTS


def identify(
    model,
    records: Sequence,
    *,
    free: Sequence[str] | None = None,
    validate: Sequence = (),
    start: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    outputs: Sequence[str] | None = None,
    noise: Mapping[str, float] | None = None,
    weights: str = "auto",
    starts: int = 4,
    loss: str = "auto",
    loss_scale: float = 2.0,
    initial_states: str = "auto",
    windows: Sequence[float] | None = None,
    step: float | None = None,
    method: str = "auto",
    iterations: int = 60,
    threads: int | None = None,
    progress: bool | Callable | None = None,
    interpolation: Mapping[str, str] | None = None,
) -> Fit:
    """Fit free parameters so that the free runs of the model meet the recordings.

        min over p, x0   1/2 sum_records sum_k sum_outputs rho( ((y(t_k; p, x0) - y_k) / noise)^2 )

    Short windows with free start states lead a poor start into the right valley, growing windows keep it there, free
    runs over the whole recordings decide. When those do not reach the noise, other starts are tried.

    Args:
        model: a Model or FlatModel.
        records: recordings to fit, each with the inputs and at least one output of the model. One with holes is cut
            into the parts between them; where one begins in motion, all start states are estimated.
        free: globs over parameter paths; None frees what the model declares free.
        validate: recordings to judge by; only their start states are estimated.
        start, bounds: by path, SI, in place of the model's own.
        outputs: names of the outputs to fit, None for all that are recorded.
        noise: standard deviation by output, SI, in place of the estimate from the recordings.
        weights: "noise" weighs every residual by its sensor's noise; "residual" weighs an output that the model cannot
            bring to its noise by what it leaves of it; "auto" does so unless that output's noise was given.
        starts: most starts to try; 1 for the given one alone.
        loss: "linear", "soft_l1" or "huber", beyond ``loss_scale`` sigmas; "auto" is linear, and leaves out samples
            that stand alone far from all others where nothing but noise is left without them (a finding says which).
        initial_states: "auto" estimates those an output measures (its first sample is a measurement among others) and
            takes the rest from the model; "free" estimates all; "fixed" takes the first samples as exact.
        windows: lengths [s] of the shooting windows, () for free runs alone, None to choose from the model's modes.
        step, method: of the simulation, see `hydrotwin.simulation.prepare`.
        progress: True for a bar, or a function ``(stage, iteration, cost)``.
        interpolation: "hold" or "linear" by input, in place of what the model says or the recordings show.

    Raises DeclarationError (unknown or unusable parameter, bounds, option), DataError (recordings that cannot be
    used), SolveError (every start diverges).
    """
    began = time.perf_counter()
    if not len(records):
        raise DataError(f"identify: no recording to fit {model.name} to. Give at least one.")
    model = settled(model, records, interpolation)
    flat = getattr(model, "flat", model)
    if starts < 1:
        raise DeclarationError(f"identify: starts must be at least 1 (got {starts}).")
    if weights not in WEIGHTS:
        raise DeclarationError(f"identify: no weights '{weights}'. {nearest(weights, WEIGHTS)}")
    parameters = free_parameters(flat, free, start, bounds)
    require_unseen(records, validate, [s.name for s in flat.outputs])
    records, validate = (unbroken_for(flat, some) for some in distinct(records, validate))
    train = recordings(flat, records, outputs, "record")
    sigma = output_noise(flat, train, noise)
    with reporting(progress, flat.name) as report:
        adaptable = _adaptable(flat, weights, noise) & np.isfinite(sigma)
        effort, given_up = Effort(windows, starts, iterations), []
        for _ in range(PATIENCE + 1):
            report("compile", 0, np.nan)
            propagator = prepare(
                flat, free_parameters=parameters.names, free_states=[s.name for s in flat.states], step=step,
                method=method,
            )  # fmt: skip
            cost = Loss("linear" if loss == "auto" else loss, loss_scale)
            task = Task(
                flat, parameters, propagator, train, by_noise(sigma), cost, initial_states, threads or processors(),
                report, sigma,
            )  # fmt: skip
            task, minima = search(task, effort, adaptable)
            said, spared_some = [], False
            if loss == "auto":
                task, minima, strays = spared(task, minima, effort, adaptable)
                said, spared_some = strays.findings(), strays.left_out
            report("what was assumed", 0, minima[0].cost)
            change = doubted(task, minima[0], adaptable) if len(given_up) < PATIENCE else None
            if change is None:
                break
            given_up.append(change)
            if not change.used:
                break
            initial_states = "free" if change.free_starts else initial_states
            parameters = free_parameters(flat, [*parameters.names, *change.freed], start, bounds)
            flat = flat.with_inputs(change.inputs)
            train = recordings(flat, records, outputs, "record")
        report("uncertainty", 0, minima[0].cost)
        settings = {
            "loss": loss, "loss_scale": loss_scale, "initial_states": initial_states, "starts": starts, "step": step,
            "method": method, "weights": weights, "spared": spared_some,
        }  # fmt: skip
        judged = recordings(flat, validate, outputs, "validation record")
        fit = answer(undecided(task), minima, judged, settings, began)
        said = [*(Finding("assumption", (), f"identify: {s}") for c in given_up for s in c.sentences), *said]
        said += [Finding("hole", (), f"identify: {s}") for s in cuts([*records, *validate])]
        fit = dataclasses.replace(fit, findings=(*said, *fit.findings))
        stay = fitted_beside(flat, parameters.names)
        known = refitted(flat.provenance, provenance_of_fit(fit), stay)
        return dataclasses.replace(fit, flat=dataclasses.replace(fit.flat, provenance=known))


def _adaptable(flat, weights: str, noise: Mapping[str, float] | None) -> np.ndarray:
    """Outputs (ny,) whose weight may follow what is left of them."""
    if weights == "auto":
        return np.array([s.name not in (noise or {}) for s in flat.outputs])
    return np.full(len(flat.outputs), weights == "residual")


def processors() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
