"""check_fmu on FMUs that offer Model Exchange, alone or beside Co-Simulation, and as other programs take them."""

from __future__ import annotations

import dataclasses
import re
import xml.etree.ElementTree as ET

import numpy as np
import pytest

from hydrotwin.export import check_fmu, export_fmu, reference_run
from hydrotwin.export.check_plan import plan_of
from hydrotwin.export.fmu_process import gates
from hydrotwin.export.fmu_process.verdicts import NotTried
from tests.export.foreign import KEEPS_NO_STATE, STALE_AFTER_TIME, SWALLOWS_NAN, fmi3_model_exchange, rewritten
from tests.export.test_check import OF_EXCHANGE, ROWS
from tests.export.test_description import read

BOTH, ME, FMI3 = ("kind", "both"), ("kind", "me"), ("fmi", 3)
HALF = {f"{name} (Model Exchange)" for name in OF_EXCHANGE}


@pytest.mark.parametrize("fmi", [2, 3])
def test_an_fmu_with_both_is_tried_as_both_and_by_other_programs(systems, tmp_path, fmi):
    flat = systems["clocked mass"]
    fmu = export_fmu(flat, tmp_path / "both.fmu", fmi=fmi, kind="both", reference=reference_run(flat, fine=True))
    check = check_fmu(fmu)
    assert check.passed, str(check)
    others = {2: {"libcosimpy"}, 3: {"CasADi importer", "terminals"}}[fmi]
    halves = {*HALF, "FMPy Model Exchange", "reference (Model Exchange)", "related files"}
    assert {row.name for row in check.rows} == (ROWS - {"libcosimpy"}) | halves | others
    assert [row.name for row in check.rows if not row.passed] == {2: ["intermediate update"], 3: []}[fmi], str(check)
    assert "CoSimulation and ModelExchange" in check["readable"].detail


def test_a_stale_answer_in_the_other_half_is_found(variants, tmp_path):
    fmu = rewritten(variants["clocked mass", BOTH], tmp_path / "stale.fmu", c=STALE_AFTER_TIME)
    check = check_fmu(fmu)
    named = ["order of setting (Model Exchange)", "any order of calls (Model Exchange)"]
    assert [row.name for row in check.failures] == named


@pytest.mark.parametrize("key", [(BOTH,), (ME,)])
def test_a_state_that_is_not_brought_back_is_found_in_model_exchange(variants, tmp_path, key):
    fmu = rewritten(variants["clocked mass", *key], tmp_path / "forgets.fmu", c=KEEPS_NO_STATE)
    failed = {row.name for row in check_fmu(fmu).failures}
    assert failed == ({"state"} if key == (ME,) else {"state", "state (Model Exchange)"})


def test_a_nan_that_reaches_the_outputs_of_model_exchange_is_a_remark(variants, tmp_path):
    fmu = rewritten(variants["clocked mass", ME], tmp_path / "careless.fmu", c=SWALLOWS_NAN)
    check = check_fmu(fmu)
    assert check.passed
    assert check["NaN input"].verdict == "remark"
    assert "reaches" in check["NaN input"].detail


def test_a_wrong_reference_is_found_in_both_halves(variants, systems):
    record = reference_run(systems["clocked mass"], fine=True)
    wrong = dataclasses.replace(record, signals={**record.signals, "place": record["place"] + 0.01 * record.time})
    check = check_fmu(variants["clocked mass", BOTH], wrong)
    assert {row.name for row in check.failures} == {"reference", "reference (Model Exchange)"}


def test_derivatives_listed_in_another_order_than_they_come_are_found_and_seen_by_casadis_importer(variants, tmp_path):
    good = variants["clocked mass", FMI3, ME]
    first, second = re.findall(r"<ContinuousStateDerivative [^>]*/>", read(good))
    swapped = rewritten(good, tmp_path / "swapped.fmu", xml={first: "<A/>", second: first, "<A/>": second})
    assert check_fmu(good)["CasADi importer"].passed
    check = check_fmu(swapped)
    assert "order of states" in [row.name for row in check.failures]
    assert check["CasADi importer"].verdict == "remark"
    assert "largest difference" in check["CasADi importer"].detail


def test_casadis_own_fmu_of_model_exchange_is_taken_by_its_importer(tmp_path):
    check = check_fmu(fmi3_model_exchange(tmp_path))
    assert check["CasADi importer"].passed, str(check)
    assert check["FMPy Model Exchange"].passed, str(check)


def test_a_program_that_is_not_installed_fails_nothing(monkeypatch):
    monkeypatch.setattr(gates.importlib.util, "find_spec", lambda name: None)
    for name in ("libcosimpy", "CasADi importer"):
        with pytest.raises(NotTried, match="not installed"):
            gates.GATES[name](None, "", "x.fmu")


def test_a_difference_is_relative_and_infinite_for_what_is_not_finite():
    assert gates._difference(np.array([2.0, 0.0]), np.array([1.0, 0.0])) == 0.5
    assert gates._difference(np.array([np.nan]), np.array([1.0])) == np.inf


def test_gates_are_for_the_kinds_they_can_take(variants):
    from fmpy import read_model_description

    def names(*key):
        md = read_model_description(str(variants["clocked mass", *key]), validate=False)
        return [entry["row"] for entry in plan_of(md) if entry["group"] == "gates"]

    assert names(BOTH) == ["FMPy Co-Simulation", "FMPy Model Exchange", "libcosimpy"]
    assert names(FMI3, ME) == ["FMPy Model Exchange", "CasADi importer"]
    assert names(FMI3) == ["FMPy Co-Simulation"]
    assert ET.fromstring(read(variants["clocked mass", FMI3])).find("ModelExchange") is None
