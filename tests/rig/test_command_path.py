"""What happens to a command on its way, checked by hand."""

from __future__ import annotations

import numpy as np
import pytest

from tests.rig import command_path as path
from tests.rig.sensors import play


def held(*values):
    return path.Signal.held(np.arange(len(values)), values)


def test_a_held_signal_keeps_its_value_until_the_next_sample():
    values, slopes = held(1.0, 2.0, 3.0).on(np.array([-1.0, 0.0, 0.5, 1.0, 1.999, 2.0, 9.0]))
    assert values.tolist() == [1, 1, 1, 2, 2, 3, 3]
    assert not slopes.any()


def test_the_deadband_takes_its_width_from_both_sides():
    assert path.command_deadband(held(-2.0, -0.5, 0.0, 0.5, 2.0), width=1.0).values.tolist() == [-1, 0, 0, 0, 1]


def test_play_follows_only_when_pushed():
    assert path.spool_hysteresis(held(0.0, 1.0, 0.8, 0.0, -1.0), width=0.5).values.tolist() == [
        0,
        0.75,
        0.75,
        0.25,
        -0.75,
    ]
    assert play(np.array([0.0, 1.0, 0.8, 0.0, -1.0]), 0.5).tolist() == [0, 0.75, 0.75, 0.25, -0.75]


def test_a_rate_limit_ramps_and_arrives_between_samples():
    signal = path.rate_limit(held(0.0, 1.0, 1.0, -3.0, -3.0), rate=2.0)
    values, _ = signal.on(np.array([0.0, 1.0, 1.25, 1.5, 2.0, 3.0, 4.0, 4.5, 5.0, 6.0]))
    assert values == pytest.approx([0, 0, 0.5, 1, 1, 1, -1, -2, -3, -3])


def test_lost_packets_repeat_the_last_one_that_came():
    signal = path.packet_loss(held(*range(200)), share=0.3, seed=1)
    kept = signal.values == np.arange(200)
    assert 0.2 < 1 - kept.mean() < 0.4
    assert np.all(np.diff(signal.values) >= 0)
    assert set(signal.values) == set(np.flatnonzero(kept))


def test_asymmetry_saturation_bias_and_rounding_act_sample_by_sample():
    assert path.direction_asymmetry(held(-2.0, 2.0), ratio=0.5).values.tolist() == [-1, 2]
    assert path.command_saturation(held(-9.0, 1.0), limit=3.0).values.tolist() == [-3, 1]
    assert path.null_bias(held(-1.0, 1.0), value=0.25).values.tolist() == [-0.75, 1.25]
    assert path.command_quantisation(held(0.12, 0.19), step=0.1).values == pytest.approx([0.1, 0.2])
