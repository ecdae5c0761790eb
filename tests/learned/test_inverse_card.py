"""The card of an inverse and of a compensator: errors at points that took no part, beside what costs little."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.learned import (
    Characteristic,
    characteristic,
    judged_compensator,
    judged_inverse,
    learn_inverse,
    read_block,
    write_block,
)
from hydrotwin.learned.inverse.judging import ALONE, EVERY, LINE
from hydrotwin.learned.report_card import MEAN, card_of
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

CURRENT, RATE = Signal("current", "1"), Signal("wanted_position_rate", "m/s")
NOISE = 1e-3


def points(bend: float = 0.05, noise: float = 0.0, count: int = 200) -> Characteristic:
    """0.1 m/s at full command, with a deadband of ``bend`` on either side."""
    u = np.linspace(-1, 1, count)
    r = 0.1 * np.sign(u) * np.maximum(np.abs(u) - bend, 0)
    return Characteristic(CURRENT, RATE, u, r + noise * np.random.default_rng(0).standard_normal(count), noise)


def row(block) -> dict:
    return card_of(block)["outputs"]["position_rate"]


def test_the_error_is_that_of_an_inverse_which_never_saw_the_points():
    forward = points(noise=NOISE)
    block = judged_inverse(forward, None, None)
    out = np.arange(len(forward.commands)) % EVERY == EVERY // 2
    found = row(block)
    assert found["unit"] == "m/s" and card_of(block)["held_out"][0]["points"] == out.sum()
    assert NOISE * 0.8 < found["rmse"] < 1.5 * NOISE, "noise of the points themselves, and little more"
    wrong = forward.rates.copy()
    wrong[out] += 0.02
    off = judged_inverse(Characteristic(CURRENT, RATE, forward.commands, wrong, NOISE), None, None)
    assert row(off)["rmse"] == pytest.approx(0.02, rel=0.1) and row(off)["bias"] == pytest.approx(-0.02, rel=0.1)


def test_the_block_is_the_one_that_learns_from_all_points():
    forward = points(noise=NOISE)
    judged, plain = judged_inverse(forward, None, None), learn_inverse(forward)
    assert all(np.array_equal(judged.arrays[name], plain.arrays[name]) for name in plain.arrays)


def test_yardsticks_are_the_mean_and_the_straight_line_of_what_was_learnt_from():
    found = row(judged_inverse(points(), None, None))
    assert set(found["yardsticks"]) == {MEAN, LINE}
    assert found["yardsticks"][MEAN] == pytest.approx(0.055, rel=0.1)
    assert found["rmse"] < 0.2 * found["yardsticks"][LINE]


def test_an_inverse_of_what_is_straight_says_first_that_a_line_does_as_well():
    card = card_of(judged_inverse(points(bend=0.0, noise=5e-3), None, None))
    assert card["bad"] and LINE in (*card["no_better_than"], *card["cannot_tell"])
    assert card["says"].startswith(("Of position_rate the block is no better than", "Of position_rate the recordings"))


def test_a_compensator_is_held_against_the_machine_alone_over_what_its_curve_asks_for():
    curve = [(0.5, 0.02), (1.0, 0.06)]
    block = judged_compensator(points(), None, None, curve)
    found = row(block)
    assert found["rmse"] < 0.1 * found["yardsticks"][ALONE]
    same = judged_compensator(points(bend=0.0, noise=NOISE), None, None, [(1.0, 0.1 - 4 * NOISE)])
    assert ALONE in card_of(same)["no_better_than"] or row(same)["yardsticks"][ALONE] < 4 * NOISE


def test_the_card_comes_back_from_the_file(tmp_path):
    block = judged_inverse(points(), None, None)
    assert card_of(read_block(write_block(block, tmp_path / "i.toml")[0])) == card_of(block)


def test_too_few_points_to_leave_any_out_are_told():
    card = card_of(judged_inverse(points(count=13), None, None))
    assert card["bad"] and card["says"].startswith("Nothing was held out: 13 steady points are too few")
    assert "Hold 15 commands or more" in card["says"]


def ramps(noise: float = 1e-4) -> Record:
    """A command that never rests, and what moves by it 0.1 s later."""
    time = np.arange(0.0, 60.0, 0.02)
    command = np.sin(1.9 * time) * (0.4 + 0.6 * np.abs(np.sin(0.13 * time)))
    late = np.interp(time - 0.1, time, command)
    position = 0.5 + np.cumsum(0.1 * np.sign(late) * np.maximum(np.abs(late) - 0.1, 0)) * 0.02
    values = {"current": command, "position": position + noise * np.random.default_rng(0).standard_normal(len(time))}
    return Record(time, values, {"current": "1", "position": "m"}, "ramps")


def test_where_every_sample_counts_the_ends_of_the_recordings_are_left_out():
    record = ramps()
    forward = characteristic(record, "current", "position")
    assert "moving_points" in forward.source
    block = judged_inverse(record, "current", "position", forward=forward)
    assert "ends of the recordings" in card_of(block)["says"]
    assert row(block)["rmse"] < 0.5 * row(block)["yardsticks"][LINE]


def falling(command: np.ndarray) -> np.ndarray:
    """A flow that rises up to 0.6 of the command, and falls by a quarter of it behind."""
    return np.where(command > 0, 2 * command * (1.2 - command), command)


def answering(command: np.ndarray, answer, noise: float = 5e-3) -> Record:
    time = 0.02 * np.arange(len(command))
    values = {"current": command, "flow": answer(command) + noise * np.random.default_rng(0).standard_normal(len(time))}
    return Record(time, values, {"current": "1", "flow": "m/s"}, "answer")


STAIRS = np.repeat(np.random.default_rng(3).permutation(np.linspace(-1, 1, 41)), 100)
WAVES = np.sin(1.9 * 0.02 * np.arange(3000)) * (0.4 + 0.6 * np.abs(np.sin(0.13 * 0.02 * np.arange(3000))))


@pytest.mark.parametrize("command", [STAIRS, WAVES], ids=["steady points", "every sample"])
def test_where_the_machine_falls_is_said_first_with_how_much(command):
    block = judged_inverse(answering(command, falling), "current", "flow")
    said, told = card_of(block), block.provenance["falls"]
    assert said["bad"] and said["says"].startswith("From 0.") and "there is no inverse there" in said["says"]
    assert told["begin"] == pytest.approx(0.6, abs=0.06) and told["end"] == pytest.approx(1.0, abs=0.06)
    assert told["by"] == pytest.approx(0.32, abs=0.06)


@pytest.mark.parametrize("command", [STAIRS, WAVES], ids=["steady points", "every sample"])
@pytest.mark.parametrize("answer", [np.cbrt, lambda u: np.sign(u) * np.maximum(np.abs(u) - 0.2, 0)])
def test_what_rises_or_stays_is_not_said_to_fall(answer, command):
    block = judged_inverse(answering(command, answer, noise=0.03), "current", "flow")
    assert "falls" not in block.provenance and "no inverse there" not in card_of(block)["says"]


@pytest.mark.parametrize("command", [STAIRS, WAVES], ids=["steady points", "every sample"])
@pytest.mark.parametrize("answer", [np.negative, np.square])
def test_what_falls_more_than_it_rises_is_refused_and_nothing_is_learnt(answer, command):
    with pytest.raises(DataError, match="it falls as 'current' rises"):
        judged_inverse(answering(command, answer), "current", "flow", rate=False)


def test_ends_that_judge_a_part_of_the_commands_say_which():
    once = np.interp(np.arange(3000), [0, 1500, 2999], [-1.0, 1.0, -1.0])
    says = card_of(judged_inverse(answering(once, np.cbrt), "current", "flow", moving=True))["says"]
    assert says.startswith("The ends of the recordings judge 40 % of the range of current (-1 to -0.201)")
