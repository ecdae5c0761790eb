"""Criteria of a record made again: their bound is that of then, and the same number the same verdict."""

from __future__ import annotations

import dataclasses
import math

import pytest

from hydrotwin.comparison import Wanted, acceptance, compare
from hydrotwin.comparison.again import Again, _judged
from hydrotwin.report import write_report
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


def test_a_bias_of_next_to_nothing_is_made_again_as_far_as_its_errors_are(found):
    """Errors that make up for each other leave digits that another processor has otherwise: 1e-4 of them is nothing."""
    [score] = found.scores
    for bias, same in ((1.5e-5, True), (1e-2, False)):
        rows = [dataclasses.replace(score, bias=bias * score.rmse)]
        known = dataclasses.replace(found, scores=tuple(rows), means=tuple(rows))
        row = {"text": "motor_speed.bias < 1 rad/s", "passed": True, "value": 1e-6 * score.rmse}
        assert _judged(row | {"low": -math.inf, "high": 1.0}, known, NOTHING).passed is same


def test_a_bias_is_not_worse_than_one_of_next_to_nothing_by_last_digits(found, tmp_path):
    [score] = found.scores
    for bias, passed in ((1e-6, True), (1.5e-5, True), (1e-2, False)):
        before, now = (
            dataclasses.replace(found, scores=(dataclasses.replace(score, bias=b * score.rmse),)) for b in (1e-6, bias)
        )
        write_report(before, tmp_path)
        wanted = Wanted(("motor_speed.bias not worse than compare.json",), base=tmp_path)
        assert acceptance(now, wanted).passed is passed
