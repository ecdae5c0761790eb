"""compare --ssp: a comparison packed as an SSP archive, from the command line."""

from __future__ import annotations

import json
import tomllib
import zipfile

import numpy as np
import pytest
from fmpy.ssp.ssd import read_ssd, read_ssv

import hydrotwin as ht
from hydrotwin.export import read_fmu
from hydrotwin.export.inside import RECORD_FILE
from hydrotwin.models import cehA
from hydrotwin.models.effects import add_effect
from tests.face.command_line import SHIPPED, hydrotwin, short


def values(archive, name: str) -> dict[str, float]:
    return {p.name: float(p.value) for p in read_ssv(archive, resource=f"resources/{name}.ssv").parameters}


@pytest.fixture(scope="module")
def packed(recordings):
    """A comparison of the shipped model, an identified one with an effect, the formula, an FMU and the yardstick."""
    leaking = add_effect(cehA.model(), "internal_leakage", values={"conductance": 2e-14})
    found = leaking.with_parameters({"motor.gain": 117.0})
    ht.write_model_file(recordings / "model.toml", "cehA", found)
    ht.export_fmu(ht.load("eq17"), recordings / "vendor.fmu")
    (recordings / "scenario.toml").write_text(
        'models = ["cehA", {model = "model.toml", name = "identified"}, "eq17", '
        '{model = "vendor.fmu", name = "bought"}, "hold_last"]\nvalidate = ["validate_*.csv"]\nmodes = ["free run"]\n'
    )
    archive = recordings / "models.ssp"
    return archive, hydrotwin("compare", recordings / "scenario.toml", "--out", recordings / "r", "--ssp", archive)


def test_the_archive_holds_every_model_and_says_who_is_not_in_it(packed, recordings):
    archive, answer = packed
    assert answer.code == 0, answer.said
    assert "hold last sample: left out, it is no system" in answer.said and f", {archive}" in answer.said
    system = read_ssd(archive).system
    assert [c.name for c in system.elements] == ["cehA", "identified", "eq17", "bought"]
    assert [c.name for c in system.connectors if c.kind == "input"] == ["command", "motor_speed"]
    with zipfile.ZipFile(archive) as files:
        assert {"resources/validate_1.csv", "resources/validate_2.csv"} <= set(files.namelist())
        assert files.read("resources/bought.fmu") == (recordings / "vendor.fmu").read_bytes()


def test_nominal_is_the_machine_as_shipped_without_the_effect(packed):
    nominal, identified = values(packed[0], "nominal"), values(packed[0], "identified")
    (leak,) = (n for n in identified if "leakage" in n)
    shipped = {p.name: p.value for p in ht.load("cehA").flat.parameters}
    assert {n: v for n, v in nominal.items() if n.startswith("cehA.")} == {f"cehA.{n}": v for n, v in shipped.items()}
    assert (identified["identified.motor.gain"], nominal["identified.motor.gain"]) == (117.0, shipped["motor.gain"])
    assert (identified[leak], nominal[leak]) == (pytest.approx(2e-14), 0.0)
    assert next(b.source for b in read_ssd(packed[0]).system.parameterBindings) == "resources/identified.ssv"


def test_what_a_scenario_sets_and_estimates_is_in_the_archive(packed, recordings, tmp_path):
    """As the comparison ran them: a component with the values of another model would give other numbers."""
    (recordings / "set.toml").write_text(
        'models = [{model = "cehA", name = "soft", set = {"cylinder.oil.bulk_modulus" = "900 MPa"}}, "cehA", '
        '{model = "vendor.fmu", name = "bought", set = {motor_speed = "3 rad/s"}}]\n'
        'validate = ["validate_*.csv"]\nmodes = ["free run"]\ninitial_states = "auto"\n'
    )
    archive = tmp_path / "set.ssp"
    answer = hydrotwin("compare", recordings / "set.toml", "--out", tmp_path / "r", "--ssp", archive)
    assert answer.code == 0, answer.said
    nominal, start = values(archive, "nominal"), values(archive, "start_validate_2")
    assert nominal["soft.cylinder.oil.bulk_modulus"] == 900e6 != nominal["cehA.cylinder.oil.bulk_modulus"]
    told = json.loads((tmp_path / "r" / "compare.json").read_text(encoding="utf-8"))["starts"]
    (estimated,) = (row for row in told if (row["model"], row["record"]) == ("soft", "validate_2"))
    assert estimated["states"]
    for state in estimated["states"]:
        assert start[f"soft.{state['name']}.start"] == state["value"]


def test_each_recording_brings_its_start(packed, recordings):
    for name in ("validate_1", "validate_2"):
        angle = ht.read_record(recordings / f"{name}.csv")["arm_angle"][0]
        starts = values(packed[0], f"start_{name}")
        assert starts["identified.arm.angle.start"] == starts["bought.arm_angle.start"] == pytest.approx(angle)


def test_a_recording_with_a_hole_lies_in_the_archive_as_the_parts_that_were_run(recordings, tmp_path):
    """Each begins where its runs did: the start behind the hole had been that of the whole recording."""
    rows = (recordings / "validate_1.csv").read_text(encoding="utf-8").splitlines()
    middle = len(rows) // 2
    holed = tmp_path / "holed.csv"
    holed.write_text("\n".join(rows[:middle] + rows[middle + 40 :]), encoding="utf-8")
    archive, words = tmp_path / "holed.ssp", ("--mode", "free run", "--output", "arm_angle", "--out", tmp_path / "r")
    answer = hydrotwin("compare", "--model", "cehA", "--validate", holed, *words, "--ssp", archive)
    assert answer.code == 0, answer.said
    with zipfile.ZipFile(archive) as files:
        lengths = {n: len(files.read(n).splitlines()) for n in files.namelist() if n.endswith(".csv")}
    assert list(lengths) == ["resources/holed_part_1.csv", "resources/holed_part_2.csv"]
    assert sum(lengths.values()) == len(rows) - 40 + 1
    (estimated,) = json.loads((tmp_path / "r" / "compare.json").read_text(encoding="utf-8"))["starts"]
    first, second = (values(archive, f"start_holed_part_{k}") for k in (1, 2))
    assert first["cehA.arm.angle.start"] == pytest.approx(ht.read_record(holed)["arm_angle"][0])
    for state in estimated["states"]:
        assert second[f"cehA.{state['name']}.start"] == state["value"]


def test_models_in_a_loop_are_packed_with_their_controller(tmp_path):
    source = SHIPPED / "cehA/closed_loop"
    short(source / "measured.csv", tmp_path / "measured.csv", 3.0)
    text = (source / "scenario.toml").read_text()
    (tmp_path / "scenario.toml").write_text(text)
    archive = tmp_path / "loop.ssp"
    answer = hydrotwin("compare", tmp_path / "scenario.toml", "--out", tmp_path / "r", "--ssp", archive)
    assert answer.code == 0, answer.said
    assert [c.name for c in read_ssd(archive).system.connectors if c.kind == "input"] == ["reference"]
    with zipfile.ZipFile(archive) as files:
        files.extract("resources/cehA.fmu", tmp_path)
    record = ht.read_record(tmp_path / "measured.csv")
    angle = read_fmu(tmp_path / "resources/cehA.fmu").free_run(record)["arm_angle"]
    assert np.abs(angle - record["arm_angle"]).max() < 0.05 * np.ptp(record["arm_angle"])  # it follows the reference


def test_a_name_that_is_no_archive_is_refused_before_the_run(recordings):
    words = ("--model", "cehA", "--validate", recordings / "validate_1.csv", "--ssp", recordings / "out.zip")
    answer = hydrotwin("compare", *words, "--out", recordings / "never")
    assert answer.code == 2 and "It must end in .ssp" in answer.said
    assert not (recordings / "never").exists()


def test_a_learned_block_carries_its_record_in_an_archive_as_in_its_own_fmu(recordings, tmp_path):
    files = sorted(recordings.glob("train_*.csv"))
    block = ("learn", "arx", *files, "--input", "command", "--output", "motor_speed", "--out", tmp_path / "arx.toml")
    assert hydrotwin(*block).code == 0
    archive, models = tmp_path / "m.ssp", ("--model", tmp_path / "arx.toml", "--model", "eq17")
    words = ("--validate", recordings / "validate_1.csv", "--output", "motor_speed", "--out", tmp_path / "r")
    answer = hydrotwin("compare", *models, *words, "--ssp", archive)
    assert answer.code == 0, answer.said
    assert hydrotwin("export", tmp_path / "arx.toml", "--out", tmp_path / "arx.fmu").code == 0
    with zipfile.ZipFile(archive) as packed, zipfile.ZipFile(tmp_path / "arx.fmu") as alone:
        component = next(n for n in packed.namelist() if n.endswith(".fmu") and "eq17" not in n)
        packed.extract(component, tmp_path)
        (record,) = (name for name in alone.namelist() if name == RECORD_FILE)
        own = tomllib.loads(alone.read(record).decode())
    with zipfile.ZipFile(tmp_path / component) as inside:
        told = tomllib.loads(inside.read(RECORD_FILE).decode())
    assert told["credibility"] == own["credibility"] and own["credibility"]
