"""What training sees of a recording: the period, the lags, the box, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hydrotwin.learned import domain_share
from hydrotwin.learned.linear.periods import affordable_period
from hydrotwin.learned.training_data import (
    check_excitation,
    choose_input_lags,
    choose_period,
    on_period,
    split_tail,
    training_box,
    usable,
)
from hydrotwin.models.language.errors import DataError, UnitError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from tests.learned.toy_machine import ANGLE, COMMAND, PERIOD, toy_record, untrained_block


def sine(frequency, rate=1000.0, duration=10.0, noise=0.0):
    t = np.arange(round(duration * rate)) / rate
    y = np.sin(2 * np.pi * frequency * t) + noise * np.random.default_rng(0).standard_normal(len(t))
    return Record(t, {"y": y}, {"y": "1"})


def test_a_faster_motion_needs_a_shorter_period():
    periods = [choose_period([sine(f)]) for f in (0.5, 2.0, 8.0)]
    assert periods[0] > periods[1] > periods[2]
    assert periods[1] == pytest.approx(0.02, rel=0.6)


def test_the_period_is_a_whole_number_of_samples_and_keeps_the_signal():
    record = sine(2.0)
    period = choose_period([record])
    assert period / 0.001 == pytest.approx(round(period / 0.001), abs=1e-9)
    kept = record.resample(period)
    lost = np.interp(record.time, kept.time, kept["y"]) - record["y"]
    assert np.sqrt(np.mean(lost[:-50] ** 2)) < 0.005


def test_coarse_recordings_keep_their_own_period():
    assert choose_period([sine(2.0, rate=25.0)]) == pytest.approx(0.04)


def test_few_samples_are_not_thinned():
    few, more = sine(2.0, duration=3.0), sine(0.5, duration=30.0)
    assert choose_period([few]) > 0.005
    assert affordable_period(([few], []), [], []) == pytest.approx(0.001), "3000 samples: none to spare"
    found = affordable_period(([more], []), [], [])
    assert found == pytest.approx(0.014) and found < choose_period([more]), "2000 of 30 000 are left"


@pytest.mark.parametrize("delay", [0, 3, 7])
def test_a_dead_time_asks_for_more_input_samples(delay):
    """With a hard command: a smooth one can be continued from its past, which hides the delay."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1, 1, 100), 10)
    late = np.r_[np.zeros(delay), u[: len(u) - delay]]
    speed = lfilter([0.3], [1, -0.7], late)
    angle = np.cumsum(np.r_[0.0, speed[:-1]]) * 0.02 + 1e-8 * rng.standard_normal(len(u))
    lags = choose_input_lags([u[:, None]], [angle[:, None]], 2)
    assert delay < lags <= delay + 6


def test_the_box_flags_a_recording_that_leaves_it():
    block = untrained_block()  # command -1..1, arm_angle 0..2
    t = np.arange(4.0)
    record = Record(t, {"command": [0, 1, 0, -1], "arm_angle": [0, 1, 2.5, 3]}, {"command": "V", "arm_angle": "rad"})
    share = domain_share(block, record)
    assert (share.inside, share.farthest, share.beyond) == (0.5, 0.5, ("arm_angle",))
    assert domain_share(block, record.select(["command"])).inside == 1.0


def test_a_block_without_a_box_or_a_recording_without_its_signals_is_refused():
    record = toy_record(1, duration=1.0)
    with pytest.raises(DataError, match="none of the signals of the training domain"):
        domain_share(untrained_block(), record.select(["motor_speed"]))


def test_the_training_box_is_the_range_over_all_recordings():
    records = [toy_record(s, duration=5.0) for s in (1, 2)]
    box = training_box(records, (COMMAND, ANGLE))
    both = np.concatenate([r.array(["command", "arm_angle"]) for r in records])
    assert box.names == ("command", "arm_angle")
    assert np.allclose([box.lower, box.upper], [both.min(axis=0), both.max(axis=0)])


def test_uneven_samples_come_onto_the_period_with_the_command_held():
    time = np.cumsum(np.random.default_rng(0).uniform(0.01, 0.03, 500))
    record = Record(time, {"command": np.sign(np.sin(time)), "arm_angle": time}, {"command": "V", "arm_angle": "rad"})
    even = on_period(record, 0.02, (COMMAND,))
    assert np.allclose(np.diff(even.time), 0.02) and set(np.unique(even["command"])) <= {-1.0, 0.0, 1.0}
    assert np.allclose(even["arm_angle"], even.time)


def test_the_held_out_tail_is_not_in_the_part_that_is_fitted():
    first, tail = split_tail(toy_record(1, duration=10.0), 0.2)
    assert first.time[-1] <= tail.time[0] and tail.duration == pytest.approx(2.0, abs=2 * PERIOD)


def damaged(change):
    record = toy_record(1, duration=5.0)
    angle, time = record["arm_angle"].copy(), record.time.copy()
    if change == "nan":
        angle[[70, 71]] = np.nan
    if change == "gap":
        time[100:] += 5.0
    return Record(time, {"command": record["command"], "arm_angle": angle}, record.units | {}, "run_3")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [("nan", r"'arm_angle' has 2 values that are not numbers, the first at 1\.4 s"), ("gap", "unbroken recording")],
)
def test_holes_in_a_recording_are_refused_with_their_place(change, sentence):
    with pytest.raises(DataError, match=rf"run_3: .*{sentence}"):
        usable([damaged(change)], (COMMAND, ANGLE))


def test_a_column_of_another_dimension_is_refused():
    with pytest.raises(UnitError, match="arm_angle"):
        usable([toy_record(1, duration=1.0)], (Signal("arm_angle", "Pa"),))


def test_a_signal_that_never_moves_is_refused_by_name():
    record = toy_record(1, duration=5.0)
    still = record.with_signals({"command": np.full(len(record), 1.5)})
    with pytest.raises(DataError, match=r"'command' never changes .*got 1\.5 V throughout"):
        check_excitation([still], (COMMAND, ANGLE))
    check_excitation([still, record], (COMMAND, ANGLE))
