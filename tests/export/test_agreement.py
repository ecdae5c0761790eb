"""One model, several masters, one answer."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.export.method import choose_method
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests.export.raw import DISCARD, OK, Library
from tests.export.systems import arm_record, command_record, mass_record, tank_in_volts
from tests.simulation.flat_cehA import flat_cehA

WITHIN = 1e-6  # of the range of each signal


def largest_difference(found: Record, expected: Record, names) -> float:
    return max(float(np.abs(found[n] - expected[n]).max() / np.ptp(expected[n])) for n in names)


def names_of(system) -> list[str]:
    return [s.name for s in system.outputs]


def test_the_fmu_of_the_actuator_equals_simulate(fmus, systems):
    record, flat = arm_record(), systems["cehA"]
    found = read_fmu(fmus["cehA"]).free_run(record)
    assert largest_difference(found, simulate(flat, record), names_of(flat)) < WITHIN


def test_an_fmu_starts_at_every_measured_state_as_simulate_does(tmp_path):
    """A level, a temperature, a speed: not only positions say where a recording begins (units m and rad)."""
    flat = tank_in_volts()
    signals = {"pump": np.full(80, 2.0), "level": np.linspace(7.0, 6.0, 80)}
    record = Record(np.arange(0.0, 8.0, 0.1), signals, {"pump": "V", "level": "V"})
    fmu = read_fmu(export_fmu(flat, tmp_path / "tank.fmu"))
    assert fmu.starts_of(record) == {"level.start": 7.0}
    assert largest_difference(fmu.free_run(record), simulate(flat, record), ["level"]) < WITHIN
    unknown = record.with_signals({"level": np.r_[np.nan, record["level"][1:]]})
    assert fmu.starts_of(unknown) == {}


def test_libcosimpy_runs_the_fmu_to_the_same_numbers(fmus, systems):
    from libcosimpy.CosimExecution import CosimExecution
    from libcosimpy.CosimManipulator import CosimManipulator
    from libcosimpy.CosimObserver import CosimObserver
    from libcosimpy.CosimSlave import CosimLocalSlave

    record, names = arm_record(2.0), names_of(systems["cehA"])
    execution = CosimExecution.from_step_size(step_size=int(record.period * 1e9 + 0.5))
    slave = execution.add_local_slave(CosimLocalSlave(fmu_path=str(fmus["cehA"]), instance_name="arm"))
    references = {v.name.decode(): v.reference for v in execution.slave_variables(slave)}
    execution.real_initial_value(slave, references["arm.angle.start"], 0.1)
    override, observer = CosimManipulator.create_override(), CosimObserver.create_last_value()
    execution.add_manipulator(override)
    execution.add_observer(observer)
    found = []
    for value in record["command"][:-1]:
        override.slave_real_values(slave, [references["command"]], [float(value)])
        execution.step()
        found.append(observer.last_real_values(slave, [references[n] for n in names]))
    expected = simulate(systems["cehA"], record).array(names)
    assert (np.abs(np.array(found) - expected[1:]) / np.ptp(expected, axis=0)).max() < WITHIN


@pytest.mark.parametrize("version", [2, 3])
def test_fmpys_own_master_runs_the_fmu_to_the_same_numbers(variants, systems, version):
    from fmpy import simulate_fmu

    record, names = arm_record(2.0), names_of(systems["cehA"])
    pairs = list(zip(record.time, record["command"], strict=True))
    signals = np.array(pairs, dtype=[("time", np.float64), ("command", np.float64)])
    result = simulate_fmu(
        str(variants["cehA", ("fmi", version)]), start_values={"arm.angle.start": 0.1}, input=signals, output=names,
        output_interval=0.01, start_time=0.0, stop_time=record.time[-1],
    )  # fmt: skip
    expected = simulate(systems["cehA"], record).array(names)
    found = np.column_stack([result[n] for n in names])
    assert (np.abs(found - expected) / np.ptp(expected, axis=0)).max() < WITHIN


def cvodes(flat, record: Record, start: dict[str, float]) -> dict[str, np.ndarray]:
    """Outputs of SUNDIALS' CVODES at 1e-12, inputs held."""
    p, nominal = flat.parameter_vector(), np.array([s.nominal for s in flat.states])
    u = record.array([s.name for s in flat.inputs])
    z, h = ca.SX.sym("z", len(nominal)), float(record.period)
    us = ca.SX.sym("u", u.shape[1])
    dae = {"x": z, "p": us, "ode": flat.ode(0, z * nominal, us, p)[0] / nominal}
    solver = ca.integrator("cvodes", "cvodes", dae, 0, h, {"reltol": 1e-12, "abstol": 1e-12, "max_num_steps": 100_000})
    x = flat.start_given(tuple(start))(u[0], p, list(start.values())).full().ravel() / nominal
    rows = []
    for k in range(len(record)):
        rows.append(flat.ode(0, x * nominal, u[k], p)[1].full().ravel())
        x = solver(x0=x, p=u[k])["xf"].full().ravel()
    return dict(zip(names_of(flat), np.array(rows).T, strict=True))


def test_the_adaptive_fmu_agrees_with_cvodes_in_every_output(tmp_path):
    record, flat = arm_record(2.0), flat_cehA()
    fmu = export_fmu(flat, tmp_path / "adaptive.fmu", method="adaptive")
    expected = cvodes(flat, record, {"arm.angle": 0.1})
    found = read_fmu(fmu).free_run(record)
    errors = {n: np.abs(found[n] - expected[n]).max() / np.ptp(expected[n]) for n in expected}
    assert max(errors.values()) < WITHIN, errors


def test_the_explicit_fmu_agrees_with_cvodes_in_the_motion(fmus):
    record = arm_record(2.0)
    expected, found = cvodes(flat_cehA(), record, {"arm.angle": 0.1}), read_fmu(fmus["cehA"]).free_run(record)
    for name in ("arm_angle", "rod_position", "motor_speed"):
        assert np.abs(found[name] - expected[name]).max() < WITHIN * np.ptp(expected[name])


def test_a_stiff_model_gets_the_adaptive_method_and_agrees_with_cvodes(fmus, systems):
    flat = systems["stiff"]
    assert choose_method(flat, "auto", flat.step)[0] == "adaptive"
    t = np.arange(0.0, 2.0, 0.01)
    record = Record(t, {"drive": np.sin(3 * t)}, {"drive": "1"})
    expected, found = cvodes(flat, record, {}), read_fmu(fmus["stiff"]).free_run(record)
    assert np.abs(found["level"] - expected["level"]).max() < WITHIN * np.ptp(expected["level"])


def test_the_actuator_gets_the_step_of_simulate(systems):
    assert choose_method(systems["cehA"], "auto", 1e-3)[:2] == ("refined", 1e-3)


def with_linear_inputs(system, names):
    """A model or contender whose inputs move linearly if named, and are held if not."""
    kinds = {s.name: "linear" if s.name in names else "hold" for s in system.inputs}
    inputs = tuple(dataclasses.replace(s, interpolation=kinds[s.name]) for s in system.inputs)
    return dataclasses.replace(system, inputs=inputs)


@pytest.mark.parametrize("linear", [["force"], ["extra"], ["force", "extra"], []])
def test_held_and_linear_inputs_on_uneven_samples_equal_simulate(fmus, systems, linear):
    record, flat = mass_record(), with_linear_inputs(systems["delayed mass"], linear)
    block = with_linear_inputs(read_fmu(fmus["delayed mass"]), linear)
    assert largest_difference(block.free_run(record), simulate(flat, record), names_of(flat)) < WITHIN


def test_a_linear_input_without_dead_time_has_no_half_sample_delay(fmus, systems):
    record = arm_record(2.0, 0.02)
    flat, block = (with_linear_inputs(s, ["command"]) for s in (systems["cehA"], read_fmu(fmus["cehA"])))
    assert largest_difference(block.free_run(record), simulate(flat, record), ["arm_angle", "motor_speed"]) < WITHIN


def test_the_derivative_to_the_dead_time_is_the_slope_of_what_was(libraries):
    instance = libraries["delayed mass"].instance().initialise()
    for k in range(10):
        instance.set("force", 0.3 * k)
        assert instance.slope("force", 30.0) == OK
        assert instance.step(k * 0.01, 0.01) == OK
    seen = []
    for delay in (0.037 + 1e-5, 0.037 - 1e-5, 0.037):
        instance.set("force_delay", delay)
        seen += instance.get("seen_force")
    assert instance.directional("seen_force", "force_delay") == pytest.approx((seen[0] - seen[1]) / 2e-5, rel=1e-6)
    assert instance.directional("seen_force", "force") == 0.0
    instance.free()


@pytest.mark.parametrize("delay", [0.0, 0.0013, 0.25, 5.0])
def test_the_dead_time_is_a_parameter_that_works(fmus, systems, delay):
    record, flat = mass_record(1.0), systems["delayed mass"]
    slow = with_linear_inputs(read_fmu(fmus["delayed mass"], values={"force_delay": delay}), ["force"])
    expected = simulate(flat, record, parameters={"force_delay": delay})
    found = slow.free_run(record)
    for name in names_of(flat):
        assert np.abs(found[name] - expected[name]).max() < WITHIN * max(np.ptp(expected[name]), 1e-3)


def test_a_short_history_keeps_the_mean_of_the_input(systems, tmp_path):
    """With 8 pieces for 40 samples of dead time the input is smoothed, not lost."""
    flat = systems["delayed mass"].with_parameters({"force_delay": 0.4})
    record = mass_record(2.0)
    block = read_fmu(export_fmu(flat, tmp_path / "short.fmu", history=8))
    found, expected = block.free_run(record), simulate(flat, record)
    assert np.abs(found["place"] - expected["place"]).max() < 0.2 * np.ptp(expected["place"])
    assert np.abs(found["place"] - expected["place"]).max() > 0.0


@pytest.mark.parametrize("name", ["lag", "lag in MX", "network"])
def test_a_block_equals_simulate_bit_by_bit(fmus, systems, name):
    record = command_record()
    found, expected = read_fmu(fmus[name]).free_run(record), simulate(systems[name], record)
    for output in names_of(systems[name]):
        np.testing.assert_allclose(found[output], expected[output], rtol=1e-14, atol=1e-15)


@pytest.mark.parametrize("ratio", [0.25, 1.0, 2.5, 7.0])
def test_a_block_is_held_between_its_samples_whatever_the_masters_step(libraries, systems, ratio):
    """The block moves at 0, 20, 40 ms ...; a master of another step sees the last sample, and the same states."""
    block, instance = systems["lag"], libraries["lag"].instance().initialise()
    assert instance.set("command", 0.7) == OK
    size, x, y = ratio * block.period, np.zeros(2), None
    taken = 0
    for k in range(40):
        assert instance.step(k * size, size) == OK
        now = (k + 1) * size
        while taken * block.period <= now + 1e-9:
            after, y = block.step(x, 0.7, block.parameter_vector())
            x, taken = after.full().ravel(), taken + 1
        assert instance.get("angle", "rate") == pytest.approx(y.full().ravel().tolist(), rel=1e-13)
    instance.free()


def test_a_block_leaving_its_training_data_says_how_far(fmus):
    record = command_record()
    found = read_fmu(fmus["lag with domain"]).free_run(record)
    outside = np.maximum(np.maximum(np.abs(record["command"]) - 1.0, 0) / 2.0, (np.abs(found["rate"]) - 0.9) / 1.8)
    np.testing.assert_allclose(found["training_distance"], np.maximum(outside, 0.0), atol=1e-12)


def test_a_new_start_angle_moves_the_static_equilibrium(libraries, systems):
    flat = systems["cehA"]
    for angle in (-0.2, 0.0, 0.4):
        instance = libraries["cehA"].instance().initialise(**{"arm.angle.start": angle, "precharge": 1.5e6})
        expected = flat.start_given(["arm.angle"])([0.0], flat.parameter_vector({"precharge": 1.5e6}), [angle])
        assert instance.get(*(s.name for s in flat.states)) == pytest.approx(
            expected.full().ravel().tolist(), rel=1e-14
        )
        instance.free()


def test_a_parameter_changed_while_running_takes_effect_at_the_next_step(libraries, systems):
    instance = libraries["cehA"].instance().initialise()
    instance.set("command", 1.0)
    assert [instance.step(k * 0.01, 0.01) for k in range(100)] == [OK] * 100
    assert instance.get("motor_speed")[0] == pytest.approx(120.0, rel=1e-6)
    instance.set("motor.gain", 60.0)
    assert [instance.step(1.0 + k * 0.01, 0.01) for k in range(100)] == [OK] * 100
    assert instance.get("motor_speed")[0] == pytest.approx(60.0, rel=1e-6)
    instance.free()


def test_a_numerical_failure_is_discarded_and_the_state_is_the_one_before(libraries):
    instance = libraries["cehA"].instance().initialise()
    assert instance.step(0.0, 0.01) == OK
    before, stored = instance.get("arm_angle", "pressure_cap"), instance.serialized()
    instance.set("motor.time_constant", 1e-300)  # its rate is not finite
    instance.set("command", 5.0)
    assert instance.step(0.01, 0.5) == DISCARD
    assert "not finite" in instance.library.messages[-1][1]
    assert instance.get("arm_angle", "pressure_cap") == before
    instance.set("motor.time_constant", 0.03)
    assert instance.step(0.01, 0.01) == OK
    assert instance.restore(stored) == OK
    assert instance.get("arm_angle", "pressure_cap") == before
    instance.free()


def test_given_names_the_states_that_can_be_set(tmp_path, systems):
    flat = systems["cehA"]
    fmu = export_fmu(flat, tmp_path / "all.fmu", given=[s.name for s in flat.states])
    library = Library(fmu, tmp_path / "all")
    starts = {f"{s.name}.start": value for s, value in zip(flat.states, (10.0, 3e6, 2.5e6, 0.2, 0.05), strict=True)}
    instance = library.instance().initialise(**starts)
    assert instance.get(*(s.name for s in flat.states)) == list(starts.values())
    instance.free()


def test_inside_and_outside_of_the_training_data_are_told_alike_in_python_and_in_the_fmu(fmus, systems):
    record = command_record()
    found, expected = read_fmu(fmus["lag with domain"]).free_run(record), simulate(systems["lag with domain"], record)
    assert set(np.unique(expected["inside_training_domain"])) == {0.0, 1.0}
    for name in ("training_distance", "inside_training_domain"):
        np.testing.assert_allclose(found[name], expected[name], atol=1e-12)


def test_derivatives_of_co_simulation_follow_the_step_though_only_outputs_were_read(libraries, systems):
    flat = systems["cehA"]
    instance = libraries["cehA"].instance().initialise()
    names = [f"der({s.name})" for s in flat.states]
    for k in range(3):
        assert instance.step(0.01 * k, 0.01) == OK
        instance.get(*(s.name for s in flat.outputs))
    x, t = instance.get(*(s.name for s in flat.states)), 0.03
    expected = flat.ode(t, x, [0.0] * len(flat.inputs), flat.parameter_vector())[0].full().ravel()
    np.testing.assert_allclose(instance.get(*names), expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max())
    instance.free()
