"""Against an earlier comparison: failures count, and what may make an error another without a better model is told."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hydrotwin.comparison import Wanted, acceptance, compare
from hydrotwin.report import write_report
from hydrotwin.report.acceptance import acceptance_lines
from tests.comparison.toys import Toy, recording

RECORDS = tuple(recording(k, duration=3.0, name=name) for k, name in enumerate(("warm", "cold"), 1))
OUTPUTS = {"arm_angle", "motor_speed", "pressure_cap"}


def compared(*toys, records=RECORDS):
    return compare(toys, records, repeats=0, modes=("free run",))


def written(comparison, folder, **changes):
    """The folder with the compare.json of a comparison, keys of it replaced."""
    path = write_report(comparison, folder)["json"]
    path.write_text(json.dumps(json.loads(path.read_text(encoding="utf-8")) | changes), encoding="utf-8")
    return path


def lines_of(found):
    return [text for _, text in acceptance_lines(found, {})]


@pytest.fixture(scope="module")
def good():
    return compared(Toy("m"))


@pytest.fixture(scope="module")
def whole():
    """A model that is off, the more so on the recording on which the other one fails."""
    return compared(Toy("m", gain=200.0))


@pytest.fixture(scope="module")
def failing():
    return compared(Toy("m", fails_on="cold"))


def test_a_model_that_fails_where_it_did_not_is_worse(whole, failing, tmp_path):
    """The mean over the recordings that are left is smaller, and says nothing of the other."""
    found = acceptance(failing, Wanted(against=written(whole, tmp_path)))
    assert {c.output for c in found.changes} == OUTPUTS
    assert all(c.worse and not c.better and c.lost == ("cold",) for c in found.changes)
    speed = next(c for c in found.changes if c.output == "motor_speed")
    warm = next(s.rmse for s in whole.scores if (s.output, s.record) == ("motor_speed", "warm"))
    assert speed.before == pytest.approx(warm) and speed.now < speed.before
    (line,) = (text for text in lines_of(found) if "motor_speed" in text)
    assert "worse than before" in line and "no score now on cold" in line
    text = write_report(failing, tmp_path / "now", accepted=found)["markdown"].read_text(encoding="utf-8")
    assert "worse: no score now on cold" in text


def test_a_model_that_no_longer_fails_is_better_unless_it_is_worse_elsewhere(whole, failing, good, tmp_path):
    before = Wanted(against=written(failing, tmp_path))
    assert all(c.won == ("cold",) and c.better and not c.worse for c in acceptance(good, before).changes)
    assert all(c.won == ("cold",) and c.worse and not c.better for c in acceptance(whole, before).changes)
    same = acceptance(failing, before)
    assert not any(c.worse or c.better or c.scored for c in same.changes)
    assert any("As before" in text for text in lines_of(same))


def test_a_model_that_failed_on_all_is_not_new(good, tmp_path):
    """It was told as new against a comparison that it had taken part in."""
    broken = compare([Toy("m"), Toy("n", kind="broken", fails_on="warm")], RECORDS[:1], repeats=0, modes=("free run",))
    before = Wanted(against=written(broken, tmp_path))
    still = acceptance(broken, before)
    assert not still.new and not any("New against" in text for text in lines_of(still))
    mended = acceptance(compared(Toy("m"), Toy("n"), records=RECORDS[:1]), before)
    assert not mended.new and {(c.model, c.output) for c in mended.changes if c.better} == {("n", o) for o in OUTPUTS}
    assert any("better than before: n" in text and "no score before on warm" in text for text in lines_of(mended))
    assert acceptance(compared(Toy("m"), records=RECORDS[:1]), before).gone == ("n",)


def test_a_model_that_fails_on_all_is_worse(good, tmp_path):
    warm = compared(Toy("m"), records=RECORDS[:1])
    now = compared(Toy("m", fails_on="warm"), records=RECORDS[:1])
    found = acceptance(now, Wanted(against=written(warm, tmp_path)))
    assert {c.output for c in found.changes} == OUTPUTS
    assert all(c.worse and c.lost == ("warm",) and np.isnan(c.now) for c in found.changes)
    assert all("no score now on warm" in text for text in lines_of(found))
    write_report(now, tmp_path / "now", accepted=found)  # with no mean to show


def test_of_means_alone_as_many_recordings_can_be_compared(whole, failing, tmp_path):
    found = acceptance(failing, Wanted(against=written(whole, tmp_path, scores=[])))
    assert all(c.worse and c.lost == ("1 of 2 recordings",) for c in found.changes)
    same = acceptance(whole, Wanted(against=written(whole, tmp_path, scores=[])))
    assert same.changes and not any(c.worse or c.better or c.scored for c in same.changes)


def test_the_same_file_read_otherwise_is_told_wherever_it_is_compared(good, tmp_path):
    """Another unit, column or scale makes an error another, and no model better."""
    path = written(good, tmp_path)
    other = [RECORDS[0], RECORDS[1].with_signals({"command": 2.0 * RECORDS[1]["command"]})]
    wanted = Wanted(("motor_speed not worse than compare.json",), base=tmp_path, against=path)
    found = acceptance(compared(Toy("m"), records=other), wanted)
    (told,) = found.otherwise
    assert told.startswith("command of cold had other values then")
    assert any(told in text for text in lines_of(found))
    assert found.judged[0].caution == told.rstrip(".")
    again = acceptance(good, wanted)
    assert again.otherwise == () and again.judged[0].caution == ""


def test_a_clock_that_was_read_otherwise_is_told(good, tmp_path):
    path = written(good, tmp_path)
    told = json.loads(path.read_text(encoding="utf-8"))
    told["recordings"][0]["signals"]["time"]["mean"] *= 1000
    path.write_text(json.dumps(told), encoding="utf-8")
    (told,) = acceptance(good, Wanted(against=path)).otherwise
    assert told.startswith("time of warm had other values then")


def test_inputs_between_samples_and_recordings_that_are_not_told_are_otherwise(good, tmp_path):
    path = written(good, tmp_path, recordings=[])
    told = json.loads(path.read_text(encoding="utf-8"))
    told["models"][0]["between_samples"]["command"]["interpolation"] = "smooth"
    path.write_text(json.dumps(told), encoding="utf-8")
    between, unknown = acceptance(good, Wanted(against=path)).otherwise
    assert between.startswith("Between its samples command of m was taken as smooth then")
    told["models"][0]["between_samples"]["command"] |= {"interpolation": "hold", "shift": 0.005}
    path.write_text(json.dumps(told))
    assert (
        "as hold 0.005 s later than stamped then, and as hold now"
        in acceptance(good, Wanted(against=path)).otherwise[0]
    )
    assert unknown.startswith("compare.json does not say of which recordings it is")


def test_models_that_only_one_of_two_comparisons_has_are_on_the_screen_and_the_page(good, tmp_path):
    path = written(compared(Toy("old")), tmp_path)
    found = acceptance(good, Wanted(against=path))
    assert found.changes == ()
    text = write_report(good, tmp_path / "now", accepted=found)["markdown"].read_text(encoding="utf-8")
    for sentence in ("New against the earlier comparison: m.", "No longer compared: old."):
        assert sentence in text and any(sentence in line for line in lines_of(found))


def test_outputs_that_only_one_of_two_comparisons_scored_are_told(good, failing, tmp_path):
    """What a comparison of fewer outputs leaves out did not stay "as before"."""
    few = compare([Toy("m")], RECORDS, repeats=0, modes=("free run",), outputs=["arm_angle"])
    assert acceptance(few, Wanted(against=written(good, tmp_path))).otherwise == (
        "Outputs no longer compared: motor_speed, pressure_cap.",
    )
    found = acceptance(good, Wanted(against=written(few, tmp_path)))
    assert found.otherwise == ("Outputs new against the earlier comparison: motor_speed, pressure_cap.",)
    assert any("Outputs new" in text for text in lines_of(found))
    assert not acceptance(failing, Wanted(against=written(good, tmp_path))).otherwise


@pytest.mark.parametrize(("shift", "passed"), [(1e-9, True), (2e-5, True), (2e-3, False)])
def test_the_same_run_on_another_processor_is_not_worse(good, tmp_path, shift, passed):
    """The last digit had missed it, by 0 % too much."""
    path = write_report(good, tmp_path)["json"]
    told = json.loads(path.read_text(encoding="utf-8"))
    rows = [row | {"rmse": row["rmse"] * (1 - shift)} for row in told["scores"]]
    path.write_text(json.dumps(told | {"scores": rows}), encoding="utf-8")
    (judged,) = acceptance(good, Wanted((f"arm_angle not worse than {path}",))).judged
    assert judged.passed is passed
