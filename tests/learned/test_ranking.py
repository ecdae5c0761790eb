"""Every kind on the same recordings, ranked by its free run on what was held out."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from hydrotwin.learned import learn, learn_piecewise, ranking, refit, refitted, trials
from hydrotwin.learned.learning import takes
from hydrotwin.learned.ranking import Tried, learn_best
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.simulation import simulate
from tests.learned.toy_machine import toy_record

INPUTS, OUTPUTS = ["command"], ["arm_angle"]


@pytest.fixture(scope="module")
def records():
    return [toy_record(1, 10.0), toy_record(2, 10.0)]


@pytest.fixture(scope="module")
def best(records):
    told = []
    block = learn_best(
        records, INPUTS, OUTPUTS, kinds=("piecewise", "grey_box"), progress=lambda *words: told.append(words)
    )
    return block, told


def test_the_best_is_what_its_kind_alone_would_have_learnt(best, records):
    block, _ = best
    rows = block.provenance["ranking"]
    assert {row["kind"] for row in rows} == {"piecewise", "grey_box"}
    shares = [row["percent_of_range"]["arm_angle"] for row in rows]
    assert shares == sorted(shares) and shares[0] < shares[1]
    assert [row["kind"] for row in rows if row["chosen"]] == [rows[0]["kind"]]
    assert all(row["numbers"] > 0 and len(row["stretches"]["arm_angle"]) >= 3 for row in rows)
    alone = learn(rows[0]["kind"], records, INPUTS, OUTPUTS)
    assert all(np.array_equal(block.arrays[name], alone.arrays[name]) for name in alone.arrays)
    assert block.provenance["free_run"]["outputs"]["arm_angle"]["percent_of_range"] == pytest.approx(shares[0])
    assert all(row["seconds"] > 0 for row in rows)


def test_progress_tells_what_ended_and_what_is_best(best):
    _, told = best
    assert [words[:2] for words in told] == [(1, 2), (2, 2)]
    assert "best so far" in told[-1][2]


@pytest.mark.parametrize(("small", "chosen"), [([0.1, 0.09, 0.098], "piecewise"), ([0.3, 0.3, 0.3], "grey_box")])
def test_of_kinds_that_are_as_good_the_one_with_the_fewest_numbers_is_taken(best, records, monkeypatch, small, chosen):
    block, _ = best
    rich = replace(block, arrays=dict(block.arrays) | {"more": np.ones(1000)})

    def tried(kind, one, stretches):
        share = float(np.sqrt(np.mean(np.square(stretches))))
        return Tried(kind, one, {"arm_angle": share}, 1.0, "", {"arm_angle": stretches})

    both = [tried("grey_box", rich, [0.1, 0.08, 0.1]), tried("piecewise", block, small)]
    monkeypatch.setattr(ranking, "_raced", lambda *_: (both, False))
    rows = learn_best(records, INPUTS, OUTPUTS, kinds=("grey_box", "piecewise")).provenance["ranking"]
    assert [row["kind"] for row in rows] == ["grey_box", "piecewise"], "the best first"
    assert [row["kind"] for row in rows if row["chosen"]] == [chosen]
    assert [row["as_good"] for row in rows] == [True, chosen == "piecewise"]


def test_a_block_may_be_trained_again_on_all_and_keeps_the_card_of_what_had_not_seen_all(records):
    block = learn("piecewise", records, INPUTS, OUTPUTS)
    again = refitted(block, "piecewise", records, INPUTS, OUTPUTS)
    whole = learn_piecewise(records, INPUTS, OUTPUTS)
    assert all(np.array_equal(again.arrays[name], whole.arrays[name]) for name in whole.arrays)
    before, after = block.provenance["free_run"], again.provenance["free_run"]
    assert after["outputs"] == before["outputs"] and after["refitted"]
    assert after["says"].startswith(before["says"]) and "trained again on all recordings" in after["says"]


FORM = {"period": 0.1, "output_lags": 1, "input_lags": 4, "delay": 2, "integrates": True, "places": True, "hidden": 3}
FORM |= {"substeps": 2}
PROCESS = {"period": 0.2, "kernel": "linear+rbf", "level": 1, "increments": 1, "samples": 3}


@pytest.mark.parametrize(
    ("kind", "told", "form"),
    [
        (
            "nn",
            {"kind": "network", "form": FORM},
            {"period": 0.1, "lags": (1, 4), "delay": 2, "integrates": True, "hidden": 3, "substeps": 2},
        ),
        (
            "gp",
            {"kind": "gaussian_feedback", **PROCESS},
            {"period": 0.2, "lags": (1, 1, 3), "kernel": "linear+rbf"},
        ),
        ("piecewise", {"kind": "piecewise"}, {}),
    ],
)
def test_trained_again_a_block_keeps_the_form_that_was_judged(records, monkeypatch, kind, told, form):
    block, asked = learn_piecewise(records, INPUTS, OUTPUTS), {}

    def train(*given, **options):
        asked.update(options)
        return block

    monkeypatch.setattr(refit, "trainer", lambda *_: train)
    judged = replace(block, provenance=told)
    refitted(judged, kind, records, INPUTS, OUTPUTS, seed=3)
    assert asked == form | {"seed": 3} and all(takes(kind, option) for option in form)


def test_equations_keep_what_they_have_in_common(records):
    block = learn("arx", records, INPUTS, OUTPUTS)
    form = refit.form_of(block)
    assert set(form) == {"period", "rate", "lags", "delay"} and all(takes("arx", option) for option in form)
    told = block.provenance["arx"]["arm_angle"]
    assert form["lags"] == (told["past"], told["inputs"]["command"]["samples"])
    again = refitted(block, "arx", records, INPUTS, OUTPUTS)
    assert again.structure == block.structure and again.period == block.period
    other = {**told, "rate": not told["rate"], "past": told["past"] + 1}
    two = replace(block, provenance={**block.provenance, "arx": {"arm_angle": told, "speed": other}})
    assert set(refit.form_of(two)) == {"period", "delay"}


def test_the_longest_trainings_begin_first_behind_one_that_answers_at_once():
    kinds = ["arx", "linear", "nn", "gp", "piecewise", "state_nn"]
    waiting = sorted((trials.Trial(kind, "all") for kind in kinds), key=trials._longest_first)
    assert [trial.kind for trial in waiting] == ["arx", "gp", "nn", "state_nn", "linear", "piecewise"]


def test_a_kind_that_fails_costs_only_itself(records):
    block = learn_best(records, ["command", "motor_speed"], OUTPUTS, kinds=("piecewise", "arx"))
    last = block.provenance["ranking"][-1]
    assert block.provenance["ranking"][0]["kind"] == "arx" and last["kind"] == "piecewise"
    assert "piecewise" in last["failed"] and "percent_of_range" not in last


def test_nothing_that_can_be_learnt_is_said_with_every_reason(records):
    short = [records[0].window(0.0, 0.1)]
    with pytest.raises(DataError, match=r"no kind could be trained. all: .*too few"):
        learn_best(short, INPUTS, OUTPUTS, kinds=("piecewise",))


def test_a_reason_that_kinds_share_is_said_once():
    tried = [Tried("arx", failed="learn: too few."), Tried("nn", failed="no."), Tried("narx", failed="learn: too few.")]
    assert ranking._reasons(tried) == "arx, narx: too few. nn: no."
    assert ranking._reasons(tried[::2]) == "all: too few."


def test_a_process_that_broke_is_told(tmp_path):
    assert "without an answer" in trials.answer(trials.Trial("nn", "all"), tmp_path).failed
    assert Tried("nn").share == float("inf")


def test_kinds_that_cannot_be_tried_are_refused(records):
    for kind in ("hybrid", "nm"):
        with pytest.raises(DeclarationError, match="to try"):
            learn_best(records, INPUTS, OUTPUTS, kinds=(kind,))


def test_what_runs_worse_over_what_it_has_seen_is_not_kept(best, records):
    """The judged block is said to have missed by a tenth of what the kind reaches."""
    block, _ = best
    card = block.provenance["free_run"]
    good = {name: row | {"rmse": 0.1 * row["rmse"]} for name, row in card["outputs"].items()}
    judged = replace(block, provenance=block.provenance | {"free_run": card | {"outputs": good}})
    again = refitted(judged, "piecewise", records, INPUTS, OUTPUTS)
    assert again.arrays is judged.arrays and again.provenance["ranking"] == judged.provenance["ranking"]
    assert again.provenance["free_run"]["says"].endswith(refit.KEPT)
    assert again.provenance["free_run"]["refitted"] is False


def test_a_training_on_all_recordings_that_a_budget_cut_says_so_first(records, monkeypatch):
    """The card is that of the training before, which nothing had cut."""
    block, cut = learn("piecewise", records, INPUTS, OUTPUTS), "time budget of 5 s"

    def training(*given, **options):
        found = learn_piecewise(*given, **options)
        return replace(found, provenance={**found.provenance, "stopped": cut})

    monkeypatch.setattr(refit, "trainer", lambda *_: training)
    card = refitted(block, "piecewise", records, INPUTS, OUTPUTS).provenance["free_run"]
    assert card["refitted"] and card["bad"] and card["says"].startswith(refit.CUT.format(why=cut))


def test_a_budget_is_that_of_all_trials_together_and_says_what_it_cut(records, monkeypatch):
    """The machine may be busy: what is held is the clock, not what is reached within it."""
    slow = [toy_record(k, 40.0) for k in range(5)]
    began = time.monotonic()
    block = learn_best(slow, INPUTS, OUTPUTS, kinds=("gp", "arx"), budget=8.0, workers=1)
    assert time.monotonic() - began < 8.0 + trials.GRACE
    rows = {row["kind"]: row for row in block.provenance["ranking"]}
    assert rows["arx"]["chosen"] and "the budget was over" in rows["gp"]["failed"]


def test_what_no_time_is_left_for_is_not_tried_and_says_so_and_there_is_an_answer(records):
    block = learn_best(records, INPUTS, OUTPUTS, kinds=("gp", "arx"), budget=0.02, workers=1)
    rows = {row["kind"]: row for row in block.provenance["ranking"]}
    assert rows["arx"]["chosen"] and rows["gp"]["failed"] == trials.NOT_TRIED and rows["gp"]["cut"]
    card = block.provenance["free_run"]
    assert card["bad"] and card["says"].startswith(ranking.CUT.format(kinds="gp"))


def test_kinds_that_the_budget_cut_or_that_failed_are_on_the_card(records, monkeypatch):
    """One was ended with its best so far, one could not be trained, one was trained to its end."""
    block = learn("piecewise", records, INPUTS, OUTPUTS)
    cut = replace(block, provenance={**block.provenance, "stopped": "time budget of 5 s"})

    def tried(kind, one, share):
        return Tried(kind, one, {"arm_angle": share}, 1.0, "", {"arm_angle": [share] * 3})

    found = [tried("piecewise", block, 0.1), tried("nn", cut, 0.5), Tried("gp", failed="GPyTorch is not installed.")]
    for some, first in ((found, ranking.CUT.format(kinds="nn")), ([found[0], found[2]], "")):
        monkeypatch.setattr(ranking, "_raced", lambda *_, some=some: (some, False))
        answer = learn_best(records, INPUTS, OUTPUTS, kinds=("piecewise", "nn", "gp"))
        card = answer.provenance["free_run"]
        assert card["says"].startswith(first) and "budget" not in card["says"].removeprefix(first)
        assert card["says"].endswith("Not ranked: gp: GPyTorch is not installed.")
        assert [row.get("cut", False) for row in answer.provenance["ranking"]] == [row is found[1] for row in some]


def test_time_is_shared_among_those_that_wait_and_all_of_it_is_left_to_the_last():
    clock = trials.Clock(90.0, 2)
    begin, end = clock.share(9)
    assert end - begin == pytest.approx(20.0, abs=0.1)
    assert clock.share(1)[1] == pytest.approx(clock.end, abs=0.1) == clock.share(2)[1]
    past = (begin - 30.0, begin - 1.0)
    assert clock.late("gp", past, others=True) and not clock.late("gp", past, others=False)
    assert not clock.late("nn", past, others=True), "it looks at the clock itself, and is left to write its card"
    over = trials.Clock(-trials.GRACE - 1.0, 2)
    assert over.late("nn", past, others=False) and not over.late("arx", past, others=False)
    assert trials.Clock(None, 2).share(9) is None and not trials.Clock(None, 2).late("gp", None, True)


def test_a_formula_that_is_trained_again_keeps_its_form_and_takes_constants_of_all_recordings(records):
    block = learn("narx", records, INPUTS, OUTPUTS, period=0.1)
    again = refitted(block, "narx", records, INPUTS, OUTPUTS)
    assert again.provenance["free_run"]["refitted"]
    assert np.array_equal(again.arrays["tokens"], block.arrays["tokens"])
    assert not np.array_equal(again.arrays["constants"], block.arrays["constants"])
    assert again.structure == block.structure and again.period == block.period
    error = {}
    for one in (block, again):
        runs = [simulate(one, r)["arm_angle"] - r["arm_angle"] for r in records]
        error[one] = np.sqrt(np.mean(np.concatenate(runs) ** 2))
    assert error[again] < error[block], "over what it has now seen"
    factors = [t["factor"] for t in again.provenance["narx"]["arm_angle"]["terms"]]
    assert all(np.isclose(again.arrays["constants"], f).any() for f in factors)
    assert again.certificate.difference < 1e-9


def test_a_race_drops_only_what_could_not_be_chosen_and_whole_trainings_choose_alike():
    """Outcomes drawn at random: the race ends with the kinds that are as good as the best, and their figures."""
    rng, spared = np.random.default_rng(0), 0
    for _ in range(200):
        kinds = ["arx", "nn", "gp", "linear", "narx", "state_nn"]
        outcomes = {}
        for kind in kinds:
            for on in ("first", "all"):
                parts = rng.lognormal(rng.choice([-1.0, 0.0, 2.0]), 0.5, 3)
                share = float(np.sqrt(np.mean(parts**2)))
                outcomes[trials.Trial(kind, on)] = trials.Outcome(None, {"y": share}, {"y": parts.tolist()})
        found = {}
        for thorough in (True, False):
            race = ranking._Race(kinds, ["first", "all"], thorough)
            for some, _ in race.rounds():
                race.outcomes |= {trial: outcomes[trial] for trial in some}
            ended = race.ended()
            assert len(ended) == len(kinds)
            best = min((t for t in ended if not t.dropped), key=lambda t: t.share)
            found[thorough] = {t.kind: t.errors for t in ended if not t.dropped and t.as_good_as(best)}
        assert found[True] == found[False]
        spared += sum(bool(t.dropped) for t in ended)
    assert spared > 200


def test_where_no_kind_can_be_judged_on_the_first_course_all_go_on():
    race = ranking._Race(["nn", "gp"], ["first", "all"], False)
    rounds = race.rounds()
    for trial in next(rounds)[0]:
        race.outcomes[trial] = trials.Outcome(failed="too short")
    assert next(rounds)[0] == [trials.Trial("nn", "all"), trials.Trial("gp", "all")]
