"""Friction tests as people record them: loads, one direction, short plateaus, ramps, noise, several files."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification import friction_test, stribeck
from hydrotwin.models.language.errors import DataError
from hydrotwin.records import Record

TRUTH = {"kinetic": 200.0, "static": 300.0, "viscous": 1000.0, "stribeck_velocity": 0.02}
SPEEDS = (0.002, 0.004, 0.007, 0.012, 0.02, 0.03, 0.045, 0.06, 0.08, 0.1)
BOTH = tuple(sign * speed for speed in SPEEDS for sign in (1, -1))
MASS = 100.0  # kg: what a ramp of speed adds to the force


def pushed(levels, *, ramp=0.0, rate=100.0, load=0.0, noise=(1e-4, 1.0), friction=None, name="push", seed=0) -> Record:
    """A recording that keeps each speed of ``levels`` (v, seconds), with ``ramp`` s of acceleration before it."""
    v, before = [], 0.0
    for speed, seconds in levels:
        v += [*np.linspace(before, speed, round(ramp * rate), endpoint=False), *[speed] * round(seconds * rate)]
        before = speed
    v, time = np.array(v), np.arange(len(v)) / rate
    force = (friction or true_friction)(v) + load + MASS * np.gradient(v, time)
    if ramp == 0:
        force -= MASS * np.gradient(v, time)
    spread = np.random.default_rng(seed).standard_normal((2, len(v)))
    columns = {"velocity": v + noise[0] * spread[0], "force": force + noise[1] * spread[1]}
    return Record(time, columns, {"velocity": "m/s", "force": "N"}, name)


def true_friction(v):
    return stribeck(v, *TRUTH.values())


def kept(speeds, seconds=1.0):
    return [(v, seconds) for v in speeds]


def assert_true(fit, load=0.0):
    for c in fit.coefficients:
        assert abs(c.value - TRUTH[c.name]) < 4 * c.sigma, c
        assert c.value == pytest.approx(TRUTH[c.name], rel=0.05)
    assert abs(fit.load.value - load) < max(4 * fit.load.sigma, 1e-6)


@pytest.mark.parametrize("load", [80.0, -250.0])
def test_a_constant_load_is_separated_where_both_directions_were_pushed(load):
    fit = friction_test([pushed(kept(BOTH), load=load)])
    assert_true(fit, load)
    assert "constant load" in fit.findings[0]


@pytest.mark.parametrize(("direction", "kinetic"), [(1, 280.0), (-1, 120.0)])
def test_one_direction_alone_does_not_tell_the_load_from_friction(direction, kinetic):
    fit = friction_test([pushed(kept([direction * v for v in SPEEDS]), load=80.0)])
    level, static, viscous, v_s = fit.coefficients
    assert fit.load is None
    assert np.isinf(level.sigma) and level.interval == (0, np.inf)
    assert np.isinf(static.sigma) and static.interval[0] == pytest.approx(100, abs=2) and static.interval[1] == np.inf
    assert viscous.interval[0] < 1000 < viscous.interval[1] and viscous.sigma < 10
    assert v_s.interval[0] < 0.02 < v_s.interval[1]
    (said,) = fit.findings
    assert "same direction" in said and "give the load" in said
    assert level.value == pytest.approx(kinetic, abs=1) and f"load is {level.value:.5g}" in said


def test_a_load_that_is_given_makes_one_direction_enough():
    fit = friction_test([pushed(kept(SPEEDS), load=80.0)], load=80.0)
    for c in fit.coefficients:
        assert abs(c.value - TRUTH[c.name]) < 4 * c.sigma < 0.1 * TRUTH[c.name]
    assert not fit.findings
    assert fit.force == pytest.approx(fit.curve(fit.velocity) + 80.0, abs=1.0)


@pytest.mark.parametrize(
    "recording",
    [
        pushed(kept(BOTH, 0.2)),
        pushed(kept(BOTH, 0.1), ramp=0.1),
        pushed(kept(BOTH, 0.05), rate=1000.0),
        pushed([(v, min(10.0, 0.1 / abs(v))) for v in BOTH], ramp=0.1),
        pushed(kept(BOTH), ramp=1.0),
        pushed([pair for v in BOTH for pair in ((v, 1.0), (0.0, 0.5))]),
        pushed(kept(BOTH), noise=(2e-3, 1.0)),
        pushed(kept(BOTH), noise=(0.0, 0.0), ramp=0.5),
    ],
    ids=["0.2 s", "0.1 s and ramps", "50 ms", "by stroke", "slow ramps", "rests between", "noisy speed", "no noise"],
)
def test_every_plateau_is_found_by_its_own_length(recording):
    fit = friction_test([recording])
    assert len(fit.velocity) == len(BOTH)
    assert_true(fit)


def test_what_gives_no_point_is_told_with_its_reason():
    fit = friction_test([pushed([pair for v in BOTH for pair in ((v, 1.0), (0.0, 0.5))], ramp=0.2)])
    reasons = [stretch.reason for stretch in fit.dropped]
    assert sum("rest" in reason for reason in reasons) == len(BOTH)
    assert sum("speed changes" in reason for reason in reasons) == 2 * len(BOTH)
    first = fit.dropped[0]
    assert (first.recording, first.start) == ("push", 0.0) and first.end == pytest.approx(0.19, abs=0.04)
    recording = pushed(kept(BOTH))
    jump = np.where((recording.time > 3.5) & (recording.time < 7.5), 60.0, 0.0)
    fit = friction_test([recording.with_signals({"force": recording["force"] + jump})])
    assert ["force changes by" in stretch.reason for stretch in fit.dropped] == [True, True]


@pytest.mark.parametrize("period", [5.0, 0.2])
def test_ramps_alone_are_refused(period):
    recording = pushed([(v, 0.0) for v in (0.1, -0.1, 0.1, -0.1, 0.0)], ramp=period)
    with pytest.raises(DataError, match=r"different speeds.*Left out: push, 0 s to .*the speed changes all along it"):
        friction_test([recording])


def test_one_speed_many_times_is_one_speed():
    with pytest.raises(DataError, match="1 different speeds in 4 points"):
        friction_test([pushed([(0.05, 1.0), (0.0, 0.5)] * 4)])


def test_one_file_a_speed_is_one_test():
    records = [pushed([(0, 0.5), (v, 1.0), (0, 0.5)], ramp=0.2, name=f"run {k}", seed=k) for k, v in enumerate(BOTH)]
    fit = friction_test(records)
    assert len(fit.velocity) == len(BOTH)
    assert_true(fit)
    assert {stretch.recording for stretch in fit.dropped} == {r.name for r in records}


def test_friction_that_differs_by_direction_is_said_to_differ():
    def friction(v):
        return np.where(v > 0, true_friction(v), stribeck(v, 260.0, 360.0, 700.0, 0.02))

    fit = friction_test([pushed(kept(BOTH), friction=friction)])
    assert any("differs between the directions" in said for said in fit.findings)
    assert fit.coefficients[2].interval[0] < 700 and fit.coefficients[2].interval[1] > 1000
    assert not any("differs between" in said for said in friction_test([pushed(kept(BOTH))]).findings)


def test_a_table_in_the_order_of_its_speeds_is_taken_row_by_row():
    v = np.array([sign * speed for sign in (1, -1) for speed in np.geomspace(1e-3, 0.1, 20)])
    table = Record(np.arange(40) * 1.0, {"velocity": v, "force": true_friction(v)}, {"velocity": "m/s", "force": "N"})
    assert friction_test([table]).values == pytest.approx(TRUTH, rel=1e-6)


def test_a_force_with_the_sign_of_friction_instead_of_the_push_is_refused():
    recording = pushed(kept(BOTH), load=80.0)
    turned = recording.with_signals({"force": -recording["force"]})
    with pytest.raises(DataError, match=r"acts against the motion.*--scale force=-1"):
        friction_test([turned])
