"""`hydrotwin export --experiment` and `hydrotwin check --replay`: the record travels with the FMU, and is run again."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import pytest

import hydrotwin as ht
from hydrotwin.models.language.credibility import FIT, Evidence, versions
from tests.export.test_replay import INSIDE, edited, swapped
from tests.face.command_line import hydrotwin


@pytest.fixture(scope="module")
def model(tmp_path_factory) -> Path:
    """A model file with a record, without the time that a fit takes."""
    row = {"name": "train_1", "sha256": "c" * 64, "role": FIT}
    evidence = Evidence("identify", "2026-05-04T10:00:00+02:00", "", versions(), (row,))
    path = tmp_path_factory.mktemp("model") / "m.toml"
    return ht.write_model_file(path, "cehA", ht.load("cehA"), evidence=evidence)


@pytest.fixture(scope="module")
def fmu(model, recordings) -> Path:
    path = model.with_name("m.fmu")
    answer = hydrotwin("export", model, "--experiment", recordings / "validate_1.csv", "--out", path)
    assert answer.code == 0, answer.said
    return path


def test_the_record_and_the_experiments_are_told_and_run_again(fmu):
    answer = hydrotwin("check", fmu, "--replay", "--json")
    data = json.loads(answer.out)
    assert answer.code == 0 and data["passed"]
    rows = {row["name"]: row for row in data["rows"]}
    assert "identify on 2026-05-04" in rows["record"]["detail"]
    assert {r["experiment"] for r in data["replays"]} == {"reference", "validate_1"}
    assert len(data["replays"]) == 12 and all(r["passed"] and r["margin"] > 0.9 for r in data["replays"])


def test_other_values_in_the_fmu_are_told_with_each_output_and_exit_code_1(fmu, tmp_path):
    with zipfile.ZipFile(fmu) as archive:
        text = archive.read("modelDescription.xml").decode()
    start = text.index('name="motor.gain"')
    value = text[text.index('start="', start) + 7 : text.index('"', text.index('start="', start) + 7)]
    part = text[start : text.index(f'start="{value}"', start) + len(value) + 8]
    other = part.replace(f'start="{value}"', f'start="{float(value) * 1.1!r}"')
    path = edited(fmu, tmp_path / "m.fmu", {"modelDescription.xml": swapped(part, other)})
    again = hydrotwin("check", path, "--replay")
    assert again.code == 1 and "FAIL record" in again.said
    assert "no longer holds: parameter values of the FMU were edited" in again.said


def test_wrong_results_fail_and_say_the_margin(fmu, tmp_path):
    name = f"{INSIDE}validation-ref.csv"

    def late(text: str) -> str:
        header, first, *rows = text.splitlines()
        return "\n".join([header, first, *(row.replace(",", ",1", 1) for row in rows)]) + "\n"

    answer = hydrotwin("check", edited(fmu, tmp_path / "m.fmu", {name: late}), "--replay")
    assert (
        answer.code == 1 and "FAIL validate_1 arm_angle" in answer.said and "PASS validate_1 motor_speed" in answer.said
    )


def test_of_a_stale_model_file_nothing_goes_along_that_no_longer_holds(model, tmp_path):
    text = model.read_text(encoding="utf-8")
    line = next(row for row in text.splitlines() if row.startswith("motor.gain"))
    value = ht.read_model_file(model).settings["motor.gain"]["value"]
    path = tmp_path / "m.toml"
    path.write_text(text.replace(line, line.replace(repr(value), repr(value * 1.01))), encoding="utf-8")
    answer = hydrotwin("export", path, "--out", tmp_path / "m.fmu")
    assert answer.code == 0 and "no longer holds" in answer.said
    with zipfile.ZipFile(tmp_path / "m.fmu") as archive:
        record = archive.read(f"{INSIDE}credibility.toml").decode()
    assert "identify" not in record


def test_what_cannot_be_carried_along_is_refused_and_nothing_is_written(model, recordings, tmp_path):
    good = (recordings / "validate_1.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    header = good[0].replace("command", "commando")
    for name, text, says in (
        ("other.csv", header + "".join(good[1:]), "command"),
        ("cut.csv", "".join(good[:20]) + "0.1", "cut.csv"),
        ("unit.csv", good[0].replace("command [V]", "command [bar]") + "".join(good[1:]), "bar"),
    ):
        file = tmp_path / name
        file.write_text(text, encoding="utf-8")
        answer = hydrotwin("export", model, "--experiment", file, "--out", tmp_path / "m.fmu")
        assert answer.code == 2 and says in answer.said, answer.said
        assert not (tmp_path / "m.fmu").exists()


def test_a_recording_with_a_hole_goes_along_in_parts(model, recordings, tmp_path):
    rows = (recordings / "validate_1.csv").read_text(encoding="utf-8").splitlines(keepends=True)
    file, middle = tmp_path / "holed.csv", len(rows) // 2
    file.write_text("".join(rows[:middle] + rows[middle + 40 :]), encoding="utf-8")
    answer = hydrotwin("export", model, "--experiment", file, "--out", tmp_path / "m.fmu")
    assert answer.code == 0 and "holed has a hole" in answer.said
    again = json.loads(hydrotwin("check", tmp_path / "m.fmu", "--replay", "--json").out)
    assert {r["experiment"] for r in again["replays"]} == {"reference", "holed (part 1)", "holed (part 2)"}


def test_nothing_to_run_again_is_wrong_usage(fmu, tmp_path):
    path = edited(fmu, tmp_path / "m.fmu", {f"{INSIDE}fmi-ls-manifest.xml": None})
    answer = hydrotwin("check", path, "--replay")
    assert answer.code == 2 and "there is nothing to run again (it carries no experiments along)" in answer.said
    answer = hydrotwin("check", tmp_path / "m.toml", "--replay")
    assert answer.code == 2
