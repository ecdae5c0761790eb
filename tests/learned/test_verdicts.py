"""Whether one run is better than another on more than chance, by the stretches of what was held out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrotwin.learned import learn, learn_best
from hydrotwin.learned.held_out import Part, Split, split
from hydrotwin.learned.repeats import repeats, without_repeats
from hydrotwin.learned.report_card import BLOCK, Row, Words, card
from hydrotwin.learned.verdicts import (
    STRETCHES,
    as_good,
    log_ratio,
    may_be_as_good,
    rms_of,
    stretches,
    surely_less,
)
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record


def test_few_parts_are_cut_into_enough_stretches_and_many_are_left_whole():
    one = np.arange(90.0)
    assert [len(s) for s in stretches([one])] == [30, 30, 30]
    assert len(stretches([one, one])) >= STRETCHES and sum(map(len, stretches([one, one]))) == 180
    assert [len(s) for s in stretches([one] * 4)] == [90] * 4
    assert rms_of([np.r_[np.full(30, 3.0), np.zeros(30), np.full(30, -4.0)]]) == [3.0, 0.0, 4.0]


def test_a_ratio_that_is_the_same_everywhere_is_certain():
    mean, error = log_ratio([0.5, 1.0, 2.0], [1.0, 2.0, 4.0])
    assert mean == pytest.approx(np.log(0.5)) and error == pytest.approx(0.0, abs=1e-12)
    assert surely_less([0.5, 1.0, 2.0], [1.0, 2.0, 4.0])


def test_stretches_that_disagree_are_not_certain():
    assert not surely_less([0.2, 1.5, 1.2], [1.0, 1.0, 1.0])
    assert not surely_less([0.2, 0.9, 0.8], [1.0, 1.0, 1.0]), "of three, two of which are almost as bad"
    assert surely_less([0.7, 0.9, 0.8], [1.0, 1.0, 1.0])
    assert not surely_less([0.5], [1.0]), "one stretch tells nothing of chance"
    assert not surely_less([np.inf, 0.1, 0.1], [1.0, 1.0, 1.0])


def test_of_what_is_no_better_the_card_is_sure_in_one_of_twenty():
    rng = np.random.default_rng(0)
    for count in (3, 10):
        drawn = np.exp(0.5 * rng.normal(size=(4000, count)))
        sure = np.mean([surely_less(errors, np.ones(count)) for errors in drawn])
        assert 0.04 < sure < 0.06


def test_what_is_as_good_as_the_best_neither_loses_everywhere_nor_fails_somewhere():
    best = [1.0, 1.2, 0.8, 1.0]
    assert as_good(best, best) and as_good([1.1, 1.1, 0.9, 0.95], best)
    assert not as_good([1.2 * e for e in best], best), "a little worse, but everywhere"
    assert not as_good([0.5, 0.6, 0.4, 5.0], best), "better in three stretches, lost in one"


def rows(errors, arx):
    rms = [float(np.sqrt(np.mean(np.square(part)))) for part in (errors, arx)]
    return [Row(Signal("y", "m"), rms[0], 1.0, {"ARX": rms[1]}, stretches={BLOCK: errors, "ARX": arx})]


@pytest.fixture
def held():
    record = Record(np.arange(100.0), {"y": np.arange(100.0)}, {"y": "m"}, "run")
    return Split([record], [Part(record, 40.0, 60.0), Part(record, 90.0, 99.0)])


def test_the_card_says_first_that_it_cannot_tell(held):
    told = card(held, rows([0.01, 0.06, 0.05], [0.09, 0.04, 0.05]), Words())
    assert told["says"].startswith("Of y the recordings cannot tell whether the block is better than ARX (over 3 ")
    assert "0.11 to 1.5 times its error" in told["says"]
    assert told["bad"] and told["cannot_tell"] == ["ARX"] and told["no_better_than"] == []


def test_the_card_says_nothing_of_what_is_better_everywhere_and_the_worst_of_what_is_not(held):
    fine = card(held, rows([0.01, 0.02, 0.03], [0.03, 0.05, 0.05]), Words())
    assert not fine["bad"] and fine["cannot_tell"] == [] and "10 mm to 30 mm by stretch" in fine["says"]
    worse = card(held, rows([0.05, 0.06, 0.05], [0.05, 0.04, 0.05]), Words())
    assert worse["no_better_than"] == ["ARX"] and worse["cannot_tell"] == []
    assert worse["says"].startswith("Of y the block is no better than ARX.")


def periodic(noise: float) -> Record:
    """Five periods of one motion, with what is not repeated."""
    rng = np.random.default_rng(1)
    u = np.tile(np.repeat(rng.uniform(-1, 1, 20), 10), 5) + noise * rng.normal(size=1000)
    y = np.cumsum(u - u.mean()) * 0.01
    return Record(0.02 * np.arange(1000), {"u": u, "y": y}, {"u": "V", "y": "m"}, "periods")


def test_what_repeats_what_was_trained_on_is_told_from_other_commands():
    assert repeats(split([periodic(0.05)], ["u"], ["y"]), ["u"])
    assert not repeats(split([periodic(1.0)], ["u"], ["y"]), ["u"])


def test_the_card_says_first_that_what_was_held_out_repeats_what_was_trained_on():
    told = learn("arx", [periodic(0.01)], ["u"], ["y"]).provenance["free_run"]
    assert told["repeats"] and told["bad"] and told["says"].startswith("What was held out repeats commands ")
    assert set(told["cannot_tell"]) | set(told["no_better_than"]) == set(told["outputs"]["y"]["yardsticks"])


def test_of_commands_that_repeat_the_first_course_is_left():
    one, other = periodic(0.01), periodic(1.0)
    (first,) = without_repeats([one], ["u"], ["y"])
    assert len(first) == 200 and np.array_equal(first["u"], one["u"][:200])
    assert without_repeats([other], ["u"], ["y"]) == [other]
    smooth = one.with_signals({"u": np.sin(one.time)})  # three periods and more, of 314 samples
    assert [len(r) for r in without_repeats([smooth], ["u"], ["y"])] == [314]
    twice = [one, replace(one, name="copy")]
    assert [r.name for r in without_repeats(twice, ["u"], ["y"])] == [one.name]


def test_kinds_are_also_ranked_on_the_first_course_where_commands_repeat():
    records, names = [periodic(0.01)], (["u"], ["y"])
    block = learn_best(records, *names, kinds=("arx", "piecewise"), workers=1, thorough=True)
    told = block.provenance["free_run"]
    assert told["repeats"] and "also trained on the first 3.98 s of 20 s alone" in told["says"]
    for row in block.provenance["ranking"]:
        cards = [learn(row["kind"], part, *names).provenance["free_run"]["outputs"]["y"]
                 for part in (records, without_repeats(records, *names))]  # fmt: skip
        assert row["percent_of_range"]["y"] == pytest.approx(
            np.sqrt(np.mean([c["percent_of_range"] ** 2 for c in cards]))
        )
        assert len(row["stretches"]["y"]) == 6
    other = learn_best([periodic(1.0)], *names, kinds=("arx",), workers=1)
    assert "The commands repeat" not in other.provenance["free_run"]["says"]


def test_a_kind_that_the_first_course_rules_out_is_not_trained_on_all_and_says_so():
    records, names = [periodic(0.01)], (["u"], ["y"])
    block, other = (learn_best(records, *names, kinds=("piecewise", "arx"), workers=n) for n in (1, 2))
    plain = [
        [{k: v for k, v in row.items() if k != "seconds"} for row in b.provenance["ranking"]] for b in (block, other)
    ]
    assert plain[0] == plain[1], "two processes choose as one does"
    last = block.provenance["ranking"][-1]
    assert last["kind"] == "piecewise" and not (last["chosen"] or last["as_good"]) and "numbers" not in last
    card = learn("piecewise", without_repeats(records, *names), *names).provenance["free_run"]["outputs"]["y"]
    assert last["percent_of_range"]["y"] == pytest.approx(card["percent_of_range"]), "that of the first course"
    assert "could not be as good as arx" in last["dropped"] and "--thorough" in last["dropped"]
    says = "Not trained on all, for after the first course nothing could make them as good: piecewise"
    assert says in block.provenance["free_run"]["says"]


def test_the_bound_of_what_may_be_as_good_holds_whatever_the_other_stretches_are():
    rng = np.random.default_rng(0)
    for _ in range(500):
        best, errors = rng.uniform(0.2, 2.0, (2, 6))
        if as_good(errors, best):
            assert all(may_be_as_good(errors[:k], best) for k in range(7))
    assert not may_be_as_good([9.0], [1.0, 1.1, 0.9])


def test_a_kind_that_the_first_course_is_too_short_for_is_not_chosen_and_says_so():
    rng = np.random.default_rng(2)
    u = np.tile(rng.uniform(-1, 1, 64), 16)[:1000] + 0.01 * rng.normal(size=1000)
    y = np.cumsum(u - u.mean()) * 0.01
    records = [Record(0.02 * np.arange(1000), {"u": u, "y": y}, {"u": "V", "y": "m"}, "short periods")]
    rows = learn_best(records, ["u"], ["y"], kinds=("arx", "symbolic"), workers=1).provenance["ranking"]
    assert [row["chosen"] for row in rows] == [True, False] and rows[0]["kind"] == "arx"
    assert "percent_of_range" in rows[0] and "percent_of_range" not in rows[1]
    assert "On the first course of the commands alone, it cannot be judged" in rows[1]["failed"]
