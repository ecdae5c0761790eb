"""simulate and predict_one_step on records."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import Record
from hydrotwin.simulation import lower, predict_one_step, prepare, simulate
from tests.simulation.flat_cehA import flat_cehA
from tests.simulation.small_models import lag

TIME = 10.0 + np.cumsum(np.random.default_rng(5).uniform(0.005, 0.015, 150))
COMMAND = 2 * np.sin(5 * TIME)


def record_of(**columns):
    units = {"command": "V", "arm_angle": "rad", "pressure_cap": "Pa"}
    return Record(TIME, {"command": COMMAND, **columns}, {n: units[n] for n in ("command", *columns)}, name="run_3")


def test_a_simulation_is_a_record_of_outputs_on_the_same_time():
    model = flat_cehA()
    answer = simulate(model, record_of())
    assert answer.names == tuple(s.name for s in model.outputs)
    assert (answer.time == TIME).all()
    assert answer.units["pressure_rod"] == "Pa" and answer.name == "run_3, cehA" and answer.digest is None


def test_a_model_around_a_flat_model_is_simulated_too():
    class Wrapped:
        name, flat = "wrapped", flat_cehA()

    assert (simulate(Wrapped(), record_of())["arm_angle"] == simulate(Wrapped.flat, record_of())["arm_angle"]).all()


def test_states_start_from_what_was_measured_first():
    model = flat_cehA()
    answer = simulate(model, record_of(arm_angle=np.linspace(0.3, 0.1, 150)))
    assert answer["arm_angle"][0] == 0.3
    balance = model.start_given(["arm.angle"])(0, model.parameter_vector(), [0.3]).full().ravel()
    assert answer["pressure_cap"][0] == pytest.approx(balance[1])
    answer = simulate(model, record_of(arm_angle=np.full(150, np.nan), pressure_cap=np.full(150, 3e6)))
    assert answer["arm_angle"][0] == 0.0 and answer["pressure_cap"][0] == 3e6


def test_a_given_start_goes_before_the_measured_one():
    start = {"arm.angle": -0.2, "motor.speed": 7.0}
    answer = simulate(flat_cehA(), record_of(arm_angle=np.full(150, 0.3)), start=start)
    assert (answer["arm_angle"][0], answer["motor_speed"][0]) == (-0.2, 7.0)
    with pytest.raises(DeclarationError, match=r"Did you mean 'arm\.angle'"):
        simulate(flat_cehA(), record_of(), start={"arm.angel": 0.0})


def test_changed_parameters_change_the_run():
    model = flat_cehA()
    stronger = simulate(model, record_of(), parameters={"motor.gain": 240.0})
    assert stronger["motor_speed"] == pytest.approx(2 * simulate(model, record_of())["motor_speed"], rel=1e-6)


def test_a_missing_input_is_reported():
    record = Record(TIME, {"comand": COMMAND}, {"comand": "V"}, name="run_3")
    with pytest.raises(DataError, match=r"run_3: no column 'command'.*Did you mean 'comand'"):
        simulate(flat_cehA(), record)


def test_one_step_prediction_starts_each_interval_from_the_measurement():
    model = lag()
    measured = np.random.default_rng(6).normal(size=150)
    record = Record(TIME, {"u": COMMAND, "x_seen": measured}, {"u": "1", "x_seen": "1"})
    answer = predict_one_step(model, record)["x_seen"]
    target = 2 * COMMAND[:-1]
    expected = target + (measured[:-1] - target) * np.exp(-np.diff(TIME) / 0.05)
    assert answer[0] == measured[0]
    assert answer[1:] == pytest.approx(expected, abs=1e-8)


def test_one_step_prediction_keeps_unmeasured_states_of_the_free_run():
    """With the angle alone measured, all else (pressures, speeds) is that of the free run."""
    model, record = flat_cehA(), record_of(arm_angle=0.2 + 0.01 * np.sin(TIME))
    p = model.parameter_vector()
    x0 = model.start_given(["arm.angle"])(COMMAND[0], p, [record["arm_angle"][0]]).full().ravel()
    propagator = prepare(model)
    _, x = propagator.run(TIME, COMMAND, p, x0)
    answer = predict_one_step(model, record)
    k = 77
    x[k, 3] = record["arm_angle"][k]
    one, _ = propagator.run(TIME[k : k + 2], COMMAND[k : k + 2], p, x[k])
    assert answer.array(answer.names)[k + 1] == pytest.approx(one[1], rel=1e-12)


def test_one_step_prediction_of_its_own_simulation_is_that_simulation():
    model = flat_cehA()
    truth = simulate(model, record_of(), start={"arm.angle": 0.2})
    record = record_of(arm_angle=truth["arm_angle"], pressure_cap=truth["pressure_cap"])
    again = predict_one_step(model, record)
    for name in again:
        assert again[name] == pytest.approx(truth[name], rel=1e-9, abs=1e-9)


def test_a_gap_in_a_measured_output_falls_back_to_the_free_run():
    model = lag()
    measured = np.full(150, 0.5)
    measured[70] = np.nan
    record = Record(TIME, {"u": COMMAND, "x_seen": measured}, {"u": "1", "x_seen": "1"})
    free = simulate(model, record)["x_seen"]
    assert predict_one_step(model, record)["x_seen"][71] == pytest.approx(free[71], rel=1e-6)


def test_an_empty_record_is_refused():
    with pytest.raises(DataError, match="no samples to run lag on"):
        simulate(lag(), Record([], {"u": []}, {"u": "1"}))


@pytest.mark.parametrize("system", [lag(), lower(lag(), 0.01)], ids=["model", "block"])
def test_gaps_in_an_input_are_reported_with_time_and_place(system):
    u = np.where(np.arange(150) == 40, np.nan, 1.0)
    record = Record(TIME, {"u": u, "x_seen": u}, {"u": "1", "x_seen": "1"}, name="run_3")
    with pytest.raises(DataError, match=rf"run_3: input column 'u' has gaps \(got 1 .* t = {TIME[40]:g} s\)"):
        simulate(system, record)
