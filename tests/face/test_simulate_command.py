"""`hydrotwin simulate` on the shipped machine: what it tells of a run, and of the recording that it begins with."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import hydrotwin as ht
from tests.face.command_line import hydrotwin


@pytest.fixture
def here(recordings, monkeypatch):
    """Run a test in the folder of the recordings."""
    monkeypatch.chdir(recordings)
    return recordings


def test_simulate_tells_the_error_against_the_recorded_columns(here):
    answer = hydrotwin("simulate", "cehA", "--input", "validate_1.csv", "--set", "motor.gain=125", "--json")
    told = {row["output"]: row for row in json.loads(answer.out)["outputs"]}
    record = ht.read_record("validate_1.csv")
    speed = ht.simulate(ht.load("cehA"), record, parameters={"motor.gain": 125.0})["motor_speed"]
    assert told["motor_speed"]["rmse"] == pytest.approx(np.sqrt(np.mean((speed - record["motor_speed"]) ** 2)))
    assert told["motor_speed"]["maximum"] == pytest.approx(speed.max())


def test_simulate_says_how_accurate_it_is(here):
    fine = hydrotwin("simulate", "cehA", "--input", "validate_1.csv", "--json")
    told = json.loads(fine.out)["accuracy"]
    assert told["reached"] and 0 < told["error"] < 1e-3
    coarse = hydrotwin("simulate", "cehA", "--input", "validate_1.csv", "--method", "explicit", "--step", "0.01")
    assert "not accurate: half the step changes pressure" in " ".join(coarse.said.split())


@pytest.mark.parametrize("how", ["auto", "free"])
def test_a_recording_too_short_for_its_start_runs_with_a_note_in_simulate_as_in_compare(here, tmp_path, how):
    short = tmp_path / "short.csv"
    short.write_text("\n".join(Path("validate_1.csv").read_text().splitlines()[:31]))
    ran = hydrotwin("simulate", "cehA", "--input", short, "--initial-states", how, "--json")
    plain = json.loads(hydrotwin("simulate", "cehA", "--input", short, "--json").out)
    answer = json.loads(ran.out)
    (note,) = [n for n in answer["notes"] if "too short" in n]
    assert ran.code == 0 and "starts as without an estimate" in note and answer["outputs"] == plain["outputs"]
    compared = hydrotwin(
        "compare", "--model", "cehA", "--validate", short, "--initial-states", how, "--out", tmp_path / "report"
    )
    assert compared.code == 0 and " ".join(note.split()) in " ".join(compared.said.split())


def test_simulate_tells_that_the_first_sample_of_an_output_is_unknown_as_compare_does(here, tmp_path):
    lines = Path("validate_1.csv").read_text().splitlines()
    at = next(k for k, name in enumerate(lines[0].split(",")) if name.startswith("arm_angle"))
    first = lines[1].split(",")
    first[at] = ""
    (tmp_path / "late.csv").write_text("\n".join([lines[0], ",".join(first), *lines[2:200]]))
    told = hydrotwin("simulate", "cehA", "--input", tmp_path / "late.csv", "--missing", "keep")
    assert told.code == 0 and "the first sample of arm_angle is not known" in " ".join(told.said.split())


def test_a_setting_outside_its_bounds_runs_and_is_told(here):
    answer = hydrotwin("simulate", "cehA", "--input", "validate_1.csv", "--set", "motor.gain=10")
    assert answer.code == 0
    assert "motor.gain: outside its bounds (got 10 rad/(s.V)). They are 20 to 600." in answer.said


def test_a_scale_turns_percent_into_volts(here, tmp_path):
    text = Path("validate_1.csv").read_text().replace("command [V]", "command [%]")
    (tmp_path / "percent.csv").write_text(text)
    answer = hydrotwin(
        "simulate", "cehA", "--input", tmp_path / "percent.csv", "--scale", "command=1 V/%", "--out", tmp_path / "o.csv"
    )
    assert answer.code == 0, answer.err
    expected = ht.simulate(ht.load("cehA"), ht.read_record("validate_1.csv"))
    assert ht.read_record(tmp_path / "o.csv")["arm_angle"] == pytest.approx(expected["arm_angle"], abs=1e-9)


WARM = '''
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der


class Wall(Component):
    """A wall between a heater and a room."""

    heater = Input("W", "heater")
    wall = Output("degC", "wall")
    room = Parameter(20.0, "degC", "room", bounds=(-40, 60), source="guess")
    loss = Parameter(5.0, "W/K", "loss", bounds=(1, 100), source="guess")
    capacity = Parameter(100.0, "J/K", "capacity", bounds=(1, 1e4), source="guess")
    temperature = State(20.0, "degC", "wall", nominal=20.0)

    def equations(self):
        yield der(self.temperature) == (self.heater - self.loss * (self.temperature - self.room)) / self.capacity
        yield self.wall == self.temperature


def wall():
    return Model(Wall(), "wall", step=0.1)
'''


def test_a_number_alone_says_nothing_of_what_is_declared_in_another_unit(tmp_path, monkeypatch):
    """25 had been 25 K of a room that is declared in degC; a scenario refuses it."""
    monkeypatch.chdir(tmp_path)
    Path("warm.py").write_text(WARM)
    Path("run.csv").write_text("time [s],heater [W]\n" + "".join(f"{t},0\n" for t in range(600)))
    call = ("simulate", "warm.py:wall", "--input", "run.csv", "--out", "out.csv", "--set")
    refused = hydrotwin(*call, "room=25")
    assert refused.code == 2 and "may mean degC or K. Give the unit: room=25degC" in " ".join(refused.said.split())
    assert hydrotwin(*call, "room=25degC", "--set", "loss=6").code == 0
    assert float(Path("out.csv").read_text().split()[-1].split(",")[-1]) == pytest.approx(298.15, abs=1e-3)


def test_a_recording_with_a_hole_is_run_in_parts_and_says_so(recordings, tmp_path):
    """Carried on over the hole, the command drove the arm into its stop."""
    whole = ht.read_record(recordings / "validate_1.csv")
    keep = (whole.time < 2.0) | (whole.time > 3.0)
    signals = {n: v[keep] for n, v in whole.signals.items()}
    ht.write_record(ht.Record(whole.time[keep], signals, whole.units, "holed"), tmp_path / "holed.csv")
    answer = hydrotwin("simulate", "cehA", "--input", tmp_path / "holed.csv", "--out", tmp_path / "run.csv", "--json")
    told = json.loads(answer.out)
    assert any(n.startswith("holed has a hole (1.99") and "2 parts" in n for n in told["notes"])
    assert [start["record"] for start in told["starts"]] == ["holed (part 2)"]
    both = hydrotwin("simulate", "cehA", "--input", tmp_path / "holed.csv", "--initial-states", "auto", "--json")
    assert [s["record"] for s in json.loads(both.out)["starts"]] == ["holed (part 1)", "holed (part 2)"]
    run = ht.read_record(tmp_path / "run.csv")
    assert len(run) == keep.sum()
    plain = json.loads(hydrotwin("simulate", "cehA", "--input", recordings / "validate_1.csv", "--json").out)
    errors = [{o["output"]: o["rmse"] for o in one["outputs"]}["arm_angle"] for one in (told, plain)]
    assert errors[0] < 2 * errors[1]
