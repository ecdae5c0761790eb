"""The Stribeck curve through points of velocity and force, with a constant load and a drift of the force in time.

    F(v, t) = (F_k + (F_s - F_k) exp(-(v/v_s)^2)) sign(v) + F_v v + F_0 + b t

Source of the curve: C-EHA paper, Eq. 8.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, nnls

UNITS = {"kinetic": "N", "static": "N", "viscous": "N.s/m", "stribeck_velocity": "m/s", "load": "N", "drift": "N/s"}
OF_FRICTION = 4  # coefficients of friction alone, the first ones
UNKNOWN = 1e9  # N/s: standard deviation of a drift of which nothing is known
GRID = 60  # Stribeck velocities tried before the descent


def stribeck(v: np.ndarray, F_k: float, F_s: float, F_v: float, v_s: float) -> np.ndarray:
    """Eq. 8, zero at rest. Velocity in m/s, force in N."""
    return (F_k + (F_s - F_k) * np.exp(-((v / v_s) ** 2))) * np.sign(v) + F_v * v


@dataclass(frozen=True)
class Drift:
    """How the force drifts: ``time`` (n,) s of the points, and the ``rate`` +- ``sigma`` [N/s] seen within them.

    chance : that slopes of one rate scatter so much.
    """

    time: np.ndarray
    rate: float
    sigma: float
    chance: float = 1.0

    def unseen(self) -> Drift:
        """As if nothing were known from within the points."""
        return Drift(self.time, 0.0, UNKNOWN)


@dataclass(frozen=True)
class Curve:
    """The curve through points (n,), with the coefficients ``names``.

    loaded : whether a load is one of them. told : whether friction is not mixed with an unknown load.
    drift : makes the drift one of them; the rate within the points counts as one more point.
    """

    v: np.ndarray
    F: np.ndarray
    loaded: bool
    told: bool
    drift: Drift | None = None

    @property
    def names(self) -> tuple[str, ...]:
        load, drift = ("load",) if self.loaded else (), ("drift",) if self.drift else ()
        return (*list(UNITS)[:OF_FRICTION], *load, *drift)

    def force(self, x: np.ndarray) -> np.ndarray:
        """Force [N] at the points, (n,), for coefficients in the order of ``names``."""
        friction = stribeck(self.v, *x[:OF_FRICTION]) + (x[OF_FRICTION] if self.loaded else 0.0)
        return friction + self.drifted(x)

    def drifted(self, x: np.ndarray) -> np.ndarray | float:
        """The part of the force [N] that is drift."""
        return x[-1] * self.drift.time if self.drift else 0.0

    def residual(self, x: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Weighted differences of the points, and of the drift."""
        r = (self.force(x) - self.F) * weight
        return np.append(r, (x[-1] - self.drift.rate) / self.drift.sigma) if self.drift else r

    def jacobian(self, x: np.ndarray, weight: np.ndarray) -> np.ndarray:
        """Derivative of the residual by the coefficients."""
        v, (F_k, F_s, _, v_s) = self.v, x[:OF_FRICTION]
        bump = np.exp(-((v / v_s) ** 2))
        by_v_s = (F_s - F_k) * bump * 2 * v**2 / v_s**3
        columns = [(1 - bump) * np.sign(v), bump * np.sign(v), v, by_v_s * np.sign(v)]
        columns += [np.ones_like(v)] if self.loaded else []
        columns += [self.drift.time] if self.drift else []
        J = np.column_stack(columns) * weight[:, None]
        return np.vstack([J, [0.0] * (len(columns) - 1) + [1 / self.drift.sigma]]) if self.drift else J

    def slope(self, x: np.ndarray) -> np.ndarray:
        """Change of the force with the speed [N.s/m] at the points."""
        F_k, F_s, F_v, v_s = x[:OF_FRICTION]
        return F_v - 2 * (F_s - F_k) * np.exp(-((self.v / v_s) ** 2)) * np.abs(self.v) / v_s**2

    def descended(self, weight: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
        """The coefficients of least weighted squares. Friction mixed with a load may be negative.

        For a given v_s the curve is linear in the others, so v_s is first tried on a grid, then all descend.
        """
        if start is None:
            tried = (self._at_stribeck_velocity(weight, v_s) for v_s in self._grid())
            start = min(tried, key=lambda row: row[0])[1]
        unit = np.maximum(np.abs(start), 1e-9)
        forces = [k for k, name in enumerate(self.names) if UNITS[name] == "N"]
        unit[forces] = np.maximum(unit[forces], 1e-6 * self._largest())
        if self.drift:
            unit[-1] = max(unit[-1], 1e-6 * self._largest() / max(float(np.abs(self.drift.time).max()), 1e-9))
        least = 0.0 if self.told else -np.inf
        lower = [least, least, 0, 1e-3] + [-np.inf] * (len(unit) - OF_FRICTION)
        found = least_squares(
            lambda x: self.residual(x * unit, weight),
            start / unit,
            jac=lambda x: self.jacobian(x * unit, weight) * unit,
            bounds=(lower, np.inf),
        )
        return found.x * unit

    def _largest(self) -> float:
        return max(float(np.abs(self.F).max()), np.finfo(float).tiny)

    def _grid(self) -> np.ndarray:
        speed = np.abs(self.v[self.v != 0])
        return np.geomspace(speed.min(), speed.max(), GRID)

    def _at_stribeck_velocity(self, weight: np.ndarray, v_s: float) -> tuple[float, np.ndarray]:
        """Weighted sum of squares and coefficients of the best curve with this v_s."""
        x = np.zeros(len(self.names))
        x[3] = v_s
        linear = [j for j in range(len(x)) if j != 3]
        A = self.jacobian(x, weight)[:, linear]
        free = [k for k, j in enumerate(linear) if j >= OF_FRICTION or (j < 2 and not self.told)]  # may be negative
        A = np.column_stack([A, -A[:, free]])
        size = np.maximum(np.linalg.norm(A, axis=0), np.finfo(float).tiny)
        found, cost = nnls(A / size, -self.residual(x, weight))
        found /= size
        found[free] -= found[len(linear) :]
        x[linear] = found[: len(linear)]
        smallest = 1e-6 * self._largest() * np.array([1.0, 1.0, 1 / np.abs(self.v).max()])
        x[:3] = np.maximum(x[:3], smallest) if self.told else [*x[:2], max(x[2], smallest[2])]
        return float(cost), x
