"""identify: the parameters of a model from recordings, by nonlinear least squares with exact derivatives."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy.stats import qmc

from hydrotwin.models.language.errors import DataError, DeclarationError, SolveError
from hydrotwin.simulation import prepare

from . import horizon
from .answer import TROUBLE, answer, explains
from .descent import Task, descend
from .fit import Fit
from .least_squares import Minimum
from .loss import Loss
from .noise import output_noise, weights
from .problem import free_parameters, recordings
from .progress import reporting

SPREAD = 0.35  # of the other starts, in ln p or relative to p
AGREEMENT = 1e-4  # of the cost ...
SAME = 0.01  # ... and in q: two starts that end so close have found the same minimum


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
    starts: int = 4,
    loss: str = "linear",
    loss_scale: float = 2.0,
    initial_states: str = "auto",
    windows: Sequence[float] | None = None,
    step: float | None = None,
    method: str = "auto",
    iterations: int = 60,
    threads: int | None = None,
    progress: bool | Callable | None = None,
) -> Fit:
    """Fit free parameters so that the free runs of the model meet the recordings.

        min over p, x0   1/2 sum_records sum_k sum_outputs rho( ((y(t_k; p, x0) - y_k) / noise)^2 )

    Short windows with free start states lead a poor start into the right valley, growing windows keep it there, free
    runs over the whole recordings decide. When those do not reach the noise, other starts are tried.

    Args:
        model: a Model or FlatModel.
        records: recordings to fit, each with the inputs and at least one output of the model.
        free: globs over parameter paths; None frees what the model declares free.
        validate: recordings to judge by; only their start states are estimated.
        start, bounds: by path, SI, in place of the model's own.
        outputs: names of the outputs to fit, None for all that are recorded.
        noise: standard deviation by output, SI, in place of the estimate from the recordings.
        starts: most starts to try; 1 for the given one alone.
        loss: "linear", "soft_l1" or "huber", beyond ``loss_scale`` sigmas.
        initial_states: "auto" estimates those an output measures (its first sample is a measurement among others) and
            takes the rest from the model; "free" estimates all; "fixed" takes the first samples as exact.
        windows: lengths [s] of the shooting windows, () for free runs alone, None to choose from the model's modes.
        step, method: of the simulation, see `hydrotwin.simulation.prepare`.
        progress: True for a bar, or a function ``(stage, iteration, cost)``.

    Raises DeclarationError (unknown or unusable parameter, bounds, option), DataError (recordings that cannot be
    used), SolveError (every start diverges).
    """
    began = time.perf_counter()
    flat = getattr(model, "flat", model)
    if not len(records):
        raise DataError(f"identify: no recording to fit {flat.name} to. Give at least one.")
    if starts < 1:
        raise DeclarationError(f"identify: starts must be at least 1 (got {starts}).")
    parameters = free_parameters(flat, free, start, bounds)
    train = recordings(flat, records, outputs, "record")
    judged = recordings(flat, validate, outputs, "validation record")
    sigma = output_noise(flat, train, noise)
    with reporting(progress, flat.name) as report:
        report("compile", 0, np.nan)
        propagator = prepare(
            flat, free_parameters=parameters.names, free_states=[s.name for s in flat.states], step=step, method=method
        )
        task = Task(
            flat, parameters, propagator, train, weights(sigma), Loss(loss, loss_scale), initial_states,
            threads or _processors(), report,
        )  # fmt: skip
        minima = _minima(task, windows, starts, iterations)
        report("uncertainty", 0, minima[0].cost)
        settings = {
            "loss": loss, "loss_scale": loss_scale, "initial_states": initial_states, "starts": starts, "step": step,
            "method": method,
        }  # fmt: skip
        return answer(task, minima, judged, sigma, settings, began)


def _minima(task: Task, windows: Sequence[float] | None, starts: int, iterations: int) -> list[Minimum]:
    """The minima that the starts lead to, the lowest first.

    The first that was reached without trouble and explains the recordings ends the search, and so do two that agree.
    """
    found, stopped = [], None
    for q in _starts(task, starts):
        lengths = windows
        if lengths is None:
            lengths = horizon.horizons(task.flat, task.recordings, task.free.vector(q))
        try:
            latest = descend(task, q, lengths, iterations)
        except SolveError as error:
            stopped = stopped or error
            continue
        agree = bool(found) and _agree(latest, found[0])
        found = sorted([*found, latest], key=lambda m: m.cost)
        if agree or (latest.iterations < TROUBLE and explains(task, latest)):
            break
    if not found:
        raise stopped
    return found


def _agree(one: Minimum, other: Minimum) -> bool:
    return abs(one.cost - other.cost) < AGREEMENT * other.cost and bool(np.all(np.abs(one.q - other.q) < SAME))


def _starts(task: Task, starts: int):
    """The given start, then a scrambled Sobol sequence around it inside the bounds."""
    q0 = task.free.scaled(task.free.start)
    yield q0
    lower, upper = task.free.scaled(task.free.lower), task.free.scaled(task.free.upper)
    if starts > 1:
        cube = qmc.Sobol(len(q0), seed=0).random_base2(int(np.ceil(np.log2(starts))))
        for point in cube[: starts - 1]:
            yield np.clip(q0 + SPREAD * (2 * point - 1), lower, upper)


def _processors() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
