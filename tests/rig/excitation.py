"""Commands that keep a given machine inside its span, and whole sets of recordings made with them."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from . import commands
from .effects import named_effects
from .machines import machine_of, sensor_noise
from .recording import record

COARSE = 2e-4  # step while searching a command [s]
KINDS = ("drive", "steps", "ramps", "sweep", "strokes", "sines", "chirp")


def drive(
    machine: str,
    duration: float = 40.0,
    rate: float = 100.0,
    *,
    kind: str = "drive",
    seed: int = 0,
    jitter: float = 0.0,
    parameters: Mapping[str, float] | None = None,
    effects=None,
    start: float | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Time and a command that keeps this very machine within its span when replayed open loop.

    ``kind`` "drive" is the smooth command of a real drive, with pauses; "steps" and "ramps" have hard corners; "sweep"
    is a sine sweep, "chirp" one with a linear frequency; "strokes" have dwells between them; "sines" are several, one
    after the other. ``jitter`` spreads the sample times by that share of a period. A machine whose input is a wanted
    position gets the path that the same command would move it along.
    """
    if kind not in KINDS:
        raise ValueError(f"rig: no command kind {kind!r} (there are {', '.join(KINDS)}).")
    m = machine_of(machine)
    time = commands.jittered_time(duration, rate, jitter, seed) if jitter else _ticks(duration, rate)
    bare = [(n, o) for n, o in named_effects(machine, effects) if not n.startswith(("sensor", "quantisation"))]
    truth = dict(parameters=parameters, effects=bare, start=start, step=COARSE, hold_after_loss=True)
    if kind == "drive":
        return time, _smooth(m, time, rate, seed, truth)
    return time, _hard(m, time, kind, seed, truth)


def _given(m, command, time, truth):
    """What the machine gets for a command that makes a speed: itself, or the path that it moves along."""
    if not m.positioned:
        return command
    speed = command * np.where(command > 0, *m.speed_per_command)
    path = np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))])
    return np.round(_first_position(m, truth) + path, 6)


def _ticks(duration, rate):
    return np.arange(round(duration * rate) + 1) / rate


def _smooth(m, time, rate, seed, truth):
    """Feed a path forward as speed, then add a slow correction from the simulated error until the path is kept."""
    first = _first_position(m, truth)
    path, gate, quick = commands.path(time, first, m.span, 0.8 * m.fastest, m.path_band, seed)
    command = _for_speed(m, np.gradient(path, time)) + 0.08 * m.command_limit * gate * quick
    allowed = 0.1 * (m.span[1] - m.span[0])
    for _ in range(12):
        command = np.round(np.clip(command, -m.command_limit, m.command_limit), 4)
        given = _given(m, command, time, truth)
        error = path - record(m.name, given, time, **truth)[m.position]
        if np.max(np.abs(error)) < allowed:
            return given
        slow = commands.smoothed(error, rate * 0.5)
        command = command + gate * _for_speed(m, 0.8 * np.gradient(slow, time) + 0.2 * slow)
    raise RuntimeError(f"rig: no drive command keeps {m.name} inside {m.span} with these effects.")


def _hard(m, time, kind, seed, truth):
    """Any other kind, made smaller until the machine stays inside its span."""
    first, amplitude = _first_position(m, truth), 0.8 * m.command_limit
    margin = 0.15 * (m.span[1] - m.span[0])
    for _ in range(12):
        if kind == "sweep":
            command = commands.sweep(time, 0.5 * amplitude)
        else:
            room = (m.span[0] - first, m.span[1] - first)
            command = getattr(commands, kind)(time, amplitude, seed, speed=m.speed_per_command, room=room)
        given = _given(m, np.round(command, 4), time, truth)
        position = record(m.name, given, time, **truth)[m.position]
        if m.span[0] - margin < position.min() and position.max() < m.span[1] + margin:
            return given
        amplitude *= 0.8
    raise RuntimeError(f"rig: no {kind} command keeps {m.name} inside {m.span} with these effects.")


def _for_speed(m, speed):
    """Command for a speed, from the gains out and in of the machine with its default values."""
    return speed / np.where(speed > 0, *m.speed_per_command)


def _first_position(m, truth):
    still = {**truth, "effects": None}
    start = m.start_value if truth["start"] is None else truth["start"]
    held = np.full(2, start if m.positioned else 0.0)
    return record(m.name, held, np.array([0.0, 1e-3]), **still)[m.position][0]


def clean_recordings(
    machine: str,
    kind: str = "train",
    count: int | None = None,
    *,
    seed: int = 0,
    duration: float = 40.0,
    rate: float = 100.0,
    command: str = "drive",
    jitter: float = 0.0,
    noise: Mapping[str, float] | None = None,
    quantisation: Mapping[str, float] | None = None,
    parameters: Mapping[str, float] | None = None,
    effects=None,
) -> list[dict[str, np.ndarray]]:
    """Independent recordings under smooth drive commands; without ``effects`` nothing is hidden.

    ``kind`` is "train" (3 by default) or "validate" (2); the two never share a command. ``noise=None`` is the usual
    sensor noise, ``noise={}`` none. ``command``: a kind of ``drive``.
    """
    first, usual = {"train": (0, 3), "validate": (500, 2)}[kind]
    truth = dict(parameters=parameters, effects=effects)
    noise = sensor_noise(machine) if noise is None else noise
    answer = []
    for own in range(1000 * seed + first, 1000 * seed + first + (usual if count is None else count)):
        time, u = drive(machine, duration, rate, kind=command, seed=own, jitter=jitter, **truth)
        answer.append(record(machine, u, time, noise=noise, quantisation=quantisation, seed=own, **truth))
    return answer
