"""`check rig.py:axis@model.toml --replay`: the record of one's own model, compared beside models of other outputs."""

from __future__ import annotations

import json
import re
import tomllib
import warnings

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.comparison import Wanted, acceptance, replay
from hydrotwin.export.inside import record_of
from hydrotwin.models.language.credibility import StaleEvidenceWarning
from hydrotwin.records import Record, write_record
from tests.face.command_line import hydrotwin

CODE = '''
from hydrotwin.models.components import ForceSource, LinearLoad
from hydrotwin.models.language import Component, Input, Model, Output, connect
from hydrotwin.models.laws import Viscous


class Slide(Component):
    """A mass on a slide."""

    force = Input("N", nominal=50.0)
    position = Output("m")
    motor = ForceSource()
    load = LinearLoad(mass=95.0, friction=Viscous(viscous=200.0), load_force=0.0)

    def equations(self):
        yield connect(self.force, self.motor.force)
        yield connect(self.motor.flange, self.load.flange)
        yield self.position == self.load.position


class Watched(Component):
    """The same with a second force and its speed as an output."""

    force, wind = Input("N", nominal=50.0), Input("N", nominal=50.0)
    position, speed = Output("m"), Output("m/s")
    motor, air = ForceSource(), ForceSource()
    load = LinearLoad(mass=95.0, friction=Viscous(viscous=200.0), load_force=0.0)

    def equations(self):
        yield connect(self.force, self.motor.force)
        yield connect(self.wind, self.air.force)
        yield connect(self.motor.flange, self.load.flange)
        yield connect(self.air.flange, self.load.flange)
        yield self.position == self.load.position
        yield self.speed == self.load.velocity


def slide():
    return Model(Slide(), "slide")


def watched():
    return Model(Watched(), "watched")
'''


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A model of one's own, identified, and a recording with an output and an input that only another model has."""
    found = tmp_path_factory.mktemp("slide")
    (found / "rig.py").write_text(CODE, encoding="utf-8")
    time, random = np.arange(0.0, 2.0, 0.01), np.random.default_rng(1)
    force = 50.0 * np.sign(np.sin(4.0 * time))
    speed = np.r_[0.0, np.cumsum(force[:-1]) * 0.01 / 95.0]
    position = np.r_[0.0, np.cumsum(speed[:-1]) * 0.01] + 1e-5 * random.standard_normal(len(time))
    signals = {"force": force, "wind": 0.0 * time, "position": position, "speed": speed}
    units = {"force": "N", "wind": "N", "position": "m", "speed": "m/s"}
    write_record(Record(time, signals, units), found / "run.csv")
    words = ("--free", "load.mass", "--starts", 1, "--out", found / "m.toml")
    answer = hydrotwin("identify", f"{found}/rig.py:slide", found / "run.csv", *words)
    assert answer.code == 0, answer.said
    return found


def test_the_record_of_ones_own_model_is_made_again_where_its_code_is_named(folder):
    own = f"{folder}/rig.py:slide@{folder}/m.toml"
    words = ("--validate", folder / "run.csv", "--mode", "free run", "--slope", "position", "--slope", "speed")
    words += ("--interpolation", "wind=linear", "--accept", "position.rmse < 10 m", "--record", folder / "m.toml")
    other = ("--model", f"{folder}/rig.py:watched")  # its speed, and its wind, are of what was asked
    answer = hydrotwin("compare", "--model", own, *other, *words, "--out", folder / "report")
    assert answer.code == 0, answer.said
    answer = hydrotwin("check", folder / "m.toml", "--replay")
    assert answer.code == 2 and "Name the code yourself" in answer.said
    assert hydrotwin("check", own).code == 0
    answer = hydrotwin("check", own, "--replay")
    assert answer.code == 0 and "14 of 14 numbers are the same." in answer.said, answer.said


def test_values_that_are_nowhere_are_refused(folder):
    answer = hydrotwin("check", f"{folder}/rig.py:slide@{folder}/n.toml", "--replay")
    assert answer.code == 2 and "Did you mean 'm.toml'" in answer.said


def test_what_stood_beside_a_recording_is_part_of_the_question_and_of_its_replay(folder, tmp_path):
    """`import.toml` says how a file is read: moved without it everything was OTHER, and with another scale in it the
    same words took the place of a missed criterion."""
    (tmp_path / "run.csv").write_text((folder / "run.csv").read_text().replace("position [m]", "way"), encoding="utf-8")
    beside = tmp_path / "import.toml"
    beside.write_text('columns = {position = "way"}\nunits = {way = "m"}\n', encoding="utf-8")
    file = tmp_path / "m.toml"
    file.write_text((folder / "m.toml").read_text(encoding="utf-8").partition("[credibility]")[0], encoding="utf-8")
    own, tight = f"{folder}/rig.py:slide@{file}", "position.rmse < 1e-9 m"
    words = ("--mode", "free run", "--accept", tight, "--record", file, "--out", tmp_path / "report")
    assert hydrotwin("compare", "--model", own, "--validate", tmp_path / "run.csv", *words).code == 1
    beside.write_text('columns = {position = "way"}\nscale = {position = "1e-9 m/m"}\nunits = {way = "m"}\n')
    hydrotwin("compare", "--model", own, "--validate", tmp_path / "run.csv", *words)
    assert hydrotwin("check", own).said.count("compare on") == 2
    (tmp_path / "moved").mkdir()
    (tmp_path / "run.csv").rename(tmp_path / "moved/run.csv")
    (tmp_path / "moved/import.toml").write_text('scale = {force = "3 N/N"}\n', encoding="utf-8")  # of what lay there
    answer = hydrotwin("check", own, "--replay", "--recordings", tmp_path / "moved")
    assert "same" in answer.said and "OTHER" not in answer.said, answer.said


def test_a_criterion_beside_another_model_is_made_again_where_runs_were_cut_for_that_model(folder, tmp_path):
    """Of a hole in the wind, which the slide does not read, its runs begin anew behind it: made again alone, every
    number was another. The bound that the other model set is that of the record; it had not been tried."""
    lines = (folder / "run.csv").read_text(encoding="utf-8").splitlines()
    at = lines[0].split(",").index("wind [N]")
    rows = [line.split(",") for line in lines]
    for row in rows[100:120]:
        row[at] = ""
    (tmp_path / "run.csv").write_text("\n".join(map(",".join, rows)), encoding="utf-8")
    file = tmp_path / "m.toml"
    file.write_text((folder / "m.toml").read_text(encoding="utf-8").partition("[credibility]")[0], encoding="utf-8")
    own, beside = f"{folder}/rig.py:slide@{file}", ("--model", f"watched={folder}/rig.py:watched", "--missing", "keep")
    asked = ("--slope", "position", "--mode", "free run", "--accept", "rmse not worse than watched by 900 %")
    asked += ("--accept", "position not worse than watched by -99.99 %", "--record", file, "--out", tmp_path / "report")
    answer = hydrotwin("compare", "--model", f"own={own}", *beside, "--validate", tmp_path / "run.csv", *asked)
    assert answer.code == 1, answer.said
    answer = hydrotwin("check", own, "--replay", "--json")
    made = {row["what"]: row for row in json.loads(answer.out)["again"]}
    assert all(row["passed"] for row in made.values())
    overall = made["rmse not worse than watched by 900 %"]
    assert overall["why"] == "held against the bound that watched set then" and overall["unit"] in ("mm", "mm/s")
    [worst] = [row["worst"] for row in tomllib.loads(file.read_text())["credibility"]["evidence"][-1]["criteria"][:1]]
    assert overall["unit"] == {"position": "mm", "position.rate": "mm/s"}[worst]


def test_a_comparison_from_python_says_itself_how_it_was_asked(folder, tmp_path):
    """Starts, slopes and inputs between samples had to be said once more, or every number made again was another."""
    file = tmp_path / "m.toml"
    file.write_text((folder / "m.toml").read_text(encoding="utf-8").partition("[credibility]")[0], encoding="utf-8")
    model = ht.load(f"{folder}/rig.py:slide@{file}")
    asked = {"initial_states": "free", "rates": ["position"], "interpolation": {"force": "linear"}, "repeats": 0}
    found = ht.compare([model], [ht.read_record(folder / "run.csv")], modes=["free run"], **asked)
    ht.record_comparison(file, found, acceptance(found, Wanted(("position.rate.rmse < 1 m/s",))))
    assert all(row.passed for row in replay(file, model))


def test_of_equations_that_were_edited_under_the_values_of_a_fit_no_band_is_told(folder, tmp_path):
    """`compare` had trusted the band: only --replay noticed that a force acts twice now."""
    run, values = folder / "run.csv", tmp_path / "m.toml"
    values.write_bytes((folder / "m.toml").read_bytes())
    code, model = tmp_path / "rig.py", f"{tmp_path}/rig.py:slide@{values}"
    code.write_text(CODE, encoding="utf-8")
    words = ("compare", "--model", model, "--validate", run, "--output", "position", "--mode", "free run")
    band = ("--accept", "position.coverage in [0, 99.9] %")
    with warnings.catch_warnings():
        warnings.simplefilter("error", StaleEvidenceWarning)
        assert ht.load(model).provenance["spread"]
    assert hydrotwin(*words, "--out", tmp_path / "a", "--accept", "position.rmse < 1 m", "--record", values).code == 0
    assert hydrotwin("check", model).code == 0
    answer = hydrotwin("check", values)  # of the code, which it may not start, it had said nothing
    assert answer.code == 0 and f"Name the code: hydrotwin check {folder}/rig.py:slide@" in answer.said.replace(
        "\n", " "
    )
    assert "not looked at" in json.loads(hydrotwin("check", values, "--json").out)["unchecked"]
    assert not json.loads(hydrotwin("check", model, "--json").out)["unchecked"]
    code.write_text(CODE.replace("Viscous(viscous=200.0)", "Viscous(viscous=201.0)"), encoding="utf-8")
    assert hydrotwin("check", model).code == 0, "a value of the code that the file holds is no equation"
    code.write_text(CODE.replace("self.position == self", "self.position == 1.5 * self"), encoding="utf-8")
    with pytest.warns(StaleEvidenceWarning, match="equations are others than its values were fitted to"):
        edited = ht.load(model)
    assert "spread" not in edited.provenance and all(p.sigma is None for p in edited.flat.parameters)
    answer = hydrotwin(*words, "--out", tmp_path / "b", *band)
    assert answer.code == 2 and "has no band of position" in answer.said
    answer = hydrotwin(*words, "--out", tmp_path / "b")
    told = json.loads((tmp_path / "b" / "compare.json").read_text(encoding="utf-8"))
    assert answer.code == 0 and any("its equations are others than" in n for n in told["notices"])
    assert not told["models"][0]["bands"]
    answer = hydrotwin("check", model)
    assert answer.code == 1 and "STALE" in answer.said and "equations are others" in answer.said
    answer = hydrotwin(*words, "--out", tmp_path / "b", "--record", values)
    assert answer.code == 2 and "Identify the model again" in answer.said
    assert hydrotwin("export", model, "--out", tmp_path / "m.fmu").code == 0
    (inside,) = record_of(tmp_path / "m.fmu").credibility.evidence  # neither what it held nor what judged it
    assert inside.passed is None and not inside.metrics and "its equations are others than" in inside.told
    known = ht.load(str(tmp_path / "m.fmu")).provenance
    assert any("equations are others than" in since for since in known["since the fit"]) and known["trained_on"]
    old = values.read_text(encoding="utf-8")
    values.write_text(re.sub(r"(?m)^equations = .*\n", "", old), encoding="utf-8")
    assert ht.load(model).provenance["spread"], "a file of before goes by what it says"


def test_the_record_of_a_comparison_without_criteria_says_which_samples_nobody_knows(folder, tmp_path):
    values = tmp_path / "m.toml"
    values.write_bytes((folder / "m.toml").read_bytes())
    record = ht.read_record(folder / "run.csv")
    silent = record.with_signals({"position": np.where(record.time > 1.5, np.nan, record["position"])})
    model = ht.load(f"{folder}/rig.py:slide@{values}")
    found = ht.compare([model], [silent], modes=["free run"], outputs=["position"], repeats=0)
    told = ht.record_comparison(values, found).evidence[-1].told
    assert "no criteria" in told and "not judged: position on 49 of 200 samples of run, not known" in told
