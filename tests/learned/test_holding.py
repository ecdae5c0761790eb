"""Whether what is held has settled: of blocks and of recordings, of what integrates and what does not, in any unit."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest

from hydrotwin.learned import characteristic
from hydrotwin.learned.inverse.judging import judged_inverse
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal, StateVariable
from hydrotwin.models.spool_valve import quasi_static
from hydrotwin.records import Record
from hydrotwin.simulation import lower
from hydrotwin.simulation.block import Block

PERIOD, COMMAND = 0.01, Signal("u", "V")
START = {"y": 0.0}


def bent(u):
    return u + 0.3 * u**3


def block(rate, unit: str, least: float = -np.inf, most: float = np.inf) -> Block:
    """y' = rate(y, u), kept between two limits."""
    x, u, p, y = ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("p", 0), ca.SX.sym("y")
    moved = ca.fmin(ca.fmax(x + PERIOD * rate(x, u), least), most)
    step = ca.Function("step", [x, u, p], [moved, x], ["x", "u", "p"], ["x_next", "y"])
    start = ca.Function("start", [u, y, p], [y], ["u", "y", "p"], ["x"])
    state = StateVariable("y", unit, measured_by="y")
    return Block("machine", (COMMAND,), (Signal("y", unit),), (state,), (), step, start, PERIOD)


def staircase(seconds: float, lag: float, *, integral=False, noise=0.0, unit="Pa", count=40) -> Record:
    """Random commands held for ``seconds`` each; a machine that follows `bent` with a lag [s], or its integral."""
    random = np.random.default_rng(0)
    u = np.repeat(random.uniform(-1, 1, count), round(seconds / PERIOD))
    y, x, kept = np.zeros(len(u)), bent(u[0]), np.exp(-PERIOD / lag)
    for k in range(len(u)):
        y[k], x = x, kept * x + (1 - kept) * bent(u[k])
    y = PERIOD * np.cumsum(y) if integral else y
    return Record(
        PERIOD * np.arange(len(u)), {"u": u, "y": y + noise * random.normal(size=len(u))}, {"u": "V", "y": unit}
    )


def worst(found) -> float:
    return float(np.abs(found.rates - bent(found.commands)).max())


# -- blocks --------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("unit", ["m", "rad", "V", "Pa"])
@pytest.mark.parametrize("lag", [0.03, 0.1, 2.0])
def test_a_block_whose_output_settles_gives_its_level_whatever_its_unit(unit, lag):
    found = characteristic(block(lambda y, u: (bent(u) - y) / lag, unit), "u", "y", start=START)
    assert found.rate.name == "wanted_y" and worst(found) < 0.03
    assert (found.source["settle"] > 0.5) == (lag > 0.1), "as long as it takes"


@pytest.mark.parametrize("unit", ["m", "rad", "V", "Pa"])
@pytest.mark.parametrize("most", [np.inf, 1.0])
def test_a_block_whose_output_integrates_gives_its_rate_whatever_its_unit(unit, most):
    found = characteristic(block(lambda y, u: bent(u), unit, -most, most), "u", "y", start=START, settle=0.2)
    assert found.rate.name == "wanted_y_rate" and worst(found) < 1e-9


def test_a_limit_that_the_output_reaches_is_told_as_one():
    machine = block(lambda y, u: bent(u), "m", -0.3, 0.3)
    with pytest.raises(DataError, match=r"stands at -0\.3 m while 'u' is held at -1 V: it reached a limit"):
        characteristic(machine, "u", "y", start=START)


def test_what_a_closed_valve_traps_is_no_integral():
    model = lower(quasi_static(), PERIOD)
    assert characteristic(model, "current", "spool").rate.name == "wanted_spool"
    assert characteristic(model, "current", "position").rate.name == "wanted_position_rate"


def test_what_never_settles_is_said_to_and_the_given_time_is_kept():
    machine = block(lambda y, u: bent(u) - 0.02 * y, "m")
    with pytest.raises(DataError, match="has not settled 1 s after"):
        characteristic(machine, "u", "y", start=START, settle=1.0, rate=False)


def test_rates_that_depend_on_where_the_machine_stands_are_told():
    learnt = judged_inverse(block(lambda y, u: bent(u) * (1 + 0.5 * y), "m"), "u", "y", start=START)
    assert "it depends on where the machine stands, or comes late" in learnt.provenance["held_out"]["says"]


# -- recordings ----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("integral", [False, True])
@pytest.mark.parametrize(("seconds", "lag", "allowed"), [(3.0, 0.3, 0.05), (2.0, 0.05, 0.01), (0.4, 0.02, 0.03)])
def test_recordings_are_read_once_the_machine_has_settled(seconds, lag, allowed, integral):
    found = characteristic(staircase(seconds, lag, integral=integral), "u", "y", rate=integral)
    assert worst(found) < allowed and not found.source["creeping"]
    assert found.fell is None


@pytest.mark.parametrize(("seconds", "lag"), [(1.2, 0.3), (0.4, 0.1), (4.0, 1.0)])
def test_commands_that_end_before_the_machine_rests_are_told_and_not_blamed_on_it(seconds, lag):
    learnt = judged_inverse(staircase(seconds, lag, noise=0.003), "u", "y")
    told = learnt.provenance["held_out"]["says"]
    assert told.startswith("y has hardly settled where the commands end")


def test_a_time_that_is_given_is_taken():
    assert characteristic(staircase(3.0, 0.3), "u", "y", settle=0.7, window=0.3).source["settle"] == 0.7


def rising(seconds: float, lag: float, *, ramp: bool = False) -> Record:
    """Levels that only rise, or one ramp, of a machine that follows with a lag [s] and begins at rest."""
    held = round(seconds / PERIOD)
    u = np.linspace(-1, 1, 40 * held) if ramp else np.repeat(np.linspace(-1, 1, 40), held)
    y, x, kept = np.zeros(len(u)), bent(u[0]), np.exp(-PERIOD / lag)
    for k in range(len(u)):
        y[k], x = x, kept * x + (1 - kept) * bent(u[k])
    return Record(PERIOD * np.arange(len(u)), {"u": u, "y": y}, {"u": "V", "y": "Pa"})


@pytest.mark.parametrize("ramp", [False, True])
def test_what_comes_late_everywhere_alike_is_told_by_the_way_that_commands_go(ramp):
    says = judged_inverse(rising(2.0, 3.0, ramp=ramp), "u", "y").provenance["held_out"]["says"]
    assert "u goes one way only: lag and play of the machine shift all points alike" in says
    assert ("still changes while commands are held" in says) == (not ramp)


def test_a_machine_that_rests_is_not_said_to_go_on():
    found = characteristic(staircase(2.0, 0.05, noise=0.01), "u", "y")
    assert found.source["going_on"] == 0.0 and not found.source["one_way"]


def test_the_card_of_a_command_that_never_rests_decides_rate_or_level_as_the_block_did():
    t = PERIOD * np.arange(12_000)
    u = np.interp(t % 40, [0, 20, 40], [-1, 1, -1])
    record = Record(t, {"u": u, "y": PERIOD * np.cumsum(bent(u))}, {"u": "V", "y": "m"})
    learnt = judged_inverse(record, "u", "y", moving=True)
    assert learnt.provenance["held_out"]["outputs"]["y_rate"]["percent_of_range"] < 0.5
    assert "Dead time, lag and play are one there" in learnt.provenance["held_out"]["says"]


def test_the_inverse_of_a_learned_block_says_what_the_block_says_of_itself():
    machine = block(lambda y, u: (bent(u) - y) / 0.1, "m")
    learned = dataclasses.replace(machine, provenance={"free_run": {"bad": True, "says": "It is no better than ARX."}})
    says = judged_inverse(learned, "u", "y", start=START).provenance["held_out"]["says"]
    assert says.startswith("It is the inverse of machine, not of the machine, and of that: It is no better than ARX.")
    assert "steady points that were left out, of machine and not of the machine" in says


@pytest.mark.parametrize("stop", [0.3, 0.6, 5.0])
def test_what_stands_at_an_end_stop_says_nothing_of_the_command(stop):
    random = np.random.default_rng(2)
    u, y = np.repeat(random.uniform(-1, 1, 120), 150), np.zeros(120 * 150)
    for k in range(1, len(u)):
        y[k] = np.clip(y[k - 1] + PERIOD * 0.3 * bent(u[k - 1]), -stop, stop)
    y += 1e-4 * random.normal(size=len(y))
    learnt = judged_inverse(Record(PERIOD * np.arange(len(u)), {"u": u, "y": y}, {"u": "V", "y": "m"}), "u", "y")
    card = learnt.provenance["held_out"]
    assert card["outputs"]["y_rate"]["percent_of_range"] < 2.0
    assert ("stands at an end stop" in card["says"]) == (stop < 5.0)


def test_a_level_that_saturates_is_no_end_stop():
    record = staircase(2.0, 0.05)
    level = record.with_signals({"y": np.clip(record["y"], -0.5, 0.5)})
    found = characteristic(level, "u", "y")
    assert found.rate.name == "wanted_y" and found.reach == pytest.approx((-0.5, 0.5), abs=1e-6)


def test_a_machine_that_swings_is_held_until_it_rests():
    x, u, p, y = ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p", 0), ca.SX.sym("y")
    moved = x + PERIOD * ca.vertcat(x[1], 100 * (bent(u) - x[0]) - 12 * x[1])
    step = ca.Function("step", [x, u, p], [moved, x[0]], ["x", "u", "p"], ["x_next", "y"])
    start = ca.Function("start", [u, y, p], [ca.vertcat(y, 0)], ["u", "y", "p"], ["x"])
    states = (StateVariable("y", "m", measured_by="y"), StateVariable("v", "m/s"))
    machine = Block("spring", (COMMAND,), (Signal("y", "m"),), states, (), step, start, PERIOD)
    found = characteristic(machine, "u", "y", start=START)
    assert found.rate.name == "wanted_y" and worst(found) < 0.005
