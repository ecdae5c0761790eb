"""What a residual follows, told of residuals made from what was seen, and of one made from what was not."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hydrotwin.discovery.diagnosis.regions import Carrier
from hydrotwin.discovery.diagnosis.unknown import describe_unknown, strongest

from .test_regions import MACHINE, NOISE, POSITION, PRESSURE, SPEED, only, scene


def described(gap, output="pressure_cap", held_back=True):
    recordings, left = scene(gap, seeds=(0, 1, 2, 3))
    split = 2 if held_back else 4
    rows = describe_unknown(MACHINE, recordings[:split], left[:split], recordings[split:], left[split:], NOISE)
    return {row.output: row for row in rows}[output]


def turns(t, y):
    """Angle of the motor [rad], from the middle of each sample to the next."""
    w = y[:, SPEED]
    return np.concatenate([[0.0], np.cumsum(0.5 * (w[1:] + w[:-1]) * np.diff(t))])


def test_seven_times_a_turn_of_the_motor_is_found_without_its_angle():
    found = described(lambda t, u, y: only(PRESSURE, 1.2e5 * np.sin(7.0 * turns(t, y) + 0.4)))
    assert found.inputs == ("motor_speed",)
    assert "following motor_speed periodically (7.0 times a turn)" in found.sentence
    assert re.search(r"off by up to 1\.[12]\d* bar", found.sentence)
    assert found.explained > 0.9
    size, k = re.search(r"([\d.e+]+) Pa cos\(([\d.]+) integral\(motor_speed\) \+ phase\)", found.formula).groups()
    assert float(size) == pytest.approx(1.2e5, rel=0.05)
    assert float(k) == pytest.approx(7.0, abs=0.02)


def test_a_pattern_along_a_rod_is_found_with_its_pitch():
    found = described(lambda t, u, y: only(PRESSURE, 1e5 * np.cos(2 * np.pi * y[:, POSITION] / 0.005)))
    assert found.inputs == ("rod_position",)
    assert re.search(r"rod_position periodically \(every (5|4\.99|5\.0\d?) mm\)", found.sentence)


def test_a_hum_of_fixed_frequency_is_found_in_time():
    found = described(lambda t, u, y: only(PRESSURE, 5e4 * np.sin(2 * np.pi * 12.5 * t)))
    assert found.inputs == ("time",)
    assert "12.5 times a second" in found.sentence


def test_a_residual_that_follows_the_sign_of_the_speed_has_that_formula():
    found = described(lambda t, u, y: only(PRESSURE, 6e4 * np.sign(y[:, SPEED])))
    assert len(found.inputs) == 1 and found.explained > 0.9
    size, term = re.search(r"([\d.e+]+) Pa (sign\(.*\))", found.formula).groups()
    assert float(size) == pytest.approx(6e4, rel=0.05)
    assert term in ("sign(motor_speed)", "sign(der(rod_position))")


def test_a_square_has_its_coefficient_with_its_unit():
    found = described(lambda t, u, y: only(PRESSURE, 2e4 * u**2))
    assert found.inputs == ("command",)
    assert float(re.search(r"([\d.e+]+) Pa/V\^2 command\^2", found.formula)[1]) == pytest.approx(2e4, rel=0.05)


def test_a_surface_over_two_quantities_is_described_without_a_formula():
    def gap(t, u, y):
        return only(SPEED, 8.0 * np.sin(2.0 * u) * np.cos(25.0 * (y[:, POSITION] - 0.3)))

    recordings, left = scene(gap, seeds=range(8))
    found = describe_unknown(MACHINE, recordings[:6], left[:6], recordings[6:], left[6:], NOISE)[0]
    assert found.output == "motor_speed" and found.formula == ""
    assert {"command", "rod_position"} <= set(found.inputs)
    assert found.explained > 0.5


def test_what_no_recorded_quantity_explains_is_said():
    hidden = iter(np.random.default_rng(k) for k in range(4))
    found = described(lambda t, u, y: only(PRESSURE, 6e4 * np.sign(next(hidden).standard_normal(len(t)))))
    assert found.sentence == "no recorded quantity explains what is left of pressure_cap: less than 10 %"
    assert found.explained < 0.1 and found.inputs == () and found.formula == ""


def test_without_recordings_for_choosing_the_later_halves_judge():
    found = described(lambda t, u, y: only(PRESSURE, 6e4 * np.sign(y[:, SPEED])), held_back=False)
    assert found.explained > 0.9


def test_no_effect_of_the_catalogue_is_named():
    found = described(lambda t, u, y: only(PRESSURE, 6e4 * np.sign(y[:, SPEED])))
    assert not re.search("friction|leak|backlash|deadband", found.sentence + found.formula)


def test_a_residual_within_the_noise_is_not_described():
    recordings, left = scene()
    small = [0.9 * r for r in left]
    assert describe_unknown(MACHINE, recordings[:2], small[:2], recordings[2:], small[2:], NOISE) == ()


def test_what_hardly_turns_carries_no_wave_and_no_frequency_is_negative():
    r = np.random.default_rng(0).standard_normal(2000)
    window = np.arange(2000) // 250
    for reach in (0.0, 1e-3, 2.0):
        angle = reach * np.linspace(0.0, 1.0, 2000)
        frequency, energy = strongest(Carrier("w", "rad", False, (angle,), 0.1, 40.0), angle, r, window)
        assert frequency > 0.0
        assert energy < 0.05 * float(r @ r)


def test_a_wave_is_found_by_its_frequency_though_every_window_has_another_phase():
    angle = 30.0 * np.linspace(0.0, 1.0, 2000) ** 1.3
    window = np.arange(2000) // 250
    phase = np.random.default_rng(0).uniform(0.0, 6.28, 8)[window]
    r = np.cos(2 * np.pi * 5.5 * angle + phase) + 0.5 * np.random.default_rng(1).standard_normal(2000)
    frequency, energy = strongest(Carrier("w", "rad", False, (angle,), 0.1, 40.0), angle, r, window)
    assert frequency == pytest.approx(5.5, rel=0.02)
    assert energy == pytest.approx(1000.0, rel=0.15)
