"""Which output that was not recorded is proposed: one that parts what the recorded ones do not, whatever its unit."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification.identifiability import identifiability
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der


class Product(Component):
    """Only the product of two gains shows at the shaft; a second output sees the same product, a third one gain."""

    command = Input("1", "command")
    first = Parameter(2.0, "1", "first gain", bounds=(0.1, 10.0), free=True)
    second = Parameter(3.0, "1", "second gain", bounds=(0.1, 10.0), free=True)
    lag = Parameter(1.0, "s", "lag", bounds=(0.1, 10.0))
    turning = State(0.0, "1", "angle")
    angle = Output("1", "angle")
    power = Output("1", "the same product again, a million times as large")
    force = Output("1", "one gain alone, a billionth as large as its nominal value says")

    def equations(self):
        yield self.lag * der(self.turning) == self.first * self.second * self.command - self.turning
        yield self.angle == self.turning
        yield self.power == 1e6 * self.turning
        yield self.force == 1e-9 * self.first * self.command


class Free:
    names, start, sizes = ("first", "second"), np.array([1.0, 1.0]), np.ones(2)


def sentence(unrecorded, correlated=1.0 - 1e-9):
    information = 1e6 * np.array([[1.0, correlated], [correlated, 1.0]])
    (found,) = identifiability(None, Free, information, unrecorded, np.zeros(2, dtype=bool))
    return str(found)


ONE = np.array([[1.0, 0.0], [0.0, 0.0]])  # dy dy^T of an output that one of the two moves
BOTH = np.ones((2, 2))  # of one that sees their product


@pytest.mark.parametrize("unit", [1e-20, 1.0, 1e20])
def test_an_output_that_one_of_them_moves_parts_them_in_whatever_unit(unit):
    assert sentence({"force": unit * ONE}).endswith("Fix one, or record force.")


@pytest.mark.parametrize("unit", [1e-20, 1.0, 1e20])
def test_an_output_that_sees_the_same_trade_parts_nothing(unit):
    assert sentence({"power": unit * BOTH}).endswith("Fix one.")
    nearly = np.array([[1.0, 1.0], [1.0, 1.0 + 1e-4]])
    assert sentence({"power": unit * nearly}).endswith("Fix one.")


def test_the_better_of_two_is_named_although_the_other_is_larger():
    assert sentence({"power": 1e12 * BOTH, "force": 1e-12 * ONE}).endswith("or record force.")


def test_what_nothing_moves_is_not_named():
    assert sentence({"still": np.zeros((2, 2))}).endswith("Fix one.")


def test_a_sensor_is_told_by_a_whole_fit():
    from hydrotwin import simulate
    from hydrotwin.identification import identify
    from hydrotwin.records import Record

    model, time = Model(Product()), np.arange(0.0, 10.0, 0.05)
    command = {"command": np.sign(np.sin(time))}
    run = simulate(model, Record(time, command, {"command": "1"}))
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(time))
    record = Record(time, command | {"angle": run["angle"] + noise}, {"command": "1", "angle": "1"})
    found = [str(f) for f in identify(model, [record]).findings if f.kind == "indistinguishable"]
    assert len(found) == 1 and found[0].endswith("Fix one, or record force.")


@pytest.mark.parametrize("noise", [1e-2, 1e-5, 1e-8])
def test_parameters_that_are_one_are_told_so_however_precise_the_recording(noise):
    """Precise recordings made the damping of the solver look like curvature, and the runs were called chaotic."""
    from hydrotwin import simulate
    from hydrotwin.identification import identify
    from hydrotwin.records import Record

    model, time = Model(Product()), np.arange(0.0, 20.0, 0.02)
    command = {"command": np.sign(np.sin(time))}
    run = simulate(model, Record(time, command, {"command": "1"}))
    measured = run["angle"] + noise * np.random.default_rng(1).standard_normal(len(time))
    record = Record(time, command | {"angle": measured}, {"command": "1", "angle": "1"})
    assert {f.kind for f in identify(model, [record], noise={"angle": noise}).findings} == {"indistinguishable"}
