"""Anybody's FMU as a contender."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hydrotwin.comparison import compare
from hydrotwin.export import check_fmu, export_fmu, read_fmu
from hydrotwin.models.effects import add_effect
from hydrotwin.models.language import Model
from hydrotwin.models.language.errors import DataError, DeclarationError, SolveError, UnitError
from hydrotwin.records import Record
from hydrotwin.simulation import predict_one_step, simulate
from tests.discovery.slides import Drive, drive_records
from tests.export.foreign import CRASHES, HANGS, fmi3_model_exchange, rewritten
from tests.export.systems import arm_record, command_record

ROOT = Path(__file__).parents[2]


def test_the_block_knows_what_the_fmu_says_of_itself(fmus, systems):
    block, flat = read_fmu(fmus["cehA"]), systems["cehA"]
    assert (block.name, block.kind) == ("cehA", "fmu")
    assert [(s.name, s.unit) for s in block.inputs] == [("command", "V")]
    assert [(s.name, s.unit, s.nominal) for s in block.outputs] == [(s.name, s.unit, s.nominal) for s in flat.outputs]
    values = {p.name: p.value for p in block.parameters}
    assert {p.name: p.value for p in flat.parameters}.items() <= values.items()
    assert block.provenance["tool"].startswith("hydrotwin")


def test_it_starts_where_the_recording_starts(fmus):
    found = read_fmu(fmus["cehA"]).free_run(arm_record(0.1))
    assert found["arm_angle"][0] == pytest.approx(0.1, abs=1e-15)


def test_a_crash_of_the_fmu_is_an_error_here(fmus, tmp_path):
    fmu = rewritten(fmus["lag"], tmp_path / "crash.fmu", c=CRASHES)
    with pytest.raises(SolveError, match="SIGABRT"):
        read_fmu(fmu).free_run(command_record())


def test_a_hang_of_the_fmu_is_an_error_in_time(fmus, tmp_path):
    fmu = rewritten(fmus["lag"], tmp_path / "hang.fmu", c=HANGS)
    began = time.monotonic()
    with pytest.raises(SolveError, match="did not come to an end"):
        read_fmu(fmu, time_limit=3.0).free_run(command_record())
    assert time.monotonic() - began < 10.0


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="looks children up in /proc")
def test_whoever_kills_a_run_leaves_no_fmu_behind(fmus, tmp_path):
    fmu = rewritten(fmus["lag"], tmp_path / "hang.fmu", c=HANGS)
    script = f"""
from hydrotwin.export import read_fmu
from {command_record.__module__} import command_record
read_fmu({str(fmu)!r}).free_run(command_record())
"""
    with subprocess.Popen([sys.executable, "-c", script], cwd=ROOT) as run:
        children = Path(f"/proc/{run.pid}/task/{run.pid}/children")
        _until(lambda: children.read_text().split())
        (child,) = children.read_text().split()
        time.sleep(1.0)  # it has begun
        run.kill()
    _until(lambda: not Path(f"/proc/{child}").exists() or " Z " in Path(f"/proc/{child}/stat").read_text())


def _until(done, limit: float = 30.0):
    began = time.monotonic()
    while not done():
        assert time.monotonic() - began < limit
        time.sleep(0.05)


@pytest.mark.parametrize("fmi", [2, 3])
def test_a_failing_step_names_the_reason_of_the_fmu(variants, fmi):
    block = read_fmu(variants["cehA", ("fmi", fmi)], values={"motor.time_constant": 1e-300})
    with pytest.raises(SolveError, match="not finite"):
        block.free_run(arm_record(1.0))


def test_units_of_the_fmu_are_converted(fmus, tmp_path):
    degrees = {
        '<Real declaredType="Angle" unit="rad" displayUnit="deg"': '<Real unit="deg"',
        '<Unit name="rad">': '<Unit name="deg"/><Unit name="rad">',
    }
    fmu = rewritten(fmus["lag"], tmp_path / "degrees.fmu", xml=degrees)
    record = command_record()
    found = read_fmu(fmu).free_run(record)
    plain = read_fmu(fmus["lag"]).free_run(record)
    assert found.units["angle"] == "rad"
    start = found["angle"][0] / plain["angle"][0]
    assert start == pytest.approx(1.0)  # 0.3 rad went in as 17.2 and came back
    assert not np.allclose(found["angle"][5:], plain["angle"][5:])  # the inside still counts in rad


def test_a_unit_only_the_fmu_defines_is_read_from_its_exponents(fmus, tmp_path):
    inches = {
        '<Real declaredType="ElectricPotential" unit="V"': '<Real unit="zoll"',
        '<Unit name="V">': '<Unit name="zoll"><BaseUnit m="1" factor="0.0254"/></Unit><Unit name="V">',
    }
    block = read_fmu(rewritten(fmus["lag"], tmp_path / "zoll.fmu", xml=inches))
    assert block.inputs[0].unit == "m"
    assert block.description.scales["command"] == (0.0254, 0.0)


def test_names_and_units_can_be_given(fmus):
    block = read_fmu(fmus["lag"], names={"command": "voltage"}, units={"command": "mV"})
    record = command_record()
    renamed = type(record)(
        record.time, {"voltage": record["command"] / 1000, "angle": record["angle"]}, {"voltage": "V", "angle": "rad"}
    )
    expected = read_fmu(fmus["lag"]).free_run(record)
    np.testing.assert_allclose(block.free_run(renamed)["angle"], expected["angle"], rtol=1e-12)


def test_a_wrong_unit_and_a_wrong_name_are_named(fmus):
    block, record = read_fmu(fmus["cehA"]), arm_record(1.0)
    wrong = type(record)(record.time, {"command": record["command"]}, {"command": "Pa"})
    with pytest.raises(UnitError, match="command"):
        block.free_run(wrong)
    with pytest.raises(DeclarationError, match=r"Did you mean 'motor\.gain'"):
        read_fmu(fmus["cehA"], values={"motor.gian": 1.0})


def test_a_file_that_is_no_fmu_is_a_data_error(tmp_path):
    (tmp_path / "x.fmu").write_text("nothing")
    with pytest.raises(DataError, match="not an FMU"):
        read_fmu(tmp_path / "x.fmu")
    with pytest.raises(DataError, match="no such file"):
        read_fmu(tmp_path / "y.fmu")


def test_one_step_says_that_inner_states_cannot_be_set(fmus):
    with pytest.raises(DeclarationError, match="one-step prediction is not available"):
        read_fmu(fmus["lag"]).one_step(command_record())


def test_one_step_equals_ours_when_every_state_has_a_start(systems, tmp_path):
    flat, record = systems["cehA"], arm_record(1.0)
    rng = np.random.default_rng(3)
    truth = simulate(flat, record)
    noisy = {
        n: truth[n] + 1e-3 * np.ptp(truth[n]) * rng.standard_normal(len(record)) for n in ("arm_angle", "motor_speed")
    }
    record = record.with_signals(noisy, {"motor_speed": "rad/s"})
    fmu = export_fmu(flat, tmp_path / "all.fmu", given=[s.name for s in flat.states])
    starts = {
        s.name: float(v)
        for s, v in zip(
            flat.states, flat.start_given(())([0.0], flat.parameter_vector(), []).full().ravel(), strict=True
        )
    }
    values = {f"{n}.start": v for n, v in starts.items() if n not in ("arm.angle", "motor.speed")}
    start = {n: v for n, v in starts.items() if n not in ("arm.angle", "motor.speed")}
    found = read_fmu(fmu, values=values).one_step(record)
    expected = predict_one_step(flat, record, start=start)
    for name in ("arm_angle", "motor_speed", "pressure_cap"):
        assert np.abs(found[name] - expected[name]).max() < 1e-6 * np.ptp(expected[name])


def test_an_fmu_of_fmi_3_for_model_exchange_runs(tmp_path):
    """Made by CasADi's own exporter: another writer, another version, another kind of interface."""
    fmu = fmi3_model_exchange(tmp_path)
    block = read_fmu(fmu, units={"u": "V"})
    t = np.linspace(0.0, 2.0, 101)
    record = Record(t, {"u": (t >= 1.0).astype(float)}, {"u": "V"})
    expected = np.where(t < 1.0, np.exp(-2 * t), 0.5 + (np.exp(-2.0) - 0.5) * np.exp(-2 * (t - 1.0)))
    np.testing.assert_allclose(block.free_run(record)["y"], expected, atol=1e-5)
    assert block.provenance["fmi"].startswith("3")
    assert check_fmu(fmu)["runs"].passed
    with pytest.raises(DeclarationError, match="'x' cannot be set"):
        read_fmu(fmu, starts={"x": "y"})


def test_its_time_is_0_where_the_recording_begins(tmp_path):
    """A drive that grows stronger while it runs, recorded by a clock that began earlier: as `simulate` runs it."""
    model = add_effect(Model(Drive()), "drift", values={"rate": 0.02})
    (recorded,) = drive_records(1)
    run, later = (
        Record(recorded.time + clock, {"command": recorded["command"]}, {"command": "V"}, "run") for clock in (0, 1000)
    )
    block = read_fmu(export_fmu(model, tmp_path / "drive.fmu"))
    plain, ours = simulate(model, run)["rate"], simulate(model, later)
    assert ours.time[0] == 1000.0
    np.testing.assert_allclose(ours["rate"], plain, rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(predict_one_step(model, later)["rate"], predict_one_step(model, run)["rate"], rtol=1e-8)
    found = block.free_run(later)
    assert found.time[0] == 1000.0
    np.testing.assert_allclose(found["rate"], plain, rtol=1e-6, atol=1e-6)


@pytest.fixture
def unknown_at_times(systems, tmp_path):
    """The FMU of a model whose every state has a start, the model, and a recording that misses samples of a sensor."""
    flat, record = systems["cehA"], arm_record(0.2)
    fmu = export_fmu(flat, tmp_path / "all.fmu", given=[s.name for s in flat.states])
    angle = simulate(flat, record)["arm_angle"].copy()
    angle[:3] = angle[8:12] = np.nan
    return fmu, flat, record.with_signals({"arm_angle": angle})


def test_one_step_keeps_the_free_run_where_a_sensor_knows_nothing(unknown_at_times):
    """As a model does: one unknown sample had cost the whole run."""
    fmu, flat, record = unknown_at_times
    starts = np.asarray(flat.start_given(())([0.0], flat.parameter_vector(), [])).ravel()
    start = {s.name: float(v) for s, v in zip(flat.states, starts, strict=True)}
    found = read_fmu(fmu, values={f"{n}.start": v for n, v in start.items()}).one_step(record)
    expected = predict_one_step(flat, record, start=start)
    for name in ("arm_angle", "motor_speed", "pressure_cap"):
        assert np.abs(found[name] - expected[name]).max() < 1e-6 * np.ptp(expected[name])


@pytest.mark.parametrize("how", ["measured", "auto", "free"])
def test_an_fmu_whose_start_is_not_in_the_recording_says_so(unknown_at_times, how):
    fmu, _, record = unknown_at_times
    asked = {"modes": ["free run"], "repeats": 1, "initial_states": how}
    (started,) = compare([read_fmu(fmu)], [record], **asked).starts
    assert "the first sample of arm_angle is not known" in str(started) and "Set the start, or" in str(started)
    given = read_fmu(fmu, values={"arm.angle.start": 0.1})
    assert not [s for s in compare([given], [record], **asked).starts if "not known" in str(s)]
