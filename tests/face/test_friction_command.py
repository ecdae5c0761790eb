"""`hydrotwin friction`: what the test cannot say and what it left out stand on the screen, in the JSON, on the page."""

from __future__ import annotations

import json

import pytest

from hydrotwin.records import write_record
from tests.face.command_line import hydrotwin
from tests.identification.test_plateaus import BOTH, SPEEDS, kept, pushed


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    rests = [pair for v in BOTH for pair in ((v, 0.5), (0.0, 0.2))]
    write_record(pushed(rests, load=80.0), tmp_path / "both.csv", units={"velocity": "mm/s", "force": "kN"})
    write_record(pushed(kept(SPEEDS, 0.5), load=80.0), tmp_path / "one.csv")
    return tmp_path


def test_the_load_and_what_was_left_out_are_told_everywhere(folder):
    said = hydrotwin("friction", "both.csv", "--out", "page")
    assert said.code == 0
    assert "left out both, 0.5 s to 0.69 s (20 samples" in said.said and "a constant load of" in said.said
    page = (folder / "page" / "friction.md").read_text(encoding="utf-8")
    data = json.loads((folder / "page" / "friction.json").read_text(encoding="utf-8"))
    assert page.count("at rest, or slower") == len(BOTH) and "constant load" in page
    assert data["values"]["load"] == pytest.approx(80, abs=1) and len(data["dropped"]) == len(BOTH)
    answer = json.loads(hydrotwin("friction", "both.csv", "--json").out)
    assert [row["name"] for row in answer["coefficients"]][-1] == "load"
    assert {row["recording"] for row in answer["dropped"]} == {"both"} and "at rest" in answer["dropped"][0]["reason"]


def test_one_direction_gives_no_bound_that_it_cannot_know(folder):
    answer = json.loads(hydrotwin("friction", "one.csv", "--json").out)
    static = next(row for row in answer["coefficients"] if row["name"] == "static")
    assert static["sigma"] is None and static["interval"][1] is None
    assert "same direction" in answer["findings"][0]
    known = hydrotwin("friction", "one.csv", "--load", "80")
    assert "same direction" not in known.said and "300" in known.said


def test_glitches_and_a_drift_are_told_everywhere(folder):
    recording = pushed(kept(BOTH, 2.0))
    force = recording["force"] + 1.5 * recording.time
    force[50::97] = 9999.0
    write_record(recording.with_signals({"force": force}), folder / "glitches.csv")
    said = hydrotwin("friction", "glitches.csv", "--out", "page").said
    assert "the force drifts by 1.5 N/s" in said and "samples stand far" in said
    assert "the force of 9999 N" in said and "more stretches: on the page" in said
    answer = json.loads(hydrotwin("friction", "glitches.csv", "--json").out)
    faults = [row for row in answer["dropped"] if row["fault"]]
    assert len(faults) > 20 and all("9999 N" in row["reason"] for row in faults)
    drift = next(row for row in answer["coefficients"] if row["name"] == "drift")
    assert drift["unit"] == "N/s" and drift["value"] == pytest.approx(1.5, abs=0.01)
    page = (folder / "page" / "friction.md").read_text(encoding="utf-8")
    assert page.count("the force of 9999 N stands far from") >= len(faults) and "drift of the force" in page
