"""Friction tests with faults of the sensors: glitches, a drifting force, a coarse velocity, too few points."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification import friction_test
from hydrotwin.models.language.errors import DataError
from tests.identification.test_plateaus import BOTH, SPEEDS, TRUTH, assert_true, kept, pushed

ONE_AFTER_THE_OTHER = (*SPEEDS, *(-v for v in SPEEDS))


def changed(recording, **columns):
    return recording.with_signals(columns)


@pytest.mark.parametrize(
    ("column", "at", "value"),
    [
        ("force", slice(5, None, 97), 9999.0),
        ("force", [50, 700, 1500], 9999.0),
        ("force", [50, 250, 700, 1500], -32768.0),
        ("force", slice(1240, 1250), 0.0),
        ("velocity", slice(5, None, 97), 9.0),
        ("velocity", [50, 51, 700], 0.0),
    ],
    ids=["every 97th", "three", "negative", "a burst of zeros", "velocity", "two zeros of velocity"],
)
def test_a_glitch_is_left_out_of_its_plateau_and_told(column, at, value):
    recording = pushed(kept(BOTH))
    values = recording[column].copy()
    values[at] = value
    fit = friction_test([changed(recording, **{column: values})])
    assert len(fit.velocity) == len(BOTH)
    assert_true(fit)
    faults = [stretch for stretch in fit.dropped if stretch.fault]
    assert faults and all(f"{value:.4g}" in stretch.reason for stretch in faults)
    samples = sum(stretch.samples for stretch in faults)
    assert any(f"{samples} samples stand far" in said and str(faults[0]) in said for said in fit.findings)
    inside = [k for k in np.arange(len(values))[at] if 10 <= k % 100 < 90]  # the edges of plateaus are not used
    assert samples >= len(inside)


def test_a_plateau_that_is_all_glitches_gives_no_point():
    recording = pushed(kept(BOTH))
    force = recording["force"].copy()
    force[510:590:2] = 9999.0
    fit = friction_test([changed(recording, force=force)])
    assert len(fit.velocity) == len(BOTH) - 1
    assert_true(fit)
    assert [("force" in stretch.reason, stretch.fault) for stretch in fit.dropped] == [(True, False)]


@pytest.mark.parametrize("rate", [1.5, -1.5, 15.0])
@pytest.mark.parametrize("speeds", [BOTH, ONE_AFTER_THE_OTHER], ids=["alternating", "one after the other"])
def test_a_force_that_drifts_gives_the_friction_without_the_drift(speeds, rate):
    recording = pushed(kept(speeds))
    fit = friction_test([changed(recording, force=recording["force"] + rate * recording.time)])
    assert_true(fit)
    assert abs(fit.drift.value - rate) < 4 * fit.drift.sigma < 0.1 * abs(rate)
    assert any("the force drifts by" in said for said in fit.findings)
    assert not any("load of" in said or "differs between" in said for said in fit.findings)
    assert fit.told[-1] is fit.drift and fit.force == pytest.approx(fit.curve(fit.velocity), abs=1.0)


def test_a_drift_that_is_not_steady_is_told_to_be_rough():
    recording = pushed(kept(BOTH, 2.0))
    warming = 60.0 * (1 - np.exp(-recording.time / 15.0))
    findings = friction_test([changed(recording, force=recording["force"] + warming)]).findings
    assert any("its rate changes from plateau to plateau" in said for said in findings)
    steady = friction_test([changed(recording, force=recording["force"] + 1.5 * recording.time)]).findings
    assert any("drifts" in said for said in steady) and not any("its rate changes" in said for said in steady)


def test_a_drift_that_a_coarse_force_hides_within_the_plateaus_is_not_called_a_direction():
    recording = pushed(kept(BOTH, 2.0), ramp=0.1)
    drifting = recording["force"] + 1.5 * recording.time
    findings = friction_test([changed(recording, force=np.round(drifting / 20) * 20)]).findings
    assert any("drifts by 1.5" in said and "hold the drift" in said for said in findings)
    assert not any("differs between the directions, and one curve" in said for said in findings)


def test_no_drift_is_fitted_where_there_is_none():
    for seed in range(5):
        assert friction_test([pushed(kept(BOTH), load=80.0, seed=seed)]).drift is None


def test_a_drift_in_several_recordings_is_told_and_not_guessed():
    records = [pushed([(v, 5.0)], name=f"run {k}", seed=k) for k, v in enumerate(BOTH)]
    assert not any("drifts" in said for said in friction_test(records).findings)
    drifting = [changed(r, force=r["force"] + 1.0 * r.time) for r in records]
    fit = friction_test(drifting)
    assert fit.drift is None
    assert any("drifts by" in said and "is not taken out" in said for said in fit.findings)


@pytest.mark.parametrize("step", [5e-4, 1e-3, 2e-3])
@pytest.mark.parametrize("ramp", [0.0, 0.1])
def test_a_coarse_velocity_shows_every_speed_once(step, ramp):
    recording = pushed(kept(BOTH, 2.0), ramp=ramp)
    rounded = np.round(recording["velocity"] / step) * step
    fit = friction_test([changed(recording, velocity=rounded)])
    assert len(fit.velocity) == len(BOTH)
    for c in fit.coefficients:
        assert abs(c.value - TRUTH[c.name]) < 4 * c.sigma


@pytest.mark.parametrize(
    ("speeds", "lacking"),
    [
        (SPEEDS[::3], "4 points are too few for 4 coefficients.* At least 5 points are needed: record 1 more"),
        ((*SPEEDS[::3], -0.03), "5 points are too few for 5 coefficients.*load.* record 1 more"),
        (SPEEDS[:3], "3 different speeds in 3 points cannot show.* At least 4 speeds are needed"),
    ],
)
def test_what_is_lacking_is_said_rightly(speeds, lacking):
    with pytest.raises(DataError, match=lacking):
        friction_test([pushed(kept(speeds))])
