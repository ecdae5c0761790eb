"""Recordings to validate with judge and do nothing else: another one gives the same block, bit for bit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.commands.training import trained, written
from hydrotwin.learned import refitted
from hydrotwin.learned.bands import WIDE
from hydrotwin.learned.learning import held_out_of
from hydrotwin.learned.validation import FIRST, doubtful, sentence, validated
from hydrotwin.models.language.errors import DataError
from hydrotwin.records import Record
from tests.learned.test_bad_input import MODEL, PERIOD, recording
from tests.learned.toy_machine import ANGLE, toy_record, untrained_block, with_deviation

INPUTS, OUTPUTS = ["current"], ["position"]
KINDS = {  # options that keep a training short, and what it needs
    "nn": ({"hidden": 2, "starts": 1, "effort": 0.1, "lags": (1, 2), "period": PERIOD}, None),
    "nn paper": ({"fit": "paper", "iterations": 20, "starts": 2}, "torch"),
    "gp": ({"points": 60, "samples": 300, "compress": 10, "lags": 2}, "gpytorch"),
    "dual_gp": ({"points": 60, "samples": 300, "compress": 10, "knots": 8, "lags": 2}, "gpytorch"),
    "piecewise": ({"starts": 3, "dead_time": 0.0}, None),
    "grey_box": ({"starts": 3, "effort": 0.2, "knots": 5}, None),
    "arx": ({}, None),
    "linear": ({}, None),
    "symbolic": ({"starts": 1, "generations": 3, "population": 40, "lags": (0, 1), "period": PERIOD}, "pyoperon"),
    "narx": ({"terms": 3, "degree": 2, "lags": (1, 2), "period": PERIOD}, "sympy"),
    "state_nn": ({"hidden": 2, "hidden_states": 1, "starts": 1, "effort": 0.1, "period": PERIOD}, None),
    "hybrid": ({"starts": 1, "hidden": 0, "effort": 0.1, "period": PERIOD, "features": ["velocity"]}, None),
}


def answers(seed: int) -> Record:
    """A recording to validate with, whose position follows nothing that was trained on."""
    record = recording(8.0, strength=0.8)
    walk = np.cumsum(np.random.default_rng(seed).normal(size=len(record)))
    return record.with_signals({"position": 0.05 * walk / np.ptp(walk)})


def learned(kind: str, validate: list[Record]):
    options, needs = KINDS[kind]
    if needs:
        pytest.importorskip(needs)
    kind = kind.split()[0]
    more = {"model": ht.load(MODEL)} if kind == "hybrid" else {}
    inputs = () if kind == "hybrid" else INPUTS
    given = (kind, [recording()], inputs, OUTPUTS)
    return trained("learn", ht.learn, given, False, validate=validate, **options, **more)  # with the bar of a screen


def curve(validate: list[Record]):
    """The characteristic that the recordings follow."""
    return ht.learn("piecewise", [recording()], INPUTS, OUTPUTS, validate=validate, starts=3, dead_time=0.0)


def content(block) -> dict[str, bytes]:
    """All numbers of a block, and those of a hybrid's residual."""
    block = getattr(block, "residual", block)
    return {} if block is None else {name: array.tobytes() for name, array in block.arrays.items()}


@pytest.mark.parametrize("kind", KINDS)
def test_another_recording_to_validate_with_gives_the_same_block_bit_for_bit(kind):
    none, other = (learned(kind, validate) for validate in ([], [answers(1)]))
    assert content(none) == content(other)
    runs = [ht.simulate(block, recording(4.0))["position"] for block in (none, other)]
    assert runs[0].tobytes() == runs[1].tobytes()
    run = ht.simulate(other, answers(1))["position"]
    told = float(np.sqrt(np.mean((run - answers(1)["position"]) ** 2)))
    assert other.provenance["validation"]["position"] == pytest.approx(told)
    assert "validated_on" in other.provenance and not none.provenance.get("validation")


def test_a_recording_that_cannot_judge_is_refused_before_the_training():
    trained = replace(recording(), digest="a")
    with pytest.raises(DataError, match="Only an unseen recording can judge"):
        ht.learn("piecewise", [trained], INPUTS, OUTPUTS, validate=[replace(recording(), digest="a")])
    with pytest.raises(DataError, match="no column 'position'"):
        ht.learn("piecewise", [trained], INPUTS, OUTPUTS, validate=[recording().select(["current"])])


def test_a_block_that_is_trained_again_is_judged_again():
    block = ht.learn("arx", [recording()], INPUTS, OUTPUTS, validate=[answers(1)])
    again = refitted(block, "arx", [recording()], INPUTS, OUTPUTS, validate=[answers(1)])
    run = ht.simulate(again, answers(1))["position"]
    told = float(np.sqrt(np.mean((run - answers(1)["position"]) ** 2)))
    assert again.provenance["validation"] == {"position": pytest.approx(told)}


def test_what_the_recordings_that_judge_say_is_said():
    block = ht.learn("arx", [recording()], INPUTS, OUTPUTS)
    assert sentence(block) == ""
    block = curve([recording(8.0, 0.8), recording(6.0, 0.9)])
    said = sentence(block)
    assert said.startswith("Free run over 2 validation recordings, which took no part: RMS error of position ")
    assert f" ({FIRST} " in said and not doubtful(block)


def test_the_yardsticks_of_what_judges_are_what_they_come_to_by_hand():
    train, seen = recording(), [recording(8.0, 0.8), recording(6.0, 0.5)]
    block = curve(seen)
    split = held_out_of([train], INPUTS, OUTPUTS)
    mean, arx = float(np.mean(split.fit[0]["position"])), ht.learned.learn_arx(split.fit, INPUTS, OUTPUTS)

    def rms(run) -> float:
        return float(np.sqrt(np.mean(np.concatenate([run(r) - r["position"] for r in seen]) ** 2)))

    told = block.provenance["validation_beside"]["position"]
    assert told == {
        FIRST: pytest.approx(rms(lambda r: r["position"][0])),
        "the mean": pytest.approx(rms(lambda r: mean)),
        "ARX": pytest.approx(rms(lambda r: ht.simulate(arx, r)["position"])),
    }


def test_a_block_that_is_no_better_where_it_is_validated_says_so_first():
    block = curve([answers(1)])
    still = float(np.sqrt(np.mean((answers(1)["position"] - answers(1)["position"][0]) ** 2)))
    assert block.provenance["validation"]["position"] > still
    assert sentence(block).startswith(
        f"On what it was to be validated with, of position the block is no better than {FIRST}"
    )


def test_what_judges_outside_of_what_was_trained_on_is_said_to():
    inside, outside = (curve([recording(8.0, strength)]) for strength in (0.5, 2.0))
    told = outside.provenance["validation_beyond"]
    share = np.mean(np.abs(recording(8.0, 2.0)["current"]) > np.abs(outside.domain.upper[0]))
    assert told["share"] >= share > 0.2 and "current" in told["signals"]
    assert f"It extrapolates in {100 * told['share']:.3g} % of that: " in sentence(outside) and doubtful(outside)
    assert "validation_beyond" not in inside.provenance and "extrapolates" not in sentence(inside)


@pytest.mark.parametrize(("judge", "first"), [(recording(8.0, 0.8), "checked:"), (answers(1), "careful:")])
def test_bad_news_of_either_card_is_the_first_line_on_the_screen(judge, first, tmp_path, capsys):
    block = curve([judge])
    fine = {"bad": False, "says": "Well held out."}
    block = replace(block, provenance={**block.provenance, "free_run": fine})
    written(block, tmp_path / "block.toml", as_json=False)
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith(first) and said.count("careful:") == (first == "careful:")


def test_a_block_trained_again_keeps_the_yardsticks_of_what_judges():
    judge = [recording(8.0, 0.8)]
    block = ht.learn("arx", [recording()], INPUTS, OUTPUTS, validate=judge)
    again = refitted(block, "arx", [recording()], INPUTS, OUTPUTS, validate=judge)
    assert again.provenance["validation_beside"] == block.provenance["validation_beside"] != {}
    assert again.provenance["validation"] != block.provenance["validation"]


def test_the_band_is_judged_where_the_block_is_validated():
    """The width is that of the card, not one made of the misses at hand."""
    good, bad = (curve([judge]) for judge in (recording(8.0, 0.8), answers(1)))
    for block, judge in ((good, recording(8.0, 0.8)), (bad, answers(1))):
        wide = block.provenance["free_run"]["outputs"]["position"]["band"]["half_width"]
        miss = ht.simulate(block, judge)["position"] - judge["position"]
        inside = float(np.mean(np.abs(miss) <= wide))
        assert block.provenance["validation_coverage"] == {"position": pytest.approx(inside)}
        assert f"The 95 % band of position holds {100 * inside:.3g} % of that" in sentence(block)
    assert "of that: do not rely on it." in sentence(bad) and bad.provenance["validation_coverage"]["position"] < 0.75


def test_a_deviation_of_the_block_is_its_band_there():
    block = with_deviation(untrained_block(outputs=(ANGLE,)))
    judge = toy_record(3)
    told = validated(block, [judge.select(["command", "arm_angle"])]).provenance["validation_coverage"]
    run = ht.simulate(block, judge)
    inside = np.abs(run["arm_angle"] - judge["arm_angle"]) <= WIDE * run["arm_angle.sd"]
    assert told == {"arm_angle": pytest.approx(np.mean(inside))}
