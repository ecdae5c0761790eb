"""A short run of our own that an FMU carries along, so that any tool can replay it and compare."""

from __future__ import annotations

import numpy as np

from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.simulation.block import Block

DURATION = 2.0  # s
SAMPLES = 200
SHARE = 0.2  # of nominal: the size of the inputs' movement
REFINED = 8


def reference_run(model, *, fine: bool = False, step: float | None = None) -> Record:
    """Inputs that move a fifth of nominal around their defaults, and the outputs that `simulate` gives.

    Inputs change at the samples only (held in between). It starts where the model starts by itself; a block starts with
    its measured outputs at zero, or at the middle of its training domain.

    fine : with an eighth of the model's step, for Model Exchange: the importer's solver meets the exact solution.
    step : internal step [s] instead; not for blocks.
    """
    system = getattr(model, "flat", model)
    period = system.period if isinstance(system, Block) else DURATION / SAMPLES
    time = np.arange(0.0, DURATION + period / 2, period).round(9)
    signals, units = {}, {}
    for k, signal in enumerate(system.inputs):
        wave = np.sin(2 * np.pi * (0.5 + 0.2 * k) * time) * (time > DURATION / 10)
        signals[signal.name] = _middle(system, signal.name, signal.default) + SHARE * signal.nominal * wave
        units[signal.name] = signal.unit
    if isinstance(system, Block):
        for signal in system.outputs:
            signals.setdefault(signal.name, np.full(len(time), _middle(system, signal.name, 0.0)))
            units[signal.name] = signal.unit
    inputs = Record(time, signals, units, "reference")
    if fine and step is None:
        step = system.step / REFINED
    outputs = simulate(model, inputs) if step is None else simulate(model, inputs, step=step)
    answers = {s.name: outputs[s.name] for s in system.outputs}
    return inputs.with_signals(answers, units={s.name: s.unit for s in system.outputs})


def _middle(system, name: str, otherwise: float) -> float:
    domain = getattr(system, "domain", None)
    if domain is None or name not in domain.names:
        return otherwise
    k = domain.names.index(name)
    return 0.5 * (domain.lower[k] + domain.upper[k])
