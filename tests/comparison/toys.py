"""A toy machine and toy models of it: a motor with lag that turns an arm, and what each model gets wrong."""

from __future__ import annotations

import numpy as np
from scipy.signal import lfilter

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

COMMAND = Signal("command", "V", nominal=5.0)
ANGLE = Signal("arm_angle", "rad", "angle of the arm above horizontal")
SPEED = Signal("motor_speed", "rad/s", nominal=300.0)
PRESSURE = Signal("pressure_cap", "Pa", nominal=1e6)
OUTPUTS = (ANGLE, SPEED, PRESSURE)
UNITS = {s.name: s.unit for s in (COMMAND, *OUTPUTS)}


def machine(time, command, *, gain=120.0, lag=0.03, stiffness=4.0e6, angle=0.4):
    """Outputs of the toy on a uniform time axis: lagged speed, its integral as angle, a pressure that follows both."""
    h = time[1] - time[0]
    a = np.exp(-h / lag)
    speed = lfilter([0.0, gain * (1 - a)], [1.0, -a], command)
    arm = angle + 2.0e-4 * h * np.concatenate([[0.0], np.cumsum(speed[:-1])])
    pressure = 2.0e6 + stiffness * np.cos(arm) * 0.4 + 900.0 * speed
    return {"arm_angle": arm, "motor_speed": speed, "pressure_cap": pressure}


def recording(seed=0, *, duration=8.0, period=0.01, noise=1.0, name=None) -> Record:
    """A recording of the toy with smooth random commands and sensor noise."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, duration, period)
    phases = random.uniform(0, 2 * np.pi, 6)
    waves = random.uniform(0.05, 0.8, 6)
    command = 1.4 * sum(np.sin(2 * np.pi * f * time + p) for f, p in zip(waves, phases, strict=True))
    signals = machine(time, command)
    sigma = {"arm_angle": 2e-4, "motor_speed": 2.0, "pressure_cap": 8e3}
    noisy = {n: v + noise * sigma[n] * random.standard_normal(len(time)) for n, v in signals.items()}
    return Record(time, {"command": command, **noisy}, UNITS, name or f"validation_{seed}", digest=f"{seed:064x}")


class Toy:
    """A model of the toy machine with its own constants; ``drift`` [rad/s] and ``bend`` spoil it."""

    inputs = (COMMAND,)

    def __init__(
        self, name, kind="physical", *, drift=0.0, bend=0.0, outputs=OUTPUTS, fails_on="", domain=None, **constants
    ):
        self.name, self.kind, self.outputs, self.constants = name, kind, outputs, constants
        self.drift, self.bend, self.fails_on = drift, bend, fails_on
        self.provenance = {"made by": "tests"}
        if domain is not None:
            self.domain = domain

    def free_run(self, record):
        if record.name == self.fails_on:
            raise SolveError(f"{self.name}: the run left the finite numbers (got nan at 1.2 s). Try a smaller step.")
        signals = machine(record.time, record["command"], angle=record["arm_angle"][0], **self.constants)
        signals["arm_angle"] = signals["arm_angle"] + self.drift * record.time + self.bend * np.sin(record.time)
        return self._record(record, signals)

    def one_step(self, record):
        free = self.free_run(record)
        measured = {s.name: record[s.name] for s in self.outputs if s.name in record.signals}
        steps = {n: np.r_[v[0], v[:-1] + np.diff(free[n])] for n, v in measured.items()}
        return self._record(record, {**free.signals, **steps})

    def _record(self, record, signals):
        kept = {s.name: signals[s.name] for s in self.outputs}
        return Record(record.time, kept, {n: UNITS[n] for n in kept}, self.name)
