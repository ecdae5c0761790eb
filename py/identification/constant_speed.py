"""The constant-speed friction test: force against velocity, and the Stribeck curve through it.

    F(v) = (F_k + (F_s - F_k) exp(-(v/v_s)^2)) sign(v) + F_v v

The piston is pushed at one speed after the other while the pump circuit is open; once the speed is steady the pushing
force is the friction. Source: C-EHA paper, section 4.1, Eq. 8, Fig. 7, Table 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, nnls
from scipy.special import stdtrit

from hydrotwin.models.language.errors import DataError

NAMES = ("kinetic", "static", "viscous", "stribeck_velocity")
UNITS = ("N", "N", "N.s/m", "m/s")
GRID = 60  # Stribeck velocities tried before the descent
STEADY = 0.02  # relative drift of the mean speed within a stretch
SETTLE = 0.6  # s over which the drift is looked at, before and after
SHORTEST = 10  # samples
AT_REST = 5.0  # standard errors from zero below which a stretch is one of rest


@dataclass(frozen=True)
class FrictionCoefficient:
    """One coefficient of Eq. 8 with its standard deviation and two-sided interval."""

    name: str
    value: float
    sigma: float
    interval: tuple[float, float]
    unit: str


@dataclass(frozen=True, eq=False)
class FrictionFit:
    """The Stribeck curve through the points (velocity, force), SI; ``rmse`` in N."""

    coefficients: tuple[FrictionCoefficient, ...]
    covariance: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    rmse: float
    confidence: float
    findings: tuple[str, ...]

    @property
    def values(self) -> dict[str, float]:
        """Coefficients by name, SI."""
        return {c.name: c.value for c in self.coefficients}

    def curve(self, velocity: np.ndarray) -> np.ndarray:
        """Friction force [N] at velocities [m/s]."""
        return stribeck(np.asarray(velocity, dtype=float), *self.values.values())


def stribeck(v: np.ndarray, F_k: float, F_s: float, F_v: float, v_s: float) -> np.ndarray:
    """Eq. 8, zero at rest. Velocity in m/s, force in N."""
    return (F_k + (F_s - F_k) * np.exp(-((v / v_s) ** 2))) * np.sign(v) + F_v * v


def friction_test(
    records: Sequence, *, velocity: str = "velocity", force: str = "force", confidence: float = 0.95
) -> FrictionFit:
    """Fit Eq. 8 to recordings of pushing at constant speed.

    Each stretch of steady speed gives one point, the means of velocity and force: single samples would carry the noise
    of the velocity into the curve and flatten it. A table that changes speed from row to row is taken as points.

    Args:
        records: recordings that hold ``velocity`` [m/s] and ``force`` [N]; one speed or many in each.
        confidence: of the intervals.

    Raises DataError without the columns, or with too few different speeds to see the curve.
    """
    parts = [constant_speed_points(record, velocity, force) for record in records]
    if not parts:
        raise DataError("friction test: no recording (got none). Give at least one with velocity and force.")
    v, F, error_v, error_F = (np.concatenate(column) for column in zip(*parts, strict=True))
    return fit_stribeck(v, F, error_v, error_F if np.isfinite(error_F).all() else None, confidence=confidence)


def constant_speed_points(record, velocity: str = "velocity", force: str = "force"):
    """Mean velocity and force of each stretch of steady speed, then their standard errors: four arrays (points,)."""
    for name in (velocity, force):
        if name not in record.signals:
            raise DataError(
                f"{record.name}: no column '{name}' (got {', '.join(record.signals)}). A friction test needs velocity "
                "and force. Name the columns: velocity=..., force=...."
            )
    v, F = np.asarray(record[velocity], dtype=float), np.asarray(record[force], dtype=float)
    keep = np.isfinite(v) & np.isfinite(F)
    time, v, F = np.asarray(record.time, dtype=float)[keep], v[keep], F[keep]
    if len(v) < 2 * SHORTEST or _table_of_points(v):
        moving = v != 0
        return v[moving], F[moving], np.zeros(moving.sum()), np.full(moving.sum(), np.nan)
    stretches = [slice(*ends) for ends in _steady_stretches(time, v)]
    count = np.array([part.stop - part.start for part in stretches])
    mean_v, mean_F = (np.array([column[part].mean() for part in stretches]) for column in (v, F))
    noise_v, noise_F = (np.median([column[part].std() for part in stretches] or [0.0]) for column in (v, F))
    error_v, error_F = noise_v / np.sqrt(count), np.maximum(noise_F, 1e-9 * np.abs(F).max()) / np.sqrt(count)
    moving = np.abs(mean_v) > AT_REST * error_v
    return mean_v[moving], mean_F[moving], error_v[moving], error_F[moving]


def _table_of_points(v: np.ndarray) -> bool:
    """Rows of a table jump in speed as often as not; neighbouring samples of a run seldom do."""
    smooth = np.abs(np.diff(v, 2)).mean() if len(v) > 2 else 0.0
    return bool(smooth > 0.3 * np.std(v))


def _steady_stretches(time: np.ndarray, v: np.ndarray) -> list[tuple[int, int]]:
    """Sample ranges [first, last) of at least SETTLE seconds in which the mean speed does not drift."""
    half = max(SHORTEST // 2, int(np.ceil(SETTLE / np.median(np.diff(time)) / 2)))
    noise = np.median(np.abs(np.diff(v))) / (0.6745 * np.sqrt(2))
    total = np.concatenate([[0.0], np.cumsum(v)])
    before = np.full(len(v), np.nan)
    before[half:] = (total[half:-1] - total[: -half - 1]) / half
    after = np.full(len(v), np.nan)
    after[: len(v) - half] = (total[half:-1] - total[: len(v) - half]) / half
    drift = np.abs(after - before)
    steady = drift < np.maximum(4 * noise * np.sqrt(2 / half), STEADY * np.abs(after + before) / 2)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], steady.astype(int), [0]])))
    edge = half // 3
    return [(a + edge, b - edge) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= half + 2 * edge]


def fit_stribeck(
    velocity: np.ndarray,
    force: np.ndarray,
    velocity_error: np.ndarray | float = 0.0,
    force_error: np.ndarray | float | None = None,
    *,
    confidence: float = 0.95,
) -> FrictionFit:
    """Eq. 8 through points (n,) in m/s and N with their standard errors; without them the scatter of the points tells.

    For a given v_s the curve is linear in the other three, so v_s is first tried on a grid, then all four descend.
    An error of velocity counts as one of force through the slope of the curve.
    """
    v, F = np.asarray(velocity, dtype=float), np.asarray(force, dtype=float)
    speeds = np.unique(np.round(np.log(np.abs(v[v != 0])), 1))
    if len(speeds) < 4 or len(v) < 5:
        raise DataError(
            f"friction test: {len(speeds)} different speeds in {len(v)} points cannot show the four coefficients. At "
            "least four speeds are needed, some of them below the Stribeck velocity. Record more speeds."
        )
    known = force_error is not None
    force_error = np.broadcast_to(np.asarray(force_error if known else 1.0, dtype=float), v.shape)
    weight = 1 / force_error
    for _ in range(2):
        x = _descended(v, F, weight)
        slope = x[2] - 2 * (x[1] - x[0]) * np.exp(-((v / x[3]) ** 2)) * np.abs(v) / x[3] ** 2
        weight = 1 / np.hypot(force_error, slope * velocity_error)
    return _answer(_descended(v, F, weight), v, F, weight, confidence, 1.0 if known else 0.0)


def _descended(v: np.ndarray, F: np.ndarray, weight: np.ndarray) -> np.ndarray:
    start = min((_at_stribeck_velocity(v, F, weight, v_s) for v_s in _grid(v)), key=lambda row: row[0])[1]
    unit = np.maximum(np.abs(start), 1e-9)
    found = least_squares(
        lambda x: (stribeck(v, *(x * unit)) - F) * weight,
        start / unit,
        jac=lambda x: _jacobian(v, *(x * unit)) * unit * weight[:, None],
        bounds=([0, 0, 0, 1e-3], np.inf),
    )
    return found.x * unit


def _grid(v: np.ndarray) -> np.ndarray:
    speed = np.abs(v[v != 0])
    return np.geomspace(speed.min(), speed.max(), GRID)


def _at_stribeck_velocity(v: np.ndarray, F: np.ndarray, weight: np.ndarray, v_s: float) -> tuple[float, np.ndarray]:
    """Weighted sum of squares and coefficients of the best curve with this v_s."""
    bump = np.exp(-((v / v_s) ** 2))
    A = np.column_stack([(1 - bump) * np.sign(v), bump * np.sign(v), v]) * weight[:, None]
    size = np.maximum(np.linalg.norm(A, axis=0), np.finfo(float).tiny)
    x, cost = nnls(A / size, F * weight)
    smallest = 1e-6 * np.array([1.0, 1.0, 1 / np.abs(v).max()]) * np.abs(F).max()
    return float(cost), np.array([*np.maximum(x / size, smallest), v_s])


def _jacobian(v: np.ndarray, F_k: float, F_s: float, F_v: float, v_s: float) -> np.ndarray:
    bump = np.exp(-((v / v_s) ** 2))
    by_v_s = (F_s - F_k) * bump * 2 * v**2 / v_s**3
    return np.column_stack([(1 - bump) * np.sign(v), bump * np.sign(v), v, by_v_s * np.sign(v)])


def _answer(x, v: np.ndarray, F: np.ndarray, weight: np.ndarray, confidence: float, least: float) -> FrictionFit:
    """The fit with intervals; ``least`` is the variance of a weighted residual below which luck is not believed."""
    r, J = (stribeck(v, *x) - F) * weight, _jacobian(v, *x) * weight[:, None]
    freedom = len(v) - len(x)
    size = np.maximum(np.linalg.norm(J, axis=0), np.finfo(float).tiny)
    inverse = np.linalg.pinv((J / size).T @ (J / size), hermitian=True)
    covariance = max(float(r @ r) / freedom, least) * inverse / np.outer(size, size)
    sigma = np.sqrt(np.diag(covariance))
    reach = stdtrit(freedom, 0.5 + confidence / 2) * sigma
    coefficients = tuple(
        FrictionCoefficient(name, float(value), float(s), (float(value - h), float(value + h)), unit)
        for name, value, s, h, unit in zip(NAMES, x, sigma, reach, UNITS, strict=True)
    )
    rmse = float(np.sqrt(np.mean((r / weight) ** 2)))
    return FrictionFit(coefficients, covariance, v, F, rmse, confidence, tuple(_findings(coefficients, v)))


def _findings(coefficients: Sequence[FrictionCoefficient], v: np.ndarray) -> list[str]:
    found = []
    F_k, F_s, _, v_s = coefficients
    slowest = np.abs(v[v != 0]).min()
    if slowest > v_s.value:
        found.append(
            f"friction test: the slowest speed is {slowest:.3g} m/s, above the Stribeck velocity {v_s.value:.3g} m/s. "
            "The static friction is extrapolated. Record slower runs."
        )
    if F_s.value - F_k.value < 2 * np.hypot(F_s.sigma, F_k.sigma):
        found.append(
            "friction test: static and kinetic friction do not differ beyond their uncertainty. The Stribeck velocity "
            "has no meaning here. Record slow runs, or use Coulomb and viscous friction."
        )
    return found
