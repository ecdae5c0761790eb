"""The machine under a sampled controller: command and outputs decide each other sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from . import native, sensors
from .effects import named_effects
from .machines import machine_of
from .recording import STEP, _fields, _steps, _with_noise


def record_closed_loop(
    machine: str,
    controller: Callable[[int, Mapping[str, float]], float],
    time,
    *,
    parameters: Mapping[str, float] | None = None,
    effects=None,
    noise: Mapping[str, float] | None = None,
    quantisation: Mapping[str, float] | None = None,
    seed: int = 0,
    start: float | None = None,
    step: float = STEP,
) -> dict[str, np.ndarray]:
    """Simulate the truth while ``controller(k, outputs)`` sets the command at every sample; it is held to the next.

    The controller sees the true outputs; the noise of the sensors is on what is written down. Arguments as `record`;
    effects that change the command or delay a sensor are not applied here.
    """
    m, time = machine_of(machine), np.asarray(time, dtype=float)
    effects = named_effects(machine, effects)
    values, fields = _fields(m, parameters or {}, effects)
    state = np.zeros(native.STATES)
    first = m.start_state(values, fields, m.start_value if start is None else start, 0.0)
    state[: len(first)] = first
    command, outputs = np.zeros(len(time)), np.zeros((len(time), len(m.outputs)))
    still = np.zeros(2)
    for k, t in enumerate(time):
        if k == 0:
            outputs[0] = native.run(machine, time[:1], np.zeros(1), np.zeros(1), fields, state, len(m.outputs), step)
        command[k] = controller(k, dict(zip(m.outputs, outputs[k], strict=True)))
        if k + 1 < len(time):
            held = np.full(2, command[k])
            span = native.run(machine, np.array([t, time[k + 1]]), held, still, fields, state, len(m.outputs), step)
            outputs[k + 1] = span[-1]
    columns = {"time": time.copy(), m.input: command}
    for i, name in enumerate(m.outputs):
        columns[name] = sensors.measured(name, time, outputs[:, i], time, effects)
    return _with_noise(columns, m, noise or {}, {**_steps(effects), **(quantisation or {})}, seed)
