"""The constant-speed friction test: force against velocity, and the Stribeck curve through it.

    F(v) = (F_k + (F_s - F_k) exp(-(v/v_s)^2)) sign(v) + F_v v + F_0

The piston is pushed at one speed after the other while the pump circuit is open; once the speed is steady the pushing
force is the friction, and a constant load F_0 (a weight, an offset of the sensor). In one direction alone the load
cannot be told from F_k and F_s. Source: C-EHA paper, section 4.1, Eq. 8, Fig. 7, Table 1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares, nnls
from scipy.special import fdtrc, stdtrit

from hydrotwin.models.language.errors import DataError

from .plateaus import Stretch, is_table, plateaus

NAMES = ("kinetic", "static", "viscous", "stribeck_velocity", "load")
UNITS = ("N", "N", "N.s/m", "m/s", "N")
GRID = 60  # Stribeck velocities tried before the descent
FEWEST_SPEEDS = 4  # that can show the four coefficients of the curve
DIFFERENT = 1e-3  # chance below which the two directions are said to have different friction


@dataclass(frozen=True)
class FrictionCoefficient:
    """One coefficient with its standard deviation and two-sided interval; infinite where the points do not tell it."""

    name: str
    value: float
    sigma: float
    interval: tuple[float, float]
    unit: str


@dataclass(frozen=True, eq=False)
class FrictionFit:
    """The Stribeck curve through the points (velocity, force), SI; ``rmse`` in N.

    load : the constant force beside friction; None where all points have one direction, or where it was given.
    dropped : stretches of the recordings that gave no point, with the reason.
    """

    coefficients: tuple[FrictionCoefficient, ...]
    covariance: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    rmse: float
    confidence: float
    findings: tuple[str, ...]
    load: FrictionCoefficient | None = None
    dropped: tuple[Stretch, ...] = ()

    @property
    def told(self) -> tuple[FrictionCoefficient, ...]:
        """The coefficients of friction, and the load where it was fitted."""
        return (*self.coefficients, self.load) if self.load else self.coefficients

    @property
    def values(self) -> dict[str, float]:
        """Coefficients of friction by name, SI."""
        return {c.name: c.value for c in self.coefficients}

    def curve(self, velocity: np.ndarray) -> np.ndarray:
        """Force [N] at velocities [m/s]: friction, and the load where it is known."""
        friction = stribeck(np.asarray(velocity, dtype=float), *self.values.values())
        return friction + (self.load.value if self.load else 0.0)


def stribeck(v: np.ndarray, F_k: float, F_s: float, F_v: float, v_s: float) -> np.ndarray:
    """Eq. 8, zero at rest. Velocity in m/s, force in N."""
    return (F_k + (F_s - F_k) * np.exp(-((v / v_s) ** 2))) * np.sign(v) + F_v * v


def friction_test(
    records: Sequence,
    *,
    velocity: str = "velocity",
    force: str = "force",
    load: float | None = None,
    confidence: float = 0.95,
) -> FrictionFit:
    """Fit friction and a constant load to recordings of pushing at constant speed.

    Each stretch of steady speed gives one point, the means of velocity and force: single samples would carry the noise
    of the velocity into the curve and flatten it. A table that changes speed from row to row is taken as points.

    Args:
        records: recordings that hold ``velocity`` [m/s] and ``force`` [N]; one speed or many in each.
        load: the constant force [N] beside friction, where it is known.
        confidence: of the intervals.

    Raises DataError without the columns, or with too few different speeds to see the curve.
    """
    parts = [_points(record, velocity, force) for record in records]
    if not parts:
        raise DataError("friction test: no recording (got none). Give at least one with velocity and force.")
    points, dropped = zip(*parts, strict=True)
    dropped = tuple(stretch for some in dropped for stretch in some)
    v, F, error_v, error_F = (np.concatenate(column) for column in zip(*points, strict=True))
    known = error_F if np.isfinite(error_F).all() else None
    try:
        fit = fit_stribeck(v, F, error_v, known, load=load, confidence=confidence)
    except DataError as error:
        shown = "".join(f" {stretch}." for stretch in dropped[:3])
        more = f" And {len(dropped) - 3} more." if len(dropped) > 3 else ""
        raise DataError(f"{error}{' Left out:' if dropped else ''}{shown}{more}") from None
    return dataclasses.replace(fit, dropped=dropped)


def _points(record, velocity: str, force: str):
    """Four arrays (points,): mean velocity and force of each plateau, their standard errors; and what was left out."""
    for name in (velocity, force):
        if name not in record.signals:
            raise DataError(
                f"{record.name}: no column '{name}' (got {', '.join(record.signals)}). A friction test needs velocity "
                "and force. Name the columns: velocity=..., force=...."
            )
    v, F = np.asarray(record[velocity], dtype=float), np.asarray(record[force], dtype=float)
    keep = np.isfinite(v) & np.isfinite(F)
    time, v, F = np.asarray(record.time, dtype=float)[keep], v[keep], F[keep]
    found, dropped = plateaus(record.name, time, v, F)
    if is_table(time, v, found):
        moving = v != 0
        return (v[moving], F[moving], np.zeros(moving.sum()), np.full(moving.sum(), np.nan)), []
    count = np.array([part.stop - part.start for part in found])
    mean_v, mean_F = (np.array([column[part].mean() for part in found]) for column in (v, F))
    noise_v, noise_F = (np.median([column[part].std() for part in found] or [0.0]) for column in (v, F))
    error_v = noise_v / np.sqrt(count)
    return (mean_v, mean_F, error_v, np.maximum(noise_F, 1e-9 * np.abs(F).max(initial=0.0)) / np.sqrt(count)), dropped


def fit_stribeck(
    velocity: np.ndarray,
    force: np.ndarray,
    velocity_error: np.ndarray | float = 0.0,
    force_error: np.ndarray | float | None = None,
    *,
    load: float | None = None,
    confidence: float = 0.95,
) -> FrictionFit:
    """Eq. 8 and a constant load through points (n,) in m/s and N with their standard errors.

    Without errors the scatter of the points tells. For a given v_s the curve is linear in the others, so v_s is first
    tried on a grid, then all descend. An error of velocity counts as one of force through the slope of the curve.

    load : the constant force [N] where it is known. Points of one direction alone do not show it.
    """
    v, F = np.asarray(velocity, dtype=float), np.asarray(force, dtype=float) - (load or 0.0)
    both = bool((v > 0).any() and (v < 0).any())
    fitted = 5 if both and load is None else 4
    speeds = np.unique(np.round(np.log(np.abs(v[v != 0])), 1))
    if len(speeds) < FEWEST_SPEEDS or len(v) <= fitted:
        raise DataError(
            f"friction test: {len(speeds)} different speeds in {len(v)} points cannot show the four coefficients. At "
            "least four speeds are needed, some of them below the Stribeck velocity. Record more speeds."
        )
    if both and float(np.sign(v) @ (F - F.mean())) < 0:
        raise DataError(
            "friction test: the force acts against the motion (it falls from backward to forward). The pushing force "
            "is needed, positive where it moves forward. Turn its sign: --scale force=-1."
        )
    known = force_error is not None
    error = np.broadcast_to(np.asarray(force_error if known else 1.0, dtype=float), v.shape)
    curve = _Curve(v, F, fitted, both or load is not None)
    weight, x = 1 / error, None
    for _ in range(2):
        x = curve.descended(weight, x)
        slope = x[2] - 2 * (x[1] - x[0]) * np.exp(-((v / x[3]) ** 2)) * np.abs(v) / x[3] ** 2
        weight = 1 / np.hypot(error, slope * velocity_error)
    x = curve.descended(weight, x)
    fit = curve.answer(x, weight, confidence, 1.0 if known else 0.0)
    findings = (*fit.findings, *_by_direction(v, F, weight, curve, x))
    return dataclasses.replace(fit, force=F + (load or 0.0), findings=findings)


@dataclass(frozen=True)
class _Curve:
    """The curve with ``fitted`` coefficients, 5 with the load; ``told``: whether friction is not mixed with a load."""

    v: np.ndarray
    F: np.ndarray
    fitted: int
    told: bool

    def force(self, x: np.ndarray) -> np.ndarray:
        return stribeck(self.v, *x[:4]) + (x[4] if self.fitted == 5 else 0.0)

    def jacobian(self, x: np.ndarray) -> np.ndarray:
        v, (F_k, F_s, _, v_s) = self.v, x[:4]
        bump = np.exp(-((v / v_s) ** 2))
        by_v_s = (F_s - F_k) * bump * 2 * v**2 / v_s**3
        columns = [(1 - bump) * np.sign(v), bump * np.sign(v), v, by_v_s * np.sign(v), np.ones_like(v)]
        return np.column_stack(columns[: self.fitted])

    def descended(self, weight: np.ndarray, start: np.ndarray | None = None) -> np.ndarray:
        """The coefficients (fitted,) of least weighted squares. Friction mixed with a load may be negative."""
        if start is None:
            tried = (self._at_stribeck_velocity(weight, v_s) for v_s in self._grid())
            start = min(tried, key=lambda row: row[0])[1]
        unit = np.maximum(np.abs(start), 1e-9)
        unit[[0, 1, *range(4, self.fitted)]] = np.maximum(unit[[0, 1, *range(4, self.fitted)]], 1e-6 * self._largest())
        least = 0.0 if self.told else -np.inf
        found = least_squares(
            lambda x: (self.force(x * unit) - self.F) * weight,
            start / unit,
            jac=lambda x: self.jacobian(x * unit) * unit * weight[:, None],
            bounds=([least, least, 0, 1e-3, -np.inf][: self.fitted], np.inf),
        )
        return found.x * unit

    def answer(self, x: np.ndarray, weight: np.ndarray, confidence: float, least: float) -> FrictionFit:
        """The fit with intervals; ``least``: variance of a weighted residual below which luck is not believed."""
        r, J = (self.force(x) - self.F) * weight, self.jacobian(x) * weight[:, None]
        freedom = len(self.v) - len(x)
        size = np.maximum(np.linalg.norm(J, axis=0), np.finfo(float).tiny)
        inverse = np.linalg.pinv((J / size).T @ (J / size), hermitian=True)
        covariance = max(float(r @ r) / freedom, least) * inverse / np.outer(size, size)
        reach = float(stdtrit(freedom, 0.5 + confidence / 2))
        hump = float(np.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]))
        findings = _findings(x, self.v, hump)
        sigma = np.sqrt(np.diag(covariance))
        intervals = list(zip(x - reach * sigma, x + reach * sigma, strict=True))
        if not self.told:
            findings.append(_mixed(x, intervals, np.sign(self.v[0]), reach * hump))
            intervals[0] = (0.0, np.inf)
            intervals[1] = (max(0.0, x[1] - x[0] - reach * hump), np.inf)
            covariance[:2], covariance[:, :2] = np.nan, np.nan
            covariance[[0, 1], [0, 1]] = sigma[:2] = np.inf
        rows = [
            FrictionCoefficient(name, float(value), float(s), (float(low), float(high)), unit)
            for name, value, s, (low, high), unit in zip(NAMES, x, sigma, intervals, UNITS, strict=False)
        ]
        if len(rows) == 5:
            findings += _loaded(rows[4], x[0])
        rmse = float(np.sqrt(np.mean((r / weight) ** 2)))
        load = rows[4] if len(rows) == 5 else None
        kept = covariance[:4, :4]
        return FrictionFit(tuple(rows[:4]), kept, self.v, self.F, rmse, confidence, tuple(findings), load)

    def _largest(self) -> float:
        return max(float(np.abs(self.F).max()), np.finfo(float).tiny)

    def _grid(self) -> np.ndarray:
        speed = np.abs(self.v[self.v != 0])
        return np.geomspace(speed.min(), speed.max(), GRID)

    def _at_stribeck_velocity(self, weight: np.ndarray, v_s: float) -> tuple[float, np.ndarray]:
        """Weighted sum of squares and coefficients of the best curve with this v_s."""
        x = np.array([0.0, 0.0, 0.0, v_s, 0.0])[: self.fitted]
        linear = [j for j in range(self.fitted) if j != 3]
        A = self.jacobian(x)[:, linear] * weight[:, None]
        free = [k for k, j in enumerate(linear) if j == 4 or (j < 2 and not self.told)]  # may be negative
        A = np.column_stack([A, -A[:, free]])
        size = np.maximum(np.linalg.norm(A, axis=0), np.finfo(float).tiny)
        found, cost = nnls(A / size, self.F * weight)
        found /= size
        found[free] -= found[len(linear) :]
        x[linear] = found[: len(linear)]
        smallest = 1e-6 * self._largest() * np.array([1.0, 1.0, 1 / np.abs(self.v).max()])
        x[:3] = np.maximum(x[:3], smallest) if self.told else [*x[:2], max(x[2], smallest[2])]
        return float(cost), x


def _mixed(x: np.ndarray, intervals: list, direction: float, hump_reach: float) -> str:
    sign = "plus" if direction > 0 else "minus"
    kinetic, static = (
        f"{name} friction {sign} load is {value:.5g} ± {(high - low) / 2:.2g} N"
        for name, value, (low, high) in zip(NAMES[:2], x[:2], intervals[:2], strict=True)
    )
    return (
        "friction test: every speed has the same direction, so a constant load cannot be told from friction: "
        f"{kinetic}, {static}. Their difference, {x[1] - x[0]:.5g} ± {hump_reach:.2g} N, is friction alone. Record the "
        "other direction too, or give the load (--load)."
    )


def _loaded(load: FrictionCoefficient, kinetic: float) -> list[str]:
    if load.interval[0] <= 0 <= load.interval[1]:
        return []
    return [
        f"friction test: a constant load of {load.value:.5g} N acts beside friction (a weight, a sensor offset). "
        f"Or friction depends on the direction, kinetic {kinetic + load.value:.5g} N forward and "
        f"{kinetic - load.value:.5g} N backward: both look the same."
    ]


def _by_direction(v: np.ndarray, F: np.ndarray, weight: np.ndarray, curve: _Curve, x: np.ndarray) -> list[str]:
    """Said where the two directions, each with a curve of its own, leave much less than one curve for both."""
    sides = [v > 0, v < 0]
    if any(len(np.unique(np.round(np.log(np.abs(v[side])), 1))) < FEWEST_SPEEDS for side in sides):
        return []
    parts = [_Curve(v[side], F[side], 4, False) for side in sides]
    own = [part.descended(weight[side]) for part, side in zip(parts, sides, strict=True)]
    left = sum(
        float((((part.force(y) - part.F) * weight[side]) ** 2).sum())
        for part, y, side in zip(parts, own, sides, strict=True)
    )
    more, freedom = 8 - curve.fitted, len(v) - 8
    if freedom < 1:
        return []
    together = float((((curve.force(x) - F) * weight) ** 2).sum())
    ratio = (together - left) / more / max(left / freedom, np.finfo(float).tiny)
    if fdtrc(more, freedom, max(ratio, 0.0)) > DIFFERENT or together - left < 1e-12 * float(((F * weight) ** 2).sum()):
        return []
    said = [f"viscous {y[2]:.4g} N.s/m, static - kinetic {y[1] - y[0]:.4g} N, v_s {y[3]:.3g} m/s" for y in own]
    return [
        "friction test: friction differs between the directions, and one curve for both is a compromise. Forward: "
        f"{said[0]}. Backward: {said[1]}. Fit each direction by itself."
    ]


def _findings(x: np.ndarray, v: np.ndarray, hump_sigma: float) -> list[str]:
    found = []
    slowest = np.abs(v[v != 0]).min()
    if slowest > x[3]:
        found.append(
            f"friction test: the slowest speed is {slowest:.3g} m/s, above the Stribeck velocity {x[3]:.3g} m/s. "
            "The static friction is extrapolated. Record slower runs."
        )
    if x[1] - x[0] < 2 * hump_sigma:
        found.append(
            "friction test: static and kinetic friction do not differ beyond their uncertainty. The Stribeck velocity "
            "has no meaning here. Record slow runs, or use Coulomb and viscous friction."
        )
    return found
