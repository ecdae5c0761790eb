"""The Python in README.md runs: the first fit, and a machine of one's own as file.py:factory."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

import hydrotwin as ht
from tests.face.command_line import ROOT, hydrotwin

README = (ROOT / "README.md").read_text(encoding="utf-8")
SNIPPETS = [block.partition("```")[0] for block in README.split("```python\n")[1:]]
TRUE = {"load.mass": 110.0, "load.friction.viscous": 260.0}


@pytest.fixture(scope="module")
def workshop(tmp_path_factory):
    """The slide of README.md as slide.py, and a recording of a slide that is heavier and rubs more."""
    folder = tmp_path_factory.mktemp("slide")
    (folder / "slide.py").write_text(next(s for s in SNIPPETS if "def slide" in s), encoding="utf-8")
    time = np.arange(0.0, 4.0, 0.01)
    force = 60.0 * np.sin(2.0 * np.pi * 0.7 * time) + 40.0 * np.sign(np.sin(2.0 * np.pi * 0.23 * time))
    home = os.getcwd()
    os.chdir(folder)
    try:
        pushed = ht.Record(time, {"force": force}, {"force": "N"}, "pushed")
        position = ht.simulate(ht.load("slide.py:slide"), pushed, parameters=TRUE)["position"]
        noisy = position + 1e-5 * np.random.default_rng(3).standard_normal(len(time))
        record = ht.Record(time, {"force": force, "position": noisy}, {"force": "N", "position": "m"}, "train")
        ht.write_record(record, "train.csv")
    finally:
        os.chdir(home)
    return folder


def test_the_first_snippet_fits_the_shipped_machine(recordings, tmp_path, monkeypatch, capsys):
    shutil.copytree(recordings, tmp_path / "examples/cehA/recordings")
    monkeypatch.chdir(tmp_path)
    scope: dict = {}
    exec(compile(next(s for s in SNIPPETS if "ht.identify" in s), "README.md", "exec"), scope)
    assert {p.name for p in scope["fit"].parameters} == {
        "motor.gain",
        "motor.time_constant",
        "cylinder.friction.viscous",
    }
    assert "motor.gain" in capsys.readouterr().out
    error = scope["simulated"]["motor_speed"] - scope["train"][0]["motor_speed"]
    assert np.sqrt(np.mean(error**2)) < 1.0  # rad/s, of 240


def test_the_snippet_with_python_control_lifts_the_arm(capsys):
    scope: dict = {}
    exec(compile(next(s for s in SNIPPETS if "to_control" in s), "README.md", "exec"), scope)
    oil = max(abs(p) for p in scope["linear"].poles() if p.imag > 0) / (2 * np.pi)
    assert oil == pytest.approx(30.5, abs=0.05)
    angle = scope["raised"].outputs[scope["plant"].output_index["arm_angle"]]
    commanded = np.column_stack([scope["time"], np.full(501, 0.5)])
    record = ht.Record(
        commanded[:, 0], {"command": commanded[:, 1], "arm_angle": angle}, {"command": "V", "arm_angle": "rad"}
    )
    ours = ht.simulate(ht.load("cehA"), record)["arm_angle"]
    assert angle[-1] > angle[0] + 0.01
    assert ours == pytest.approx(angle, abs=1e-4)
    assert scope["controller"].period == 0.01


def test_every_snippet_of_the_readme_is_run_here():
    assert len(SNIPPETS) == 3
    assert "hydrotwin identify slide.py:slide train.csv --free 'load.*' --out slide.toml" in README


def test_the_slide_of_the_readme_is_identified_and_runs_with_its_values(workshop, monkeypatch):
    monkeypatch.chdir(workshop)
    answer = hydrotwin("identify", "slide.py:slide", "train.csv", "--free", "load.*", "--out", "slide.toml")
    assert answer.code == 0, answer.err
    assert "slide.py:slide@slide.toml" in answer.out, "it tells how the file is used"
    plain = hydrotwin("simulate", "slide.py:slide", "--input", "train.csv", "--out", "plain.csv")
    fitted = hydrotwin("simulate", "slide.py:slide@slide.toml", "--input", "train.csv", "--out", "fitted.csv")
    assert plain.code == fitted.code == 0, plain.err + fitted.err
    measured = ht.read_record("train.csv")["position"]
    errors = [np.std(ht.read_record(f)["position"] - measured) for f in ("plain.csv", "fitted.csv")]
    assert errors[1] < 1.2e-5 < 100 * errors[1] < errors[0]
    values = {p.name: p.value for p in ht.load("slide.py:slide@slide.toml").flat.parameters}
    for name, value in TRUE.items():
        assert values[name] == pytest.approx(value, rel=0.01), name


def test_a_model_file_of_the_users_code_does_not_start_it(workshop, monkeypatch):
    monkeypatch.chdir(workshop)
    flat = ht.load("slide.py:slide").flat
    ht.write_model_file(Path("alone.toml"), "slide.py:slide", flat)
    answer = hydrotwin("simulate", "alone.toml", "--input", "train.csv")
    assert answer.code == 2
    assert "slide.py:slide@alone.toml" in answer.said


def test_the_slide_of_the_readme_shows_as_modelica(workshop, monkeypatch):
    monkeypatch.chdir(workshop)
    answer = hydrotwin("modelica", "slide.py:slide")
    assert answer.code == 0
    assert answer.out.startswith("package slide ") and "extends Slide;" in answer.out
