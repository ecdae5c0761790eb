"""The gap an effect makes, and the size of the effect that makes a given gap.

    gap     = rms over fit recordings, samples, recorded outputs of (y_with - y_without) / noise
    visible = the same after the part that wrong free parameters and start states can absorb, to first order, is taken
              off: a lower bound of what a refitted base model leaves, which cannot follow so far where it is nonlinear

Both with the true base parameters, the same command, and no noise.
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
NEAR = 0.02  # relative error of the severity that is near enough
LEAST = 1e-6  # the smallest level looked at


class Unreachable(Exception):
    """The effect does not make this gap inside its plausible limits; the message says how far it came."""


@dataclass(frozen=True)
class Bed:
    """A machine, its true base parameters and its commands: what cases of one seed share.

    commands: (time, command) of the fit recordings, then of those held out.
    """

    machine: str
    seed: int
    excitation: str
    truth: Mapping[str, float]
    settings: Mapping[str, float]
    commands: tuple[tuple[np.ndarray, np.ndarray], ...]

    def run(self, effects, index: int, *, step: float, changes=None, start=None) -> dict[str, np.ndarray]:
        """The truth without noise under one command, with the pairs of ``effects``."""
        time, command = self.commands[index]
        parameters = {**self.settings, **self.truth, **(changes or {})}
        return rig.record(
            self.machine, command, time, parameters=parameters, effects=list(effects), step=step, start=start,
            hold_after_loss=True,
        )  # fmt: skip


@functools.lru_cache(maxsize=8)
def bed(machine: str, seed: int, excitation: str, off: float, free: tuple, settings: tuple, seconds: float) -> Bed:
    """Draw the truth and commands that keep it inside its span."""
    random = np.random.default_rng([seed, len(machine)])
    usual = rig.MACHINES[machine].parameters
    truth = {name: usual[name] * (1 + off * random.uniform(-1, 1)) for name in free}
    parameters = {**dict(settings), **truth}
    commands = []
    for count, own in ((FIT, 1000 * seed), (HELD_OUT, 1000 * seed + 500)):
        commands += _commands(machine, excitation, own, count, parameters, seconds)
    return Bed(machine, seed, excitation, truth, dict(settings), tuple(commands))


def _commands(machine, excitation, own, count, parameters, seconds):
    found = []
    while len(found) < count:
        with contextlib.suppress(RuntimeError):  # a draw that leaves the span of the machine
            found.append(rig.drive(machine, seconds, 100.0, kind=excitation, seed=own, parameters=parameters))
        own += 1
    return found


@functools.lru_cache(maxsize=64)
def _plain_run(bed_key: tuple, index: int, step: float):
    return bed(*bed_key).run((), index, step=step)


class Meter:
    """Measures gaps of one bed at its recorded outputs."""

    def __init__(self, key: tuple, outputs: tuple[str, ...]):
        self.key, self.bed, self.outputs = key, bed(*key), outputs
        noise = rig.sensor_noise(self.bed.machine)
        self.noise = {name: noise[name] for name in outputs}

    def differences(self, effects, *, step: float) -> np.ndarray:
        """(with - without)/noise of every fit recording, sample and output, flat."""
        parts = []
        for i in range(FIT):
            plain, run = _plain_run(self.key, i, step), self.bed.run(effects, i, step=step)
            parts += [(run[n] - plain[n]) / s for n, s in self.noise.items()]
        return np.concatenate(parts)

    def gap(self, effects, *, step: float = COARSE) -> float:
        return float(np.sqrt(np.mean(self.differences(effects, step=step) ** 2)))

    def visible(self, effects, *, step: float = COARSE) -> float:
        d, Q = self.differences(effects, step=step), _absorbed(self.key, self.outputs)
        return float(np.sqrt(np.mean((d - Q @ (Q.T @ d)) ** 2)))

    def facts(self, sign: float, output: str) -> Facts:
        """What the machine does without any effect."""
        m = rig.MACHINES[self.bed.machine]
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
def _absorbed(key: tuple, outputs: tuple[str, ...]) -> np.ndarray:
    """Orthonormal basis of what free parameters and start states of the base model can do, (samples, directions)."""
    here, noise = bed(*key), rig.sensor_noise(key[0])
    m = rig.MACHINES[here.machine]
    start_pressure = "precharge" if here.machine == "cehA" else "start_pressure_b"
    usual = {**m.parameters, **here.settings, **here.truth}

    def column(index, changes, start=None):
        plain, run = _plain_run(key, index, COARSE), here.run((), index, step=COARSE, changes=changes, start=start)
        return np.concatenate([(run[n] - plain[n]) / noise[n] for n in outputs])

    columns = [[column(i, {name: value * 1.001}) for i in range(FIT)] for name, value in here.truth.items()]
    moved = m.start_value + noise[m.start_output]
    for i in range(FIT):
        for own in (column(i, {}, moved), column(i, {start_pressure: usual[start_pressure] * 1.01})):
            columns.append([own if k == i else np.zeros_like(own) for k in range(FIT)])
    S = np.array([np.concatenate(parts) for parts in columns]).T
    lengths = np.linalg.norm(S, axis=0)
    U, s, _ = np.linalg.svd(S[:, lengths > 0] / lengths[lengths > 0], full_matrices=False)
    return U[:, s > 1e-6 * s[0]]


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
