"""Record a machine: command in, measured columns out; and whole sets of recordings."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from . import commands, native, sensors
from .command_path import Signal
from .effects import changed_command, named_effects, true_values
from .machines import NEUTRAL, machine_of, sensor_noise

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
) -> dict[str, np.ndarray]:
    """Simulate the truth and measure it at ``time``; the command is held from each sample to the next.

    Args: command (n,) in V or 1; time (n,) [s], any spacing; parameters by name, SI; effects: {name: options} or pairs;
    noise, quantisation: per output, SI (absent = none); start: arm angle [rad] or position [m]; step: longest step [s].
    Returns: columns ``time``, the command, and every output, SI.
    """
    m, time = machine_of(machine), np.asarray(time, dtype=float)
    command = np.asarray(command, dtype=float)
    if command.shape != time.shape or time.ndim != 1 or np.any(np.diff(time) <= 0):
        raise ValueError("rig: command and time must be of one length, and time must rise.")
    effects = named_effects(machine, effects)
    values, fields = _fields(m, parameters or {}, effects)
    signal = changed_command(Signal.held(time, command), effects)
    corners = [time, signal.times, *sensors.extra_times(effects, time), *_instants(fields)]
    times = _breakpoints(np.concatenate(corners), time[0], time[-1])
    u, slopes = signal.on(times)
    state = m.start_state(values, fields, m.start_value if start is None else start, u[0])
    outputs = native.run(machine, times, u, slopes, fields, state, len(m.outputs), step)
    columns = {"time": time.copy(), m.input: command.copy()}
    for i, name in enumerate(m.outputs):
        columns[name] = sensors.measured(name, times, outputs[:, i], time, effects)
    return _with_noise(columns, m, noise or {}, {**_steps(effects), **(quantisation or {})}, seed)


def _fields(m, parameters, effects):
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


def drive(
    machine: str,
    duration: float = 40.0,
    rate: float = 100.0,
    *,
    seed: int = 0,
    parameters: Mapping[str, float] | None = None,
    effects=None,
    start: float | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Time and smooth drive command that keeps this very machine within its span, found by simulating it.

    A path with pauses is fed forward as speed; a slow correction from the simulated error is added until the path is
    kept, then the command is rounded and is open loop like any other recording.
    """
    m = machine_of(machine)
    time = np.arange(round(duration * rate) + 1) / rate
    path, gate, quick = commands.path(time, m.span, 0.8 * m.fastest, m.path_band, seed)
    path += (_first_position(m, parameters, start) - path[0]) * np.exp(-time / 5.0)
    command = _for_speed(m, np.gradient(path, time)) + 0.08 * m.command_limit * gate * quick
    truth = dict(parameters=parameters, effects=_without_sensors(machine, effects), start=start, step=2e-4)
    allowed = 0.1 * (m.span[1] - m.span[0])
    for _ in range(12):
        command = np.round(np.clip(command, -m.command_limit, m.command_limit), 4)
        error = path - record(machine, command, time, **truth)[m.position]
        if np.max(np.abs(error)) < allowed:
            return time, command
        slow = commands.smoothed(error, rate * 0.5)
        command = command + gate * _for_speed(m, 0.8 * np.gradient(slow, time) + 0.2 * slow)
    raise RuntimeError(f"rig: no command found that keeps {machine} inside {m.span} with these effects.")


def _for_speed(m, speed):
    """Command for a speed, from the gains out and in of the machine with its default values."""
    return speed / np.where(speed > 0, *m.speed_per_command)


def _without_sensors(machine, effects):
    return [(n, o) for n, o in named_effects(machine, effects) if not n.startswith(("sensor", "quantisation"))]


def _first_position(m, parameters, start):
    still = record(m.name, np.zeros(2), np.array([0.0, 1e-3]), parameters=parameters, start=start)
    return still[m.position][0]


def clean_recordings(
    machine: str,
    kind: str = "train",
    count: int | None = None,
    *,
    seed: int = 0,
    duration: float = 40.0,
    rate: float = 100.0,
    noise: Mapping[str, float] | None = None,
    quantisation: Mapping[str, float] | None = None,
    parameters: Mapping[str, float] | None = None,
    effects=None,
) -> list[dict[str, np.ndarray]]:
    """Independent recordings under smooth drive commands; without ``effects`` nothing is hidden.

    ``kind`` is "train" (3 by default) or "validate" (2); the two never share a command. ``noise=None`` is the usual
    sensor noise, ``noise={}`` none.
    """
    first, usual = {"train": (0, 3), "validate": (500, 2)}[kind]
    answer = []
    for i in range(usual if count is None else count):
        own = 1000 * seed + first + i
        begin = machine_of(machine).start_value
        time, command = drive(machine, duration, rate, seed=own, parameters=parameters, effects=effects, start=begin)
        answer.append(
            record(
                machine,
                command,
                time,
                parameters=parameters,
                effects=effects,
                noise=sensor_noise(machine) if noise is None else noise,
                quantisation=quantisation,
                seed=own,
                start=begin,
            )
        )
    return answer
