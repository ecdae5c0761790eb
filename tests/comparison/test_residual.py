"""Residual analysis on errors whose origin is known."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.comparison import explain
from hydrotwin.records import Record

TIME = np.arange(0.0, 40.0, 0.01)
RANDOM = np.random.default_rng(5)
FORCE = np.convolve(RANDOM.standard_normal(len(TIME) + 199), np.hanning(200) / 100, "valid")
NOISE = 0.01 * RANDOM.standard_normal(len(TIME))


def record(measured):
    return Record(TIME, {"force": FORCE, "x": measured}, {"force": "N", "x": "m"}, "run")


def test_white_noise_is_called_only_noise():
    truth = np.sin(TIME)
    found = explain(record(truth + NOISE), "x", truth, model="m", noise=0.01)
    assert found.only_noise
    assert found.white_percent >= 84.0
    assert found.times_noise == pytest.approx(1.0, abs=0.05)
    assert found.follows == ""
    assert found.correlation_time == pytest.approx(0.01)


def test_an_error_that_follows_a_signal_names_it_and_its_lag():
    delayed = np.r_[np.full(30, FORCE[0]), FORCE[:-30]]
    found = explain(record(np.sin(TIME) + NOISE), "x", np.sin(TIME) + 0.5 * delayed, model="m", noise=0.01)
    assert found.follows == "force"
    assert found.strength > 0.95
    assert found.lag == pytest.approx(0.30, abs=0.02)
    assert not found.only_noise


def test_the_sign_tells_a_prediction_that_is_too_low_where_the_signal_is_high():
    found = explain(record(np.sin(TIME) + NOISE), "x", np.sin(TIME) - 0.5 * FORCE, model="m", noise=0.01)
    assert found.strength < -0.95


def test_explained_is_the_share_of_the_measured_variance():
    truth = np.sin(TIME)
    found = explain(record(truth), "x", 0.5 * truth, model="m")
    assert found.explained_percent == pytest.approx(75.0, abs=0.1)
    assert np.isnan(found.times_noise)


def test_a_time_axis_that_is_not_uniform_gives_the_same_answer():
    keep = np.sort(RANDOM.choice(len(TIME), 3000, replace=False))
    sparse = Record(TIME[keep], {"force": FORCE[keep], "x": np.sin(TIME)[keep]}, {"force": "N", "x": "m"}, "sparse")
    found = explain(sparse, "x", (np.sin(TIME) + 0.5 * FORCE)[keep], model="m")
    assert found.follows == "force"
    assert found.strength > 0.95
