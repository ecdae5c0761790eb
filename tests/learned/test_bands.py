"""Scores of a band, and what is done about one that covers too little or too much."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.learned.bands import GOOD, band_of, calibrated, independent, scores, with_arrays
from tests.learned.test_feedback_gp import tank_block, tank_record
from tests.learned.toy_machine import toy_record, untrained_block


@pytest.fixture
def tank():
    return tank_block()


def test_a_right_band_scores_as_the_gaussian_does():
    rng = np.random.default_rng(0)
    sd = rng.uniform(0.5, 2.0, 20_000)
    found = scores(sd * rng.normal(size=20_000), sd)
    assert found["coverage"] == pytest.approx(0.95, abs=0.01) and found["factor"] == pytest.approx(1.0, abs=0.03)
    assert found["nlpd"] == pytest.approx(np.mean(np.log(sd)) + 0.5 * np.log(2 * np.pi * np.e), abs=0.03)
    assert found["crps"] == pytest.approx(np.mean(sd) / np.sqrt(np.pi), rel=0.03)
    assert found["independent"] == pytest.approx(20_000, rel=0.1)


def test_the_crps_is_that_of_scoringrules():
    scoringrules = pytest.importorskip("scoringrules")
    rng = np.random.default_rng(1)
    miss, sd = rng.normal(size=50), rng.uniform(0.5, 2.0, 50)
    assert scores(miss, sd)["crps"] == pytest.approx(float(np.mean(scoringrules.crps_normal(miss, 0.0, sd))), rel=1e-9)


def test_misses_that_are_alike_for_long_are_few():
    rng = np.random.default_rng(2)
    slow = np.repeat(rng.normal(size=100), 50)
    assert 50 < independent(slow) < 200 and independent(np.ones(500)) < 3


def test_a_band_that_is_far_too_narrow_is_widened_and_said_not_to_be_trusted(tank):
    record = tank_record(7)
    narrow = with_arrays(tank, {name: 0.05 * tank.arrays[name] for name in ("run_scale", "step_scale")})
    assert band_of(narrow, [record])["level"]["free_run"]["coverage"] < 0.6
    mended = calibrated(narrow, [(narrow, [record])])
    told = mended.provenance["band"]["level"]
    assert not told["trustworthy"] and "do not trust" in told["says"] and told["calibrated"]["free_run"] > 2
    assert band_of(mended, [record])["level"]["free_run"]["coverage"] >= GOOD[0]


def test_a_right_band_is_left_nearly_as_it_is(tank):
    record = tank_record(8)
    told = calibrated(tank, [(tank, [record])]).provenance["band"]["level"]
    assert 0.5 < told["calibrated"]["free_run"] < 1.5 and told["trustworthy"]


def test_a_block_without_deviations_gets_a_conformal_band_in_words():
    block, record = untrained_block(), toy_record(3)
    found = band_of(block, [record])["arm_angle"]
    assert found["source"] == "conformal" and found["one_step"]["half_width"] > 0
    run = calibrated(block, [(block, [record])])
    assert all(np.array_equal(run.arrays[k], block.arrays[k]) for k in block.arrays)
    assert "tells no deviation of arm_angle" in run.provenance["band"]["arm_angle"]["says"]
