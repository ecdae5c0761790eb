"""Eq. 17 of the C-EHA paper: as printed, with its drift."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hydrotwin.learned import published_formula
from hydrotwin.learned.published_formula import next_position
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.records import Record
from hydrotwin.simulation import predict_one_step, simulate

FULL_SPEED = 600.0  # rad/s, 0.08 m/s of the data sheet


def recording(command, motor_speed, seconds, start_deg=30.0):
    time = 1e-3 * np.arange(round(seconds * 1000) + 1)
    columns = {
        "command": np.broadcast_to(command, time.shape),
        "motor_speed": np.broadcast_to(motor_speed, time.shape),
        "arm_angle": np.full(time.shape, math.radians(start_deg)),
    }
    return Record(time, columns, {"command": "V", "motor_speed": "rad/s", "arm_angle": "rad"})


def degrees(record):
    return np.degrees(record["arm_angle"])


def as_printed(x1, x2, x3):
    """Eq. 17 term by term, in plain Python."""
    cos, tanh = math.cos, math.tanh
    return (
        x1
        + 0.002027 * x3
        + 0.002027 * tanh(cos(x2))
        - 0.002027 * tanh(x2 * (x1 + 8.97))
        - 0.004659 * tanh(cos(cos(x2)))
        + 0.004659 * x2 * cos(cos(x3))
        + 0.004659 * x2
        + 0.004659 * x2 * tanh(x1 + 8.97)
        + 0.0001014 * x1 * cos(2 * cos(x3))
        + 0.00214
    )


@pytest.mark.parametrize("x", [(30.0, 0.0, 0.0), (-12.5, 1.3, 4.2), (0.0, -4.0, -5.7), (45.0, 0.01, 0.3)])
def test_the_formula_is_the_printed_one(x):
    assert float(next_position(*x)) == pytest.approx(as_printed(*x), abs=1e-14)


def test_at_rest_with_zero_input_the_arm_drifts_half_a_degree_in_five_seconds():
    drift = degrees(simulate(published_formula(), recording(0.0, 0.0, 5.0)))
    assert drift[0] == pytest.approx(30.0, abs=1e-12)
    assert drift[-1] == pytest.approx(30.5406, abs=1e-4)
    assert np.all(np.diff(drift) > 0)


def test_the_drift_ends_near_32_8_degrees():
    settled = degrees(simulate(published_formula(), recording(0.0, 0.0, 1.0, start_deg=32.826)))
    assert abs(settled[-1] - settled[0]) < 1e-3


def test_read_in_radians_the_arm_would_race_at_rest():
    drift = simulate(published_formula(angle_unit=1.0), recording(0.0, 0.0, 0.1))
    assert degrees(drift)[-1] - 30.0 > 7.0


@pytest.mark.parametrize(
    ("unit", "speed"), [(1000 * math.tau / 60, (5, 20)), (math.tau, (150, 250)), (1.0, (1000, 1400))]
)
def test_only_thousands_of_rpm_turn_the_arm_at_a_credible_speed(unit, speed):
    run = degrees(simulate(published_formula(speed_unit=unit), recording(0.0, FULL_SPEED, 0.1)))
    assert speed[0] < (run[-1] - run[0]) / 0.1 < speed[1]


def test_a_larger_voltage_unit_makes_the_same_command_weaker():
    runs = [degrees(simulate(published_formula(voltage_unit=v), recording(2.0, 0.0, 0.5)))[-1] for v in (1.0, 2.5)]
    assert runs[0] - 30 > 1.8 * (runs[1] - 30) > 0


def test_one_step_ahead_the_formula_moves_by_one_increment():
    record = recording(1.0, 200.0, 0.05)
    ahead = degrees(predict_one_step(published_formula(), record))
    assert ahead[1:] == pytest.approx(as_printed(30.0, 1.0, 200.0 / (1000 * math.tau / 60)), abs=1e-9)


def test_a_unit_that_is_not_positive_is_refused():
    with pytest.raises(DeclarationError, match=r"voltage_unit must be positive \(got 0 V\)"):
        published_formula(voltage_unit=0)
