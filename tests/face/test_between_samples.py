"""--interpolation and what is written of it: model.toml, JSON, tables, reports, FMUs."""

from __future__ import annotations

import json
import tomllib
from pathlib import Path

import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.records import write_record
from tests.face.command_line import hydrotwin
from tests.identification.sliding import moved, slide, wave

ROOT = Path(__file__).resolve().parents[2]
MODEL = """
import sys
sys.path.insert(0, {root!r})
from tests.identification.sliding import slide as made


def slide():
    return made()
"""
FREE = ("--free", "load.mass", "--free", "load.friction.viscous")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model file of Python and two recordings of a smooth measured force."""
    folder = tmp_path_factory.mktemp("slide")
    (folder / "slide.py").write_text(MODEL.format(root=str(ROOT)), encoding="utf-8")
    for seed in range(2):
        write_record(moved(seed, wave(seed)), folder / f"run_{seed}.csv")
    export_fmu(slide(), folder / "slide.fmu")
    return folder


@pytest.fixture(scope="module")
def identified(folder):
    words = ("identify", f"{folder}/slide.py:slide", folder / "run_0.csv", *FREE)
    report = ("--report", folder / "report")
    return hydrotwin(*words, "--out", folder / "linear.toml", *report), hydrotwin(
        *words, "--out", folder / "held.toml", "--interpolation", "force=hold", "--json"
    )


def test_identify_says_and_writes_what_was_chosen_by_whom_and_why(folder, identified):
    shown, told = identified
    assert "input force is linear between samples (chosen by the recordings: a measured quantity [N]" in shown.said
    inputs = tomllib.loads((folder / "linear.toml").read_text(encoding="utf-8"))["inputs"]
    assert (inputs["force"]["interpolation"], inputs["force"]["chosen_by"]) == ("linear", "recording")
    assert json.loads(told.out)["inputs"] == {"force": {"interpolation": "hold", "chosen_by": "user"}}
    entrants = json.loads((folder / "report" / "compare.json").read_text(encoding="utf-8"))["models"]
    assert all(row["between_samples"]["force"]["interpolation"] == "linear" for row in entrants)


def test_simulate_runs_a_model_file_as_it_was_identified_unless_told_otherwise(folder, identified):
    def left(file, *more):
        spec = f"{folder}/slide.py:slide@{folder / file}"
        answer = json.loads(hydrotwin("simulate", spec, "--input", folder / "run_1.csv", "--json", *more).out)
        return answer["inputs"]["force"]["interpolation"], answer["outputs"][1]["rmse"]

    assert left("linear.toml")[0] == "linear" and left("held.toml")[0] == "hold"
    kind, rmse = left("linear.toml", "--interpolation", "force=hold")
    assert kind == "hold" and rmse > 2 * left("linear.toml")[1]


def test_an_fmu_follows_the_same_rule_and_the_same_option(folder):
    def left(*more):
        words = ("simulate", folder / "slide.fmu", "--input", folder / "run_0.csv", "--json", *more)
        answer = json.loads(hydrotwin(*words).out)
        return answer["inputs"]["force"], answer["outputs"][1]["rmse"]

    force, linear = left()
    assert (force["interpolation"], force["chosen_by"]) == ("linear", "recording")
    force, held = left("--interpolation", "force=hold")
    assert (force["interpolation"], force["chosen_by"]) == ("hold", "user") and held != linear
    assert read_fmu(folder / "slide.fmu", interpolation={"force": "hold"}).inputs[0].interpolation == "hold"


def test_check_says_what_the_inputs_of_a_reference_do_between_samples(folder):
    def told(*more):
        words = ("check", folder / "slide.fmu", "--reference", folder / "run_0.csv", "--json", *more)
        return next(r["detail"] for r in json.loads(hydrotwin(*words).out)["rows"] if r["name"] == "reference")

    assert "inputs held between samples" in told()
    assert "force linear between samples" in told("--interpolation", "force=linear")


@pytest.mark.parametrize("wrong", ["force", "force=cubic", "=hold", "forse=hold"])
def test_an_option_that_says_nothing_is_refused(folder, wrong):
    words = ("simulate", f"{folder}/slide.py:slide", "--input", folder / "run_0.csv", "--interpolation", wrong)
    answer = hydrotwin(*words)
    assert answer.code == 2 and "force" in answer.said


def test_a_scenario_says_it_in_its_file(folder, tmp_path):
    scenario = folder / "scenario.toml"
    text = 'models = [{model = "slide.py:slide", name = "a"}, "slide.fmu"]\nvalidate = ["run_0.csv"]\n'
    scenario.write_text(text + 'interpolation = {force = "hold"}\n', encoding="utf-8")
    answer = hydrotwin("compare", scenario, "--out", tmp_path, "--json")
    rows = json.loads(answer.out)["models"]
    assert [row["between_samples"]["force"]["interpolation"] for row in rows] == ["hold", "hold"]
    refused = hydrotwin("compare", scenario, "--out", tmp_path, "--interpolation", "force=linear")
    assert refused.code == 2 and "--interpolation would be ignored" in refused.said


def test_compare_says_it_of_which_model_where_they_differ(folder, identified, tmp_path):
    """A held force beside a linear one had stood on the page alone."""
    files = {name: f"{name}={folder}/slide.py:slide@{folder}/{name}.toml" for name in ("linear", "held")}
    models = [word for file in files.values() for word in ("--model", file)]
    words = ("--validate", folder / "run_1.csv", "--mode", "free run", "--out", tmp_path / "report")
    said = " ".join(hydrotwin("compare", *models, *words).said.split())
    assert "held: input force is held between samples (chosen by you)" in said
    assert "linear: input force is linear between samples (chosen by the recordings" in said
    alone = " ".join(hydrotwin("compare", *models[:2], *words).said.split())
    assert "linear: input" not in alone and "input force is linear between samples" in alone


def test_every_command_tells_where_a_recording_is_not_as_those_of_the_fit(folder, identified, tmp_path):
    """The reason had been that of the recordings of the fit, on others of which it does not hold."""
    text = (folder / "linear.toml").read_text(encoding="utf-8")
    why = text[text.index("why = ") :].split('"')[1]
    text = text.replace('interpolation = "linear"', 'interpolation = "hold"').replace(why, "it stays where it is")
    (folder / "else.toml").write_text(text.split("[credibility]")[0], encoding="utf-8")
    spec, record = f"{folder}/slide.py:slide@{folder}/else.toml", folder / "run_1.csv"
    told = "input force is taken as held between its samples, and run_1 shows it otherwise: a measured quantity"
    commands = (
        ("simulate", spec, "--input", record),
        ("compare", "--model", spec, "--validate", record, "--mode", "free run", "--out", tmp_path / "r"),
        ("identify", spec, record, "--free", "load.mass", "--starts", 1, "--out", tmp_path / "m.toml"),
        ("sensitivity", spec, record, "--parameters", "load.mass", "--samples", 0),
    )
    for words in commands:
        assert told in " ".join(hydrotwin(*words).said.split()), words
        if words[0] != "compare":
            settled = " ".join(hydrotwin(*words, "--interpolation", "force=linear").said.split())
            assert "shows it otherwise" not in settled
