"""effects and gap on the command line: what they print, write, keep and refuse."""

from __future__ import annotations

import json
import shutil
import sys
import tomllib
from dataclasses import replace
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.models import cehA
from hydrotwin.models.effects import CATALOGUE, add_effect, candidates
from hydrotwin.models.language.errors import DataError, SolveError
from hydrotwin.work.executor import Here
from hydrotwin.work.memory import Memory, key_of
from tests.face.command_line import contents, hydrotwin
from tests.report import gap_discoveries

GAP = ("gap", "cehA", "train_1.csv", "--validate", "validate_1.csv", "--out", "gap")
KEYS = {"model", "verdict", "steps", "noise", "train", "validate", "separating_experiment", "seconds", "findings"}


RUBBING = add_effect(cehA.model(), "coulomb_friction", values={"force": 83.0})


def friction_found(**more):
    """Friction in the C-EHA, named: the report's example with the real machine in it."""
    return replace(gap_discoveries.named(), base=cehA.model(), model=RUBBING, **more)


@pytest.fixture
def here(recordings, tmp_path, monkeypatch):
    """A folder with recordings of its own."""
    for path in recordings.glob("*.csv"):
        shutil.copy(path, tmp_path)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def discover(monkeypatch):
    """`hydrotwin.discover` replaced; the test says what it finds or raises."""
    replaced = mock.Mock(return_value=friction_found())
    monkeypatch.setitem(sys.modules, "hydrotwin.discovery.discover", SimpleNamespace(discover=replaced))
    return replaced


# -- effects -------------------------------------------------------------------------------------------------------
def test_the_catalogue_lists_every_effect_with_equation_parameters_and_place():
    answer = hydrotwin("effects", "--json")
    assert answer.code == 0, answer.err
    rows = {row["id"]: row for row in json.loads(answer.out)}
    assert set(rows) == set(CATALOGUE)
    for row in rows.values():
        assert row["equation"] and row["fits"] and row["title"] and row["source"], row["id"]
        assert row["parameters"] and all(p["typical"] for p in row["parameters"]), row["id"]
    friction = rows["coulomb_friction"]
    assert (friction["equation"], friction["fits"]) == (
        "F = F_c sign(v)",
        "a flange or a link on a joint of its own",
    )
    assert friction["parameters"][0]["unit"] == "N"
    assert rows["motor_droop"]["fits"] == "behind a port (a shaft)", "a sensor of the drive is taken over besides"
    printed = hydrotwin("effects")
    assert printed.code == 0
    assert all(f" {effect} " in f" {printed.said} " for effect in CATALOGUE)


def test_effects_of_a_machine_name_site_part_and_range_in_its_units():
    answer = hydrotwin("effects", "cehA", "--json")
    assert answer.code == 0, answer.err
    rows = json.loads(answer.out)
    assert [(r["effect"], r["site"]) for r in rows] == [(c.id, c.site.name) for c in candidates(cehA.model())]
    assert [r["twins"] for r in rows] == [[t.partition(" at ")[2] for t in c.twins] for c in candidates(cehA.model())]
    deadband = next(r for r in rows if r["effect"] == "command_deadband")
    (width,) = deadband["parameters"]
    assert (width["unit"], width["name"]) == ("V", "command_deadband.width")
    assert width["typical"] == pytest.approx([0.025, 1.0])  # 0.5 to 20 % of 5 V
    printed = hydrotwin("effects", "cehA")
    assert "cylinder.annulus-" in printed.said and "0.025 ... 1 V" in printed.said  # a narrow column breaks the name


def test_effects_of_a_machine_tell_the_places_that_are_one():
    answer = hydrotwin("effects", "spool_valve", "--json")
    one = next(r for r in json.loads(answer.out) if r["effect"] == "command_deadband")
    assert (one["site"], one["twins"]) == ("current", ["slide.target"])
    assert "= slide.target" in hydrotwin("effects", "spool_valve").said


def test_effects_of_something_without_equations_are_refused():
    answer = hydrotwin("effects", "eq17")
    assert answer.code == 2
    assert "'eq17' is no physical model" in answer.said


# -- gap: what it hands on -----------------------------------------------------------------------------------------
def test_gap_hands_on_what_was_asked_for(here, discover):
    answer = hydrotwin(
        *GAP[:3], "train_2.csv", *GAP[3:], "--free", "motor.*", "--free", "arm.mass", "--effects", "coulomb*",
        "--effects", "* at command", "--exclude", "drift", "--max-effects", "2", "--executor", "here",
    )  # fmt: skip
    assert answer.code == 0, answer.err
    (model, records), asked = discover.call_args
    assert (model.name, [r.name for r in records]) == ("cehA", ["train_1", "train_2"])
    assert [r.name for r in asked["validate"]] == ["validate_1"]
    assert asked["free"] == ["motor.*", "arm.mass"]
    assert (asked["effects"], list(asked["exclude"])) == (["coulomb*", "* at command"], ["drift"])
    assert asked["max_effects"] == 2
    assert isinstance(asked["executor"], Here)


@pytest.mark.parametrize("command", ["gap", "identify"])
def test_what_a_slower_sensor_lacks_is_told_and_may_stay_unknown(here, discover, command):
    head, *rows = (here / "train_1.csv").read_text().splitlines()
    k = [name.split(" ")[0] for name in head.split(",")].index("pressure_cap")
    cells = [row.split(",") for row in rows]
    slow = [",".join("" if j == k and i % 10 else cell for j, cell in enumerate(row)) for i, row in enumerate(cells)]
    (here / "slow.csv").write_text("\n".join([head, *slow]) + "\n")
    words = [command, "cehA", "slow.csv", "--out", "gap" if command == "gap" else "fitted.toml"]
    refused = hydrotwin(*words)
    assert refused.code == 2 and 'missing="keep"' in refused.said
    answer = hydrotwin(*words, "--missing", "keep")
    assert answer.code == 0, answer.err
    assert f"pressure_cap has no value in {len(rows) - len(rows[::10])} of {len(rows)} samples" in answer.said
    if command == "gap":
        assert np.isnan(discover.call_args[0][1][0]["pressure_cap"]).sum() == len(rows) - len(rows[::10])


@pytest.mark.parametrize("quiet", [True, False])
def test_progress_is_told_unless_json_is_wanted(here, discover, quiet):
    def telling(*_, progress, **__):
        assert (progress is None) == quiet
        if progress:
            progress("refit", 1, 4, "dead_time at command")
            progress("locate", 0, 0)
        return friction_found()

    discover.side_effect = telling
    answer = hydrotwin(*GAP, *(["--json"] if quiet else []))
    assert answer.code == 0, answer.err


# -- gap: what it writes -------------------------------------------------------------------------------------------
def test_gap_prints_verdict_effect_value_interval_and_gap_closed(here, discover):
    answer = hydrotwin(*GAP)
    assert answer.code == 0, answer.err
    assert "named" in answer.said and "Coulomb friction" in answer.said
    step = discover.return_value.steps[0]
    assert step.site in answer.said
    assert "95 % interval" in answer.said and "%" in answer.said


@pytest.mark.parametrize("case", ["named", "one_of_a_class", "none", "unknown", "two_effects"])
def test_every_verdict_is_done_and_leaves_report_json_model_and_modelica(case, here, discover):
    discover.return_value = getattr(gap_discoveries, case)()
    answer = hydrotwin(*GAP)
    assert answer.code == 0, answer.err
    found = json.loads((here / "gap/gap.json").read_text())
    assert set(found) >= KEYS
    assert found["verdict"] == discover.return_value.verdict
    assert f": {found['verdict']}." in answer.said
    files = {p.name for p in (here / "gap").iterdir()}
    assert files == {"report.html", "report.md", "gap.json", "model.toml", "model.mo"}
    assert ("next" in answer.out) == (case == "one_of_a_class")


def test_the_model_that_is_written_has_the_effect_and_runs(here, discover):
    assert hydrotwin(*GAP).code == 0
    again = ht.load("gap/model.toml")
    assert [(a.effect, a.site) for a in again.additions] == [("coulomb_friction", "arm.pin")]
    assert {p.name: p.value for p in again.flat.parameters}["coulomb_friction.force"] == 83.0
    record = ht.read_record("validate_1.csv")
    ours, base = (ht.simulate(m, record)["arm_angle"] for m in (again, cehA.model()))
    assert np.abs(ours - base).max() > 0
    made = tomllib.loads((here / "gap/model.toml").read_text())["provenance"]
    assert made["verdict"] == "named"
    assert [(r["name"], r["role"]) for r in made["recordings"]] == [("train_1", "train"), ("validate_1", "validate")]
    file = ht.read_model_file("gap/model.toml")
    [one] = file.credibility.evidence
    assert (one.by, one.facts["verdict"], file.stale) == ("gap", "named", "")
    assert [(r["name"], r["role"]) for r in one.recordings] == [("train_1", "fit"), ("validate_1", "judge")]
    assert {m["role"] for m in one.metrics} == {"fit", "judge"}
    assert "coulomb_friction" in (here / "gap/model.mo").read_text()


def test_a_gap_goes_on_from_a_model_file_that_has_effects(here, discover):
    assert hydrotwin(*GAP).code == 0
    answer = hydrotwin("gap", "gap/model.toml", "train_1.csv", "--validate", "validate_1.csv", "--out", "second")
    assert answer.code == 0, answer.err
    (model, _), _ = discover.call_args
    assert [a.effect for a in model.additions] == ["coulomb_friction"]
    assert tomllib.loads((here / "second/model.toml").read_text())["model"] == "cehA"


def test_json_on_standard_output_is_gap_json(here, discover):
    answer = hydrotwin(*GAP, "--json")
    assert answer.code == 0, answer.err
    printed, written = json.loads(answer.out), json.loads((here / "gap/gap.json").read_text())
    assert {key: written[key] for key in KEYS} == {key: printed[key] for key in KEYS}


# -- gap: the real thing -------------------------------------------------------------------------------------------
def test_the_leak_in_the_shipped_recordings_is_found_and_nothing_unfinished_stays(here):
    train = [f"train_{k}.csv" for k in (1, 2, 3)]
    answer = hydrotwin(
        *("gap", "cehA", *train, "--validate", "validate_1.csv", "validate_2.csv", "--executor", "here"),
        *("--effects", "*_leakage", "--effects", "coulomb_friction", "--out", "gap"),
    )
    assert answer.code == 0, answer.err
    found = json.loads((here / "gap/gap.json").read_text(encoding="utf-8"))
    assert [s["effect"] for s in found["steps"]] == ["internal_leakage"]
    assert not (here / "gap/.unfinished").exists()
    files = {"report.html", "report.md", "gap.json", "model.toml", "model.mo"}
    assert {p.name for p in (here / "gap").iterdir()} == files


# -- gap: going on after an interruption ---------------------------------------------------------------------------
def test_what_was_finished_before_ctrl_c_is_kept_and_then_forgotten(here, discover):
    key = key_of("a fit")

    def interrupted(*_, memory, **__):
        memory.put(key, {"x": np.array([1.0])})
        raise KeyboardInterrupt

    discover.side_effect = interrupted
    stopped = hydrotwin(*GAP)
    assert stopped.code == 130 and "finished fits kept: 1. The same command goes on" in stopped.err
    assert not (here / "gap/gap.json").exists()

    def going_on(*_, memory, **__):
        assert memory.get(key)["x"] == [1.0]
        return friction_found()

    discover.side_effect = going_on
    answer = hydrotwin(*GAP)
    assert answer.code == 0, answer.err
    assert "1 fit" in answer.err and "--fresh" in answer.err
    assert len(Memory(here / "gap/.unfinished")) == 0


def test_fresh_forgets_what_was_finished(here, discover):
    Memory(here / "gap/.unfinished").put(key_of("a fit"), {"x": 1.0})

    def fresh(*_, memory, **__):
        assert len(memory) == 0
        return friction_found()

    discover.side_effect = fresh
    assert hydrotwin(*GAP, "--fresh").code == 0


# -- gap: bad input ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("error", "code"),
    [(DataError("train_1.csv: nothing moves."), 2), (SolveError("cehA: diverges from every start."), 1)],
)
def test_a_gap_that_cannot_be_looked_for_says_why_on_screen_and_in_gap_json(here, discover, error, code):
    discover.side_effect = error
    answer = hydrotwin(*GAP)
    assert answer.code == code
    assert str(error) in answer.said
    found = json.loads((here / "gap/gap.json").read_text())
    assert set(found) >= KEYS
    assert (found["verdict"], found["steps"], found["findings"]) == ("unknown", [], [str(error)])
    assert {p.name for p in (here / "gap").iterdir()} == {"gap.json"}


@pytest.mark.parametrize("there", ['{"verdict": "named", "steps": []}', "not JSON", "[1, 2]", ""])
def test_whatever_an_earlier_version_or_a_user_has_written_stays_when_a_run_fails(here, discover, there):
    (here / "gap").mkdir()
    (here / "gap/gap.json").write_text(there)
    discover.side_effect = SolveError("no.")
    for _ in range(2):
        assert hydrotwin(*GAP).code == 1
    assert (here / "gap/gap.json").read_text() == there
    assert json.loads((here / "gap/failure.json").read_text())["findings"] == ["no."]


def test_the_reason_of_a_failure_is_replaced_by_that_of_the_next(here, discover):
    for words in ("first.", "second."):
        discover.side_effect = SolveError(words)
        assert hydrotwin(*GAP).code == 1
    assert json.loads((here / "gap/gap.json").read_text())["findings"] == ["second."]
    assert not (here / "gap/failure.json").exists()


@pytest.mark.parametrize(("error", "code"), [(DataError("train_1.csv: nothing moves."), 2), (SolveError("no."), 1)])
def test_a_run_that_fails_leaves_the_answer_of_an_earlier_one(here, discover, error, code):
    assert hydrotwin(*GAP).code == 0
    before, discover.side_effect = contents(here / "gap"), error
    answer = hydrotwin(*GAP)
    assert answer.code == code and str(error) in answer.said
    assert "gap/gap.json is that of an earlier run; why this run failed is in gap/failure.json" in answer.said
    after = contents(here / "gap")
    assert after.keys() - before.keys() == {"failure.json"} and before.items() <= after.items()
    assert json.loads((here / "gap/failure.json").read_text())["findings"] == [str(error)]
    discover.side_effect = None
    assert hydrotwin(*GAP).code == 0
    assert not (here / "gap/failure.json").exists()


@pytest.mark.parametrize(
    ("edit", "says"),
    [
        (lambda rows: rows[:30], "Record tens of seconds"),
        (
            lambda rows: [",".join([row.split(",")[0], "0", *row.split(",")[2:]]) for row in rows],
            "no input of cehA ever moves",
        ),
    ],
    ids=["too short", "motionless"],
)
def test_recordings_that_can_show_nothing_are_refused_by_the_search_itself(here, edit, says):
    head, *rows = (here / "train_1.csv").read_text().splitlines()
    (here / "train_1.csv").write_text("\n".join([head, *edit(rows)]) + "\n")
    answer = hydrotwin(*GAP, "--executor", "here", "--effects", "coulomb_friction")
    assert answer.code == 2, answer.said
    assert says in answer.said
    found = json.loads((here / "gap/gap.json").read_text())
    assert found["verdict"] in ("none", "unknown") and says in found["findings"][0]


def test_a_machine_of_ones_own_is_told_how_to_use_the_answer(here, discover):
    (here / "own.py").write_text("from hydrotwin.models import cehA\n\n\ndef machine():\n    return cehA.model()\n")
    answer = hydrotwin("gap", "own.py:machine", *GAP[2:])
    assert answer.code == 0, answer.err
    assert "own.py:machine@gap/model.toml" in answer.out
    again = ht.load("own.py:machine@gap/model.toml")
    assert [a.effect for a in again.additions] == ["coulomb_friction"]


@pytest.mark.parametrize(
    ("words", "says"),
    [
        (
            ["gap", "cehA", "train_1.csv", "--out", "gap", "--effects", "colomb_friction"],
            "Did you mean 'coulomb_friction'",
        ),
        (["gap", "cehA", "train_1.csv", "--out", "gap", "--exclude", "driff"], "Did you mean 'drift'"),
        (["gap", "cehA", "train_9.csv", "--out", "gap"], "train_9.csv: no such file"),
        (["gap", "eq17", "train_1.csv", "--out", "gap"], "'eq17' is no physical model"),
        ([*GAP, "--executor", "her"], "Did you mean 'here'"),
        ([*GAP[:3], "train_2.csv", "--validate", "train_1.csv", "--out", "gap"], "Only an unseen recording can judge"),
        (["gap", "cehA", "train_1.csv", "--out", "train_1.csv"], "a file, where a folder is needed"),
        (["gap", "spool_valve", "train_1.csv", "--out", "gap"], "no column 'current'"),
    ],
)
def test_wrong_words_are_told_before_anything_runs_or_is_written(here, discover, words, says):
    before = contents(here)
    answer = hydrotwin(*words)
    assert answer.code == 2
    assert says in answer.said
    assert not discover.called
    assert contents(here) == before
