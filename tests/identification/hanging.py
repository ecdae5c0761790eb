"""A mass on a spring that is pushed: the model, and how it swings by the matrix exponential."""

from __future__ import annotations

import numpy as np
from scipy.linalg import expm

from hydrotwin.models.components.mechanical import ForceSource
from hydrotwin.models.language import Component, Flange, Input, Model, Output, Parameter, State, connect, der
from hydrotwin.records import Record

PERIOD, NOISE = 0.01, 2e-6  # s, m
MASS, DAMPING = 50.0, 250.0  # kg, N.s/m
FREE = ("body.mass", "body.stiffness", "body.damping")


class Body(Component):
    """A mass on a spring."""

    flange = Flange("where it is pushed")
    mass = Parameter(MASS, "kg", "mass", bounds=(1.0, 1e4))
    stiffness = Parameter(2e6, "N/m", "stiffness", bounds=(1e3, 1e9))
    damping = Parameter(DAMPING, "N.s/m", "damping", bounds=(1.0, 1e6))
    position = State(0.0, "m", "position", nominal=1e-3)
    speed = State(0.0, "m/s", "speed", nominal=0.1)

    def equations(self):
        yield self.flange.s == self.position
        yield der(self.position) == self.speed
        pushed = self.flange.f - self.damping * self.speed - self.stiffness * self.position
        yield self.mass * der(self.speed) == pushed


class Hanging(Component):
    """The body, its position measured."""

    force = Input("N", "force", nominal=300.0)
    position = Output("m", "measured position", nominal=1e-3)
    body = Body()
    source = ForceSource()

    def equations(self):
        yield connect(self.force, self.source.force)
        yield connect(self.source.flange, self.body.flange)
        yield self.position == self.body.position


def hanging(stiffness: float = 2e6, damping: float = DAMPING) -> Model:
    """The model, 32 Hz unless told."""
    changes = {"body.stiffness": {"value": stiffness}, "body.damping": {"value": damping}}
    return Model(Hanging()).with_settings(changes, {})


def swinging(seed: int, stiffness: float = 4e6, seconds: float = 8.0) -> Record:
    """A recording of steps of the force held between samples; 45 Hz unless told."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, PERIOD)
    force = 300.0 * random.uniform(-1, 1, int(seconds / 0.5) + 1)[(time / 0.5).astype(int)]
    A = np.zeros((3, 3))
    A[0, 1] = 1.0
    A[1] = [-stiffness / MASS, -DAMPING / MASS, 1 / MASS]
    step = expm(A * PERIOD)
    x, position = np.zeros(2), np.zeros(len(time))
    for k in range(len(time) - 1):
        x = step[:2, :2] @ x + step[:2, 2] * force[k]
        position[k + 1] = x[0]
    position += NOISE * random.standard_normal(len(time))
    return Record(time, {"force": force, "position": position}, {"force": "N", "position": "m"}, f"swing_{seed}")
