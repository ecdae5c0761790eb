"""`hydrotwin sensitivity`: the screen, the page, the JSON, and what it refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hydrotwin.records import Record, write_record
from tests.face.command_line import ROOT, hydrotwin

MODEL = '''
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der


class Tank(Component):
    """A tank that a pump fills and a valve drains."""

    flow = Input("m3/s", "what the pump gives", nominal=1e-3, interpolation="linear")
    level = Output("m", "level", nominal=1.0)
    pressure = Output("Pa", "pressure at the bottom", nominal=1e4)
    area = Parameter(0.5, "m2", "of the tank", bounds=(0.01, 10.0), free=True)
    outlet = Parameter(1e-3, "m2/s", "of the valve", bounds=(1e-5, 1.0), free=True)
    gravity = Parameter(9.81, "m/s2", "of the earth")
    density = Parameter(870.0, "kg/m3", "of the oil", bounds=(500.0, 1500.0), free=True)
    idle = Parameter(1.0, "1", "nothing")
    h = State(0.2, "m", "level", nominal=1.0)

    def equations(self):
        yield self.area * der(self.h) == self.flow - self.outlet * self.h + 0 * self.idle
        yield self.level == self.h
        yield self.pressure == self.density * self.gravity * self.h


def tank():
    return Model(Tank())
'''
LOCAL = ("sensitivity", "tank.py:tank", "filling.csv", "--samples", "0")
QUICK = ("--samples", "32", "--stretches", "2")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tank.py").write_text(MODEL, encoding="utf-8")
    time = np.arange(0.0, 200.0, 0.5)
    rng = np.random.default_rng(0)
    flow = 1e-3 * (1 + np.sin(0.05 * time))
    level = [0.2]
    for q in flow[:-1]:
        level.append(level[-1] + 0.5 * (q - 1e-3 * level[-1]) / 0.5)
    level = np.array(level) + 1e-3 * rng.standard_normal(len(time))
    units = {"flow": "m3/s", "level": "m"}
    write_record(Record(time, {"flow": flow, "level": level}, units, "filling"), tmp_path / "filling.csv")
    return tmp_path


def test_it_tells_shares_what_is_not_told_apart_and_what_to_measure_next(folder):
    said = hydrotwin("sensitivity", "tank.py:tank", "filling.csv", *QUICK, "--report", "page")
    assert said.code == 0
    assert "level is driven by area" in said.said and "pressure is driven by" in said.said
    assert "density has no effect on any recorded output" in said.said and "or record pressure" in said.said
    assert "A sensor of pressure" in said.said and "which these recordings leave open" in said.said
    assert {p.name for p in (folder / "page").iterdir()} == {f"sensitivity.{end}" for end in ("html", "md", "json")}
    data = json.loads((folder / "page/sensitivity.json").read_text(encoding="utf-8"))
    assert data["format"] == "hydrotwin-sensitivity/1" and data["sobol"]["sets"] == 32 * 5
    assert data["measure_next"][0]["what"] == "pressure"
    shape = (ROOT / "docs/validation.md").read_text(encoding="utf-8").split("| key | what |")[1].split("From Python")[0]
    assert not [key for key in json.loads(hydrotwin(*LOCAL, "--json").out) if key not in shape]


def test_the_json_has_profiles_and_a_file_name_is_taken(folder):
    said = hydrotwin(
        "sensitivity", "tank.py:tank", "filling.csv", "--parameters", "area", "--parameters", "outlet", "--samples",
        "0", "--profile", "*", "--report", "out/tank.html", "--json", "--intervals", "fit",
    )  # fmt: skip
    assert said.code == 0, said.said
    data = json.loads(said.out)
    assert data["sobol"] is None
    assert [p["name"] for p in data["profiles"]["profiles"]] == ["area", "outlet"]
    assert {p["source"] for p in data["parameters"]} == {"fit, 95 %"}
    for told in data["profiles"]["profiles"]:
        assert told["low"] < told["value"] < told["high"] and told["below"] == "crossed"
    assert (folder / "out/tank.html").exists() and (folder / "out/tank.json").exists()
    shown = hydrotwin(
        "sensitivity", "tank.py:tank", "filling.csv", "--parameters", "area", "--samples", "0", "--profile", "area"
    )  # fmt: skip
    assert "profile likelihoods, 95 %" in shown.said and "the quadratic interval" in shown.said


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("tank.py:tank filling.csv --parameters aera", ["no parameter matches 'aera'", "Did you mean 'area'?"]),
        ("tank.py:tank filling.csv --parameters idle", ["idle moves no output of"]),
        ("tank.py:tank filling.csv --interval area=1:1", ["--interval area=1:1", "low below high"]),
        ("tank.py:tank filling.csv --interval aera=1:2", ["no parameter 'aera'", "area"]),
        ("tank.py:tank filling.csv --interval area=1:2", ["lies outside its interval"]),
        ("tank.py:tank filling.csv --intervals bonds", ["no intervals 'bonds'", "Did you mean 'bounds'?"]),
        ("tank.py:tank filling.csv --intervals fit", ["no fit tells how sure it is"]),
        ("tank.py:tank filling.csv --intervals 0%", ["its interval has no width"]),
        ("tank.py:tank filling.csv --samples 100", ["power of two", "128"]),
        ("tank.py:tank filling.csv --of curse", ["Did you mean 'course'?"]),
        ("tank.py:tank filling.csv --samples 0 --for presure", ["'presure' is neither", "Did you mean 'pressure'?"]),
        ("tank.py:tank filling.csv --samples 0 --profile outled", ["'outled'", "Did you mean 'outlet'?"]),
        ("tank.py:tank filling.csv --parameters area --samples 0 --profile outlet", ["outlet was not free"]),
        ("tank.py:tank nothing.csv", ["nothing.csv"]),
        ("tank.py:tank filling.csv --report tank.py", ["must end in .html"]),
        ("tank.py:tank", ["REC"]),
    ],
)
def test_what_it_refuses_is_a_sentence_and_leaves_nothing(folder, words, told):
    before = {p.name for p in folder.iterdir()}
    where = [] if "--report" in words else ["--report", "page"]
    answer = hydrotwin("sensitivity", *words.split(), *where)
    assert answer.code == 2, answer.said
    for word in told:
        assert word in answer.said, answer.said
    assert {p.name for p in folder.iterdir()} - {"__pycache__"} == before - {"__pycache__"}
