"""A mass on a slide, pushed by a force: the model, and its motion by SciPy's exact response of a linear system."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.signal import lsim

from hydrotwin.models.components import ForceSource, LinearLoad
from hydrotwin.models.language import Component, Input, Model, Output, connect
from hydrotwin.models.laws import Viscous
from hydrotwin.records import Record

MASS, VISCOUS = 120.0, 300.0  # kg, N.s/m
PERIOD, FINE = 0.02, 20  # s; steps of the truth in a sample
NOISE = {"position": 2e-4, "velocity": 5e-4}  # m, m/s
FREE = ["load.mass", "load.friction.viscous"]
TIME = np.arange(0, 8.0, PERIOD)


def slide(interpolation: str | None = None, unit: str = "N", second: bool = False) -> Model:
    """The model with one or two forces, whose interpolation is declared or not."""

    class Slide(Component):
        """A mass on a slide."""

        force = Input(unit, "force of the motor", nominal=50.0, interpolation=interpolation)
        position = Output("m", "position")
        velocity = Output("m/s", "velocity")
        motor = ForceSource()
        load = LinearLoad(mass=95.0, friction=Viscous(viscous=200.0), load_force=0.0)
        if second:
            push = Input(unit, "force of the other side", nominal=50.0, interpolation=interpolation)
            other = ForceSource()

        def equations(self):
            yield connect(self.force, self.motor.force)
            yield connect(self.motor.flange, self.load.flange)
            yield self.position == self.load.position
            yield self.velocity == self.load.velocity
            if second:
                yield connect(self.push, self.other.force)
                yield connect(self.other.flange, self.load.flange)

    return Model(Slide(), "slide")


def wave(seed: int):
    """A smooth force [N] as a function of time: eight sines up to 1.4 Hz."""
    random = np.random.default_rng(seed)
    speeds, phases = random.uniform(0.5, 9.0, 8), random.uniform(0, 6.28, 8)
    return lambda time: 12 * np.sin(np.multiply.outer(time, speeds) + phases).sum(axis=-1)


def steps(seed: int):
    """A force [N] in steps of 0.4 s as a function of time."""
    levels = np.random.default_rng(seed).uniform(-60, 60, 100)
    return lambda time: levels[np.clip(np.floor(time / 0.4 + 1e-9).astype(int), 0, 99)]


def held(force, time: np.ndarray = TIME):
    """The force as a D/A converter keeps it between ``time``."""
    return lambda t: force(time[np.clip(np.searchsorted(time, t + 1e-9, side="right") - 1, 0, None)])


def moved(seed: int, force, recorded=None, *, start=(0.0, 0.0), outputs=("position", "velocity"), time=TIME, noise=1.0):
    """A recording of the motion under ``force(t)``; ``recorded(t)`` is what the column says, the force itself if None.

    Every sample is cut into FINE pieces over which the force is linear: exact for held forces, and to 1e-5 for waves.
    """
    ends = np.append(time, 2 * time[-1] - time[-2])
    fine = np.concatenate([np.linspace(a, b, FINE, endpoint=False) for a, b in pairwise(ends)])
    A, B = [[0, 1], [0, -VISCOUS / MASS]], [[0], [1 / MASS]]
    even = np.arange(len(fine)) * (fine[-1] / (len(fine) - 1))
    middle = force(even + 1e-6) if np.ptp(np.diff(time)) < 1e-9 else force(even)
    y = lsim((A, B, np.eye(2), np.zeros((2, 1))), middle, even, X0=start, interp=_continuous(force))[1]
    random = np.random.default_rng(1000 + seed)
    truth = {n: np.interp(time, even, y[:, j]) for j, n in enumerate(NOISE)}
    signals = {n: truth[n] + noise * NOISE[n] * random.standard_normal(len(time)) for n in outputs}
    column = (recorded or force)(time)
    return Record(time, {"force": column, **signals}, {"force": "N", "position": "m", "velocity": "m/s"}, f"run_{seed}")


def _continuous(force) -> bool:
    """Whether a force moves between samples."""
    return bool(np.ptp(force(np.linspace(0.001, PERIOD - 0.001, 5))) > 0)
