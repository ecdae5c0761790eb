"""A fit says how accurate its runs are, and when it follows errors of the solver."""

from __future__ import annotations

import pytest

from hydrotwin.identification import identify

from .drive import drive, recorded

NOISE = {"position": 1e-4, "motor_speed": 1e-3}


@pytest.fixture(scope="module")
def recording():
    return recorded(drive(), 1, noise=NOISE)


def test_a_fit_knows_the_accuracy_of_its_runs(recording):
    fit = identify(drive(), [recording], starts=1)
    assert fit.accuracy.reached and 0 <= fit.accuracy.error < 1e-5
    assert not [f for f in fit.findings if f.kind == "accuracy"]


def test_a_fit_by_steps_that_miss_the_accuracy_says_so(recording):
    slow = {"motor.time_constant": 0.006}  # a step of 10 ms is 1.7 time constants
    fit = identify(drive(), [recording], free=["motor.gain"], start=slow, starts=1, method="explicit", step=0.01)
    assert not fit.accuracy.reached
    (told,) = [str(f) for f in fit.findings if f.kind == "accuracy"]
    assert "not accurate: half the step changes motor_speed by" in told
    assert "The sensors see it: half the step changes" in told and "give a smaller step" in told
