"""gap X.fmu on the command line: what it writes, that its model file is a MODEL everywhere, and what is refused."""

from __future__ import annotations

import json
import shutil
import tomllib

import pytest

import hydrotwin as ht
from hydrotwin.models.language import Model
from hydrotwin.records import write_record
from tests.discovery.slides import TwoSensors, drive_records
from tests.export.foreign import CRASHES, rewritten
from tests.face.command_line import hydrotwin

TRUE = {"gain": 10.0, "time_constant": 0.3}
GAP = ("gap", "drive.fmu", "a.csv", "b.csv", "--validate", "v.csv", "--executor", "here", "--out", "gap")


def high(w, time):
    """A sensor that reads five percent too high."""
    return 1.05 * w


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    """A folder in which the gap around an FMU of the drive has been found."""
    folder = tmp_path_factory.mktemp("around")
    ht.export_fmu(Model(TwoSensors(), step=2e-3).with_parameters(TRUE), folder / "drive.fmu")
    for name, record in zip("abv", drive_records(3, other=high), strict=True):
        write_record(record, folder / f"{name}.csv")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        answer = hydrotwin(*GAP, "--effects", "sensor_*", "--effects", "dead_time")
    assert answer.code == 0, answer.err
    return folder, answer


@pytest.fixture
def here(found, tmp_path, monkeypatch):
    """A copy of it to work in."""
    folder = tmp_path / "copy"
    shutil.copytree(found[0], folder)
    monkeypatch.chdir(folder)
    return folder


def test_the_answer_names_the_sensor_behind_the_fmu_and_writes_everything(found):
    folder, answer = found
    assert "twoSensors: named" in answer.out and "scale of the sensor" in answer.out
    content = json.loads((folder / "gap/gap.json").read_text())
    assert [(s["effect"], s["site"]) for s in content["steps"]] == [("sensor_scale", "other")]
    assert (folder / "gap/report.html").stat().st_size > 1e5
    file = tomllib.loads((folder / "gap/model.toml").read_text())
    assert file["model"] == "../drive.fmu" and len(file["provenance"]["fmu"]["sha256"]) == 64
    assert file["parameters"]["sensor_scale_other"]["error"]["value"] == pytest.approx(0.05, rel=0.05)
    text = (folder / "gap/model.mo").read_text()
    assert "RealInput puts_out_other" in text and "SensorScale sensor_scale_other" in text


def test_the_effects_of_an_fmu_stand_at_its_inputs_and_outputs_only(here):
    answer = hydrotwin("effects", "drive.fmu", "--json")
    assert answer.code == 0, answer.err
    places = {(r["effect"], r["site"]) for r in json.loads(answer.out)}
    assert {site for _, site in places} == {"command", "rate", "other"}
    assert {("dead_time", "command"), ("command_deadband", "command"), ("sensor_lag", "other")} <= places


def test_its_model_file_simulates_and_compares_better_than_the_fmu(here):
    simulated = hydrotwin("simulate", "gap/model.toml", "--input", "v.csv", "--out", "s.csv")
    assert simulated.code == 0, simulated.err
    models = ("--model", "plain=drive.fmu", "--model", "found=gap/model.toml")
    compared = hydrotwin("compare", *models, "--validate", "v.csv", "--out", "cmp", "--json")
    assert compared.code == 0, compared.err
    scores = [s for s in json.loads(compared.out)["scores"] if s["mode"] == "free run"]
    rows = {(s["model"], s["output"]): s["rmse"] for s in scores}
    assert rows["found", "other"] < 0.1 * rows["plain", "other"]
    assert rows["found", "rate"] == pytest.approx(rows["plain", "rate"], rel=1e-3)


def test_a_second_look_starts_from_the_effects_of_the_first(here):
    words = ("gap", "gap/model.toml", "a.csv", "b.csv", "--executor", "here", "--effects", "sensor_bias")
    again = hydrotwin(*words, "--out", "again")
    assert again.code == 0, again.err
    assert "twoSensors: none" in again.out
    assert [a.effect for a in ht.load("again/model.toml").additions] == ["sensor_scale"]


def test_the_class_around_it_is_modelica_and_it_is_neither_exported_nor_linearized(here):
    assert hydrotwin("modelica", "gap/model.toml", "--out", "around.mo").code == 0
    for words, says in (
        (("export", "gap/model.toml", "--out", "x.fmu"), "an FMU has no equations to write"),
        (("linearize", "gap/model.toml"), "no equations to linearize"),
    ):
        answer = hydrotwin(*words)
        assert answer.code == 2 and says in answer.said


def test_a_model_file_without_its_fmu_or_with_another_one_is_refused(here):
    (here / "drive.fmu").rename(here / "moved.fmu")
    answer = hydrotwin("simulate", "gap/model.toml", "--input", "v.csv")
    assert answer.code == 2 and "its FMU is not there (got '../drive.fmu')" in answer.said
    rewritten(here / "moved.fmu", here / "drive.fmu", xml={"modelName": "modelName "})
    answer = hydrotwin("simulate", "gap/model.toml", "--input", "v.csv")
    assert answer.code == 2 and "is another FMU than the one its effects belong to" in answer.said


@pytest.mark.parametrize(
    ("words", "says", "code"),
    [
        (("gap", "no.fmu", "a.csv", "--out", "g"), "no such file", 2),
        (("gap", "drive.fmu", "lacking.csv", "--out", "g"), "no column 'command'", 2),
        (("gap", "drive.fmu", "a.csv", "--out", "g", "--free", "gian"), "Did you mean 'gain'", 2),
        (("gap", "crashing.fmu", "a.csv", "--executor", "here", "--out", "g"), "the FMU ended its process", 1),
    ],
)
def test_what_cannot_be_looked_around_is_one_sentence(here, words, says, code):
    (record,) = drive_records(1, other=high)
    write_record(record.select(["rate"]), here / "lacking.csv")
    rewritten(here / "drive.fmu", here / "crashing.fmu", c=CRASHES)
    answer = hydrotwin(*words)
    assert answer.code == code and says in answer.said, answer.said
    assert "Traceback" not in answer.said
