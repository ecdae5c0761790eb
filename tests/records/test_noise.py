"""The noise floor of a channel, on signals whose noise is known."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.language.units import parse_unit
from hydrotwin.records import Record, noise_floor
from hydrotwin.records.noise import channel_noise, quantisation_step, recorded_step

T = np.arange(8000) * 0.005


def arm_motion(t):
    return 0.8 * np.sin(0.7 * t) + 0.3 * np.sin(2.3 * t + 1)


@pytest.mark.parametrize("sigma", [1e-6, 1e-4, 1e-2])
@pytest.mark.parametrize("seed", range(4))
def test_white_noise_on_smooth_motion_is_found_to_six_percent(sigma, seed):
    rng = np.random.default_rng(seed)
    found = channel_noise(T, arm_motion(T) + sigma * rng.normal(size=T.size))
    assert found.sigma == pytest.approx(sigma, rel=0.06)
    assert found.quantum == 0.0


@pytest.mark.parametrize("seed", range(4))
def test_bursts_of_fast_motion_do_not_raise_the_floor(seed):
    rng = np.random.default_rng(seed)
    ringing = np.where(T % 10 < 6, np.sin(2 * np.pi * 35 * T), 0.0)
    found = channel_noise(T, arm_motion(T) + ringing + 1e-4 * rng.normal(size=T.size))
    assert found.sigma == pytest.approx(1e-4, rel=0.15)


@pytest.mark.parametrize("seed", range(4))
def test_uneven_time_does_not_raise_the_floor(seed):
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.001, 0.009, 8000))
    found = channel_noise(t, arm_motion(t) + 1e-4 * rng.normal(size=t.size))
    assert found.sigma == pytest.approx(1e-4, rel=0.08)


@pytest.mark.parametrize("q", [1e-3, 5e-4])
def test_a_resting_encoder_has_the_noise_of_its_step(q):
    motion = np.where(T < 10, 0.5 * np.sin(0.3 * T), 0.5 * np.sin(3.0))
    found = channel_noise(T, np.round(motion / q) * q)
    assert found.quantum == pytest.approx(q, rel=1e-6)
    assert found.sigma == pytest.approx(q / np.sqrt(12), rel=0.05)


@pytest.mark.parametrize("ratio", [0.5, 1.0, 3.0])
def test_noise_and_rounding_add_as_variances_and_are_not_counted_twice(ratio):
    rng = np.random.default_rng(1)
    q = 1e-2
    found = channel_noise(T, np.round((arm_motion(T) + ratio * q * rng.normal(size=T.size)) / q) * q)
    assert found.quantum == pytest.approx(q, rel=1e-6)
    assert found.sigma == pytest.approx(q * np.sqrt(ratio**2 + 1 / 12), rel=0.06)
    assert found.white == pytest.approx(q * ratio, rel=0.1)


def test_the_step_is_found_when_no_two_levels_are_neighbours():
    rng = np.random.default_rng(4)
    values = 0.1 + 0.05 * rng.choice([2, 5, 8, 14, 20, 26, 33], 1000)
    assert quantisation_step(values) == pytest.approx(0.05, rel=1e-6)
    wide = 0.05 * np.round(rng.uniform(0.0, 2000.0, 2000))  # a fast movement over many steps: two in three are new
    assert len(np.unique(wide)) > 0.6 * len(wide) and quantisation_step(wide) == pytest.approx(0.05, rel=1e-6)


def test_single_precision_levels_keep_their_step():
    rng = np.random.default_rng(4)
    values = (0.0625 * rng.integers(-100, 4000, 9000)).astype(np.float32).astype(float) * 1e5
    assert quantisation_step(values) == pytest.approx(6250.0, rel=1e-4)


def test_continuous_and_held_continuous_channels_have_no_step():
    rng = np.random.default_rng(4)
    assert quantisation_step(rng.normal(size=1000)) == 0.0
    assert quantisation_step(np.repeat(rng.normal(size=500), 10)) == 0.0
    assert quantisation_step(np.full(100, 3.7)) == 0.0


def test_a_constant_or_tiny_channel_has_no_noise_and_no_error():
    assert channel_noise(T, np.full(T.size, 2.0)).sigma == 0.0
    assert channel_noise(T[:3], np.array([1.0, 2.0, 4.0])).white == 0.0
    assert channel_noise(T[:7], np.random.default_rng(0).normal(size=7)).sigma > 0.0


def test_every_channel_of_a_record_gets_its_floor():
    rng = np.random.default_rng(0)
    signals = {"x": 1e-4 * rng.normal(size=T.size), "p": 1e4 * rng.normal(size=T.size)}
    floor = noise_floor(Record(T, signals, {"x": "m", "p": "Pa"}))
    assert floor["x"].sigma == pytest.approx(1e-4, rel=0.06)
    assert floor["p"].sigma == pytest.approx(1e4, rel=0.06)


@pytest.mark.parametrize("sigma", [0.1, 0.3])
def test_a_command_that_steps_in_every_block_does_not_count_as_noise(sigma):
    random, time = np.random.default_rng(0), np.arange(0, 20, 0.02)
    speed, wanted = np.zeros(1000), np.repeat(random.normal(size=34), 30)[:1000] * 50
    for k in range(1, 1000):
        speed[k] = speed[k - 1] + 0.3 * (wanted[k - 1] - speed[k - 1])
    noise = channel_noise(time, speed + sigma * random.normal(size=1000))
    assert noise.sigma == pytest.approx(sigma, rel=0.25)


def test_samples_that_a_slow_sensor_lacks_are_left_out():
    time = np.arange(0.0, 20.0, 0.01)
    values = np.sin(time) + 0.02 * np.random.default_rng(3).standard_normal(len(time))
    slow = np.where(np.arange(len(time)) % 10, np.nan, values)
    assert channel_noise(time, slow) == channel_noise(time[::10], values[::10])
    assert channel_noise(time, np.full(len(time), np.nan)).sigma == 0.0


def significant(values, digits):
    return np.array([float(f"{v:.{digits - 1}e}") for v in values])


@pytest.mark.parametrize("unit", ["m", "mm", "in", "deg", "rpm", "bar", "psi", "L/min"])
@pytest.mark.parametrize("digits", [3, 4, 6])
def test_significant_digits_are_found_in_whatever_unit_they_were_written(unit, digits):
    factor = parse_unit(unit).factor
    motion = 12.3 * arm_motion(T[::4])
    written = significant(motion, digits)
    found = channel_noise(T[::4], written * factor)
    assert found.sigma == pytest.approx(factor * np.std(written - motion), rel=0.1)


@pytest.mark.parametrize("decimals", [1, 2, 4])
def test_a_fixed_number_of_decimals_is_a_step(decimals):
    found = channel_noise(T, np.round(12.3 * arm_motion(T), decimals) * 1e5)
    assert found.quantum == pytest.approx(10.0 ** (5 - decimals), rel=1e-6)


def test_digits_of_a_small_signal_on_a_large_offset_are_found():
    signal = 1e7 + 3e3 * arm_motion(T)
    assert recorded_step(significant(signal, 6)) == pytest.approx(100.0, rel=0.3)
    assert recorded_step(np.float32(signal).astype(float)) == pytest.approx(1.0)


def test_full_precision_has_no_step():
    assert recorded_step(arm_motion(T)) == 0.0
    assert recorded_step(1e7 + 3e3 * arm_motion(T)) == 0.0
    assert recorded_step(np.zeros(100)) == 0.0
