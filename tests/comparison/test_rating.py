"""The rating of ISO/TS 18571 and the lag against closed forms, a full table of time warping and another program."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.comparison.rating import rating
from hydrotwin.comparison.shift import correlations, lag
from hydrotwin.comparison.warping import interpreted, warped

TIME = np.linspace(0.0, 1.0, 401)
SWING = np.sin(2 * np.pi * 2 * TIME)
THEIRS = (
    0.411187874709,
    0.9,
    0.849339750741,
    0.714362285187,
    0.657215557069,
)  # corridor, phase, magnitude, slope, overall


def test_a_curve_is_rated_one_against_itself():
    found = rating([SWING], [SWING])
    assert (found.corridor, found.phase, found.magnitude, found.slope) == (1.0, 1.0, 1.0, 1.0)
    assert found.overall == pytest.approx(1.0)


def test_a_scaled_curve_has_the_slope_and_the_corridor_of_paper():
    found = rating([SWING], [0.8 * SWING])
    off = 0.2 * np.abs(SWING) / np.abs(SWING).max()
    assert found.slope == pytest.approx(1 - 0.2 / 2)
    assert found.corridor == pytest.approx(np.mean(np.minimum((0.5 - off) / 0.45, 1.0) ** 2))
    assert found.phase == 1.0


def test_a_late_curve_loses_phase_alone():
    pulse = np.exp(-(((TIME - 0.4) / 0.05) ** 2))
    late = np.exp(-(((TIME - 0.5) / 0.05) ** 2))
    found = rating([pulse], [late])
    assert found.phase == pytest.approx(1 - 40 / (0.2 * 401))
    assert found.magnitude == pytest.approx(1.0) and found.slope == pytest.approx(1.0)
    assert found.corridor < 0.9


def test_the_ratings_are_those_of_another_program():
    """Figures of the package objective-rating-metrics 1.3 (TU Graz, MIT) for the same two curves."""
    x = np.linspace(0.0, 1.0, 200)
    measured = np.sin(2 * np.pi * 1.7 * x + 0.3) + 0.4
    predicted = 0.9 * np.sin(2 * np.pi * 2 * (x - 0.03)) + 0.1 * np.cos(40 * x) + 0.5
    found = rating([measured], [predicted])
    parts = (found.corridor, found.phase, found.magnitude, found.slope, found.overall)
    assert parts == pytest.approx(THEIRS, abs=1e-9)


@pytest.mark.parametrize("curve", [np.ones(401), np.zeros(401)])
def test_what_does_not_move_is_not_rated(curve):
    assert np.isnan(rating([curve], [SWING]).overall) and np.isnan(rating([SWING], [curve]).overall)
    assert np.isnan(lag([curve], [SWING], 0.1, 0.2)).all()


def test_time_is_warped_along_the_path_of_least_sum():
    random = np.random.default_rng(3)
    a, b, reach = random.standard_normal(40), random.standard_normal(40), 6
    first, second = warped(a, b, reach)
    steps = {(1, 0), (0, 1), (1, 1)}
    assert set(zip(np.diff(first).tolist(), np.diff(second).tolist(), strict=True)) <= steps
    assert np.abs(first - second).max() <= reach and (first[0], second[0], first[-1], second[-1]) == (0, 0, 39, 39)
    assert np.sum((a[first] - b[second]) ** 2) == pytest.approx(_least(a, b, reach))


@pytest.mark.parametrize(("n", "reach"), [(1, 0), (2, 1), (40, 0), (40, 6), (40, 60), (301, 30)])
def test_compiled_and_by_numpy_time_is_warped_along_the_same_path(n, reach):
    random = np.random.default_rng(n)
    for a, b in ((random.standard_normal(n), random.standard_normal(n)), (np.ones(n), np.ones(n))):  # all ways equal
        compiled, by_numpy = warped(a, b, reach), interpreted(a, b, reach)
        assert all(np.array_equal(*pair) for pair in zip(compiled, by_numpy, strict=True))


def _least(a, b, reach):
    """The whole table, cell by cell."""
    sums = np.full((len(a) + 1, len(b) + 1), np.inf)
    sums[0, 0] = 0.0
    for i in range(len(a)):
        for j in range(max(0, i - reach), min(len(b), i + reach + 1)):
            sums[i + 1, j + 1] = (a[i] - b[j]) ** 2 + min(sums[i, j + 1], sums[i + 1, j], sums[i, j])
    return sums[-1, -1]


def test_correlations_are_those_of_numpy():
    random = np.random.default_rng(4)
    y, p = random.standard_normal(60), random.standard_normal(60)
    found = correlations([y], [p], 12)
    for k in (-12, -5, 0, 3, 12):
        mine, theirs = (y[: 60 - k], p[k:]) if k >= 0 else (y[-k:], p[:k])
        assert found[12 + k] == pytest.approx(np.corrcoef(mine, theirs)[0, 1])


@pytest.mark.parametrize("late", [-0.0137, 0.0, 0.0213])
def test_the_lag_is_found_between_samples(late):
    pulse, moved = (np.exp(-(((TIME - at) / 0.08) ** 2)) for at in (0.5, 0.5 + late))
    assert lag([pulse], [moved], 1 / 400, 0.2) == (pytest.approx(late, abs=1e-4), pytest.approx(np.nan, nan_ok=True))
