"""A gap report says how sure it is, against what, and what a longer search would try."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from hydrotwin.discovery.answer.going_on import untried_sentences
from hydrotwin.report import gap_page
from hydrotwin.report.gap_figures import AFTER, AS_WELL, BEFORE, FAINT
from hydrotwin.report.gap_sure import sure_figure, sure_sentences, sure_table
from tests.report.gap_discoveries import (
    ALL,
    DATE,
    first_screen,
    named,
    none,
    one_of_a_class,
    two_effects,
    unknown,
    written,
)

ELSE = "that something else is missing which the catalogue does not hold."


def section(found):
    return next((s for s in gap_page(found, command="", date=DATE).sections if s.id == "sure"), None)


def test_the_sentence_tells_the_most_likely_first_and_something_else_last():
    (told,) = sure_sentences(named())
    assert told.startswith(
        "95\u00a0% for Coulomb friction at cylinder.rod; 2\u00a0% for deadband at command with Coulomb"
    )
    assert "1\u00a0% for others, each less likely" in told
    assert told.endswith(f"2\u00a0% {ELSE}")


def test_nothing_several_effects_and_a_class_are_told_by_their_titles():
    assert sure_sentences(none())[0].startswith(
        "93\u00a0% that nothing is missing; 2\u00a0% for dead time at command; "
    )
    both = "71\u00a0% for Coulomb friction at cylinder.rod with internal leakage at cylinder.cap-cylinder.annulus; "
    assert sure_sentences(two_effects())[0].startswith(both)
    assert "; 36\u00a0% for slip of the pump at pump; " in sure_sentences(one_of_a_class())[0]
    assert sure_sentences(unknown())[0].endswith(f"; 97\u00a0% {ELSE}")


def test_nothing_that_is_inferred_is_certain():
    sure = replace(
        named(), probabilities={"nothing": 0.0, "coulomb_friction at cylinder.rod": 1.0, "something else": 0.0}
    )
    assert sure_sentences(sure) == (f"over 99.9\u00a0% for Coulomb friction at cylinder.rod; under 1\u00a0% {ELSE}",)


def test_a_name_that_recordings_never_used_do_not_bear_out_says_so():
    refuted = replace(unknown(), probabilities=named().probabilities)
    assert sure_sentences(refuted)[1].endswith("Those never used do not bear it out.")
    assert len(sure_sentences(unknown())) == 1


@pytest.mark.parametrize("case", ALL)
def test_the_bars_and_the_table_hold_all_there_is(case):
    found = ALL[case]()
    table, (bars,) = sure_table(found), sure_figure(found).spec["data"]
    odds = [row[1].value for row in table.rows]
    assert sum(odds) == pytest.approx(1.0)
    assert bars["x"][::-1] == pytest.approx([100.0 * p for p in odds])
    assert table.rows[-1][0].text == "Something that the catalogue does not hold"


def test_what_was_named_is_dark_its_class_light_and_the_rest_grey():
    def colours(found):
        return {row[0].text: row[0].colour for row in sure_table(found).rows}

    of_class = colours(one_of_a_class())
    assert of_class["Internal leakage at cylinder.cap-cylinder.annulus"] == AFTER
    assert of_class["Slip of the pump at pump"] == AS_WELL
    assert (of_class["Nothing"], of_class["Something that the catalogue does not hold"]) == (FAINT, BEFORE)
    assert colours(none())["Nothing"] == AFTER
    assert colours(two_effects())["Coulomb friction at cylinder.rod"] == FAINT


def test_a_search_that_its_limit_ended_says_what_a_longer_one_would_try(tmp_path):
    pair = "coulomb_friction at cylinder.rod + internal_leakage at cylinder.cap-cylinder.annulus"
    cut = replace(named(), untried=("command_deadband at command", pair, "new_effect at pump"))
    (told,) = untried_sentences(cut)
    assert told == (
        "The search ended at its time limit. A longer one would try next: deadband at command, Coulomb friction at "
        "cylinder.rod with internal leakage at cylinder.cap-cylinder.annulus and new_effect at pump."
    )
    assert told in first_screen(cut) and told in section(cut).parts[0].paragraphs
    assert "time limit" not in first_screen(named())
    data = json.loads(written(cut, tmp_path)["json"].read_text(encoding="utf-8"))
    assert data["untried"] == list(cut.untried)
    assert data["probabilities"] == cut.probabilities


def test_without_probabilities_there_is_no_section():
    assert section(replace(named(), probabilities={})) is None


def test_effects_that_the_search_had_no_time_to_look_at_are_told():
    odds = {"nothing": 0.0, "coulomb_friction at cylinder.rod": 0.7, "not looked at": 0.28, "something else": 0.02}
    told = replace(named(), probabilities=odds)
    assert "28\u00a0% that it is an effect which the search had no time to look at" in sure_sentences(told)[0]
    assert "An effect that was not looked at" in [cell.text for cell in sure_table(told).columns[0].cells]
