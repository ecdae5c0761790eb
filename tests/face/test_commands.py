"""Every command on good input: the lines of README.md and what they leave behind."""

from __future__ import annotations

import importlib.metadata
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
import typer

import hydrotwin as ht
from hydrotwin.cli import app
from hydrotwin.models.language.units import convert
from tests.face.command_line import ROOT, contents, hydrotwin

COMMANDS = [c.callback.__name__ for c in app.registered_commands]
README = (ROOT / "README.md").read_text(encoding="utf-8")
FORMATS = [".csv", ".txt", ".parquet", ".mat"]


def readme_lines() -> list[list[str]]:
    """The commands under "Use" in README.md, as words."""
    block = next(b for b in README.split("## Use")[1].split("\n\n") if "hydrotwin identify" in b)
    lines = block.replace("\\\n", " ").strip().splitlines()
    return [shlex.split(line)[1:] for line in lines]


def with_globs(words: list[str]) -> list[str]:
    """What a shell does to ``train_*.csv`` in the current folder."""
    return [found for word in words for found in (sorted(map(str, Path().glob(word))) if "*.csv" in word else [word])]


@pytest.fixture(scope="module")
def readme(recordings):
    """The folder in which every command of README.md ran, and its answers by command."""
    answers, home = {}, os.getcwd()
    os.chdir(recordings)
    try:
        for words in readme_lines():
            if words[0] != "gap":  # has a test of its own below
                hurry = {"learn": ["--budget", "3"], "sensitivity": ["--samples", "32"]}.get(words[0], [])
                answers[words[0]] = hydrotwin(*with_globs(words), *hurry)
    finally:
        os.chdir(home)
    return recordings, answers


@pytest.fixture
def here(readme, monkeypatch):
    """Run a test in the folder of the README's commands."""
    monkeypatch.chdir(readme[0])
    return readme[0]


def test_the_readme_shows_every_command():
    assert {words[0] for words in readme_lines()} | {"demo"} == set(COMMANDS)


@pytest.mark.parametrize("command", [c for c in COMMANDS if c not in ("demo", "gap")])
def test_the_readme_line_of_a_command_runs(readme, command):
    answer = readme[1][command]
    assert answer.code == 0, answer.said


def test_the_readme_line_of_gap_runs_on_two_effects_and_recordings(here):
    words = next(words for words in readme_lines() if words[0] == "gap")
    few = ["--effects", "coulomb_friction", "--effects", "dead_time", "--max-effects", "1", "--executor", "here"]
    answer = hydrotwin(*(word.replace("*", "1") for word in words), *few)
    assert answer.code == 0, answer.said
    found = json.loads(Path("gap/gap.json").read_text())
    assert found["verdict"] in ("named", "class", "none", "unknown")
    assert {s["effect"] for s in found["steps"]} <= {"coulomb_friction", "dead_time"}
    again = ht.load("gap/model.toml")
    assert [a.effect for a in again.additions] == [s["effect"] for s in found["steps"]]
    assert {p.name for p in Path("gap").iterdir()} >= {"report.html", "report.md", "gap.json", "model.toml", "model.mo"}


@pytest.mark.parametrize("command", COMMANDS)
def test_help_ends_with_an_example_of_the_command(command):
    answer = hydrotwin(command, "--help")
    assert answer.code == 0
    assert f"hydrotwin {command} " in answer.out.partition("Example")[2]
    assert answer.err == ""


def test_help_names_every_command():
    answer = hydrotwin("--help")
    assert answer.code == 0
    assert all(f" {command} " in answer.out for command in COMMANDS)


def test_no_help_text_loses_a_unit_in_brackets():
    group = typer.main.get_command(app)
    texts = {
        f"{c.name} {p.name}": p.help or "" for c in group.commands.values() for p in c.params if hasattr(p, "help")
    }
    assert len(texts) > 40
    assert [name for name, text in texts.items() if "[" in text] == []  # rich takes it for markup and drops it


def test_the_shell_finds_the_command():
    (entry,) = (e for e in importlib.metadata.entry_points(group="console_scripts") if e.name == "hydrotwin")
    assert entry.value == "hydrotwin.cli:main"
    assert shutil.which("hydrotwin", path=str(Path(sys.executable).parent))


# -- simulate --------------------------------------------------------------------------------------------------
def test_simulate_writes_what_the_package_simulates(here):
    written = ht.read_record("simulated.csv")
    expected = ht.simulate(ht.load("model.toml"), ht.read_record("validate_1.csv"))
    assert list(written) == [s.name for s in ht.load("cehA").flat.outputs]
    for name in written:
        assert written[name] == pytest.approx(expected[name], rel=1e-12, abs=1e-12), name


@pytest.mark.parametrize("suffix", FORMATS)
def test_simulate_writes_the_same_numbers_in_every_format(here, tmp_path, suffix):
    path = tmp_path / "deeper" / f"out{suffix}"
    answer = hydrotwin("simulate", "model.toml", "--input", "validate_1.csv", "--out", path)
    assert answer.code == 0, answer.err
    written, same = ht.read_record(path), ht.read_record("simulated.csv")
    assert written.time == pytest.approx(same.time)
    for name in same:
        assert written[name] == pytest.approx(same[name], rel=1e-12, abs=1e-12), name


@pytest.mark.parametrize("spec", ["cehA:third_order", "eq17", "network.toml", "cehA.fmu"])
def test_every_kind_of_model_simulates(here, spec):
    answer = hydrotwin("simulate", spec, "--input", "validate_1.csv", "--json")
    rows = json.loads(answer.out)["outputs"]
    assert answer.code == 0
    assert all(np.isfinite([row["minimum"], row["maximum"]]).all() for row in rows)
    assert "arm_angle" in {row["output"] for row in rows}


# -- identify --------------------------------------------------------------------------------------------------
def test_the_model_file_holds_values_and_where_they_came_from(here):
    file = tomllib.loads(Path("model.toml").read_text(encoding="utf-8"))
    assert file["model"] == "cehA"
    assert file["count"] == len(ht.load("cehA").flat.parameters)
    gain = file["parameters"]["motor"]["gain"]
    assert gain["unit"] == "rad/(s.V)" and 0 < gain["sigma"] < 1 and gain["value"] == pytest.approx(120, rel=0.05)
    named = {(r["name"], r["role"]): r["sha256"] for r in file["provenance"]["recordings"]}
    judged = [(f"validate_{k}", "validate") for k in (1, 2)]
    assert list(named) == [(f"train_{k}", "train") for k in (1, 2, 3)] + judged
    assert named["train_2", "train"] == contents(here)["train_2.csv"]
    assert file["provenance"]["made_by"] == f"hydrotwin {ht.__version__}"
    assert file["provenance"]["noise"]["arm_angle"] > 0


def test_identify_says_once_what_it_cannot_explain(readme):
    said = readme[1]["identify"].said
    assert said.count("not explained: ") == 1 and "the fitted model leaves" not in said


def test_identify_says_that_it_estimated_where_validation_recordings_begin(readme):
    """compare begins at their first samples: the same model had another error there, and nobody said why."""
    assert "where validation recordings begin was estimated" in " ".join(readme[1]["identify"].said.split())


def test_a_model_file_reads_back_to_what_was_identified(here, tmp_path):
    path = tmp_path / "m.toml"
    answer = hydrotwin(
        "identify", "cehA", "train_1.csv", "--free", "motor.gain", "--free", "cylinder.friction.viscous",
        "--starts", "1", "--out", path, "--json",
    )  # fmt: skip
    assert answer.code == 0, answer.err
    told = {p["name"]: p for p in json.loads(answer.out)["parameters"]}
    assert sorted(told) == ["cylinder.friction.viscous", "motor.gain"]
    read = {p.name: p for p in ht.load(str(path)).flat.parameters}
    given = {p.name: p for p in ht.load("cehA").flat.parameters}
    for name, p in read.items():
        assert p.value == pytest.approx(told[name]["value"] if name in told else given[name].value, rel=1e-12), name
    assert read["motor.gain"].sigma == pytest.approx(told["motor.gain"]["sigma"])


def test_a_fit_that_rests_on_a_bound_reads_back(here, tmp_path):
    bound = next(b for b in np.arange(121.0, 140.0, 0.1) if np.exp(np.log(b)) < b)
    text = f'model = "cehA"\n[parameters]\nmotor.gain = {{value = 150, unit = "rad/(s.V)", bounds = [{bound}, 600]}}\n'
    (tmp_path / "given.toml").write_text(text)
    words = ["train_1.csv", "--free", "motor.gain", "--starts", "1", "--out", tmp_path / "fitted.toml"]
    answer = hydrotwin("identify", tmp_path / "given.toml", *words)
    assert answer.code == 0, answer.err
    assert f"motor.gain rests on its lower bound ({bound:g} rad/(s.V)). The recordings ask for less" in answer.said
    assert ht.load(tmp_path / "fitted.toml").flat.parameter_vector()[1] == bound


def test_a_fit_can_start_from_a_model_file_and_stays_loadable(here, tmp_path):
    path = tmp_path / "again.toml"
    answer = hydrotwin(
        "identify", "model.toml", "train_1.csv", "--free", "motor.gain", "--starts", "1", "--out", path,
        "--report", tmp_path / "report",
    )  # fmt: skip
    assert answer.code == 0, answer.err
    values, before = ({p.name: p.value for p in ht.load(str(f)).flat.parameters} for f in (path, "model.toml"))
    assert values["cylinder.oil.bulk_modulus"] == before["cylinder.oil.bulk_modulus"] != 1.747e9
    assert "identified" in (tmp_path / "report/report.md").read_text(encoding="utf-8")


# -- learn -----------------------------------------------------------------------------------------------------
def test_a_learned_block_predicts_the_recorded_angle(here):
    block = ht.load("network.toml")
    assert [s.name for s in block.inputs] == ["command"] and [s.name for s in block.outputs] == ["arm_angle"]
    record = ht.read_record("train_1.csv")
    error = ht.simulate(block, record)["arm_angle"] - record["arm_angle"]
    assert np.sqrt(np.mean(error**2)) < 0.3 * np.std(record["arm_angle"])


# -- compare ---------------------------------------------------------------------------------------------------
def test_a_comparison_names_its_models_as_asked(here):
    data = json.loads(Path("report/compare.json").read_text(encoding="utf-8"))
    assert [m["name"] for m in data["models"]] == ["cehA", "identified", "network.toml", "eq17"]
    assert Path("report/report.html").stat().st_size > 10_000
    kinds = {(s["model"], s["mode"]) for s in data["scores"]}
    assert kinds == {(m["name"], mode) for m in data["models"] for mode in ("free run", "one step")}


def test_the_numbers_of_the_report_are_those_of_compare_json(here):
    data = json.loads(Path("report/compare.json").read_text(encoding="utf-8"))
    page = Path("report/report.md").read_text(encoding="utf-8")
    table = data["tables"]["headline"]
    shown = {c["key"]: c["shown_unit"] for c in table["columns"]}
    means = {(m["model"], m["output"]): m["rmse"] for m in data["means"] if m["mode"] == "free run"}
    unit = next(u for key, u in shown.items() if "arm_angle" in key)
    rows = [re.split(r"\s*\|\s*", line.replace("**", "")) for line in page.splitlines() if line.startswith("| ")]
    column = next(k for k, heading in enumerate(rows[0]) if "arm_angle" in heading)
    for model in (m["name"] for m in data["models"]):
        row = next(row for row in rows if row[1] == model)
        assert float(row[column]) == pytest.approx(convert(means[model, "arm_angle"], "rad", unit), rel=6e-3), model


def test_a_scenario_gives_the_same_scores_as_the_options(here, tmp_path):
    scenario = tmp_path / "scenario.toml"
    shutil.copy("validate_1.csv", tmp_path)
    shutil.copy("model.toml", tmp_path)
    scenario.write_text(
        'title = "Two models"\nmodels = ["cehA", {model = "model.toml", name = "identified"}, "hold_last"]\n'
        'validate = ["validate_*.csv"]\nmodes = ["free run"]\noutputs = ["arm_angle"]\n'
    )
    answer = hydrotwin("compare", scenario, "--out", tmp_path / "r", "--json")
    assert answer.code == 0, answer.err
    data = json.loads(answer.out)
    assert data == json.loads((tmp_path / "r/compare.json").read_text(encoding="utf-8"))
    assert data["title"] == "Two models" and len(data["scores"]) == 3
    earlier = json.loads(Path("report/compare.json").read_text(encoding="utf-8"))["scores"]
    for name in ("cehA", "identified"):
        (now,) = (s for s in data["scores"] if s["model"] == name)
        same = [s for s in earlier if all(s[k] == now[k] for k in ("model", "output", "mode"))]
        assert now["rmse"] == pytest.approx(same[0]["rmse"], rel=1e-12)


def test_a_comparison_scores_the_slope_of_an_output(here, tmp_path):
    words = ("--model", "cehA", "--validate", "validate_1.csv", "--output", "arm_angle", "--mode", "free run")
    answer = hydrotwin("compare", *words, "--slope", "arm_angle", "--out", tmp_path, "--json")
    assert answer.code == 0, answer.err
    units = {s["output"]: s["unit"] for s in json.loads(answer.out)["scores"]}
    assert units == {"arm_angle": "rad", "arm_angle.rate": "rad/s"}


# -- export and check ------------------------------------------------------------------------------------------
def test_a_checked_fmu_meets_the_simulation_it_came_from(here):
    answer = hydrotwin("simulate", "cehA.fmu", "--input", "validate_1.csv", "--out", "from_fmu.csv")
    assert answer.code == 0, answer.err
    assert hydrotwin("check", "cehA.fmu", "--reference", merged("from_fmu.csv")).code == 0


def merged(outputs: str) -> Path:
    """A reference for ``check``: the command of validate_1 and other outputs."""
    command = ht.read_record("validate_1.csv")["command"]
    record = ht.read_record(outputs)
    path = Path(outputs).with_name("reference.csv")
    columns = {"command": command, **record.signals}
    ht.write_record(ht.Record(record.time, columns, {"command": "V", **record.units}, "reference"), path)
    return path


def test_an_fmu_repeats_simulate_on_a_recording_whatever_it_was_told_of_starts(here, tmp_path):
    assert hydrotwin("export", "cehA", "--start", "measured", "--out", tmp_path / "m.fmu").code == 0
    assert hydrotwin("export", "cehA", "--out", tmp_path / "p.fmu").code == 0
    record = ht.read_record("validate_1.csv")
    columns = {name: record[name] for name in ("command", "arm_angle")}
    angle = ht.Record(record.time, columns, {name: record.units[name] for name in columns}, "angle")
    expected, balanced = (ht.simulate(ht.load("cehA"), r)["pressure_cap"] for r in (record, angle))
    assert np.abs(balanced - expected).max() > 1e-3 * np.ptp(expected), "it is told where the pressures begin"
    for name, of, wanted in (("m.fmu", record, expected), ("p.fmu", record, expected), ("p.fmu", angle, balanced)):
        found = ht.load(tmp_path / name).free_run(of)["pressure_cap"]
        assert np.abs(found - wanted).max() < 1e-6 * np.ptp(expected), name


def test_a_check_against_another_machine_fails_with_exit_code_one(here):
    changed = ["--set", "cylinder.cap_area=9e-4", "--set", "motor.gain=100"]
    assert hydrotwin("simulate", "cehA", "--input", "validate_1.csv", *changed, "--out", "other.csv").code == 0
    answer = hydrotwin("check", "cehA.fmu", "--reference", merged("other.csv"), "--json")
    assert answer.code == 1
    data = json.loads(answer.out)
    assert not data["passed"] and [r["name"] for r in data["rows"] if r["verdict"] == "FAIL"] == ["reference"]


# -- looking at a model ----------------------------------------------------------------------------------------
def test_modelica_prints_what_it_writes(here):
    answer = hydrotwin("modelica", "cehA")
    assert answer.code == 0 and answer.err == ""
    assert answer.out.strip() == Path("cehA.mo").read_text(encoding="utf-8").strip()
    assert answer.out.startswith("package cehA ") and "end cehA;" in answer.out


def test_linearize_gives_matrices_that_fit_together(here):
    answer = hydrotwin("linearize", "cehA", "--at", "arm.angle=0.3", "--json")
    data = json.loads(answer.out)
    a, b, c, d = (np.array(data[key]) for key in "ABCD")
    n, m, k = len(data["states"]), len(data["inputs"]), len(data["outputs"])
    assert (a.shape, b.shape, c.shape, d.shape) == ((n, n), (n, m), (k, n), (k, m))
    poles = np.sort_complex([p for p in np.linalg.eigvals(a) if p.imag >= 0])  # a pair is one mode
    told = np.sort_complex([complex(*mode["pole"]) for mode in data["modes"]])
    assert told == pytest.approx(poles, rel=1e-6, abs=1e-3)
    assert 1.0 < data["hydraulic_frequency_hz"] < 100.0
    assert Path("linear/linearisation.html").exists()


def test_every_page_says_how_it_was_made(here, tmp_path):
    for words in (("linearize", "cehA", "--at", "command=1"), ("friction", "friction_test.csv")):
        assert hydrotwin(*words, "--out", tmp_path).code == 0
        (page,) = tmp_path.glob(f"{words[0][:6]}*.md")
        text = page.read_text(encoding="utf-8")
        assert f"| command | hydrotwin {' '.join(words)} --out " in text and f"| hydrotwin | {ht.__version__} |" in text
        assert "linearised at rest" not in text.lower()  # a driven motor is not


def test_units_in_brackets_and_odd_folders_are_printed_as_they_are(here, tmp_path):
    assert "pole [rad/s]" in hydrotwin("linearize", "cehA").out
    path = tmp_path / "run [a] [/b]" / "out.csv"
    answer = hydrotwin("simulate", "cehA", "--input", "validate_1.csv", "--out", path)
    assert answer.code == 0
    assert f"written: {path}" in answer.out and path.exists()
    copy = path.with_name("[red]validate.csv")
    shutil.copy("validate_1.csv", copy)
    assert "cehA on [red]validate" in hydrotwin("simulate", "cehA", "--input", copy).out


def test_friction_finds_the_curve_of_the_paper(here, tmp_path):
    answer = hydrotwin("friction", "friction_test.csv", "--out", tmp_path, "--json")
    found = {c["name"]: c for c in json.loads(answer.out)["coefficients"]}
    viscous = next(c for name, c in found.items() if "viscous" in name)
    low, high = viscous["interval"]
    assert low < viscous["value"] < high
    assert viscous["value"] == pytest.approx(741.36, rel=0.05)
    assert (tmp_path / "friction.html").exists()


# -- for scripts -----------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "words",
    [
        "simulate cehA --input validate_1.csv",
        "identify cehA train_1.csv --free motor.gain --starts 1 --out {tmp}/j.toml",
        "learn nn train_1.csv train_2.csv --input command --output arm_angle --hidden 0 --budget 1 --out {tmp}/j.toml",
        "compare --model cehA --model eq17 --mode 'free run' --validate validate_1.csv --out {tmp}/j",
        "export eq17 --out {tmp}/j.fmu",
        "check cehA.fmu",
        "linearize cehA",
        "friction friction_test.csv",
    ],
    ids=lambda words: words.split()[0],
)
def test_json_is_all_that_goes_to_standard_output(here, tmp_path, words):
    answer = hydrotwin(*shlex.split(words.format(tmp=tmp_path)), "--json")
    assert answer.code == 0, answer.err
    assert isinstance(json.loads(answer.out), dict)


def test_every_command_that_answers_with_numbers_has_json():
    numberless = {"demo", "modelica"}
    for command in app.registered_commands:
        names = command.callback.__annotations__
        assert ("as_json" in names) == (command.callback.__name__ not in numberless), command.callback.__name__


def test_a_table_in_a_pipe_breaks_no_name(here):
    words = [sys.executable, "-m", "hydrotwin", "check", "cehA.fmu"]
    answer = subprocess.run(words, capture_output=True, text=True, env={**os.environ, "COLUMNS": "80"}, check=False)
    assert answer.returncode == 0, answer.stderr
    (line,) = (line for line in answer.stdout.splitlines() if line.startswith("pass") and "second instance" in line)
    assert line.rstrip().endswith("bit by bit")


def test_identify_takes_bounds_a_step_and_a_method(here, tmp_path):
    limits = ["--free", "motor.gain", "--bounds", "motor.gain=119.9:125", "--step", "2e-3", "--method", "explicit"]
    run = hydrotwin("identify", "cehA", "train_1.csv", "--out", tmp_path / "m.toml", "--starts", "1", "--json", *limits)
    (gain,) = json.loads(run.out)["parameters"]
    assert gain["bounds"] == [119.9, 125.0] and 119.9 <= gain["value"] <= 125.0
