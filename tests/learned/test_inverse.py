"""Inverse characteristics: the equations of the blocks, what is learnt from data and from models, what is refused."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned.block_file import assemble, read_block, write_block
from hydrotwin.learned.inverse.curve import (
    INVERSE_NETWORK,
    INVERSE_TABLE,
    least_slope,
    network_shapes,
    refuse_falling,
    static_answer,
)
from hydrotwin.learned.inverse.data import Characteristic, characteristic
from hydrotwin.learned.inverse.learn import learn_inverse, round_trip
from hydrotwin.models.language.errors import DataError, DeclarationError, SolveError
from hydrotwin.models.language.flat import Signal, StateVariable
from hydrotwin.models.language.provenance import made_from
from hydrotwin.models.spool_valve import quasi_static
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.simulation.block import Block, TrainingDomain

CURRENT, SPEED = Signal("current", "1"), Signal("wanted_velocity", "m/s", nominal=0.1)
OPENS, SHUTS, SPAN = 0.12, -0.07, 0.2185  # where the deadband ends; span of the rates
QUICK = {"hidden": 8, "iterations": 600}


def speed(u):
    """Deadband from -0.07 to 0.12, steeper inwards, saturating."""
    return 0.12 * np.tanh(1.6 * (np.maximum(u - OPENS, 0) + 1.2 * np.minimum(u - SHUTS, 0)))


def points(noise: float = 0.0, waves: float = 0.0, count: int = 401) -> Characteristic:
    u = np.linspace(-1, 1, count)
    r = speed(u) + noise * np.random.default_rng(0).standard_normal(count)
    r += waves * np.sin(30 * u) * (np.abs(speed(u)) < 0.09)
    return Characteristic(CURRENT, SPEED, u, r, max(noise, waves / 4))


def learn(forward, **options):
    return learn_inverse(forward, **options)


def true_round_trip(block) -> np.ndarray:
    wanted = np.linspace(speed(-0.95), speed(0.95), 2001)
    return (speed(static_answer(block, wanted)) - wanted) / SPAN


@pytest.fixture(scope="module")
def table():
    return learn(points())


@pytest.fixture(scope="module")
def monotone():
    pytest.importorskip("torch")
    return learn(points(5e-4), method="monotone", **QUICK)


def untrained(kind, arrays, structure):
    return assemble(
        kind, arrays, structure, name="untrained", inputs=(SPEED,), outputs=(CURRENT,), states=(), parameters=(),
        period=0.01, domain=TrainingDomain((SPEED.name,), (-1.0,), (0.5,)), provenance={"kind": "inverse", "seed": 0},
    )  # fmt: skip


def small_table():
    """A table of three knots, for the tests of every kind."""
    arrays = {"rates": np.array([-1.0, 0.0, 0.5]), "commands": np.array([-3.0, 1.0, 2.0])}
    return untrained(INVERSE_TABLE, arrays, {"knots": 3})


def small_network():
    """A network with random weights, for the tests of every kind."""
    rng = np.random.default_rng(0)
    arrays = {k: rng.normal(size=s) for k, s in network_shapes({"hidden": 4}, 1, 1).items()}
    arrays |= {"rate_lower": np.array([-0.5]), "rate_upper": np.array([0.8]), "rate_scale": np.array([0.7])}
    return untrained(INVERSE_NETWORK, arrays, {"hidden": 4})


# -- the blocks ----------------------------------------------------------------------------------------------------
def test_the_table_is_piecewise_linear_and_holds_its_ends():
    block, r = small_table(), np.array([-2.0, -1.0, -0.25, 0.25, 0.5, 9.0])
    assert static_answer(block, r) == pytest.approx(np.interp(r, [-1.0, 0.0, 0.5], [-3.0, 1.0, 2.0]), rel=1e-14)


def test_the_network_is_the_written_equation():
    block = small_network()
    a = {k: v[0] if v.shape == (1,) else v for k, v in block.arrays.items()}
    for r in (-2.0, -0.3, 0.4, 3.0):
        z = (np.clip(r, -0.5, 0.8) - a["rate_centre"]) / 0.7
        h = np.tanh(a["second_weights"] @ np.tanh(a["first_weights"] * z + a["first_bias"]) + a["second_bias"])
        u = a["command_centre"] + a["command_scale"] * (a["linear"] * z + a["output_weights"] @ h + a["output_bias"])
        assert static_answer(block, [r])[0] == pytest.approx(u, rel=1e-12)


@pytest.mark.parametrize("fixture", ["table", "monotone"])
def test_an_inverse_comes_back_from_its_file_and_its_fmu_equals_its_python_run(fixture, request, tmp_path):
    block = request.getfixturevalue(fixture)
    time = np.arange(0.0, 4.0, 0.01)
    record = Record(time, {SPEED.name: 0.15 * np.sin(2 * time)}, {SPEED.name: "m/s"})
    expected = simulate(block, record)["current"]
    again = read_block(write_block(block, tmp_path / "inverse.toml")[0])
    assert np.array_equal(simulate(again, record)["current"], expected)
    found = read_fmu(export_fmu(block, tmp_path / "inverse.fmu")).free_run(record)["current"]
    assert np.abs(found - expected).max() < 1e-9


# -- what is learnt ------------------------------------------------------------------------------------------------
def test_the_table_keeps_the_jump_of_the_deadband(table):
    assert static_answer(table, [-1e-4, 0.0, 1e-4]) == pytest.approx([SHUTS, 0.025, OPENS], abs=6e-3)
    assert np.abs(true_round_trip(table)).max() < 1e-3


@pytest.mark.parametrize("steepest", [20.0, 200.0])
def test_the_table_is_nowhere_steeper_than_its_cap(steepest):
    block = learn(points(), steepest=steepest)
    r = np.linspace(*(side[0] for side in (block.domain.lower, block.domain.upper)), 20_001)
    mean = np.ptp(block.arrays["commands"]) / np.ptp(block.arrays["rates"])
    assert np.max(np.diff(static_answer(block, r)) / np.diff(r)) == pytest.approx(steepest * mean, rel=0.1)


@pytest.mark.parametrize("method", ["table", "monotone"])
def test_noise_in_the_rates_hardly_reaches_the_round_trip(method):
    pytest.importorskip("torch")
    noise = 1e-3
    error = true_round_trip(learn(points(noise), method=method, **QUICK | {"iterations": 1200}))
    assert np.sqrt(np.mean(error**2)) < noise / SPAN


def test_the_table_is_closer_than_the_network_that_rounds_the_jump_off(table):
    pytest.importorskip("torch")
    network = learn(points(), method="network", **QUICK)
    assert network.provenance["round_trip"] > 3 * table.provenance["round_trip"]
    assert network.provenance["round_trip"] < 0.02


def test_without_its_loss_a_converged_network_falls_and_is_refused_and_with_it_does_not():
    pytest.importorskip("torch")
    rough, options = points(waves=0.004), {"method": "network", "sampling": "command", "iterations": 1000}
    with pytest.raises(SolveError, match=r"the inverse falls \(slope -.*20001 points"):
        learn(rough, monotonicity=0.0, **options)
    block = learn(rough, monotonicity=1.0, **options)
    assert least_slope(block)[0] >= 0 and block.provenance["least_slope"] == least_slope(block)[0]


def test_a_monotone_network_never_falls_not_even_untrained_from_rough_data():
    pytest.importorskip("torch")
    for seed in range(3):
        assert least_slope(learn(points(waves=0.01), method="monotone", seed=seed, hidden=6, iterations=5))[0] > 0


def test_the_stated_round_trip_is_that_of_the_block(table):
    trip = round_trip(table, points())
    assert trip.rms == table.provenance["round_trip"] and trip.worst == table.provenance["round_trip_worst"]
    assert trip.rms < trip.worst < 1e-3


def test_the_certificate_holds_and_catches_a_changed_knot(table, monotone):
    from hydrotwin.learned.inverse.learn import _certify

    assert table.certificate.holds and monotone.certificate.holds
    rates, commands = table.arrays["rates"], table.arrays["commands"]
    assert not _certify(table, lambda r: np.interp(r, rates, commands + 1e-9 * (commands > 0))).holds


def test_the_same_seed_gives_the_same_network_and_another_seed_another():
    pytest.importorskip("torch")
    one, two, other = (learn(points(), method="monotone", seed=s, hidden=4, iterations=40) for s in (3, 3, 4))
    assert all(np.array_equal(one.arrays[k], two.arrays[k]) for k in one.arrays)
    assert not np.array_equal(one.arrays["first_weights"], other.arrays["first_weights"])


def test_interrupting_keeps_the_best_so_far():
    pytest.importorskip("torch")

    def interrupt(iteration, loss):
        if iteration == 40:
            raise KeyboardInterrupt

    block = learn(points(), method="monotone", progress=interrupt, **QUICK)
    assert block.provenance["stopped"] == "interrupted" and block.provenance["iterations"] == 40


# -- characteristics -----------------------------------------------------------------------------------------------
def recorded(command: np.ndarray, period: float = 0.01, late: float = 0.0, noise: float = 1e-4) -> Record:
    time = period * np.arange(len(command))
    delayed = np.interp(time - late, time, command)
    position = np.concatenate([[0.0], np.cumsum(speed(delayed))[:-1] * period])
    position = position + noise * np.random.default_rng(1).standard_normal(len(time))
    return Record(time, {"current": command, "position": position}, {"current": "1", "position": "m"}, digest="0" * 64)


def test_a_staircase_and_slow_ramps_give_the_same_characteristic():
    stairs = recorded(np.repeat(np.random.default_rng(0).permutation(np.linspace(-1, 1, 61)), 200))
    up = np.linspace(-1, 1, 6001)
    ramps = recorded(np.concatenate([up, up[::-1]]), late=0.1)
    for record, most in ((stairs, 4e-4), (ramps, 2e-3)):
        found = characteristic(record, "current", "position")
        assert found.rate.name == "wanted_position_rate" and found.rate.unit == "m/s"
        assert np.sqrt(np.mean((found.rates - speed(found.commands)) ** 2)) < most


def test_a_known_delay_is_taken_out_of_a_ramp():
    late, up = 0.2, np.linspace(-1, 1, 6001)
    record = recorded(up, late=late)
    errors = []
    for delay in (0.0, late):
        found = characteristic(record, "current", "position", delay=delay)
        errors.append(np.sqrt(np.mean((found.rates - speed(found.commands)) ** 2)))
    assert errors[1] < 0.4 * errors[0]


def test_the_inverse_of_a_model_asks_for_the_command_that_gives_the_velocity():
    model = quasi_static()
    block = learn_inverse(model, "current", "velocity", settle=0.2)
    assert block.inputs[0].name == "wanted_velocity" and block.inputs[0].unit == "m/s"
    wanted = np.array([-0.08, -0.02, 0.01, 0.05, 0.09])
    time = np.arange(0, 0.5, 0.01)
    for v, u in zip(wanted, static_answer(block, wanted), strict=True):
        run = simulate(model, Record(time, {"current": np.full_like(time, u)}, {"current": "1"}))
        assert run["velocity"][-1] == pytest.approx(v, abs=2e-4)


def test_the_rate_of_a_position_that_never_settles_is_taken_from_a_block():
    x, u, p, y = ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("p", 0), ca.SX.sym("y")
    step = ca.Function("step", [x, u, p], [x + 0.01 * 0.2 * u**3, x], ["x", "u", "p"], ["x_next", "y"])
    start = ca.Function("start", [u, y, p], [y], ["u", "y", "p"], ["x"])
    state = StateVariable("position", "m", measured_by="position")
    block = Block("cubic", (CURRENT,), (Signal("position", "m"),), (state,), (), step, start, 0.01)
    block = dataclasses.replace(block, provenance={"trained_on": [{"name": "train", "sha256": "a" * 64}]})
    inverse = learn_inverse(block, "current", "position", start={"position": 0.0})
    assert made_from(inverse.provenance) == {"a" * 64}, "it follows what its source does"
    assert static_answer(inverse, [0.2 * 0.5**3, -0.2])[:2] == pytest.approx([0.5, -1.0], abs=5e-3)
    with pytest.raises(DataError, match="the start is not known"):
        learn_inverse(block, "current", "position")
    with pytest.raises(DataError, match="has not settled"):
        learn_inverse(block, "current", "position", start={"position": 0.0}, rate=False)


# -- what is refused -----------------------------------------------------------------------------------------------
def test_a_falling_inverse_is_refused_by_a_sentence():
    arrays = {k: np.zeros(s) for k, s in network_shapes({"hidden": 1}, 1, 1).items()}
    one = dict.fromkeys(("rate_upper", "rate_scale", "command_scale"), np.ones(1))
    downwards = {"linear": -np.ones(1), "rate_lower": -np.ones(1)}
    falling = untrained(INVERSE_NETWORK, arrays | one | downwards, {"hidden": 1})
    with pytest.raises(SolveError, match="must not ask for a smaller command"):
        refuse_falling(falling, "Do this.")


def test_knots_that_fall_are_refused():
    with pytest.raises(SolveError, match="knots must rise"):
        untrained(INVERSE_TABLE, {"rates": np.arange(3.0), "commands": np.array([0.0, 2.0, 1.0])}, {"knots": 3})


@pytest.mark.parametrize(
    ("record", "moving", "sentence"),
    [
        (recorded(np.sin(np.arange(2000) * 0.05)), False, "nowhere steady"),
        (recorded(np.repeat([0.1, -0.5], 300)), False, "too few points"),
        (recorded(np.repeat([0.1, -0.5], 300)), None, "too few points"),
        (recorded(np.zeros(3000), noise=0), None, "'current' never changes"),
        (recorded(np.zeros(3000), noise=0), False, "'current' never changes"),
    ],
)
def test_recordings_without_a_characteristic_are_refused(record, moving, sentence):
    with pytest.raises(DataError, match=sentence):
        characteristic(record, "current", "position", moving=moving)


def test_no_recordings_and_values_that_are_not_numbers_are_refused():
    with pytest.raises(DataError, match="no recordings"):
        characteristic([], "current", "position")
    with pytest.raises(DataError, match="must be finite"):
        Characteristic(CURRENT, SPEED, np.arange(20.0), np.full(20, np.nan))


@pytest.mark.parametrize(
    ("option", "sentence"),
    [
        ({"method": "tabel"}, "Did you mean 'table'"),
        ({"sampling": "speed"}, "no sampling"),
        ({"steepest": 0.5}, "steepest"),
        ({"hidden": 0}, "hidden"),
        ({"iterations": 2.5}, "iterations"),
        ({"monotonicity": -1.0}, "monotonicity"),
    ],
)
def test_impossible_options_are_refused(option, sentence):
    with pytest.raises(DeclarationError, match=sentence):
        learn(points(), **option)


def test_an_unknown_signal_of_a_model_is_refused_with_the_nearest():
    with pytest.raises(DeclarationError, match="Did you mean 'velocity'"):
        learn_inverse(quasi_static(), "current", "velocty")
    with pytest.raises(DeclarationError, match="no output is named"):
        learn_inverse(quasi_static(), "current")
    with pytest.raises(DeclarationError, match="settle must be positive"):
        learn_inverse(quasi_static(), "current", "velocity", settle=-1.0)


@pytest.mark.parametrize("option", [{"limits": (-0.5, 0.5)}, {"others": {"load": 1.0}}, {"start": {"x": 0.0}}])
def test_what_a_run_is_told_is_refused_of_recordings(option):
    ramps = recorded(np.interp(np.arange(0, 20, 0.01), [0, 10, 20], [-1, 1, -1]))
    with pytest.raises(DeclarationError, match=f"{next(iter(option))} tells of a block or a model"):
        characteristic(ramps, "current", "position", **option)


@pytest.mark.parametrize("option", [{"delay": 0.01}, {"moving": True}])
def test_what_recordings_are_told_is_refused_of_a_model(option):
    with pytest.raises(DeclarationError, match=f"{next(iter(option))} tells of recordings"):
        characteristic(quasi_static(), "current", "position", **option)
