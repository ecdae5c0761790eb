"""The machine under a sampled controller: command and outputs decide each other sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from . import commands, native
from .command_path import Signal
from .effects import command_stages, named_effects
from .machines import machine_of
from .recording import STEP, record, truth_of

BANDWIDTH = 4.0  # of the position loop of `tracking` [rad/s]


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
    hold_after_loss: bool = False,
) -> dict[str, np.ndarray]:
    """Simulate the truth while ``controller(k, outputs)`` sets the command at every sample; it is held to the next.

    The controller sees the true outputs; what sensors and their noise do is on what is written down. Arguments as
    `record`, which plays the command found here. Lost packets have no place in a loop: ValueError.
    """
    truth = dict(parameters=parameters, effects=effects, start=start, step=step, hold_after_loss=hold_after_loss)
    command = _commanded(machine, controller, np.asarray(time, dtype=float), truth)
    return record(machine, command, time, noise=noise, quantisation=quantisation, seed=seed, **truth)


def tracking(machine: str, time, seed: int = 0, start: float | None = None):
    """A controller for `record_closed_loop`: it moves a machine along strokes with dwells, in proportion to its error.

    It knows the machine with its default values only, and puts out four digits within the limit of the command.
    """
    m, time = machine_of(machine), np.asarray(time, dtype=float)
    if m.positioned:
        raise ValueError(f"rig: {machine} has a position controller of its own.")
    first = record(machine, np.zeros(2), np.array([0.0, 1e-3]), start=start)[m.position][0]
    room = (m.span[0] - first, m.span[1] - first)
    speed = commands.strokes(time, 0.8, seed, speed=(m.fastest,) * 2, room=room) * m.fastest
    path = first + np.concatenate([[0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * np.diff(time))])

    def controller(k: int, outputs: Mapping[str, float]) -> float:
        wanted = BANDWIDTH * (path[k] - outputs[m.position])
        command = wanted / m.speed_per_command[0 if wanted > 0 else 1]
        return round(float(np.clip(command, -m.command_limit, m.command_limit)), 4)

    return controller


def _commanded(machine, controller, time, truth) -> np.ndarray:
    """What the controller puts out, (n,); after a loss of the machine its last command."""
    m, loop = machine_of(machine), _Loop(machine, truth)
    command = np.zeros(len(time))
    outputs = loop.begin(time[0])
    for k, t in enumerate(time):
        command[k] = controller(k, dict(zip(m.outputs, outputs, strict=True)))
        if k + 1 < len(time):
            loop.command.push(t, command[k])
            try:
                outputs = loop.run(t, time[k + 1])
            except RuntimeError:
                if not truth["hold_after_loss"]:
                    raise
                command[k:] = command[k]
                break
    return command


class _Loop:
    """A machine that is run from sample to sample."""

    def __init__(self, machine, truth):
        effects = named_effects(machine, truth["effects"])
        self.machine, self.step = machine_of(machine), truth["step"]
        values, self.fields = truth_of(self.machine, truth["parameters"] or {}, effects)
        self.command = _Live(command_stages(machine, effects))
        self.state = np.zeros(native.STATES)
        start = self.machine.start_value if truth["start"] is None else truth["start"]
        first = self.machine.start_state(values, self.fields, start, 0.0)
        self.state[: len(first)] = first

    def begin(self, t):
        return self._run(np.array([t]), np.zeros(1), np.zeros(1))

    def run(self, begin, end):
        times = np.array([begin, *self.command.corners(begin, end), end])
        return self._run(times, *self.command.on(times))

    def _run(self, times, u, slopes):
        m = self.machine
        return native.run(m.name, times, u, slopes, self.fields, self.state, len(m.outputs), self.step)[-1]


class _Live:
    """A command on its way to the machine, sample by sample: `changed_command` with what its stages remember."""

    def __init__(self, stages):
        if any(stage.func.__name__ == "packet_loss" for stage in stages):
            raise ValueError("rig: packets are lost of a whole command, not in a loop.")
        self.stages, self.last = stages, [None] * len(stages)
        self.signal = Signal.held([], [])

    def push(self, t, u):
        """One more sample. Every stage is given its own last output, and at the same instant what comes in now."""
        new = Signal.held([t], [u])
        for i, stage in enumerate(self.stages):
            last = self._now(new.times[0]) if stage.func.__name__ == "rate_limit" else self.last[i]
            before = [] if last is None else [last]
            new = stage(Signal.held([new.times[-1]] * (len(before) + 1), [*before, new.values[-1]]))
            self.last[i] = new.values[-1] if len(new.values) else last
        self._replace(new, t)

    def _now(self, t):
        return float(self.on(np.array([t]))[0][0]) if len(self.signal.times) else None

    def _replace(self, new, t):
        """The new pieces in place of the old ones from their beginning on; what is long past is forgotten."""
        old = self.signal
        if not len(new.times):
            return
        kept = old.times < new.times[0] - 5e-11
        kept[: max(np.searchsorted(old.times, t, side="right") - 1, 0)] = False
        parts = zip((old.times, old.values, old.slopes), (new.times, new.values, new.slopes), strict=True)
        self.signal = Signal(*(np.concatenate([a[kept], b]) for a, b in parts))

    def corners(self, begin, end):
        return [t for t in self.signal.times if begin + 1e-10 < t < end - 1e-10]

    def on(self, times):
        return self.signal.on(times)
