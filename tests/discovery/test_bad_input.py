"""Recordings and models that can show nothing: a sentence says what is missing and what to record, and so gap.json."""

from __future__ import annotations

import dataclasses
import json
import warnings

import numpy as np
import pytest

from hydrotwin.discovery.answer.findings import further_out
from hydrotwin.discovery.discover import discover
from hydrotwin.identification.problem import recordings
from hydrotwin.models.language import Input, Model, der
from hydrotwin.models.language.errors import DataError, DeclarationError, SolveError
from hydrotwin.records import Record, write_record
from tests.discovery.slides import (
    NOISE,
    PERIOD,
    RATE_NOISE,
    Drive,
    Inline,
    TwoSensors,
    Unstable,
    drive_records,
    found,
    record,
    records,
)
from tests.face.command_line import hydrotwin

OWN = """
from hydrotwin.models.language import Model
from tests.discovery.slides import Slide, Unstable
from tests.discovery.test_bad_input import TwoCommands


def machine():
    return Model(Slide())


def unstable():
    return Model(Unstable())


def two_commands():
    return Model(TwoCommands())
"""


def still(force: float = 0.0, name: str = "still") -> Record:
    """A recording in which nothing is commanded and nothing moves."""
    time = np.arange(0.0, 12.0, PERIOD)
    speed = NOISE * np.random.default_rng(0).standard_normal(len(time))
    return Record(time, {"force": np.full(len(time), force), "speed": speed}, {"force": "N", "speed": "m/s"}, name)


def frozen(run: Record) -> Record:
    """The same with a sensor that always says the same."""
    return Record(run.time, {**run.signals, "speed": np.full(len(run.time), 0.25)}, run.units, run.name)


def only(kept: np.ndarray, run: Record, sensor: str, otherwise: float = np.nan) -> Record:
    """The same with a sensor that was read at the samples that are ``kept``."""
    return Record(run.time, {**run.signals, sensor: np.where(kept, run[sensor], otherwise)}, run.units, run.name)


TOO_SHORT = ("run_0 has 50 samples", "Record tens of seconds of motion in both directions")
MOTIONLESS = ("no input of slide ever moves (force)", "Record commands in both directions, slow and fast, with pauses")
CONSTANT = ("every recorded output of slide is constant (speed)", "Record motion in both directions, at several speeds")
REFUSED = {
    "too short": (lambda: records(3, seconds=1.0), TOO_SHORT),
    "motionless": (lambda: [still()], MOTIONLESS),
    "constant": (lambda: [frozen(r) for r in records(2)], CONSTANT),
}


# -- refused ---------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize("case", REFUSED)
def test_recordings_that_can_show_nothing_are_refused_by_discover(case):
    runs, sentences = REFUSED[case]
    with pytest.raises(DataError) as refused:
        found(runs(), ["null_bias"])
    assert all(sentence in str(refused.value) for sentence in sentences)


def test_no_recording_at_all_is_refused():
    with pytest.raises(
        DataError, match=r"no recording of slide\. Give at least one, better three, and one to validate"
    ):
        found([], ["null_bias"])


def test_a_base_that_runs_away_is_refused_and_asks_for_better_start_values():
    with pytest.raises(SolveError) as refused:
        discover(Model(Unstable()), drive_records(2), effects=["null_bias"], free=["gain"], executor=Inline())
    assert "the base model cannot be identified" in str(refused.value)
    assert "Correct its start values first" in str(refused.value)


def test_what_has_no_equations_is_refused():
    with pytest.raises(DeclarationError, match="is no component model, so no effect can be added inside it"):
        discover(object(), records(2), executor=Inline())


# -- answered with a finding -------------------------------------------------------------------------------------------
def test_without_a_validation_recording_the_answer_stands_and_asks_for_one():
    d = found(records(3), ["null_bias"])
    assert d.verdict == "none" and d.outputs["validate"] == ()
    (said,) = [f for f in d.findings if "no validation recording" in f]
    assert "Record another run with other commands and give it as --validate" in said
    assert {r.role for r in d.recordings} == {"fit"}


class TwoCommands(Drive):
    """A drive with a second command that adds to the first."""

    second = Input("V", "second command")

    def equations(self):
        yield self.time_constant * der(self.turning) + self.turning == self.gain * (self.command + self.second)
        yield self.rate == self.turning


def pushed(count: int = 3) -> list[Record]:
    """Recordings of a drive with a hidden push, whose second command is never given."""
    hidden = 2.0 * ((np.arange(600) > 350) & (np.arange(600) < 400))
    runs = drive_records(count, command=lambda u: u + hidden)
    units = {"command": "V", "second": "V", "rate": "rad/s"}
    return [Record(r.time, {**r.signals, "second": np.zeros(600)}, units, r.name) for r in runs]


def test_where_no_candidate_could_be_seen_the_gap_is_unknown_and_faster_motion_is_asked_for():
    d = found(pushed(), ["command_gain at second"], model=Model(TwoCommands()))
    assert d.verdict == "unknown"
    (said,) = [f for f in d.findings if "none of the effects could be seen" in f]
    assert "Record faster and larger motion in both directions, with pauses" in said
    (row,) = d.not_testable
    assert (row.effect, row.site, row.fate) == ("command_gain", "second", "not testable")
    assert row.reason == "it would not show in these recordings, whatever its size"


HARDLY = "what hardly moves is not told from what does"


@pytest.mark.xfail(strict=True, reason=HARDLY)
def test_what_hardly_moves_makes_no_candidate_testable():
    """A hidden pulse makes a gap; the slide is hardly pushed, so that a gain by direction cannot show."""
    d = found(records(3, highest=0.05, pulse=2.0), ["direction_asymmetry"])
    assert d.verdict == "unknown"
    assert [r.effect for r in d.not_testable] == ["direction_asymmetry"]


@pytest.mark.xfail(strict=True, reason=HARDLY)
def test_where_nothing_moves_visibly_none_is_not_said_without_a_warning():
    d = found(records(3, highest=0.05), ["direction_asymmetry"])
    assert d.verdict in ("none", "unknown")
    assert any("Record faster and larger motion" in f for f in d.findings)


def test_a_fault_of_a_sensor_that_was_not_recorded_is_no_candidate():
    """There is nothing to see; it neither takes part nor makes a name harder to pass."""
    model, runs = Model(TwoSensors()), drive_records(3, command=lambda u: np.clip(u, -2.0, 2.0))
    d = found(runs, ["command_saturation", "sensor_bias"], model=model)
    rows = [*d.steps[0].ranked, *d.not_testable]
    assert [s.effect for s in d.steps] == ["command_saturation"]
    assert {(r.effect, r.site) for r in rows} == {("command_saturation", "command"), ("sensor_bias", "rate")}
    alone = found(runs, ["sensor_bias at other"], model=model)
    assert alone.verdict == "unknown" and any("none of the effects could be seen" in f for f in alone.findings)


def test_a_gap_that_only_the_validation_recording_shows_is_unknown_and_says_what_to_record():
    """A limit that the recordings of the search never reach: nothing is missing in them, and still something is."""
    runs, limited = records(3, highest=100.0), record(9, limit=150.0)
    d = found(runs, ["null_bias"], validate=[limited])
    assert d.verdict == "unknown" and d.steps == ()
    assert f"shows in {limited.name} only" in d.answer and "Record more runs that move like that" in d.answer
    assert "never tried so far out: force goes from" in d.answer
    assert found(runs, ["null_bias"], validate=[record(9)]).verdict == "none"


def test_only_signals_that_leave_the_range_they_had_are_further_out():
    flat = Model(Drive()).flat
    runs = recordings(flat, drive_records(2), None, "record")
    assert further_out(flat, runs, runs) == "" == further_out(flat, runs, runs[:1])
    far = dataclasses.replace(runs[0], y=3 * runs[0].y)
    blind = dataclasses.replace(runs[0], y=np.full_like(runs[0].y, np.nan))
    said = further_out(flat, runs, [far])
    assert said.startswith("The model was never tried so far out: rate goes from") and "command" not in said
    assert further_out(flat, runs, [blind]) == ""


def test_where_no_effect_fits_the_gap_is_unknown():
    runs = drive_records(3, command=lambda u: np.clip(u, -2.0, 2.0))
    d = discover(Model(Drive()), runs, effects=["internal_leakage"], executor=Inline(), step=5e-3)
    assert d.verdict == "unknown" and d.steps == ()
    assert any("none of the effects could be seen" in f for f in d.findings)


def test_a_constant_sensor_beside_a_good_one_is_named_and_left_out():
    runs = drive_records(3, command=lambda u: np.clip(u, -2.0, 2.0), other=lambda w, t: np.full(len(w), 4.0))
    still = [Record(r.time, {**r.signals, "other": np.full(len(r.time), 4.0)}, r.units, r.name) for r in runs]
    effects = ["command_saturation", "null_bias"]
    d = discover(Model(TwoSensors()), still, effects=effects, executor=Inline(), step=5e-3, noise={"rate": RATE_NOISE})
    assert d.verdict == "named" and [s.effect for s in d.steps] == ["command_saturation"]
    assert d.steps[0].parameters[0].value == pytest.approx(2.0, rel=0.01)
    assert list(d.noise) == ["rate"] and [gap.output for gap in d.outputs["train"]] == ["rate"]
    assert any("'other' is constant in every recording" in f and "record it in motion" in f for f in d.findings)


def test_a_sensor_that_fails_for_three_seconds_does_not_hide_the_effect():
    runs = records(3, dry=30.0)
    speed = runs[1].signals["speed"].copy()
    speed[200:350] = np.nan
    runs[1] = Record(runs[1].time, {**runs[1].signals, "speed": speed}, runs[1].units, runs[1].name)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        d = found(runs, ["coulomb_friction", "null_bias"])
    assert d.verdict == "named"


def test_a_sensor_that_misses_every_third_sample_and_the_last_one_does_not_hide_the_effect():
    kept = np.random.default_rng(0).random(600) > 0.3
    kept[-20:] = False
    answer = found([only(kept, run, "speed") for run in records(3, dry=60.0)], ["coulomb_friction", "dead_time"])
    assert [s.effect for s in answer.steps] == ["coulomb_friction"]
    assert answer.steps[0].parameters[0].value == pytest.approx(60.0, rel=0.02)


def test_a_sensor_that_was_absent_in_one_recording_is_judged_by_the_others():
    first, *others = drive_records(3, other=lambda w, time: w + 0.8)
    runs = [only(np.zeros(600, dtype=bool), first, "other"), *others]
    answer = discover(Model(TwoSensors()), runs, effects=["sensor_bias", "null_bias"], executor=Inline())
    assert [(s.effect, s.site) for s in answer.steps] == [("sensor_bias", "other")]


def test_a_recording_cannot_judge_what_it_taught():
    runs = records(2, dry=60.0)
    with pytest.raises(DataError, match="run_1: samples of run_1, which is learned from"):
        found(runs, ["coulomb_friction"], validate=[record(5), runs[1]])


def test_an_infinite_reading_is_refused_and_says_when():
    run = only(np.arange(600) != 300, record(0), "speed", otherwise=np.inf)
    with pytest.raises(DataError, match="'speed' is infinite in 1 samples, the first at 6 s"):
        found([run], ["coulomb_friction"])


def test_a_recording_of_holes_in_its_command_alone_is_refused():
    run = record(0)
    force = np.where(np.arange(len(run)) % 50 > 40, np.nan, run["force"])
    broken = Record(run.time, {**run.signals, "force": force}, run.units, "run_0")
    with pytest.raises(DataError, match=r"between its holes .* the longest part has 41 samples, and it takes 50"):
        found([broken], ["null_bias"])


# -- on the command line -----------------------------------------------------------------------------------------------
@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder with the slide as a file of one's own."""
    (tmp_path / "own.py").write_text(OWN)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def gap(folder, machine: str, runs, *words):
    """Run hydrotwin gap on recordings written as CSV; its answer and its gap.json."""
    paths = []
    for run in runs:
        paths.append(folder / f"{run.name}.csv")
        write_record(run, paths[-1])
    answer = hydrotwin("gap", f"own.py:{machine}", *paths, "--out", "gap", "--executor", "here", *words)
    return answer, json.loads((folder / "gap/gap.json").read_text())


@pytest.mark.parametrize("case", REFUSED)
def test_a_refusal_has_exit_code_two_and_its_sentence_on_screen_and_in_gap_json(case, here):
    runs, sentences = REFUSED[case]
    answer, told = gap(here, "machine", runs(), "--effects", "null_bias")
    assert answer.code == 2, answer.said
    assert told["verdict"] in ("none", "unknown") and told["steps"] == []
    for sentence in sentences:
        assert sentence in answer.said and sentence in told["findings"][0]
    assert "Traceback" not in answer.said


def test_a_base_that_runs_away_leaves_a_gap_json_too(here):
    answer, told = gap(here, "unstable", drive_records(2), "--effects", "null_bias", "--free", "gain")
    assert answer.code == 1, answer.said
    assert told["verdict"] == "unknown" and "Correct its start values first" in told["findings"][0]
    assert "Correct its start values first" in answer.said


def test_a_missing_validation_recording_is_no_failure(here):
    answer, told = gap(here, "machine", records(3), "--effects", "null_bias")
    assert answer.code == 0, answer.said
    assert told["verdict"] == "none" and told["validate"] in ({}, [])
    assert any("--validate" in f for f in told["findings"])


def test_unseen_effects_are_listed_in_gap_json_with_the_reason(here):
    answer, told = gap(here, "two_commands", pushed(), "--effects", "command_gain at second")
    assert answer.code == 0, answer.said
    assert told["verdict"] == "unknown"
    assert any("Record faster and larger motion" in f for f in told["findings"])
    assert "it would not show in these recordings" in json.dumps(told["not_testable"])
    assert Model(TwoCommands()).name == told["model"]
