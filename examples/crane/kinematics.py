"""Where the tip is, how long the cylinders are, and how fast they must move along a circle; plain NumPy.

    x = L_1 cos(theta_1) + L_2 cos(theta_1 + theta_2),   y alike with sin
    L^2 = d^2 + l^2 - 2 d l cos(theta + offset),   stroke = L - L_0

Angles in rad, lengths in m; arrays (n, 2) hold boom and jib, or x and y.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Geometry:
    """The drawing: link lengths and the triangle of each actuator; boom first."""

    length: tuple[float, float] = (2.5, 2.0)
    foot: tuple[float, float] = (0.9, 1.0)
    reach: tuple[float, float] = (0.8, 0.35)
    offset: tuple[float, float] = (1.5708, 2.4435)
    retracted: tuple[float, float] = (1.0, 0.75)


DRAWING = Geometry()


def tip(angles: np.ndarray, geometry: Geometry = DRAWING) -> np.ndarray:
    """Place of the tip (n, 2) at joint angles (n, 2)."""
    (L1, L2), q1, q2 = geometry.length, angles[:, 0], angles[:, 1]
    return np.column_stack([L1 * np.cos(q1) + L2 * np.cos(q1 + q2), L1 * np.sin(q1) + L2 * np.sin(q1 + q2)])


def joint_angles(place: np.ndarray, geometry: Geometry = DRAWING) -> np.ndarray:
    """Joint angles (n, 2) at tip places (n, 2), the jib hanging below the boom's direction.

    Raises ValueError for a place out of reach.
    """
    (L1, L2), x, y = geometry.length, place[:, 0], place[:, 1]
    cosine = (x**2 + y**2 - L1**2 - L2**2) / (2 * L1 * L2)
    if (np.abs(cosine) > 1).any():
        raise ValueError(f"the tip reaches {abs(L1 - L2):g} m to {L1 + L2:g} m from the foot of the boom, not {place}.")
    q2 = -np.arccos(cosine)
    return np.column_stack([np.arctan2(y, x) - np.arctan2(L2 * np.sin(q2), L1 + L2 * np.cos(q2)), q2])


def strokes(angles: np.ndarray, geometry: Geometry = DRAWING) -> np.ndarray:
    """Strokes of the cylinders (n, 2) at joint angles (n, 2)."""
    return _lengths(angles, geometry) - np.array(geometry.retracted)


def levers(angles: np.ndarray, geometry: Geometry = DRAWING) -> np.ndarray:
    """d stroke / d angle (n, 2): the arms at which the cylinders pull."""
    d, pin = np.array(geometry.foot), np.array(geometry.reach)
    return d * pin * np.sin(angles + geometry.offset) / _lengths(angles, geometry)


def angles_of(stroke: np.ndarray, geometry: Geometry = DRAWING) -> np.ndarray:
    """Joint angles (n, 2) at strokes (n, 2)."""
    d, pin, whole = np.array(geometry.foot), np.array(geometry.reach), stroke + geometry.retracted
    return np.arccos((d**2 + pin**2 - whole**2) / (2 * d * pin)) - geometry.offset


def _lengths(angles: np.ndarray, geometry: Geometry) -> np.ndarray:
    d, pin = np.array(geometry.foot), np.array(geometry.reach)
    return np.sqrt(d**2 + pin**2 - 2 * d * pin * np.cos(angles + geometry.offset))


@dataclass(frozen=True)
class Circle:
    """Once around, from rest to rest: ``share = 10 s^3 - 15 s^4 + 6 s^5`` of the way at time ``s * duration``."""

    centre: tuple[float, float] = (3.6, 0.6)
    radius: float = 0.5
    duration: float = 25.0
    before: float = 1.0  # s at rest first

    def place(self, time: np.ndarray) -> np.ndarray:
        """Wanted place of the tip (n, 2)."""
        turn = 2 * np.pi * self._share(time)[0]
        return np.array(self.centre) + self.radius * np.column_stack([np.cos(turn), np.sin(turn)])

    def velocity(self, time: np.ndarray) -> np.ndarray:
        """Wanted velocity of the tip (n, 2) [m/s]."""
        share, rate = self._share(time)
        turn = 2 * np.pi * share
        return (2 * np.pi * self.radius * rate)[:, None] * np.column_stack([-np.sin(turn), np.cos(turn)])

    def _share(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s = np.clip((np.asarray(time, float) - self.before) / self.duration, 0, 1)
        return s**3 * (10 - 15 * s + 6 * s**2), 30 * s**2 * (1 - s) ** 2 / self.duration


def cylinder_velocities(circle: Circle, time: np.ndarray, geometry: Geometry = DRAWING) -> np.ndarray:
    """Velocities of the cylinders (n, 2) [m/s] that move the tip along the circle: levers times J^-1 v."""
    angles, v = joint_angles(circle.place(time), geometry), circle.velocity(time)
    (L1, L2), q1, q12 = geometry.length, angles[:, 0], angles.sum(axis=1)
    J12, J22 = -L2 * np.sin(q12), L2 * np.cos(q12)
    J11, J21 = J12 - L1 * np.sin(q1), J22 + L1 * np.cos(q1)
    rates = np.column_stack([J22 * v[:, 0] - J12 * v[:, 1], J11 * v[:, 1] - J21 * v[:, 0]])
    return levers(angles, geometry) * rates / (J11 * J22 - J12 * J21)[:, None]
