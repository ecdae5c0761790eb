"""check_fmu tells good from bad."""

from __future__ import annotations

import pytest

from hydrotwin.export import check_fmu, export_fmu
from hydrotwin.models.language.errors import DataError
from hydrotwin.simulation import simulate
from tests.export.foreign import (
    CRASHES,
    RESET_KEEPS_STATE,
    STALE_AFTER_TIME,
    SWALLOWS_NAN,
    WRONG_ADJOINT,
    WRONG_DIRECTION,
    rewritten,
)
from tests.export.systems import arm_record, command_record
from tests.export.test_description import read

ROWS = {
    "readable", "schema", "interfaces", "unit definitions", "type definitions", "other definitions", "variables",
    "names", "model structure", "sources", "files", "platforms", "units", "loads", "runs", "reading", "start values",
    "reset", "second instance", "state", "intermediate update", "dependencies", "directional derivatives",
    "NaN input", "unknown value reference", "step before initialization", "FMPy Co-Simulation", "libcosimpy",
    "reference",
}  # fmt: skip
OF_EXCHANGE = {
    "loads", "runs", "reading", "start values", "number of states", "nominal values", "order of states",
    "order of setting", "any order of calls", "reset", "state", "dependencies", "directional derivatives", "NaN input",
}  # fmt: skip


@pytest.mark.parametrize("name", ["delayed mass", "lag"])
def test_our_own_fmus_pass(fmus, name):
    check = check_fmu(fmus[name])
    assert check.passed, str(check)
    assert {row.name for row in check.rows} == ROWS
    assert "bit by bit" in check["reset"].detail


def test_the_embedded_reference_is_replayed(systems, tmp_path):
    flat, record = systems["cehA"], arm_record(1.0)
    simulated = simulate(flat, record).with_signals({"command": record["command"]}, {"command": "V"})
    check = check_fmu(export_fmu(flat, tmp_path / "with.fmu", reference=simulated))
    assert check["reference"].passed, str(check)


def test_a_reference_inside_that_cannot_be_replayed_is_not_tried(systems, tmp_path):
    record = command_record()
    simulated = simulate(systems["lag"], record).with_signals({"command": record["command"]}, {"command": "V"})
    fmu = export_fmu(systems["lag"], tmp_path / "a.fmu", reference=simulated)
    check = check_fmu(rewritten(fmu, tmp_path / "b.fmu", xml={'unit="V"': 'unit="rad/s"'}))
    assert check["reference"].verdict == "not tried"
    assert "what it carries along cannot be replayed: " in check["reference"].detail


def test_a_reference_that_differs_fails(fmus, systems):
    record = command_record()
    simulated = simulate(systems["lag"], record)
    wrong = simulated.with_signals(
        {"command": record["command"], "rate": simulated["rate"] + 1e-3}, {"command": "V", "rate": "rad/s"}
    )
    row = check_fmu(fmus["lag"], wrong)["reference"]
    assert row.passed is False
    assert "rate" in row.detail


def test_a_nan_that_reaches_the_outputs_is_a_remark(fmus, tmp_path):
    """No importer may set one."""
    check = check_fmu(rewritten(fmus["delayed mass"], tmp_path / "careless.fmu", c=SWALLOWS_NAN))
    assert check["NaN input"].verdict == "remark"
    assert "reaches the outputs" in check["NaN input"].detail
    assert check.passed


def test_an_undeclared_dependency_is_found(fmus, tmp_path):
    fmu = rewritten(fmus["delayed mass"], tmp_path / "wrong.fmu", xml={'dependencies="1 2"': 'dependencies="1"'})
    check = check_fmu(fmu)
    assert "dependencies" in [row.name for row in check.failures]
    assert "seen_force on extra" in check["dependencies"].detail


def test_a_reset_that_keeps_the_state_is_found(fmus, tmp_path):
    check = check_fmu(rewritten(fmus["lag"], tmp_path / "keeps.fmu", c=RESET_KEEPS_STATE))
    assert [row.name for row in check.failures] == ["reset"]
    assert "largest difference" in check["reset"].detail


def test_a_unit_that_is_used_and_not_defined_is_found(fmus, tmp_path):
    text = read(fmus["lag"])
    start = text.index('<Unit name="V">')
    unit = text[start : text.index("</Unit>", start) + len("</Unit>")]
    check = check_fmu(rewritten(fmus["lag"], tmp_path / "undefined.fmu", xml={unit: ""}))
    assert check["variables"].verdict == "FAIL"
    assert "'V'" in check["variables"].detail
    assert check["variables"].rule == "FMI 2.0.5, 2.2.7 ModelVariables"


@pytest.mark.parametrize(
    ("fault", "words"),
    [
        ({"return wanted > now ? wanted : now;": "return end;"}, "FAIL: asked to return at"),
        ({"c->core.watcher = update ? ht3_watch : NULL;": "c->core.watcher = NULL;"}, "remark: it is declared"),
        ({"    c->update(c->environment, now,": "    c->update(c->environment, 2.0 - now,"}, "FAIL: the times of"),
        ({"can = c->early_return && now < end": "can = fmi3False"}, "pass: "),
    ],
)
def test_an_intermediate_update_fails_by_what_it_does_and_not_by_what_it_could_do(variants, tmp_path, fault, words):
    good = variants["lag", ("fmi", 3)]
    check = check_fmu(rewritten(good, tmp_path / "wrong.fmu", c=fault))
    row = check["intermediate update"]
    assert f"{row.verdict}: {row.detail}".startswith(words)
    assert check.failures == ((row,) if row.verdict == "FAIL" else ())


@pytest.mark.parametrize("name", ["delayed mass", "lag"])
def test_intermediate_update_of_our_own_is_as_declared(variants, fmus, name):
    row = check_fmu(variants[name, ("fmi", 3)])["intermediate update"]
    assert row.passed, row.detail
    assert "returned when asked" in row.detail
    assert check_fmu(fmus[name])["intermediate update"].verdict == "not tried"


def test_wrong_adjoint_derivatives_are_found(variants, tmp_path):
    fmu = rewritten(variants["delayed mass", ("fmi", 3)], tmp_path / "adjoint.fmu", c=WRONG_ADJOINT)
    check = check_fmu(fmu)
    assert "adjoint" in check["directional derivatives"].detail
    assert [row.name for row in check.failures] == ["directional derivatives"]


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_answer_that_is_stale_after_the_time_was_set_is_found(variants, tmp_path, fmi):
    good = variants["clocked mass", ("kind", "me"), ("fmi", fmi)]
    check = check_fmu(rewritten(good, tmp_path / "stale.fmu", c=STALE_AFTER_TIME))
    assert check["order of setting"].passed is False
    assert "stale" in check["order of setting"].detail
    assert [row.name for row in check.failures] == ["order of setting", "any order of calls"]
    good_check = check_fmu(good)
    assert all(good_check[n].passed for n in ("order of setting", "reset", "directional derivatives"))


@pytest.mark.parametrize("fmi", [2, 3])
def test_wrong_directional_derivatives_of_model_exchange_are_found(variants, tmp_path, fmi):
    good = variants["clocked mass", ("kind", "me"), ("fmi", fmi)]
    check = check_fmu(rewritten(good, tmp_path / "wrong.fmu", c=WRONG_DIRECTION))
    assert [row.name for row in check.failures] == ["directional derivatives"]


def test_a_crash_is_one_row_and_what_needs_a_run_is_not_tried(fmus, tmp_path):
    check = check_fmu(rewritten(fmus["lag"], tmp_path / "crash.fmu", c=CRASHES), time_limit=20.0)
    assert "SIGABRT" in check["runs"].detail
    assert {row.name for row in check.rows} == ROWS
    assert [row.name for row in check.failures] == ["runs"]
    assert check["reset"].detail == check["libcosimpy"].detail == "it does not run here, see 'runs'"


def test_a_broken_description_is_reported_and_the_rest_goes_on(fmus, tmp_path):
    fmu = rewritten(fmus["lag"], tmp_path / "bad.fmu", xml={'initial="calculated"': 'initial="exact"'})
    check = check_fmu(fmu)
    assert check["variables"].verdict == "FAIL"
    assert check["runs"].passed


def test_what_cannot_be_read_is_one_row_and_a_missing_file_an_error(tmp_path):
    (tmp_path / "x.fmu").write_text("nothing")
    check = check_fmu(tmp_path / "x.fmu")
    assert [row.name for row in check.rows] == ["readable"]
    assert not check.passed
    with pytest.raises(DataError):
        check_fmu(tmp_path / "y.fmu")


def test_missing_units_are_remarked(fmus, tmp_path):
    with_unit = '<Real declaredType="ElectricPotential" unit="V" '
    check = check_fmu(rewritten(fmus["lag"], tmp_path / "bare.fmu", xml={with_unit: "<Real "}))
    assert check["units"].verdict == "remark"
    assert "command" in check["units"].detail
