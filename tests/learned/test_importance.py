"""What each input is worth to a block, by its free run without it."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.learned import learning
from hydrotwin.learned.held_out import split
from hydrotwin.learned.importance import idle, importance
from hydrotwin.models.language.flat import Signal, StateVariable
from hydrotwin.records import Record
from hydrotwin.simulation import Block

UNITS = {"push": "N", "pull": "N", "idle": "N", "speed": "m/s"}


def recorded(seed: int) -> Record:
    """A speed that follows two forces, the second half as much; a third does nothing."""
    random = np.random.default_rng(seed)
    time = 0.05 * np.arange(600)
    waves = [np.interp(time, np.linspace(0, 30, 40), random.normal(size=40)) for _ in range(3)]
    speed = np.zeros(len(time))
    for k in range(1, len(time)):
        speed[k] = speed[k - 1] + 0.1 * (waves[0][k - 1] + 0.5 * waves[1][k - 1] - speed[k - 1])
    signals = dict(zip(UNITS, [*waves, speed + 1e-3 * random.normal(size=len(time))], strict=True))
    return Record(time, signals, UNITS, f"run_{seed}")


@pytest.fixture
def block():
    """The machine itself."""
    x, u, p = ca.SX.sym("x"), ca.SX.sym("u", 3), ca.SX.sym("p", 0)
    step = ca.Function("step", [x, u, p], [x + 0.1 * (u[0] + 0.5 * u[1] - x), x], ["x", "u", "p"], ["x_next", "y"])
    y = ca.SX.sym("y")
    start = ca.Function("start", [u, y, p], [y], ["u", "y", "p"], ["x"])
    inputs = tuple(Signal(name, "N") for name in ("push", "pull", "idle"))
    state = StateVariable("speed", "m/s", measured_by="speed")
    return Block("machine", inputs, (Signal("speed", "m/s"),), (state,), (), step, start, 0.05)


def test_an_input_is_worth_what_the_free_run_loses_without_it(block):
    record = recorded(3)
    worth = importance(block, [record], ["speed"])
    assert worth["push"]["speed"] > 1.5 * worth["pull"]["speed"] > 10 * worth["idle"]["speed"]
    assert np.array_equal(record["push"], recorded(3)["push"]), "the recording is as it was"


def test_the_card_says_which_input_is_idle(block):
    records = [recorded(1), recorded(2)]
    named = ["push", "pull", "idle"], ["speed"]
    parts = split(records, *named)
    card = learning._card(block, parts, records, named, learning._rivals(block, parts, named, None))
    assert set(card["inputs"]) == {"push", "pull", "idle"}
    assert "Without idle it runs as well" in card["says"] and "Without push" not in card["says"]


def test_inputs_are_idle_where_no_output_needs_them():
    assert idle({"a": {"x": 1.0, "y": 3.0}, "b": {"x": 1.01, "y": 1.0}}, {"x": 1.0, "y": 1.0}) == ["b"]


def test_one_input_is_worth_everything_and_is_not_asked(block):
    one = Block("one", block.inputs[:1], block.outputs, block.states, (), block.step, block.start, 0.05)
    assert importance(one, [recorded(2)], ["speed"]) == {}
