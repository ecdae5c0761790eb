"""inspect, and the options that say how recordings are read, on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from hydrotwin.records import read_record
from tests.face.command_line import SHIPPED, hydrotwin

RECORDING = SHIPPED / "cehA" / "recordings" / "validate_1.csv"
GERMAN = {"time": "Zeit", "command": "Ventil_Soll", "arm_angle": "Winkel", "pressure_cap": "Druck A"}


@pytest.fixture
def german(tmp_path, monkeypatch):
    """The first eight seconds of a shipped recording as a German logger writes them, in a folder of their own."""
    record = read_record(RECORDING).window(0, 8)
    columns = {"Zeit": record.time, "Ventil_Soll": record["command"], "Winkel": np.degrees(record["arm_angle"])}
    columns["Druck A"] = record["pressure_cap"] / 1e5
    head = "Prüfstand 3;Öl 40 °C\n\n" + ";".join(columns) + "\ns;V;°;\n"
    rows = "\n".join(";".join(f"{v:.9g}".replace(".", ",") for v in row) for row in zip(*columns.values(), strict=True))
    (tmp_path / "run.txt").write_text(head + rows + "\n", encoding="cp1252")
    monkeypatch.chdir(tmp_path)
    return record


SAID = (
    "--column", "command=Ventil_Soll", "--rename", "Winkel=arm_angle", "--column", "pressure_cap=Druck A",
    "--unit", "Druck A=bar",
)  # fmt: skip


def test_what_is_in_a_recording_is_told_with_its_ranges_and_how_it_was_read(german):
    answer = hydrotwin("inspect", "run.txt")
    assert answer.code == 0, answer.said
    assert "run.txt: 801 samples in 8 s, every 0.01 s (100 Hz)" in answer.said
    for words in ("cp1252 (or --encoding), semicolon, names in row 3, units in row 4, decimal comma", "time is 'Zeit'"):
        assert words in answer.said
    assert "column 'Druck A' has no unit" in answer.said and "--unit 'Druck A=UNIT'" in answer.said
    told = json.loads(hydrotwin("inspect", "run.txt", "--unit", "Druck A=bar", "--json").out)
    rows = {c["name"]: c for c in told["files"][0]["channels"]}
    assert rows["Druck A"]["maximum"] == pytest.approx(german["pressure_cap"].max() / 1e5)
    assert rows["Winkel"]["unit"] == "°" and rows["Winkel"]["noise"] == pytest.approx(0.006, rel=0.3)


def test_a_model_is_told_which_column_is_what_and_what_it_could_learn(german):
    answer = hydrotwin("inspect", "run.txt", *SAID, "--model", "cehA", "--json")
    assert answer.code == 0, answer.said
    told = json.loads(answer.out)
    found = {m["signal"]["name"]: m["column"] for m in told["matches"]}
    assert found["command"] == "command" and found["motor_speed"] is None
    seen = {e["name"]: e["verdict"] for e in told["excited"]}
    assert seen["motor.gain"] == "well"
    without = hydrotwin("inspect", "run.txt", "--unit", "Druck A=bar", "--model", "cehA")
    assert "proposed: the only other column in V" in without.out and "Ventil_Soll" in without.out
    assert "motor.gain" in without.out, "a proposal serves for the preview"


def test_what_it_found_is_written_as_a_file_that_every_command_then_finds(german):
    answer = hydrotwin("inspect", "run.txt", *SAID, "--model", "cehA", "--write", "import.toml")
    assert answer.code == 0, answer.said
    record = read_record("run.txt")
    np.testing.assert_allclose(record["pressure_cap"], german["pressure_cap"], rtol=1e-8)
    run = hydrotwin("simulate", "cehA", "--input", "run.txt", "--out", "simulated.csv")
    assert run.code == 0 and "by import.toml" in run.err
    plain = hydrotwin("simulate", "cehA", "--input", RECORDING, "--out", "other.csv")
    assert plain.code == 0
    one, two = read_record("simulated.csv"), read_record("other.csv").window(0, 8)
    np.testing.assert_allclose(one["arm_angle"], two["arm_angle"], atol=1e-4)


def test_what_it_writes_keeps_what_it_was_read_by(german):
    written = ("--write", "import.toml")
    assert hydrotwin("inspect", "run.txt", *SAID, "--scale", "Winkel=1.2345678912 1", *written).code == 0
    first = read_record("run.txt")
    again = hydrotwin("inspect", "run.txt", "--model", "cehA", "--set", "load=2 N", *written)
    assert again.code == 0, again.said
    assert "1.2345678912 1" in Path("import.toml").read_text()
    second = read_record("run.txt")
    assert second["load"][0] == 2 and "load" not in first
    for name in first:
        np.testing.assert_array_equal(first[name], second[name])
    Path("other.csv").write_text("time [s],p [bar]\n0,1\n1,2\n")
    refused = hydrotwin("inspect", "other.csv", "--write", "import.toml")
    assert refused.code == 2 and "for run.txt, and would be lost" in refused.said


def test_the_page_shows_every_column(german, tmp_path):
    answer = hydrotwin("inspect", "run.txt", *SAID, "--model", "cehA", "--report", "page")
    assert answer.code == 0, answer.said
    page = (tmp_path / "page" / "inspection.html").read_text(encoding="utf-8")
    for words in ("What cehA makes of them", "motor.gain", "Winkel", "Ventil_Soll", "How the files are read"):
        assert words in page


def test_the_options_serve_every_command_that_reads_recordings(german):
    answer = hydrotwin(
        "identify", "cehA", "run.txt", *SAID, "--free", "motor.gain", "--starts", "1", "--out", "model.toml"
    )
    assert answer.code == 0, answer.said
    assert "read run.txt: cp1252" in answer.err
    scenario = 'models = ["cehA"]\nvalidate = ["run.txt"]\nmodes = ["free run"]\n[import]\n'
    scenario += 'columns = {command = "Ventil_Soll", arm_angle = "Winkel"}\n'
    Path("scenario.toml").write_text(scenario)
    assert hydrotwin("compare", "scenario.toml", "--out", "report").code == 0
    scored = json.loads(Path("report/compare.json").read_text())["scores"]
    assert {s["output"] for s in scored} == {"arm_angle"}
    doubled = hydrotwin("compare", "scenario.toml", "--column", "command=Ventil_Soll", "--out", "report")
    assert doubled.code == 2 and "--column would be ignored" in doubled.said
    wrong = hydrotwin("identify", "cehA", "run.txt", "--column", "command=Ventil", "--out", "model.toml")
    assert wrong.code == 2 and "Did you mean 'Ventil_Soll'?" in wrong.said


def test_an_input_that_was_not_recorded_may_be_said_to_be_constant(german):
    refused = hydrotwin("simulate", "cehA", "--input", "run.txt")
    assert refused.code == 2 and "--set 'command=0 V'" in refused.said
    answer = hydrotwin("simulate", "cehA", "--input", "run.txt", "--set", "command=500mV", "--set", "motor.gain=100")
    assert answer.code == 0 and "set command = 500mV" in answer.err, answer.said


def test_a_file_that_cannot_be_read_is_told_beside_the_others_or_alone(german, tmp_path):
    (tmp_path / "empty.csv").write_text("")
    answer = hydrotwin("inspect", "empty.csv", "run.txt")
    assert answer.code == 2 and "empty.csv: row 1: the file is empty" in answer.said and "801 samples" in answer.said
    alone = hydrotwin("inspect", "empty.csv")
    assert alone.code == 2 and "the file is empty" in alone.said


def test_parameters_take_a_unit_where_they_are_set(german):
    plain = ("simulate", "cehA", "--input", RECORDING, "--json")
    one = hydrotwin(*plain, "--set", "motor.gain=100")
    assert hydrotwin(*plain, "--set", "motor.gain=0.1 rad/(s.mV)").out == one.out and one.code == 0
    wrong = hydrotwin(*plain, "--set", "motor.gain=100 bar")
    assert wrong.code == 2 and "--set motor.gain: unit 'bar': cannot become" in wrong.said
    unknown = hydrotwin(*plain, "--set", "motor.gan=1 rad/(s.V)")
    assert unknown.code == 2 and "Did you mean 'motor.gain'?" in unknown.said


@pytest.mark.parametrize("words", [("simulate", "cehA", "--input", RECORDING, "--set"), ("linearize", "cehA", "--at")])
def test_a_name_is_set_once(german, words):
    *command, option = words
    answer = hydrotwin(*command, option, "motor.gain=1", option, "motor.gain=2")
    assert answer.code == 2 and "motor.gain: it is given twice" in answer.said
