"""The constant-speed friction test gives the coefficients of Table 1 back."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification import fit_stribeck, friction_test, stribeck
from hydrotwin.models.language.errors import DataError
from hydrotwin.records.record import Record
from tests import rig

TABLE_1 = {"kinetic": 1.87, "static": 13.15, "viscous": 741.36, "stribeck_velocity": 0.0028}
UNITS = {"velocity": "m/s", "force": "N"}


def points(seed: int, noise: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    v = np.concatenate([sign * np.geomspace(3e-4, 0.08, 20) for sign in (1, -1)])
    return v, stribeck(v, *TABLE_1.values()) + noise * np.random.default_rng(seed).normal(size=len(v))


def pulled(seed: int) -> Record:
    columns = rig.friction_test(seed=seed)
    time = columns.pop("time")
    return Record(time, columns, UNITS, name=f"pull_{seed}")


def test_table_1_comes_back_from_its_own_curve():
    fit = fit_stribeck(*points(0, noise=0.0))
    assert fit.values == pytest.approx(TABLE_1, rel=1e-6)


def test_intervals_hold_table_1_as_often_as_they_say():
    inside = []
    for seed in range(80):
        fit = fit_stribeck(*points(seed))
        inside.append([c.interval[0] <= TABLE_1[c.name] <= c.interval[1] for c in fit.coefficients])
    assert np.all(np.mean(inside, axis=0) > 0.88)
    assert np.mean(inside) < 0.995


@pytest.mark.parametrize("seed", range(6))
def test_table_1_comes_back_from_recorded_pulls_with_noise(seed):
    fit = friction_test([pulled(seed)])
    assert len(fit.velocity) == 20
    for c in fit.coefficients:
        assert abs(c.value - TABLE_1[c.name]) < 4 * c.sigma
    assert fit.values["viscous"] == pytest.approx(741.36, rel=0.02)
    assert fit.values["static"] == pytest.approx(13.15, rel=0.1)
    assert fit.values["stribeck_velocity"] == pytest.approx(0.0028, rel=0.1)


def test_a_table_of_points_is_taken_row_by_row():
    v, F = points(1)
    order = np.random.default_rng(1).permutation(len(v))
    record = Record(np.arange(len(v)) * 1.0, {"velocity": v[order], "force": F[order]}, UNITS, name="figure 7")
    assert friction_test([record]).values == pytest.approx(fit_stribeck(v, F).values, rel=1e-6)


def test_friction_without_a_stribeck_hump_is_said_to_have_none():
    v = np.concatenate([np.linspace(0.01, 0.08, 12), -np.linspace(0.01, 0.08, 12)])
    F = 5 * np.sign(v) + 700 * v + 0.2 * np.random.default_rng(0).normal(size=len(v))
    fit = fit_stribeck(v, F)
    assert fit.findings
    assert fit.values["viscous"] == pytest.approx(700, rel=0.05)


def test_too_few_speeds_are_refused():
    v = np.array([0.01, 0.01, 0.02, 0.02, -0.01, -0.02])
    with pytest.raises(DataError, match="2 different speeds in 6 points cannot show the four coefficients"):
        fit_stribeck(v, 700 * v)


def test_a_missing_column_is_refused():
    with pytest.raises(DataError, match="no column 'speed'"):
        friction_test([pulled(0)], velocity="speed")
    with pytest.raises(DataError, match="no recording"):
        friction_test([])


@pytest.mark.parametrize("law", ("quadratic", "another hump", "another load in each"))
def test_friction_of_another_law_is_said_to_leave_more_than_noise(law):
    v = np.repeat(np.geomspace(2e-3, 0.3, 12), 2) * np.tile([1.0, -1.0], 12)
    F = stribeck(v, 200.0, 300.0, 1000.0, 0.02)
    F += {
        "quadratic": 8000 * v * np.abs(v),
        "another hump": 100 * np.sign(v) * (np.exp(-np.abs(v) / 0.02) - np.exp(-((v / 0.02) ** 2))),
        "another load in each": np.repeat([0.0, 100.0], 12),
    }[law]
    noise = np.random.default_rng(1).normal(0, 0.2, len(v))
    said = " ".join(fit_stribeck(v, F + noise, 0.0, 0.2).findings)
    assert "the curve leaves" in said and "Friction follows another law" in said


@pytest.mark.parametrize("seed", range(5))
def test_friction_of_this_law_is_not(seed):
    v = np.repeat(np.geomspace(2e-3, 0.3, 12), 2) * np.tile([1.0, -1.0], 12)
    noise = np.random.default_rng(seed).normal(0, 0.2, len(v))
    assert "leaves" not in " ".join(fit_stribeck(v, stribeck(v, 200.0, 300.0, 1000.0, 0.02) + noise, 0.0, 0.2).findings)
