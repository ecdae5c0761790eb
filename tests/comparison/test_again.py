"""Criteria of a record made again: their bound is that of then, and the same number the same verdict."""

from __future__ import annotations

import math

import pytest

from hydrotwin.comparison import compare
from hydrotwin.comparison.again import Again, _judged
from tests.comparison.toys import Toy, recording

NOTHING = Again("2026-11-30", "", math.nan, math.nan, None)


@pytest.fixture(scope="module")
def found():
    return compare([Toy("good")], [recording(1)], modes=["free run"], outputs=["motor_speed"], repeats=0)


@pytest.mark.parametrize(
    ("value", "high", "passed", "same"),
    [
        (1.0, 1.5, True, True),
        (1.0, 0.5, False, True),
        (1.0, 0.5, True, False),  # it cannot have held
        (1.00005, 1.0 - 2e-9, False, True),  # the last digits of another machine had been on the other side
        (1.01, 1.5, True, False),
    ],
)
def test_a_criterion_beside_another_model_has_the_bound_of_then(found, value, high, passed, same):
    now = found.means[0].rmse
    row = {"text": "motor_speed not worse than gone", "passed": passed, "value": value * now, "high": high * now}
    again = _judged(row, found, NOTHING)
    assert again.passed is same and again.now == now and again.unit == "rpm"
    assert again.why == "held against the bound that gone set then"
