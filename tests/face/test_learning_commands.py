"""learn, invert and compensate on the command line: options by name, blocks that load and simulate."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.commands.learning import KINDS
from hydrotwin.commands.training import ranked
from hydrotwin.learned import learning, refit
from hydrotwin.records import Record
from tests.face.command_line import hydrotwin

EDGES, GAIN = (-0.1, 0.15), 0.2  # deadband [1] and m/s per unit beyond it
SIGNALS = "--input current --output position"


def rate(u):
    """The true characteristic, m/s."""
    return GAIN * (np.minimum(u - EDGES[0], 0) + np.maximum(u - EDGES[1], 0))


@pytest.fixture(scope="module")
def ramps(tmp_path_factory):
    """Slow ramps up and down, 50 Hz, 0.02 mm noise."""
    folder = tmp_path_factory.mktemp("ramps")
    for number in (1, 2):
        time = np.arange(0, 80, 0.02)
        current = np.interp(time, [0, 20, 60, 80], [0, 1, -1, 0]) * (1 if number == 1 else -0.9)
        position = np.concatenate([[0], np.cumsum(rate(current[:-1])) * 0.02])
        position += np.random.default_rng(number).normal(0, 2e-5, len(time))
        record = Record(time, {"current": current, "position": position}, {"current": "1", "position": "m"}, "ramp")
        ht.write_record(record, folder / f"ramp_{number}.csv")
    return folder


@pytest.fixture(autouse=True)
def here(ramps, monkeypatch):
    monkeypatch.chdir(ramps)
    return ramps


def test_a_characteristic_is_learnt_and_its_file_simulates():
    line = f"learn piecewise ramp_1.csv {SIGNALS} --validate ramp_2.csv --set dead_time=0 --json --out a.toml"
    answer = hydrotwin(*line.split())
    assert answer.code == 0, answer.err
    assert json.loads(answer.out)["kind"] == "piecewise"
    block, measured = ht.load("a.toml"), ht.read_record("ramp_2.csv")
    predicted = ht.simulate(block, measured)["position"]
    assert np.sqrt(np.mean((predicted - measured["position"]) ** 2)) < 0.01 * np.ptp(measured["position"])


def test_every_kind_that_can_be_learnt_is_told_in_the_help():
    assert KINDS.keys() == learning.KINDS.keys()
    said = hydrotwin("learn", "--help").said
    assert all(f"{kind}:" in " ".join(said.split()) for kind in ("auto", *KINDS))


def test_the_answer_says_first_what_a_block_is_no_better_than_and_then_how_good_it_is():
    line = f"learn piecewise ramp_1.csv {SIGNALS} --set dead_time=0 --set integrating=false"
    answer = hydrotwin(*f"{line} --json --out level.toml".split())
    assert answer.code == 0, answer.err
    told = json.loads(answer.out)
    assert told["says"].startswith("Of position the block is no better than ")
    assert "holding the last sample" in told["no_better_than"] == told["free_run"]["no_better_than"]
    assert told["integration"]["position"]["integrates"] and "its level is learned, as asked for" in told["says"]
    screen = hydrotwin(*f"{line} --out level.toml".split())
    assert screen.said.strip().startswith("careful: Of position the block is no better than ")
    good = hydrotwin(*f"learn piecewise ramp_1.csv {SIGNALS} --set dead_time=0 --out rate.toml".split())
    assert good.said.strip().startswith("checked: Free run on what was held out (")
    assert re.search(r"RMS error of position [\d.]+ mm, [\d.]+ % of its range", good.said)


def test_the_published_network_is_learnt_where_it_is_asked_for():
    pytest.importorskip("torch")
    for fit, kind in (("paper", "rate_network"), ("default", "network")):
        brief = "--set iterations=5" if fit == "paper" else "--set effort=0.01 --set period=0.1 --hidden 1"
        answer = hydrotwin(*f"learn nn ramp_1.csv {SIGNALS} --fit {fit} {brief} --json --out nn.toml".split())
        assert answer.code == 0, answer.err
        assert json.loads(answer.out)["kind"] == kind


@pytest.mark.parametrize("source", ["ramp_1.csv ramp_2.csv", "a.toml"])
def test_the_inverse_gives_back_the_command_from_recordings_and_from_a_block(source):
    if source == "a.toml":
        assert hydrotwin(*f"learn piecewise ramp_1.csv {SIGNALS} --set dead_time=0 --out a.toml".split()).code == 0
        source += " --set rate=true"
    answer = hydrotwin(*f"invert {source} {SIGNALS} --out inverse.toml".split())
    assert answer.code == 0, answer.err
    block = ht.load("inverse.toml")
    wanted = np.array([-0.15, -0.05, 0.05, 0.15])
    time = np.arange(4) * block.period
    asked = Record(time, {block.inputs[0].name: wanted}, {block.inputs[0].name: block.inputs[0].unit})
    commands = ht.simulate(block, asked)[block.outputs[0].name]
    assert rate(commands) == pytest.approx(wanted, abs=0.004)


def test_a_compensated_command_follows_the_desired_curve():
    points = "--waypoint 0.5=0.06 --waypoint 1=0.15"
    answer = hydrotwin(*f"compensate ramp_1.csv ramp_2.csv {SIGNALS} {points} --out compensator.toml".split())
    assert answer.code == 0, answer.err
    block = ht.load("compensator.toml")
    name = block.inputs[0].name
    asked = Record(np.arange(4) * block.period, {name: np.array([-1.0, -0.5, 0.5, 1.0])}, {name: "1"})
    assert rate(ht.simulate(block, asked)["current"]) == pytest.approx([-0.15, -0.06, 0.06, 0.15], abs=0.005)


def test_an_inverse_ends_with_a_card_that_criteria_judge():
    line = f"invert ramp_1.csv ramp_2.csv {SIGNALS} --out inverse.toml"
    screen = hydrotwin(*line.split(), "--accept", "position_rate.rmse < 5 mm/s", "--report", "page")
    assert screen.code == 0, screen.err
    assert re.search(r"RMS error of position_rate [\d.]+ mm/s, [\d.]+ % of its range", screen.said)
    assert "PASS position_rate.rmse < 5 mm/s" in screen.said
    assert "RMS error of position_rate" in Path("page/characteristic.md").read_text(encoding="utf-8")
    missed = hydrotwin(*line.split(), "--accept", "position_rate.rmse < 0.0001 mm/s", "--json")
    assert missed.code == 1 and json.loads(missed.out)["held_out"]["says"] == json.loads(missed.out)["says"]
    line = f"compensate ramp_1.csv ramp_2.csv {SIGNALS} --waypoint 1=0.15 --out c.toml"
    good = hydrotwin(*line.split(), "--accept", "position_rate not worse than machine")
    assert good.code in (0, 1) and "position_rate not worse than machine" in good.said
    for verb, text, words in (
        ("invert", "position.rmse < 1 mm", "position_rate"),
        ("invert", "position_rate.coverage > 90 %", "invert judges"),
        ("invert", "position_rate not worse than machine", "has no yardstick 'machine'"),
    ):
        answer = hydrotwin(*f"{verb} ramp_1.csv {SIGNALS} --out refused.toml".split(), "--accept", text)
        assert answer.code == 2 and words in answer.err and not Path("refused.toml").exists()


def test_a_hybrid_is_learnt_written_and_loaded(recordings, tmp_path):
    train = recordings / "train_1.csv"
    line = f"learn hybrid {train} --model cehA --output arm_angle --hidden 0 --budget 2 --json --out {tmp_path}/h.toml"
    answer = hydrotwin(*line.split(), "--set", "lags=1,3", "--set", "features=arm_angle,")
    assert answer.code == 0, answer.err
    block, told = ht.load(f"{tmp_path}/h.toml"), json.loads(answer.out)
    before, after = told["errors"]["arm_angle"].values()
    measured = ht.read_record(train).window(None, told["free_run"]["held_out"][0]["from"])  # what was trained on
    assert "the model alone" in told["free_run"]["outputs"]["arm_angle"]["yardsticks"]
    corrected = ht.simulate(block, measured)["arm_angle"] - measured["arm_angle"]
    assert after < before and np.sqrt(np.mean(corrected**2)) == pytest.approx(after, rel=0.05)
    assert block.residual.structure["input_lags"] == 3
    assert [s.name for s in block.residual.inputs] == ["command", "simulated.arm_angle"]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (f"learn hybrid ramp_1.csv {SIGNALS} --out a.toml", ["--model goes with hybrid"]),
        (f"learn gp ramp_1.csv {SIGNALS} --model cehA --out a.toml", ["--model goes with hybrid"]),
        (f"learn nn ramp_1.csv {SIGNALS} --fit papr --out a.toml", ["learn nn: no fit 'papr'", "'paper'"]),
        (f"learn gp ramp_1.csv {SIGNALS} --set lagz=3 --out a.toml", ["learn gp: has no option 'lagz'", "'lags'"]),
        (f"learn piecewise ramp_1.csv {SIGNALS} --hidden 3 --out a.toml", ["has no option 'hidden'", "dead_time"]),
        (f"learn gp ramp_1.csv {SIGNALS} --set lags --out a.toml", ["--set takes NAME=VALUE"]),
        (f"learn arx ramp_1.csv {SIGNALS} --set lags=5 --out a.toml", ["lags cannot be '5'", "2 values with commas"]),
        (f"learn gp ramp_1.csv {SIGNALS} --set kernel=5 --out a.toml", ["kernel cannot be '5'", "a word"]),
        (f"learn linear ramp_1.csv {SIGNALS} --set order=2,3 --out a.toml", ["order cannot be '2,3'"]),
        (f"learn nn ramp_1.csv {SIGNALS} --select ramp_1.csv --out a.toml", ["ramp_1 is trained on"]),
        (f"learn auto ramp_1.csv {SIGNALS} --select ramp_1.csv --out a.toml", ["ramp_1 is trained on"]),
        ("invert ramp_1.csv a.toml --input current --output position --out b.toml", ["one model, or recordings"]),
        (f"compensate ramp_1.csv {SIGNALS} --waypoint fast --out b.toml", ["COMMAND=RATE", "got 'fast'"]),
    ],
)
def test_wrong_words_are_answered_with_what_would_be_right(line, says):
    answer = hydrotwin(*line.split())
    assert answer.code == 2
    for words in says:
        assert words in answer.err


@pytest.mark.parametrize(
    "line",
    [
        f"invert {{own}} {SIGNALS} --out {{own}}",
        f"compensate {{own}} {SIGNALS} --waypoint 1=0.1 --out {{own}}",
        f"learn hybrid ramp_1.csv --model {{own}} {SIGNALS} --out {{own}}",
        f"learn hybrid ramp_1.csv --model slide.py:axis@{{own}} {SIGNALS} --out {{own}}",
        "learn hybrid ramp_1.csv --model {own} --output position --out {folder}/axis.toml",
    ],
)
def test_a_block_does_not_replace_the_model_that_it_is_made_of(line, tmp_path):
    """Nor do the other files of a hybrid: the last line's would be called as its model is."""
    own = tmp_path / "axis_model.toml"
    own.write_text("kept", encoding="utf-8")
    answer = hydrotwin(*line.format(own=own, folder=tmp_path).split())
    assert answer.code == 2 and "would replace it" in answer.err and own.read_text(encoding="utf-8") == "kept"


def test_what_there_is_instead_is_listed_once(here):
    for option, often in (("--budget 5", 1), ("--set lagz=3", 1)):
        answer = hydrotwin(*f"learn gp ramp_1.csv {SIGNALS} {option} --out a.toml".split())
        assert answer.code == 2 and answer.err.count("evaluations") == often, answer.err


def test_a_block_is_trained_again_on_all_when_it_was_judged(here):
    line = f"learn arx ramp_1.csv {SIGNALS} --json"
    judged, again = (hydrotwin(*f"{line} {flag} --out refit.toml".split()) for flag in ("", "--refit"))
    assert again.code == 0, again.err
    before, after = json.loads(judged.out), json.loads(again.out)
    assert after["free_run"]["outputs"] == before["free_run"]["outputs"]
    assert (
        after["trained_on"][0]["samples"]
        == len(ht.read_record(here / "ramp_1.csv"))
        > before["trained_on"][0]["samples"]
    )
    assert after["says"] == f"{before['says']} {refit.REFITTED}"


def test_a_block_is_judged_by_criteria_and_its_page_shows_what_was_held_out(here):
    line = f"learn piecewise ramp_1.csv {SIGNALS} --set dead_time=0 --out judged.toml"
    both = ("--accept", "position.rmse < 20 mm", "--accept", "rmse < 20 mm")
    good = hydrotwin(*line.split(), *both, "--report", "page")
    assert good.code == 0 and "PASS position.rmse < 20 mm: " in good.said
    assert re.search(r"PASS rmse < 20 mm: [\d.]+\s+mm\s+of\s+position", good.said), "the worst of its outputs"
    text = (here / "page" / "report.md").read_text(encoding="utf-8")
    assert "Free run on what was held out (" in text and "## Beside yardsticks" in text
    assert "on the validation recording" in text, "it was held out: nothing of it was trained on"
    bad = hydrotwin(*line.split(), "--accept", "position.rmse < 1 um", "--accept", "position not worse than mean")
    assert bad.code == 1 and "FAIL position.rmse < 1 um: " in bad.said and "PASS position not worse" in bad.said
    assert (here / "judged.toml").exists(), "it is written all the same"


def test_a_criterion_has_to_hold_of_what_it_is_validated_with_too(here):
    """Commands of three times the size: what was held out says nothing of them, and had passed the block alone."""
    time = np.arange(0, 10, 0.02)
    current = 3 * np.sin(2 * np.pi * 0.2 * time)
    far = Record(
        time, {"current": current, "position": np.cumsum(current**3) * 0.02}, {"current": "1", "position": "m"}, "far"
    )
    ht.write_record(far, here / "far.csv")
    line = f"learn arx ramp_1.csv {SIGNALS} --out near.toml --validate far.csv".split()
    missed = hydrotwin(*line, "--accept", "position.rmse < 1 m")
    assert (
        missed.code == 1 and "PASS position.rmse < 1 m: " in missed.said and "FAIL position.rmse < 1 m: " in missed.said
    )
    assert "on the recordings to validate with" in missed.said
    assert hydrotwin(*line[:-2], "--accept", "position.rmse < 1 m").code == 0
    other = hydrotwin(*line, "--accept", "position.max < 1 m")
    assert other.code == 0 and "note position.max < 1 m: judged on what was held out alone" in " ".join(
        other.said.split()
    )


def test_a_block_that_nothing_could_be_held_out_of_is_written_without_a_page(here):
    time = np.arange(0, 16, 0.02)
    current = np.interp(time, [0, 2, 6, 8], [0, 1, -1, 0])
    position = np.cumsum(rate(current)) * 0.02 + np.random.default_rng(0).normal(0, 2e-5, len(time))
    record = Record(time, {"current": current, "position": position}, {"current": "1", "position": "m"}, "short")
    ht.write_record(record, here / "short.csv")
    answer = hydrotwin(*f"learn arx short.csv {SIGNALS} --out short.toml --report no_page".split())
    text = answer.said + answer.err
    assert answer.code == 0 and "no page: nothing was held out" in text and "Nothing was held out: " in text
    assert (here / "short.toml").exists() and not (here / "no_page").exists()


@pytest.mark.parametrize(
    ("kind", "criterion", "says"),
    [
        ("piecewise", "positon.rmse < 2 mm", "Did you mean 'position'"),
        ("piecewise", "ramp_1: position.rmse < 2 mm", "Write it without 'ramp_1:'"),
        ("piecewise", "position.rmse < 2 bar", "does not fit"),
        ("piecewise", "position not worse than curve", "learn piecewise has no yardstick 'curve'"),
        ("arx", "position not worse than ARX", "learn arx has no yardstick 'ARX'"),
        ("gp", "position not worse than AXR", "Did you mean 'ARX'"),
        ("gp", "position.mae not worse than ARX", "yardsticks have rmse only"),
        ("gp", "position not worse than the model alone", "no yardstick 'the model alone'"),
    ],
)
def test_a_criterion_that_says_nothing_is_refused_before_the_training(here, kind, criterion, says):
    answer = hydrotwin(*f"learn {kind} ramp_1.csv {SIGNALS} --out never.toml".split(), "--accept", criterion)
    assert answer.code == 2 and says in answer.err and not (here / "never.toml").exists()


@pytest.mark.parametrize("more", ["ramp_1.csv", "copy.csv"])
def test_a_recording_that_is_named_twice_would_count_twice(here, more):
    (here / "copy.csv").write_bytes((here / "ramp_1.csv").read_bytes())
    answer = hydrotwin(*f"learn arx ramp_1.csv {more} {SIGNALS} --out twice.toml".split())
    (here / "copy.csv").unlink()
    assert answer.code == 2 and f"{more}: the same recording as ramp_1.csv" in answer.err
    assert "Name each recording once" in answer.err and not (here / "twice.toml").exists()


def test_every_kind_is_tried_and_the_best_is_kept(here):
    line = f"learn auto ramp_1.csv {SIGNALS} --set kinds=piecewise,grey_box --json --out best.toml"
    answer = hydrotwin(*line.split())
    assert answer.code == 0, answer.err
    rows = json.loads(answer.out)["ranking"]
    assert sorted(row["kind"] for row in rows) == ["grey_box", "piecewise"]
    (chosen,) = (row["kind"] for row in rows if row["chosen"])
    assert ht.load("best.toml").provenance["kind"] == chosen


def test_the_screen_ranks_the_kinds_that_were_tried():
    of = {"percent_of_range": {"position": 0.123}}
    rows = [{"kind": "arx", **of, "chosen": True, "as_good": True}, {"kind": "nn", "failed": "x", "cut": True}]
    line = "kinds by their error on what was held out, in % of the range of position: "
    assert ranked(rows) == f"{line}arx 0.12 (chosen), nn (cut by the budget)."


@pytest.mark.parametrize("line", ["learn linear ramp_1.csv", "learn arx ramp_1.csv", "learn nn ramp_1.csv --budget 2"])
def test_a_kind_is_trained_on_a_screen_as_it_is_in_a_script(here, line):
    """The bar asked a linear model for what it does not tell, and only --json worked."""
    answer = hydrotwin(*f"{line} {SIGNALS} --validate ramp_2.csv --out screen.toml".split())
    assert answer.code == 0, answer.err
    assert "Free run over 1 validation recording, which took no part: RMS error of position " in answer.said
