"""Models lowered to sampled blocks, and blocks run on records."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import ParameterValue, Signal, StateVariable
from hydrotwin.records import Record
from hydrotwin.simulation import Block, lower, predict_one_step, simulate, simulate_many
from hydrotwin.simulation.sampled import sample_grid, sampled_inputs
from tests.simulation.flat_cehA import flat_cehA
from tests.simulation.small_models import lag

TIME = np.arange(201) * 0.01
RANDOM = np.random.default_rng(7)


def command_record(**columns):
    command = 1.5 * np.sin(5 * TIME) + 0.5 * np.sin(11 * TIME)
    units = {"arm_angle": "rad", "pressure_cap": "Pa", "motor_speed": "rad/s"}
    return Record(TIME, {"command": command, **columns}, {"command": "V", **{n: units[n] for n in columns}}, name="run")


def input_record(time=TIME, **columns):
    u = RANDOM.normal(size=len(time))
    return Record(time, {"u": u, **columns}, {"u": "1", **{n: "1" for n in columns}}, name="noise")


def assert_same(a: Record, b: Record, tolerance=1e-9):
    assert a.names == b.names
    for name in a:
        assert a[name] == pytest.approx(b[name], abs=tolerance * np.ptp(b[name]) + 1e-12), name


@pytest.mark.parametrize("period", [0.01, 0.005, 0.0025])
def test_a_lowered_block_equals_the_simulation(period):
    model = flat_cehA()
    record = command_record(arm_angle=np.full(201, 0.15))
    fine = simulate(model, record, step=period / np.ceil(period / 1e-3))
    assert_same(simulate(lower(model, period), record), fine, 1e-6)


def test_a_lowered_block_equals_the_simulation_to_rounding():
    model, record = flat_cehA(), command_record()
    assert_same(simulate(lower(model, 0.01), record), simulate(model, record), 1e-10)


def test_an_implicit_block_equals_the_implicit_simulation():
    model, record = flat_cehA(), command_record()
    assert_same(simulate(lower(model, 0.01, "implicit"), record), simulate(model, record, method="implicit"), 1e-6)


@pytest.mark.parametrize("Td", [0.0, 0.01, 0.0137, 0.05])
def test_a_dead_time_becomes_a_delay_line(Td):
    model, record = lag(dead_time=0.05), input_record()
    block = lower(model, 0.01)
    assert [s.name for s in block.states] == ["x", *(f"u.past[{k}]" for k in range(1, 7))]
    changed = {"Td": Td}
    assert_same(simulate(block, record, parameters=changed), simulate(model, record, parameters=changed))


def test_block_step_has_derivatives_with_respect_to_the_dead_time():
    block = lower(lag(dead_time=0.05), 0.01)
    x, u, p = ca.SX.sym("x", len(block.states)), ca.SX.sym("u"), ca.SX.sym("p", 3)
    slope = ca.Function("slope", [x, u, p], [ca.jacobian(block.step(x, u, p)[0], p)[0, 2]])
    state, step = RANDOM.normal(size=len(block.states)), 1e-6
    after = [float(block.step(state, 1.0, [0.05, 2.0, Td])[0][0]) for Td in (0.0137 + step, 0.0137 - step)]
    assert float(slope(state, 1.0, [0.05, 2.0, 0.0137])) == pytest.approx((after[0] - after[1]) / (2 * step), rel=1e-6)


def test_a_block_starts_from_the_measured_outputs_and_fills_the_missing_ones():
    model = flat_cehA()
    block, p = lower(model, 0.01), model.parameter_vector()
    y = np.full(6, np.nan)
    y[0] = 0.2
    expected = model.start_given(["arm.angle"])(0, p, [0.2]).full()
    assert block.start(0, y, p).full() == pytest.approx(expected, rel=1e-12)
    y[[1, 3, 4]] = 5.0, 3e6, 1e6
    names = ["arm.angle", "motor.speed", "cylinder.cap_pressure", "cylinder.rod_pressure"]
    expected = model.start_given(names)(0, p, [0.2, 5.0, 3e6, 1e6]).full()
    assert block.start(0, y, p).full() == pytest.approx(expected, rel=1e-12)


def first_order_block(period=0.01):
    """y[k+1] = a y[k] + b u[k], written out by hand."""
    x, u, p = ca.SX.sym("x"), ca.SX.sym("u"), ca.SX.sym("p", 2)
    y = ca.SX.sym("y")
    return Block(
        "filter",
        (Signal("u", "1"),),
        (Signal("y", "1"),),
        (StateVariable("level", "1", measured_by="y"),),
        (ParameterValue("a", 0.9, "1"), ParameterValue("b", 0.1, "1")),
        ca.Function("step", [x, u, p], [p[0] * x + p[1] * u, x], ["x", "u", "p"], ["x_next", "y"]),
        ca.Function("start", [u, y, p], [y], ["u", "y", "p"], ["x"]),
        period,
    )


def test_a_block_runs_its_recurrence():
    record = input_record(y=np.full(201, 3.0))
    expected = [3.0]
    for u in record["u"][:-1]:
        expected.append(0.8 * expected[-1] + 0.1 * u)
    answer = simulate(first_order_block(), record, parameters={"a": 0.8})
    assert answer["y"] == pytest.approx(np.array(expected), rel=1e-12)
    assert answer.units == {"y": "1"} and (answer.time == TIME).all()


def test_a_block_predicts_one_step_from_the_measurement():
    measured = RANDOM.normal(size=201)
    measured[50] = np.nan  # a gap: the free run serves
    record = input_record(y=measured)
    free = simulate(first_order_block(), record)["y"]
    known = np.where(np.isfinite(measured), measured, free)
    answer = predict_one_step(first_order_block(), record)["y"]
    assert answer[0] == measured[0]
    assert answer[1:] == pytest.approx(0.9 * known[:-1] + 0.1 * record["u"][:-1], rel=1e-12)


def test_a_block_runs_at_its_own_period_on_an_uneven_record():
    time = np.cumsum(RANDOM.uniform(0.004, 0.03, 100))
    record = Record(time, {"u": np.ones(100), "y": np.zeros(100)}, {"u": "1", "y": "1"})
    steps = (time - time[0]) / 0.01
    whole = np.floor(steps)
    level = [1 - 0.9 ** (whole + k) for k in (0, 1)]
    expected = level[0] + (steps - whole) * (level[1] - level[0])
    assert simulate(first_order_block(), record)["y"] == pytest.approx(expected, abs=1e-9)


def test_a_sample_of_the_block_that_is_one_of_the_recording_but_for_rounding_sees_that():
    """A third of 10 ms, rounded, had seen the sample before, and an FMU of the block the right one."""
    time = 0.01 * np.arange(300)
    u = (np.arange(300) % 7.0)[:, None]
    block = first_order_block(period=0.00333333333)
    seen = sampled_inputs(block, time, u, sample_grid(block, time))
    assert (seen[::3, 0] == u[:, 0]).all() and (seen[1::3, 0] == u[:-1, 0]).all()


def test_a_block_without_its_start_says_what_to_record():
    with pytest.raises(DataError, match=r"filter\.level: the start is not known.*first sample of y"):
        simulate(first_order_block(), input_record())
    assert simulate(first_order_block(), input_record(), start={"level": 1.0})["y"][0] == 1.0


def test_wrong_names_and_periods_are_refused():
    with pytest.raises(DeclarationError, match="no parameter 'c'"):
        simulate(first_order_block(), input_record(y=TIME), parameters={"c": 1.0})
    with pytest.raises(DeclarationError, match=r"Did you mean 'level'"):
        simulate(first_order_block(), input_record(y=TIME), start={"levle": 1.0})
    with pytest.raises(DeclarationError, match="period must be positive"):
        lower(lag(), 0.0)
    with pytest.raises(DeclarationError, match="no block method 'euler'"):
        lower(lag(), 0.01, "euler")


def test_a_block_faster_than_the_recording_predicts_one_step_no_better_than_its_model():
    """At 10 ms samples a block of 1 ms must not see the measurement on its way to the next sample."""
    model = flat_cehA()
    time = np.arange(0, 4, 0.01)
    command = {"command": 2 * np.sin(2 * np.pi * 0.5 * time), "arm_angle": np.full(len(time), 0.1)}
    record = Record(time, command, {"command": "V", "arm_angle": "rad"}, "run")
    angle = simulate(model, record)["arm_angle"] + 1e-4 * np.random.default_rng(1).standard_normal(len(time))
    record = record.with_signals({"arm_angle": angle}, units={"arm_angle": "rad"})
    by_model = predict_one_step(model, record)["arm_angle"]
    by_block = predict_one_step(lower(model, 1e-3), record)["arm_angle"]
    np.testing.assert_allclose(by_block, by_model, rtol=0, atol=1e-9)
    assert np.std(by_block - angle) > 0.9e-4  # the noise of the sample that was not yet taken


@pytest.mark.parametrize("run", [simulate, predict_one_step])
@pytest.mark.parametrize("asked", [{"step": 0.5}, {"method": "implicit"}])
def test_a_block_refuses_a_step_and_a_method(run, asked):
    """They were taken without a word, and changed nothing."""
    with pytest.raises(DeclarationError, match=r"lag steps every 0\.01 s, .* Drop them"):
        run(lower(lag(), 0.01), input_record(), **asked)
    with pytest.raises(DeclarationError, match="Drop them"):
        simulate_many(lower(lag(), 0.01), [{}], input_record(), **asked)
