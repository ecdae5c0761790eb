"""The scenario files of the examples on measured data: read, run and judged, with model files of any values."""

from __future__ import annotations

import json
import os
import shutil
from pathlib import Path

import pytest

import hydrotwin as ht
from hydrotwin.learned import learn, write_block
from hydrotwin.models.language.model_file import write_model_file
from tests.face.command_line import hydrotwin

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
FOLDER = Path(os.environ.get("HYDROTWIN_MEASURED_DATA", "") or "/nonexistent")
PHYSICS = {  # model files by scenario, and what a user calls the model in them
    "emps": {"axis": "axis", "axis_with_coulomb": "axis_with_coulomb"},
    "cascaded_tanks": {"tanks": "model", "gap/model": "model"},
    "eha_bench": {"model": "model", "soft_and_leaking": "soft_and_leaking"},
}
LEARNED = {  # names of blocks, and what they are learned from
    "emps": (("arx", "gp"), "train.csv", ["force"], ["position"]),
    "cascaded_tanks": (("arx", "state_nn"), "train.csv", ["pump"], ["level"]),
    "eha_bench": (("arx",), "load1_stroke1.csv", ["motor_speed", "valve_direction"], ["position"]),
}
OUT = {"cascaded_tanks": "tanks"}


@pytest.fixture
def root(tmp_path, request):
    """A copy of an example with model files as its README makes them, but with values that nobody identified."""
    name = request.param
    if not (FOLDER / name).is_dir():
        pytest.skip(f"no recordings of {name}: set HYDROTWIN_MEASURED_DATA")
    shutil.copytree(EXAMPLES / name, tmp_path / "examples" / name, ignore=shutil.ignore_patterns("__pycache__"))
    out = tmp_path / "out" / OUT.get(name, name)
    for file, factory in PHYSICS[name].items():
        model = ht.load(f"{EXAMPLES / name / 'model.py'}:{factory}")
        write_model_file(out / f"{file}.toml", f"model.py:{factory}", model)
    kinds, train, inputs, outputs = LEARNED[name]
    record = ht.read_record(FOLDER / name / train)
    record = record.window(end=record.time[len(record) // 4])
    block = learn("arx", [record.select([*inputs, *outputs])], inputs, outputs)
    for kind in kinds:
        write_block(block, out / f"{kind}.toml")
    return tmp_path


@pytest.mark.parametrize("root", list(PHYSICS), indirect=True)
def test_the_scenario_of_an_example_runs_and_judges_its_model(root):
    (folder,) = (root / "examples").iterdir()
    answer = hydrotwin("compare", folder / "scenario.toml", "--out", root / "report", "--junit", root / "c.xml")
    assert answer.code == 1, answer.said  # nobody identified the model
    data = json.loads((root / "report/compare.json").read_text(encoding="utf-8"))
    assert data["failures"] == [] and data["answer"].startswith("FAIL: ")
    assert len(data["acceptance"]["criteria"]) >= 3 and (root / "c.xml").is_file()
    assert {m["name"] for m in data["models"]} == {s["model"] for s in data["means"]}
    told = {c["text"].split(".")[0].split()[0] for c in data["acceptance"]["criteria"]}
    assert told <= {s["output"] for s in data["means"]}


@pytest.mark.parametrize("name", list(PHYSICS))
def test_without_the_folder_the_scenario_says_what_to_set(name, tmp_path, monkeypatch):
    monkeypatch.delenv("HYDROTWIN_MEASURED_DATA", raising=False)
    text = (EXAMPLES / name / "scenario.toml").read_text(encoding="utf-8")
    before, after = text.split("models = [", 1)
    path = tmp_path / "scenario.toml"
    path.write_text(f'{before}models = ["cehA"]\n{after.split("]", 1)[1]}', encoding="utf-8")
    answer = hydrotwin("compare", path, "--out", tmp_path / "report")
    assert answer.code == 2 and "HYDROTWIN_MEASURED_DATA, which is not set" in answer.said, answer.said
    assert not (tmp_path / "report").exists()
