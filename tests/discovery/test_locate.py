"""Where a residual sits and what it follows, told of residuals whose place is known."""

from __future__ import annotations

import re
import time as clock

import numpy as np
import pytest

from hydrotwin.discovery.diagnosis.locate import locations
from hydrotwin.identification.problem import Recording
from hydrotwin.models.language.amounts import amount

from .test_regions import MACHINE, NOISE, POSITION, PRESSURE, SPEED, only, scene


def located(output, gap, **more):
    recordings, left = scene(gap, **more)
    return {place.output: place for place in locations(MACHINE, recordings, left, NOISE)}[output]


def test_noise_is_white_and_has_no_place():
    recordings, left = scene()
    found = locations(MACHINE, recordings, left, NOISE)
    assert [place.output for place in found] == ["rod_position", "pressure_cap", "motor_speed", "tank_level"]
    assert all(place.white and not place.drivers for place in found)
    assert [place.times_noise for place in found] == pytest.approx([1.0] * 4, abs=0.05)
    assert not any(re.search("where [a-z_]", place.where) for place in found)


def test_a_residual_that_follows_the_direction_is_located_at_the_direction():
    place = located("pressure_cap", lambda t, u, y: only(PRESSURE, 4e4 * np.sign(np.gradient(y[:, POSITION]))))
    assert not place.white and place.times_noise == pytest.approx(np.sqrt(26), rel=0.05)
    assert "pressure_cap is simulated 0.4 bar too" in place.where
    up = r"(rod_position rises|motor_speed is positive|motor_speed > 0 rpm)"
    down = r"(rod_position falls|motor_speed is negative|motor_speed < 0 rpm)"
    assert re.search(rf"too high \(5 noise\) where {up}", place.where)
    assert re.search(rf"too low \((5|4.9) noise\) where {down}", place.where)


def test_a_residual_beyond_a_position_is_located_there_in_millimetres():
    place = located("pressure_cap", lambda t, u, y: only(PRESSURE, 5e4 * (y[:, POSITION] > 0.32)))
    edge = float(re.search(r"where rod_position > (\d+) mm", place.where)[1])
    assert edge == pytest.approx(320, abs=15)
    assert "too low" not in place.where


def test_a_vibration_at_one_place_is_located_by_its_size():
    def gap(t, u, y):
        return only(SPEED, 5.0 * np.sin(300 * t) * (y[:, PRESSURE] > 3.4e6))

    place = located("motor_speed", gap)
    said = re.search(r"motor_speed is ([\d.]+) noise off where (\w+) > ([\d.]+) (bar|mm), ([\d.]+) noise", place.where)
    assert said, place.where
    assert float(said[1]) > 4 and float(said[5]) < 3


def test_an_offset_is_off_everywhere():
    place = located("tank_level", lambda t, u, y: only(3, np.full(len(t), -8e-4)))
    size = re.fullmatch(r"tank_level is simulated ([\d.]+) mm too low \(8 noise\) everywhere", place.where)[1]
    assert float(size) == pytest.approx(0.8, abs=0.01)


def test_a_residual_that_comes_late_names_its_driver_and_the_lag():
    def gap(t, u, y):
        return only(SPEED, -2.0 * np.interp(t - 0.3, t, u))

    first = located("motor_speed", gap).drivers[0]
    assert first[0] == "command"
    assert first[1] == pytest.approx(-0.97, abs=0.03)
    assert first[2] == pytest.approx(0.3, abs=0.03)


def test_a_residual_that_comes_before_its_input_has_no_negative_lag():
    def gap(t, u, y):
        return only(SPEED, 2.0 * np.interp(t + 0.3, t, u))

    drivers = located("motor_speed", gap).drivers
    assert drivers and all(lag >= 0.0 for _, _, lag in drivers)


def test_a_slow_wander_that_has_nothing_to_do_with_the_input_has_no_driver():
    hits = 0
    for seed in range(20):
        wander = np.cumsum(np.random.default_rng(seed).standard_normal(3000)) * 0.1
        hits += bool(located("motor_speed", lambda t, u, y, w=wander: only(SPEED, w)).drivers)
    assert hits <= 2


def test_uneven_time_missing_values_diverged_runs_and_short_recordings_are_taken():
    recordings, left = scene(lambda t, u, y: only(PRESSURE, 6e4 * np.sign(y[:, SPEED])))
    keep = np.sort(np.random.default_rng(0).choice(3000, 1800, replace=False))
    uneven = Recording("uneven", None, recordings[0].time[keep], recordings[0].u[keep], recordings[0].y[keep])
    holes = left[0][keep].copy()
    holes[::9] = np.nan
    short = Recording("short", None, np.array([0.0, 0.1, 0.3]), np.zeros((3, 1)), np.ones((3, 4)))
    lost = np.full_like(left[1], np.inf)
    rows = locations(MACHINE, [uneven, recordings[1], short], [holes, lost, np.zeros((3, 4))], NOISE)
    assert "too high" in rows[PRESSURE].where and "too low" in rows[PRESSURE].where
    only_short = locations(MACHINE, [short], [np.full((3, 4), 9.0)], NOISE)
    assert len(only_short) == 4 and only_short[0].white


def test_an_output_that_was_not_measured_has_no_row():
    recordings, left = scene()
    noise = NOISE.copy()
    noise[PRESSURE] = np.nan
    for r in left:
        r[:, PRESSURE] = np.nan
    assert "pressure_cap" not in [place.output for place in locations(MACHINE, recordings, left, noise)]


def test_three_recordings_are_located_within_a_second_or_two():
    recordings, left = scene(lambda t, u, y: 3 * NOISE * np.sign(u)[:, None], samples=4000)
    locations(MACHINE, recordings, left, NOISE)  # reads the table of units
    begin = clock.process_time()
    locations(MACHINE, recordings, left, NOISE)
    assert clock.process_time() - begin < 1.5


@pytest.mark.parametrize(
    ("value", "unit", "told"),
    [(2.1e5, "Pa", "2.1 bar"), (0.0123, "m", "12.3 mm"), (0.01, "rad", "0.573°"), (100.0, "rad/s", "955 rpm"),
     (0.1, "rad/s", "5.73 °/s"), (1234.0, "N", "1234 N"), (0.5, "1", "0.5"), (-1.5, "V", "-1.5 V")],
)  # fmt: skip
def test_amounts_are_told_in_the_unit_a_person_reads(value, unit, told):
    assert amount(value, unit) == told
