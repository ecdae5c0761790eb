"""Record a machine: command in, measured columns out."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from . import native, sensors
from .command_path import Signal
from .effects import changed_command, named_effects, true_values
from .machine import NEUTRAL
from .machines import machine_of

STEP = 5e-5


def record(
    machine: str,
    command,
    time,
    *,
    parameters: Mapping[str, float] | None = None,
    effects=None,
    noise: Mapping[str, float] | None = None,
    quantisation: Mapping[str, float] | None = None,
    seed: int = 0,
    start: float | None = None,
    step: float = STEP,
    hold_after_loss: bool = False,
) -> dict[str, np.ndarray]:
    """Simulate the truth and measure it at ``time``; the command is held from each sample to the next.

    Args: command (n,) in V or 1; time (n,) [s], any spacing; parameters by name, SI; effects: {name: options} or pairs;
    noise, quantisation: per output, SI (absent = none); start: arm angle [rad] or position [m]; step: longest step [s].
    Returns: columns ``time``, the command, and every output, SI.
    Raises: RuntimeError when the machine leaves its volumes; ``hold_after_loss`` holds its last outputs instead.
    """
    m, time = machine_of(machine), np.asarray(time, dtype=float)
    command = np.asarray(command, dtype=float)
    if command.shape != time.shape or time.ndim != 1 or np.any(np.diff(time) <= 0):
        raise ValueError("rig: command and time must be of one length, and time must rise.")
    effects = named_effects(machine, effects)
    values, fields = truth_of(m, parameters or {}, effects)
    signal = changed_command(machine, Signal.held(time, command), effects)
    corners = [time, signal.times, *sensors.extra_times(effects, time), *_instants(fields)]
    times = _breakpoints(np.concatenate(corners), time[0], time[-1])
    u, slopes = signal.on(times)
    state = m.start_state(values, fields, m.start_value if start is None else start, u[0])
    outputs = native.run(machine, times, u, slopes, fields, state, len(m.outputs), step, hold_after_loss)
    columns = {"time": time.copy(), m.input: command.copy()}
    for i, name in enumerate(m.outputs):
        columns[name] = sensors.measured(name, times, outputs[:, i], time, effects)
    return _with_noise(columns, m, noise or {}, {**_steps(effects), **(quantisation or {})}, seed)


def truth_of(m, parameters, effects):
    """Base parameters by path and fields of the C core, after every effect."""
    values, changed = true_values(m.name, parameters, effects)
    base = {field: values[path] for path, field in m.fields.items() if field != "-"}
    zeros = dict.fromkeys(native.field_names(m.name), 0.0)
    neutral = {name: value for name, value in NEUTRAL.items() if name in zeros}
    return values, {**zeros, **neutral, **base, **changed}


def _instants(fields):
    """Times at which something happens by itself."""
    cause = {"payload_time": "payload_step", "push_start": "push_force", "push_end": "push_force"}
    return [np.array([fields[name]]) for name, of in cause.items() if fields[of]]


def _breakpoints(times, first, last):
    times = np.sort(times[(times >= first - 1e-10) & (times <= last + 1e-10)])
    return times[np.append(True, np.diff(times) > 1e-10)]


def _steps(effects):
    return {o["output"]: o["step"] for name, o in effects if name == "quantisation"}


def _with_noise(columns, m, noise, quantisation, seed):
    unknown = (set(noise) | set(quantisation)) - set(m.outputs)
    if unknown:
        raise KeyError(f"rig: {m.name} has no output {sorted(unknown)} (there are {', '.join(m.outputs)}).")
    for i, name in enumerate(m.outputs):
        own = np.random.default_rng([seed, i])
        if noise.get(name):
            columns[name] = columns[name] + noise[name] * own.standard_normal(len(columns[name]))
        columns[name] = sensors.quantised(columns[name], quantisation.get(name, 0.0))
    return columns
