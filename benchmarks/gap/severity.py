"""The gap an effect makes, and the size of the effect that makes a given gap.

    gap     = rms over fit recordings, samples, recorded outputs of (y_with - y_without) / noise
    visible = the same after the part that wrong free parameters and start states can absorb, to first order, is taken
              off: a lower bound of what a refitted base model leaves, which cannot follow so far where it is nonlinear

Both with the true base parameters, the same command, and no noise. In a closed loop the command is what the controller
made of the machine with the effect; what can be absorbed is then taken along its commands without the effect.
"""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from tests import rig

from .amplitudes import AMPLITUDES, STIFF, Facts

COARSE, FINE = 2e-4, 5e-5  # integration steps [s]: for the search, and where the effect is stiff
FIT, HELD_OUT = 3, 2
RATE = 100.0  # samples per second
DRAWS = 500  # of a command that keeps the machine in its span; held-out recordings begin so many seeds later
CLOSED_LOOP = "closed_loop"  # the excitation whose command a controller puts out
NEAR = 0.02  # relative error of the severity that is near enough
LEAST = 1e-6  # the smallest level looked at


class Unreachable(Exception):
    """The effect does not make this gap inside its plausible limits; the message says how far it came."""


@dataclass(frozen=True)
class Bed:
    """A machine, its true base parameters and its commands: what cases of one seed share.

    commands: (time, command) of the fit recordings, then of those held out. loops: of a closed loop the seeds of its
    controllers; commands are then what these put out where nothing is hidden.
    """

    machine: str
    seed: int
    excitation: str
    truth: Mapping[str, float]
    settings: Mapping[str, float]
    commands: tuple[tuple[np.ndarray, np.ndarray], ...]
    loops: tuple[int, ...] = ()

    def run(self, effects, index: int, *, step: float, changes=None, start=None, command=None) -> dict[str, np.ndarray]:
        """The truth without noise under one command, its own if none is given, with the pairs of ``effects``."""
        time, own = self.commands[index]
        parameters = {**self.settings, **self.truth, **(changes or {})}
        return rig.record(
            self.machine, own if command is None else command, time, parameters=parameters, effects=list(effects),
            step=step, start=start, hold_after_loss=True,
        )  # fmt: skip

    def recorded(self, effects, index: int, **options) -> dict[str, np.ndarray]:
        """The truth as it is recorded, under its controller if it has one. options: of `rig.record`."""
        time, command = self.commands[index]
        options |= {"parameters": {**self.settings, **self.truth}, "effects": list(effects)}
        if not self.loops:
            return rig.record(self.machine, command, time, **options)
        controller = rig.tracking(self.machine, time, self.loops[index])
        return rig.record_closed_loop(self.machine, controller, time, **options)


@functools.lru_cache(maxsize=8)
def bed(machine: str, seed: int, excitation: str, free: tuple, settings: tuple, seconds: float) -> Bed:
    """Draw the truth and commands that keep it inside its span. free: (parameter, the largest share it is off)."""
    random = np.random.default_rng([seed, len(machine)])
    usual = rig.machine_of(machine).parameters
    truth = {name: usual[name] * (1 + off * random.uniform(-1, 1)) for name, off in free}
    parameters, found = {**dict(settings), **truth}, []
    for count, own in ((FIT, 1000 * seed), (HELD_OUT, 1000 * seed + DRAWS)):
        found += _commands(machine, excitation, own, count, parameters, seconds)
    loops = tuple(own for own, _ in found) if excitation == CLOSED_LOOP else ()
    return Bed(machine, seed, excitation, truth, dict(settings), tuple(drawn for _, drawn in found), loops)


def _commands(machine, excitation, own, count, parameters, seconds):
    """So many (seed, (time, command)), from a seed on."""
    found, draws = [], range(own, own + DRAWS)
    for own in draws:
        with contextlib.suppress(RuntimeError):  # a draw that leaves the span of the machine
            found.append((own, _command(machine, excitation, own, parameters, seconds)))
        if len(found) == count:
            return found
    raise Unreachable(f"{len(draws)} draws of {excitation} give no {count} commands that keep {machine} in its span.")


def _command(machine, excitation, own, parameters, seconds):
    if excitation != CLOSED_LOOP:
        return rig.drive(machine, seconds, RATE, kind=excitation, seed=own, parameters=parameters)
    time = np.arange(round(seconds * RATE) + 1) / RATE
    controller = rig.tracking(machine, time, own)
    columns = rig.record_closed_loop(machine, controller, time, parameters=parameters, step=COARSE)
    return time, columns[rig.machine_of(machine).input]


@functools.lru_cache(maxsize=64)
def _plain_run(bed_key: tuple, index: int, step: float):
    return bed(*bed_key).run((), index, step=step)


class Meter:
    """Measures gaps of one bed at its recorded outputs."""

    def __init__(self, key: tuple, outputs: tuple[str, ...], bits: int = 0):
        self.key, self.bed, self.outputs = key, bed(*key), outputs
        noise, step = rig.sensor_noise(self.bed.machine), steps_of(self.bed.machine, bits)
        self.noise = {name: float(np.hypot(noise[name], step.get(name, 0.0) / np.sqrt(12))) for name in outputs}

    def differences(self, effects, *, step: float) -> np.ndarray:
        """(with - without)/noise of every fit recording, sample and output, flat."""
        parts = []
        for i in range(FIT):
            plain, run = self._pair(effects, i, step)
            parts += [(run[n] - plain[n]) / s for n, s in self.noise.items()]
        return np.concatenate(parts)

    def _pair(self, effects, index, step):
        """The machine without effects and with them, under the same command."""
        if not self.bed.loops:
            return _plain_run(self.key, index, step), self.bed.run(effects, index, step=step)
        run = self.bed.recorded(effects, index, step=step, hold_after_loss=True)
        command = run[rig.machine_of(self.bed.machine).input]
        return self.bed.run((), index, step=step, command=command), run

    def gap(self, effects, *, step: float = COARSE) -> float:
        return float(np.sqrt(np.mean(self.differences(effects, step=step) ** 2)))

    def visible(self, effects, *, step: float = COARSE) -> float:
        d, Q = self.differences(effects, step=step), _absorbed(self.key, tuple(self.noise.items()))
        return float(np.sqrt(np.mean((d - Q @ (Q.T @ d)) ** 2)))

    def facts(self, sign: float, output: str) -> Facts:
        """What the machine does without any effect."""
        m = rig.machine_of(self.bed.machine)
        runs = [_plain_run(self.key, i, COARSE) for i in range(FIT)]
        pressures = np.concatenate([run[n] for run in runs for n in m.outputs if n.startswith("pressure")])
        commands = [run[m.input] for run in runs]
        slew = max(np.max(np.abs(np.diff(u)) / np.diff(r["time"])) for u, r in zip(commands, runs, strict=True))
        positions = [run[m.position] for run in runs]
        travel, first = np.concatenate(positions), [x[0] for x in positions]
        return Facts(
            machine=m.name,
            command=float(max(np.max(np.abs(u)) for u in commands)),
            slew=float(slew),
            pressure=tuple(float(q) for q in np.quantile(pressures, [0, 0.5, 1])),
            travel=(float(travel.min()), float(travel.max())),
            rest=(float(min(first)), float(max(first))),
            output=output,
            spread=float(max(np.ptp(run[output]) for run in runs)),
            sign=sign,
            seed=self.bed.seed,
            seconds=float(self.bed.commands[0][0][-1]),
        )


@functools.lru_cache(maxsize=8)
def _absorbed(key: tuple, noise: tuple[tuple[str, float], ...]) -> np.ndarray:
    """Orthonormal basis of what free parameters and start states of the base model can do, (samples, directions).

    noise: (output, sigma) of what is recorded.
    """
    here, m = bed(*key), rig.machine_of(key[0])
    usual = {**m.parameters, **here.settings, **here.truth}

    def column(index, changes, start=None):
        plain, run = _plain_run(key, index, COARSE), here.run((), index, step=COARSE, changes=changes, start=start)
        return np.concatenate([(run[n] - plain[n]) / sigma for n, sigma in noise])

    columns = [[column(i, {name: value * 1.001}) for i in range(FIT)] for name, value in here.truth.items()]
    moved = m.start_value + rig.sensor_noise(m.name)[m.start_output]
    for i in range(FIT):
        for own in (column(i, {}, moved), column(i, {m.start_pressure: usual[m.start_pressure] * 1.01})):
            columns.append([own if k == i else np.zeros_like(own) for k in range(FIT)])
    S = np.array([np.concatenate(parts) for parts in columns]).T
    lengths = np.linalg.norm(S, axis=0)
    U, s, _ = np.linalg.svd(S[:, lengths > 0] / lengths[lengths > 0], full_matrices=False)
    return U[:, s > 1e-6 * s[0]]


def steps_of(machine: str, bits: int) -> dict[str, float]:
    """Steps of converters of so many bits, by output, SI; none for 0."""
    m = rig.machine_of(machine)
    return {name: scale / 2**bits for name, scale in zip(m.outputs, m.full_scale, strict=True)} if bits else {}


def options_at(name: str, level: float, facts: Facts) -> dict:
    return AMPLITUDES[name](level, facts)


def scaled(meter: Meter, name: str, severity: float, facts: Facts) -> tuple[dict, float, float]:
    """The options of an effect that make the gap ``severity``, the level they are at, and the gap they make.

    Raises: Unreachable, when the largest plausible effect makes less, or the smallest looked at makes more.
    """
    step = FINE if name in STIFF else COARSE

    def gap_at(level):
        return meter.gap([(name, options_at(name, level, facts))], step=step)

    low, high = _bracket(gap_at, name, severity)
    for _ in range(24):
        if abs(high[1] / severity - 1) < NEAR:
            break
        level = _between(low, high, severity)
        found = (level, gap_at(level))
        low, high = (found, high) if found[1] < severity * (1 - 0.5 * NEAR) else (low, found)
        if high[0] / low[0] - 1 < 1e-7:
            break
    if abs(high[1] / severity - 1) > 0.25:
        raise Unreachable(f"{name} jumps from {low[1]:.3g} to {high[1]:.3g} times the noise.")
    return options_at(name, high[0], facts), *high


def _bracket(gap_at, name, severity):
    """Levels whose gaps lie below and above; from 1 down, so that a machine driven out of its span is met last."""
    level = 0.05
    high = (level, gap_at(level))
    while high[1] < severity * (1 - 0.5 * NEAR):
        if level >= 1:
            raise Unreachable(f"{name} at its largest plausible size makes a gap of {high[1]:.3g} times the noise.")
        low, level = high, min(1.0, level * _stride(high[1], severity))
        high = (level, gap_at(level))
        if high[1] >= severity * (1 - 0.5 * NEAR):
            return low, high
    while True:
        level = high[0] / min(1e3, 1.5 * max(high[1] / severity, 1.5))
        if level < LEAST:
            raise Unreachable(f"{name} makes {high[1]:.3g} times the noise at its smallest.")
        low = (level, gap_at(level))
        if low[1] < severity * (1 - 0.5 * NEAR):
            return low, high
        high = low


def _stride(gap, severity):
    return float(np.clip(1.3 * severity / max(gap, 1e-12), 1.5, 20.0))


def _between(low, high, severity):
    """False position in logarithms, kept off the ends: gaps grow like a power of the level."""
    a, b = np.log(low[0]), np.log(high[0])
    if low[1] <= 1e-9:
        return float(np.exp(0.5 * (a + b)))
    share = np.log(severity / low[1]) / np.log(high[1] / low[1])
    return float(np.exp(a + np.clip(share, 0.08, 0.95) * (b - a)))
