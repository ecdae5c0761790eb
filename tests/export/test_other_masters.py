"""FMUs of ours in other masters: Model Exchange under moving inputs, any order of calls, the start of every state."""

from __future__ import annotations

import ctypes as c
import dataclasses

import numpy as np
import pytest

from hydrotwin.export import check_fmu, export_fmu, read_fmu, reference_run
from hydrotwin.loading import load
from hydrotwin.records import Record
from hydrotwin.simulation import predict_one_step, simulate
from tests.export.raw import OK
from tests.export.systems import arm_record
from tests.export.test_exchange import moved, states_of

BOTH, VERSIONS = ("kind", "both"), [("fmi", 2), ("fmi", 3)]
TIME = np.arange(0.0, 0.5001, 0.01).round(9)


@pytest.fixture(scope="module")
def valve(tmp_path_factory):
    """A stiff machine as an FMU of both kinds."""
    return export_fmu(load("spool_valve"), tmp_path_factory.mktemp("valve") / "valve.fmu", kind="both")


def current(kind: str):
    """A current that moves all the time, and the valve of which the input is held or linear."""
    flat = load("spool_valve").flat
    [signal] = flat.inputs
    record = Record(TIME, {signal.name: 0.2 * signal.nominal * np.sin(3 * TIME)}, {signal.name: signal.unit})
    inputs = (dataclasses.replace(signal, interpolation=kind),)
    return record, dataclasses.replace(flat, inputs=inputs), signal.name


def in_fmpy(path, record: Record, name: str, held: bool, names: list[str]):
    """FMPy's own simulation with its CVODES and defaults."""
    from fmpy import simulate_fmu

    n = len(TIME)
    pairs = [(k, j) for k in range(n - 1) for j in (k, k + 1)] if held else [(k, k) for k in range(n)]
    rows = [(TIME[j], record[name][k]) for k, j in pairs]
    signals = np.array(rows, dtype=[("time", np.float64), (name, np.float64)])
    return simulate_fmu(
        str(path), fmi_type="ModelExchange", input=signals, output=names, output_interval=0.01, stop_time=TIME[-1],
        record_events=False,
    )  # fmt: skip


def range_share(found, expected: Record, names) -> float:
    return max(float(np.abs(found[n] - expected[n]).max() / np.ptp(expected[n])) for n in names)


def test_fmpys_cvodes_agrees_with_simulate_under_steps(valve):
    record, flat, name = current("hold")
    names = [s.name for s in flat.outputs]
    assert range_share(in_fmpy(valve, record, name, True, names), simulate(flat, record), names) < 1e-5


def test_fmpys_cvodes_comes_through_where_it_holds_a_moving_input_until_its_next_output(valve):
    """It moves inputs between its calls of CVODES alone: each is a jump, which the FMU answers with an event."""
    record, flat, name = current("hold")
    names = [s.name for s in flat.outputs]
    assert range_share(in_fmpy(valve, record, name, False, names), simulate(flat, record), names) < 1e-5


@pytest.mark.parametrize("kind", ["hold", "linear"])
def test_our_model_exchange_agrees_with_simulate(valve, kind):
    record, flat, _ = current(kind)
    block = read_fmu(valve, interpolation=kind)
    block = dataclasses.replace(block, description=dataclasses.replace(block.description, interface="ModelExchange"))
    assert range_share(block.free_run(record), simulate(flat, record), [s.name for s in flat.outputs]) < 5e-5


@pytest.mark.parametrize("version", VERSIONS)
@pytest.mark.parametrize("name", ["cehA", "clocked mass", "stiff"])
def test_after_any_calls_derivatives_and_outputs_are_those_of_a_fresh_instance(exchangers, name, version):
    library = exchangers[name, BOTH, version]
    worn, fresh, random = library.instance(kind=0), library.instance(kind=0), np.random.default_rng(2)
    worn.exchange(), fresh.exchange()
    outputs, [u], count = library.names("output"), library.names("input"), len(states_of(library))
    away, first = moved(worn), np.array(worn.vector("ContinuousStates", count))
    point = [0.0, first, 0.0]
    for _ in range(60):
        for what in random.choice(5, 8):
            if what == 0:
                point[0] = float(random.uniform(0.0, 3.0))  # forwards and back
                assert worn.set_time(point[0]) == OK
            elif what == 1:
                point[1] = first + random.uniform(-1.0, 1.0, count) * (np.array(away) - first)
                assert worn.set_states(list(point[1])) == OK
            elif what == 2:
                point[2] = float(random.uniform(-1.0, 1.0))
                assert worn.set(u, point[2]) == OK
            elif what == 3:
                worn.vector("Derivatives", count)
            else:
                worn.get(*outputs)
        assert fresh.Reset() == OK
        fresh.exchange()
        fresh.set(u, point[2]), fresh.set_states(list(point[1])), fresh.set_time(point[0])
        assert worn.vector("Derivatives", count) == fresh.vector("Derivatives", count)
        assert worn.get(*outputs) == fresh.get(*outputs)
    worn.free(), fresh.free()


def completed(instance) -> bool:
    """Whether the instance asks for event mode at the end of a step."""
    kind = c.c_int if instance.library.fmi == 2 else c.c_bool
    event, ends = kind(), kind()
    assert instance.CompletedIntegratorStep(kind(1), c.byref(event), c.byref(ends)) == OK
    return bool(event.value)


@pytest.mark.parametrize("version", VERSIONS)
def test_event_mode_is_asked_for_where_a_held_input_has_jumped_and_not_where_it_moves(exchangers, version):
    library = exchangers["clocked mass", BOTH, version]
    instance = library.instance(kind=0)
    instance.exchange()

    def step(*inputs: float) -> bool:
        for value in inputs:
            instance.set("force", value)
            instance.vector("Derivatives", 2)
        return completed(instance)

    assert not step(0.0, 0.0)
    assert not step(0.0, 0.1, 0.2)
    instance.set("force", 5.0)
    assert not completed(instance)  # nobody has asked since
    instance.vector("Derivatives", 2)
    instance.set("force", 6.0)
    assert completed(instance)
    instance.free()


def test_check_and_the_run_kept_inside_agree_with_simulate(tmp_path):
    model = load("spool_valve")
    path = export_fmu(model, tmp_path / "valve.fmu", kind="both", reference=reference_run(model))
    check = check_fmu(path)
    assert check.passed, str(check)


def test_every_state_has_a_start_that_can_be_set_and_follows_from_the_rest_until_it_is(fmus, systems):
    flat, record = systems["cehA"], arm_record(0.5)
    record = record.with_signals({"command": record["command"] + 0.5})
    starts = {p.name: p.value for p in read_fmu(fmus["cehA"]).parameters if p.name.endswith(".start")}
    assert set(starts) == {f"{s.name}.start" for s in flat.states}
    assert read_fmu(fmus["cehA"]).description.starts == {"arm.angle.start": "arm_angle"}
    measured = ("pressure_cap", "pressure_rod", "motor_speed")
    assert set(read_fmu(fmus["cehA"]).starts.values()) == {"arm_angle", *measured}
    assert not set(measured) & set(record.signals)
    for given in ({}, {"cylinder.cap_pressure": 3e6}, {"motor.speed": 40.0, "cylinder.rod_pressure": 1.5e6}):
        found = read_fmu(fmus["cehA"], values={f"{n}.start": v for n, v in given.items()}).free_run(record)
        expected = simulate(flat, record, start={"arm.angle": 0.1, **given})
        assert range_share(found, expected, [s.name for s in flat.outputs]) < 1e-9, given


def test_the_start_that_the_model_states_is_the_default_of_the_fmu(tmp_path):
    model = load("cehA").with_settings({"precharge": {"value": 33e5}})
    starts = {p.name: p.value for p in read_fmu(export_fmu(model, tmp_path / "x.fmu")).parameters}
    x = np.array(model.flat.start_given(())([0.0], model.flat.parameter_vector(), [])).ravel()
    for state, value in zip(model.flat.states, x, strict=True):
        assert starts[f"{state.name}.start"] == value
    assert 33e5 in starts.values()


def test_one_step_is_to_be_had_of_every_model_without_dead_time(fmus, systems):
    flat, record = systems["cehA"], arm_record(0.3)
    truth = simulate(flat, record)
    units = {n: u for n, u in truth.units.items() if n != "arm_angle"}
    record = record.with_signals({n: v for n, v in truth.signals.items()}, units)
    found, expected = read_fmu(fmus["cehA"]).one_step(record), predict_one_step(flat, record)
    assert range_share(found, expected, [s.name for s in flat.outputs]) < 1e-6
