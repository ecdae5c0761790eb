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
from scipy.special import chdtrc, fdtrc, stdtrit

from hydrotwin.models.language.errors import DataError

from .plateau_points import Points, points_of
from .plateaus import Stretch
from .stribeck_curve import OF_FRICTION, UNITS, Curve, Drift, stribeck

FEWEST_SPEEDS = 4  # that can show the four coefficients of the curve
DIFFERENT = 1e-3  # chance below which the directions are said to differ, or the force to drift
SCATTERED = 2.0  # times the standard error of the points: what a curve leaves when friction is not quite the same twice
SHOWN, AGREES = 2.0, 3.0  # standard errors: of a drift within the plateaus, and from it to that of the fit


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
    drift : of the force in time [N/s], where the recording shows one. ``force`` is without it, the load at the start.
    dropped : stretches and samples of the recordings that gave no point, with the reason.
    """

    coefficients: tuple[FrictionCoefficient, ...]
    covariance: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    rmse: float
    confidence: float
    findings: tuple[str, ...]
    load: FrictionCoefficient | None = None
    drift: FrictionCoefficient | None = None
    dropped: tuple[Stretch, ...] = ()

    @property
    def told(self) -> tuple[FrictionCoefficient, ...]:
        """The coefficients of friction, and the load and the drift where they were fitted."""
        return (*self.coefficients, *filter(None, (self.load, self.drift)))

    @property
    def values(self) -> dict[str, float]:
        """Coefficients of friction by name, SI."""
        return {c.name: c.value for c in self.coefficients}

    def curve(self, velocity: np.ndarray) -> np.ndarray:
        """Force [N] at velocities [m/s]: friction, and the load where it is known."""
        friction = stribeck(np.asarray(velocity, dtype=float), *self.values.values())
        return friction + (self.load.value if self.load else 0.0)


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
    of the velocity into the curve and flatten it. Samples that stand far from the others of theirs are left out. A
    drift of the force that the plateaus of one recording show is taken out. A table that changes speed from row to row
    is taken as points.

    Args:
        records: recordings that hold ``velocity`` [m/s] and ``force`` [N]; one speed or many in each.
        load: the constant force [N] beside friction, where it is known.
        confidence: of the intervals.

    Raises DataError without the columns, or with too few different speeds to see the curve.
    """
    parts = [points_of(record, velocity, force) for record in records]
    if not parts:
        raise DataError("friction test: no recording (got none). Give at least one with velocity and force.")
    dropped = tuple(stretch for _, some in parts for stretch in some)
    points = Points.joined([part for part, _ in parts])
    drift = points.drift()
    try:
        fit = fit_stribeck(
            points.velocity,
            points.force,
            points.velocity_error,
            points.force_error if np.isfinite(points.force_error).all() else None,
            load=load,
            confidence=confidence,
            drift=drift if len(records) == 1 else None,
        )
    except DataError as error:
        shown = "".join(f" {stretch}." for stretch in dropped[:3])
        more = f" And {len(dropped) - 3} more." if len(dropped) > 3 else ""
        raise DataError(f"{error}{' Left out:' if dropped else ''}{shown}{more}") from None
    said = [*_at_fault(dropped), *(_drifts_in_each(drift) if len(records) > 1 else [])]
    return dataclasses.replace(fit, dropped=dropped, findings=(*fit.findings, *said))


def fit_stribeck(
    velocity: np.ndarray,
    force: np.ndarray,
    velocity_error: np.ndarray | float = 0.0,
    force_error: np.ndarray | float | None = None,
    *,
    load: float | None = None,
    confidence: float = 0.95,
    drift: Drift | None = None,
) -> FrictionFit:
    """Eq. 8 and a constant load through points (n,) in m/s and N with their standard errors.

    Without errors the scatter of the points tells. An error of velocity counts as one of force through the slope of
    the curve.

    load : the constant force [N] where it is known. Points of one direction alone do not show it.
    drift : what the points show of a drift of the force; it is fitted where the fit without is significantly worse.
    """
    v, F = np.asarray(velocity, dtype=float), np.asarray(force, dtype=float) - (load or 0.0)
    both = bool((v > 0).any() and (v < 0).any())
    curve = Curve(v, F, both and load is None, both or load is not None)
    _check_enough(v, curve)
    steady = F - drift.rate * drift.time if drift else F
    if both and float(np.sign(v) @ (steady - steady.mean())) < 0:
        raise DataError(
            "friction test: the force acts against the motion (it falls from backward to forward). The pushing force "
            "is needed, positive where it moves forward. Turn its sign: --scale force=-1."
        )
    known = force_error is not None
    error = np.broadcast_to(np.asarray(force_error if known else 1.0, dtype=float), v.shape)
    x, weight = _weighed(curve, error, velocity_error)
    if drift:
        drifting = dataclasses.replace(curve, drift=drift)
        y, drifting_weight = _weighed(drifting, error, velocity_error)
        if _is_needed(drifting, y, curve, drifting_weight):
            curve, x, weight = drifting, y, drifting_weight
    fit = _answer(curve, x, weight, confidence, known)
    without = dataclasses.replace(curve, F=F - curve.drifted(x), drift=None)
    kept = x[: len(without.names)]
    sides = _by_direction(without, kept, weight)
    if sides and drift and not curve.drift:
        sides = _rather_drifting(dataclasses.replace(curve, drift=drift.unseen()), weight) or sides
    findings = (*fit.findings, *sides)
    return dataclasses.replace(fit, force=without.F + (load or 0.0), findings=findings)


def _check_enough(v: np.ndarray, curve: Curve) -> None:
    speeds = len(np.unique(np.round(np.log(np.abs(v[v != 0])), 1)))
    fewest = len(curve.names) + 1
    if speeds < FEWEST_SPEEDS:
        raise DataError(
            f"friction test: {speeds} different speeds in {len(v)} points cannot show the four coefficients. At "
            f"least {FEWEST_SPEEDS} speeds are needed, some of them below the Stribeck velocity. Record more speeds."
        )
    if len(v) < fewest:
        raise DataError(
            f"friction test: {len(v)} points are too few for {len(curve.names)} coefficients ({', '.join(curve.names)})"
            f": none is left over that shows how sure they are. At least {fewest} points are needed: record "
            f"{fewest - len(v)} more, at other speeds or once more at the same ones."
        )


def _weighed(curve: Curve, error: np.ndarray, velocity_error) -> tuple[np.ndarray, np.ndarray]:
    """The coefficients, and the weights of the points that hold the error of velocity, too."""
    weight, x = 1 / error, None
    for _ in range(2):
        x = curve.descended(weight, x)
        weight = 1 / np.hypot(error, curve.slope(x) * velocity_error)
    return curve.descended(weight, x), weight


def _is_needed(drifting: Curve, x: np.ndarray, steady: Curve, weight: np.ndarray) -> bool:
    """Whether the forces are too unlikely without the drift of x, and each plateau by itself shows the same drift.

    The forces alone do not tell: friction that differs between the directions looks like a drift, too.
    """
    seen = drifting.drift
    if abs(seen.rate) < SHOWN * seen.sigma or abs(x[-1] - seen.rate) > AGREES * seen.sigma:
        return False
    left = drifting.residual(x, weight)
    more = drifting.residual(np.append(steady.descended(weight, x[:-1]), 0.0), weight)
    freedom = len(left) - len(x)
    size = max(float(left @ left) / freedom, 1.0)
    return bool(fdtrc(1, freedom, max(float(more @ more - left @ left), 0.0) / size) < DIFFERENT)


def _answer(curve: Curve, x: np.ndarray, weight: np.ndarray, confidence: float, known: bool) -> FrictionFit:
    """The fit with intervals. Where the errors are ``known``, luck with smaller residuals is not believed."""
    r, J = curve.residual(x, weight), curve.jacobian(x, weight)
    freedom = len(r) - len(x)
    size = np.maximum(np.linalg.norm(J, axis=0), np.finfo(float).tiny)
    inverse = np.linalg.pinv((J / size).T @ (J / size), hermitian=True)
    covariance = max(float(r @ r) / freedom, 1.0 if known else 0.0) * inverse / np.outer(size, size)
    reach = float(stdtrit(freedom, 0.5 + confidence / 2))
    hump = float(np.sqrt(covariance[0, 0] + covariance[1, 1] - 2 * covariance[0, 1]))
    findings = [*_findings(x, curve.v, hump), *(_left_over(curve, x, r, freedom) if known else [])]
    sigma = np.sqrt(np.diag(covariance))
    intervals = list(zip(x - reach * sigma, x + reach * sigma, strict=True))
    if not curve.told:
        findings.append(_mixed(x, intervals, np.sign(curve.v[0]), reach * hump))
        intervals[0] = (0.0, np.inf)
        intervals[1] = (max(0.0, x[1] - x[0] - reach * hump), np.inf)
        covariance[:2], covariance[:, :2] = np.nan, np.nan
        covariance[[0, 1], [0, 1]] = sigma[:2] = np.inf
    rows = {
        name: FrictionCoefficient(name, float(value), float(s), (float(low), float(high)), UNITS[name])
        for name, value, s, (low, high) in zip(curve.names, x, sigma, intervals, strict=True)
    }
    load, drift = rows.get("load"), rows.get("drift")
    findings += _loaded(load, x[0]) if load else []
    findings += _drifting(drift, curve.drift) if drift else []
    rmse = float(np.sqrt(np.mean((curve.force(x) - curve.F) ** 2)))
    friction = tuple(rows.values())[:OF_FRICTION]
    kept = covariance[:OF_FRICTION, :OF_FRICTION]
    return FrictionFit(friction, kept, curve.v, curve.F, rmse, confidence, tuple(findings), load, drift)


def _left_over(curve: Curve, x: np.ndarray, r: np.ndarray, freedom: int) -> list[str]:
    """Said where the curve leaves more of the points than their own scatter: weighted residuals r (m,)."""
    times = float(np.sqrt(r @ r / freedom))
    if times < SCATTERED or chdtrc(freedom, float(r @ r)) > DIFFERENT:
        return []
    left = curve.F - curve.force(x)
    worst = int(np.argmax(np.abs(left)))
    return [
        f"friction test: the curve leaves {np.sqrt(np.mean(left**2)):.3g} N of the points, {times:.3g} times what the "
        f"noise in their plateaus explains, most at {curve.v[worst]:.3g} m/s ({left[worst]:+.3g} N). Friction follows "
        "another law (its viscous part grows with the square of the speed, its hump has another shape), or it changes "
        "from plateau to plateau (position, temperature, another load in each recording). The values are a compromise, "
        "and the intervals do not hold that. Look at the points beside the curve before you use them."
    ]


def _at_fault(dropped: Sequence[Stretch]) -> list[str]:
    faults = [stretch for stretch in dropped if stretch.fault]
    if not faults:
        return []
    samples = sum(stretch.samples for stretch in faults)
    return [
        f"friction test: {samples} samples stand far from those around them and are left out of the means, the first: "
        f"{faults[0]}. The list of what was left out has all of them. Check the sensor, its range and its cable."
    ]


def _drifting(drift: FrictionCoefficient, seen: Drift) -> list[str]:
    uneven = " But its rate changes from plateau to plateau: the values are rough." if seen.chance < DIFFERENT else ""
    return [
        f"friction test: the force drifts by {drift.value:.3g} N/s ({drift.interval[0]:.3g} to {drift.interval[1]:.3g} "
        f"N/s), {drift.value * np.ptp(seen.time):.3g} N over the test (a sensor that warms up, a line that fills). "
        f"The fit takes the drift as constant and out of the forces; a load is that at the start.{uneven} Let the "
        "sensor warm up and record again to do without this assumption."
    ]


def _rather_drifting(drifting: Curve, weight: np.ndarray) -> list[str]:
    """Said where a drift that the plateaus themselves do not show leaves less than a curve for each direction."""
    v, x = drifting.v, drifting.descended(weight)
    parts = [(Curve(v[side], drifting.F[side], False, False), weight[side]) for side in (v > 0, v < 0)]
    apart = sum(float((part.residual(part.descended(w), w) ** 2).sum()) for part, w in parts)
    left = float((drifting.residual(x, weight) ** 2).sum())
    if left / (len(v) - len(x)) > apart / (len(v) - 2 * OF_FRICTION):
        return []
    return [
        f"friction test: a force that drifts by {x[-1]:.3g} N/s fits better than friction that differs between the "
        "directions, but the plateaus are too short, or the force too coarse, to show it. The values and the load hold "
        "the drift. Let the sensor warm up, or keep each speed longer, and record again."
    ]


def _drifts_in_each(drift: Drift | None) -> list[str]:
    """Said where the plateaus of several recordings drift: how far, from one recording to the next, is unknown."""
    if drift is None or fdtrc(1, len(drift.time) - 1, (drift.rate / drift.sigma) ** 2) > DIFFERENT:
        return []
    return [
        f"friction test: the force drifts by {drift.rate:.3g} N/s within the plateaus, and the drift is not taken out: "
        "several recordings do not tell how far it went between them. Zero the sensor before each recording, or "
        "subtract the drift from the force, or record all speeds in one file."
    ]


def _mixed(x: np.ndarray, intervals: list, direction: float, hump_reach: float) -> str:
    sign = "plus" if direction > 0 else "minus"
    kinetic, static = (
        f"{name} friction {sign} load is {value:.5g} ± {(high - low) / 2:.2g} N"
        for name, value, (low, high) in zip(("kinetic", "static"), x[:2], intervals[:2], strict=True)
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


def _by_direction(curve: Curve, x: np.ndarray, weight: np.ndarray) -> list[str]:
    """Said where the two directions, each with a curve of its own, leave much less than one curve for both."""
    v, F = curve.v, curve.F
    sides = [v > 0, v < 0]
    if any(len(np.unique(np.round(np.log(np.abs(v[side])), 1))) < FEWEST_SPEEDS for side in sides):
        return []
    parts = [Curve(v[side], F[side], False, False) for side in sides]
    own = [part.descended(weight[side]) for part, side in zip(parts, sides, strict=True)]
    left = sum(
        float((part.residual(y, weight[side]) ** 2).sum()) for part, y, side in zip(parts, own, sides, strict=True)
    )
    more, freedom = 2 * OF_FRICTION - len(x), len(v) - 2 * OF_FRICTION
    if freedom < 1:
        return []
    together = float((curve.residual(x, weight) ** 2).sum())
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
