"""What is recorded before the crane tracks: staircases of one axis at a time, and the steady points in them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language import Model
from hydrotwin.records import Record
from hydrotwin.simulation import simulate

from . import kinematics

AXES = ("boom", "jib")
PERIOD, LEVELS, HOLD, SETTLE = 0.01, 7, 1.0, 0.5  # s, steps in one direction, s each, s before it is steady
NOISE = {"boom_stroke": 2e-4, "jib_stroke": 2e-4, "boom_spool": 2e-3, "jib_spool": 2e-3}  # m and 1, of the sensors
STARTS = {"boom": (0.10, 0.95), "jib": (-1.75, -0.55)}  # rad, where the cylinder goes out and where it goes in
OTHERS = {"boom": (-1.5, -1.0, -0.6), "jib": (0.25, 0.55, 0.85)}  # rad, of the axis that rests
UNITS = {"boom_stroke": "m", "jib_stroke": "m", "boom_spool": "1", "jib_spool": "1"}


@dataclass(frozen=True)
class SteadyPoints:
    """Steady stretches of the recordings, shape (n,): command, velocity of the cylinder [m/s], +1 where the command
    had been raised to its value and -1 where it had been lowered, and the strokes (n, 2) [m] at which it was.

    sigma : standard deviation of one velocity.
    """

    command: np.ndarray
    velocity: np.ndarray
    raised: np.ndarray
    strokes: np.ndarray
    sigma: float


def recordings(machine: Model, axis: str, count: int = 12, seed: int = 0) -> list[Record]:
    """Staircases of one axis, out and in by turns, with sensor noise; ``seed`` draws the levels and the noise."""
    return [_staircase(machine, axis, k, np.random.default_rng([seed, k])) for k in range(count)]


def _staircase(machine: Model, axis: str, number: int, random: np.random.Generator) -> Record:
    """Levels of one direction in random order; each recording shifts them, so that all together cover the range."""
    inward, other = number % 2, AXES[1 - AXES.index(axis)]
    levels = (np.arange(LEVELS) + random.uniform()) / LEVELS * (-1 if inward else 1)
    current = np.repeat(random.permutation(levels), round(HOLD / PERIOD))
    current = np.append(current, current[-1])
    time = PERIOD * np.arange(len(current))
    currents = {f"{axis}_current": current, f"{other}_current": np.zeros_like(current)}
    record = Record(time, currents, {name: "1" for name in currents}, f"{axis} staircase {number}")
    start = {f"links.{axis}_angle": STARTS[axis][inward], f"links.{other}_angle": OTHERS[axis][number // 2 % 3]}
    run = simulate(machine, record, start=start)
    seen = {name: run[name] + sigma * random.standard_normal(len(time)) for name, sigma in NOISE.items()}
    return record.with_signals(seen, UNITS)


def steady_points(records: list[Record], axis: str) -> SteadyPoints:
    """The second half of every step: what the cylinder does at a held command."""
    steady, step = round(SETTLE / PERIOD), round(HOLD / PERIOD)
    rows, errors = [], []
    for record in records:
        u, s = record[f"{axis}_current"], record.array(["boom_stroke", "jib_stroke"])
        before = 0.0
        for first in range(0, len(u) - step, step):
            part = slice(first + steady, first + step)
            x = record.time[part] - record.time[part].mean()
            y = s[part, AXES.index(axis)]
            v = float(x @ y / (x @ x))
            left = y - y.mean() - v * x
            errors.append(np.sqrt(left @ left / (len(x) - 2) / (x @ x)))
            rows.append([u[first], v, np.sign(u[first] - before), *s[part].mean(axis=0)])
            before = u[first]
    table = np.array(rows)
    return SteadyPoints(table[:, 0], table[:, 1], table[:, 2], table[:, 3:], float(np.median(errors)))


def holding_forces(strokes: np.ndarray, masses: tuple[float, float, float] = (120.0, 60.0, 100.0)) -> np.ndarray:
    """Forces (n, 2) [N] that push the rods in at rest, at strokes (n, 2): statics of the drawing.

    masses : of boom, jib and payload as the data sheets have them [kg]. F = g(theta)/h, see `TwoLinks`.
    """
    (m1, m2, m), (L1, L2), g = masses, kinematics.DRAWING.length, 9.80665
    angles = kinematics.angles_of(strokes)
    outer = (m2 / 2 + m) * L2 * np.cos(angles.sum(axis=1))
    inner = (m1 / 2 + m2 + m) * L1 * np.cos(angles[:, 0])
    return g * np.column_stack([inner + outer, outer]) / kinematics.levers(angles)
