"""Which integrator an exported model gets: the one with which `simulate` reaches its accuracy."""

from __future__ import annotations

import dataclasses

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, SolveError, nearest
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import Record
from hydrotwin.simulation.propagator import prepare

from .lower import middle_of_training

DURATION = 2.0  # s: of the trial run of a fast machine ...
FEWEST = 40  # ... and of a slow one so many of its steps, or of the periods of a block
SAMPLES = 200
SHARES = 0.2, 0.02, 0.0  # of nominal: the size of the inputs' movement, the first that the model bears

METHODS = ("auto", "explicit", "implicit", "adaptive")


def choose_method(flat: FlatModel, method: str, step: float) -> tuple[str, float, str]:
    """``(method, step, reason)``.

    "auto" is "refined", the explicit method with steps cut around contacts and other kinks, at the very step that
    `simulate` takes under `excitation`, so that FMU and simulation are the same numbers; where `simulate` turns to the
    implicit method, it is "adaptive". The reason says how accurate that run is.

    Raises DeclarationError for a method that is none and a step that is not positive.
    """
    check_method(flat.name, method, step)
    if not flat.states:
        return "explicit", step, "the model has no states"
    if method != "auto":
        return method, step, "chosen by the caller"
    flat = held(flat)
    driven, p = excitation(flat), flat.parameter_vector()
    u = driven.array([s.name for s in flat.inputs])
    x0 = flat.start_given(())(u[0], p, []).full().ravel()
    propagator = prepare(flat, step=step)
    try:
        *_, accuracy = propagator.controlled_run(driven.time, u, p, x0)
    except SolveError as error:
        return "adaptive", step, f"a trial run stopped ({error})"
    return "adaptive" if propagator.method == "implicit" else "refined", propagator.step, f"a trial run is {accuracy}"


def check_method(name: str, method: str, step: float | None = None) -> None:
    """Raise DeclarationError for a method that is none and a step [s] that is not positive; ``name``: of the model."""
    if method not in METHODS:
        raise DeclarationError(f"{name}: no method '{method}'. {nearest(method, METHODS)}")
    if step is not None and not step > 0:
        raise DeclarationError(f"{name}: the internal step must be positive (got {step:g} s). Give seconds, as 1e-3.")


def duration_of(pace: float) -> float:
    """Seconds of a trial run of what moves every ``pace`` s: a block by its period, a model by its longest step."""
    return max(DURATION, FEWEST * pace)


def excitation(system, period: float | None = None, share: float = SHARES[0]) -> Record:
    """Seconds (`duration_of`) of inputs that move a share of nominal around their defaults, each at its own frequency.

    Those of a block that knows its training domain move around the middle of it. period [s] : of the samples of a
    block; a model has SAMPLES.
    """
    duration = duration_of(period or float(system.step))
    period = period or duration / SAMPLES
    time = np.arange(0.0, duration + period / 2, period).round(9)
    moving, slower = time > duration / 10, DURATION / duration
    signals, units = {}, {}
    for k, signal in enumerate(system.inputs):
        wave = share * signal.nominal * np.sin(2 * np.pi * (0.5 + 0.2 * k) * slower * time) * moving
        signals[signal.name] = middle_of_training(system, signal.name, signal.default) + wave
        units[signal.name] = signal.unit
    return Record(time, signals, units, "reference")


def held(flat: FlatModel) -> FlatModel:
    """The model with inputs that are held between samples, as a master sets them."""
    return dataclasses.replace(flat, inputs=tuple(dataclasses.replace(s, interpolation="hold") for s in flat.inputs))
