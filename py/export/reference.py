"""A short run of our own that an FMU carries along, so that any tool can replay it and compare."""

from __future__ import annotations

import dataclasses

import numpy as np

from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.simulation.block import Block
from hydrotwin.simulation.inputs import at, substeps

from .lower import implicit_advance, middle_of_training
from .method import choose_method

DURATION = 2.0  # s
SAMPLES = 200
SHARE = 0.2  # of nominal: the size of the inputs' movement
REFINED = 8


SIMULATED = {"explicit": "explicit", "adaptive": "rosenbrock"}  # method of the FMU -> of `simulate`


def reference_run(model, *, fine: bool = False, step: float | None = None, method: str = "auto") -> Record:
    """Inputs that move a fifth of nominal around their defaults, and the outputs that `simulate` gives.

    Inputs change at the samples only (held in between). It starts where the model starts by itself; a block starts with
    its measured outputs at zero, or at the middle of its training domain.

    fine : with an eighth of the model's step, for Model Exchange: the importer's solver meets the exact solution.
    step, method : internal step [s] and method of `export_fmu` instead; not for blocks.
    """
    system = getattr(model, "flat", model)
    period = system.period if isinstance(system, Block) else DURATION / SAMPLES
    time = np.arange(0.0, DURATION + period / 2, period).round(9)
    signals, units = {}, {}
    for k, signal in enumerate(system.inputs):
        wave = np.sin(2 * np.pi * (0.5 + 0.2 * k) * time) * (time > DURATION / 10)
        signals[signal.name] = middle_of_training(system, signal.name, signal.default) + SHARE * signal.nominal * wave
        units[signal.name] = signal.unit
    if isinstance(system, Block):
        for signal in system.outputs:
            signals.setdefault(signal.name, np.full(len(time), middle_of_training(system, signal.name, 0.0)))
            units[signal.name] = signal.unit
    inputs = Record(time, signals, units, "reference")
    outputs = _answers(system, inputs, step or (system.step / REFINED if fine else None), method)
    answers = {s.name: outputs[s.name] for s in system.outputs}
    return inputs.with_signals(answers, units={s.name: s.unit for s in system.outputs})


def _answers(system: FlatModel | Block, inputs: Record, step: float | None, method: str) -> Record:
    if isinstance(system, Block):
        return simulate(system, inputs)
    held = dataclasses.replace(
        system, inputs=tuple(dataclasses.replace(s, interpolation="hold") for s in system.inputs)
    )
    if method == "implicit":
        return _implicit_run(held, inputs, step or held.step)
    chosen, step, _ = choose_method(held, method, step or held.step)
    return simulate(held, inputs, step=step, method=SIMULATED[chosen])


def _implicit_run(flat: FlatModel, record: Record, step: float) -> Record:
    """The outputs that the FMU of method "implicit" has, in CasADi's interpreter: `simulate` has no such method."""
    time, u, p = record.time, record.array([s.name for s in flat.inputs]), flat.parameter_vector()
    parameters = [q.name for q in flat.parameters]
    late = [p[parameters.index(s.dead_time)] if s.dead_time else None for s in flat.inputs]
    seen = [at(time, column, time - (Td or 0.0), False, "right") for column, Td in zip(u.T, late, strict=True)]
    cut, advance = substeps(time, u, step, [False] * len(late), late), implicit_advance(flat)
    x, rows = flat.start_given(())(u[0], p, []), []
    for k in range(len(time)):
        rows.append(flat.ode(time[k], x, [column[k] for column in seen], p)[1].full().ravel())
        for j in range(cut.first[k], cut.last[k] + 1) if k + 1 < len(time) else ():
            x = advance(cut.time[j], cut.length[j], x, cut.mean[j], p)
    columns = dict(zip([s.name for s in flat.outputs], np.array(rows).T, strict=True))
    return Record(time, columns, {s.name: s.unit for s in flat.outputs})
