"""A mass that a drive pulls by a spring: it swings a little and travels far. The model, and the matrix exponential."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.linalg import expm

from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der
from hydrotwin.records import Record

PERIOD, NOISE = 0.01, 2e-5  # s, m
MASS = 50.0  # kg
TRUE = {"gain": 0.12, "lag": 0.02, "stiffness": 6.6e6, "damping": 250.0}
FREE = tuple(TRUE)


class Pulled(Component):
    """The drive, the spring and the mass, whose position is measured; 45 Hz for 58."""

    command = Input("1", "command", nominal=1.0)
    position = Output("m", "measured position", nominal=0.1)
    gain = Parameter(0.1, "m/s", "speed of the drive at full command", bounds=(1e-3, 10.0))
    lag = Parameter(0.03, "s", "lag of the drive", bounds=(1e-3, 1.0))
    mass = Parameter(MASS, "kg", "mass", bounds=(1.0, 1e4))
    stiffness = Parameter(4e6, "N/m", "stiffness", bounds=(1e3, 1e9))
    damping = Parameter(250.0, "N.s/m", "damping", bounds=(1.0, 1e6))
    w = State(0.0, "m/s", "speed of the drive", nominal=0.1)
    d = State(0.0, "m", "where the drive is", nominal=0.1)
    x = State(0.0, "m", "where the mass is", nominal=0.1)
    v = State(0.0, "m/s", "speed of the mass", nominal=0.1)

    def equations(self):
        yield self.lag * der(self.w) == self.gain * self.command - self.w
        yield der(self.d) == self.w
        yield der(self.x) == self.v
        yield self.mass * der(self.v) == self.stiffness * (self.d - self.x) + self.damping * (self.w - self.v)
        yield self.position == self.x


def pulled() -> Model:
    """The model."""
    return Model(Pulled())


def pulling(seed: int, true: Mapping[str, float] = TRUE, seconds: float = 10.0) -> Record:
    """A recording of steps of the command held between samples."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, PERIOD)
    command = random.uniform(-1, 1, int(seconds / 0.7) + 1)[(time / 0.7).astype(int)]
    gain, lag, k, d = (true[n] for n in ("gain", "lag", "stiffness", "damping"))
    A = np.zeros((5, 5))  # w, d, x, v and the command
    A[0, 0], A[0, 4] = -1 / lag, gain / lag
    A[1, 0] = A[2, 3] = 1.0
    A[3] = np.array([d, k, -k, -d, 0.0]) / MASS
    step, x = expm(A * PERIOD), np.zeros(5)
    position = np.zeros(len(time))
    for i in range(len(time) - 1):
        x[4] = command[i]
        x = step @ x
        position[i + 1] = x[2]
    position += NOISE * random.standard_normal(len(time))
    return Record(time, {"command": command, "position": position}, {"command": "1", "position": "m"}, f"pull_{seed}")
