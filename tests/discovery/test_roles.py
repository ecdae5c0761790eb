"""Recordings change roles where those that choose show nothing of the gap; what nothing can confirm gets no name."""

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery import answering
from hydrotwin.discovery.answering import Found, Step
from hydrotwin.discovery.choose import Choice
from hydrotwin.discovery.roles import exchanged, fairly_split
from hydrotwin.discovery.structure import Structure
from hydrotwin.discovery.verdict import unconfirmed
from hydrotwin.models.effects.mechanism import FAR, EndStop
from tests.discovery.slides import NOISE, found, question, record, records, searching

LIMITED = ("command_saturation", "coulomb_friction", "null_bias")
QUIET = {"highest": 90.0}  # N, far below the limit


def limited(seed, **more):
    """A recording whose force is cut off at 280 N, short of its peaks."""
    return record(seed, limit=280.0, **more)


def leaving(*times):
    """A fit of recordings 0 and 2 of three, and the choice by recording 1, that leave so many times the noise."""
    asked = question(records(3))
    _, fitted = searching(asked, ("null_bias",))
    first, chosen, second = (np.full((600, 1), NOISE * t) for t in times)
    return asked, dataclasses.replace(fitted, residuals_fit=(first, second), residuals_select=(chosen,))


@pytest.mark.parametrize("times", [(5.0, 4.0, 3.0), (5.0, 1.0, 1.0), (1.0, 5.0, 1.0), (1.05, 1.0, 1.05)])
def test_roles_stay_where_both_show_the_gap_or_a_single_recording_does(times):
    assert exchanged(*leaving(*times)) is None


def test_the_recording_that_shows_the_gap_second_best_takes_the_place_of_one_that_does_not():
    asked, fitted = leaving(5.0, 1.0, 4.0)
    changed = exchanged(asked, fitted)
    assert [r.name for r in changed.fit] == ["run_0", "run_1"] and [r.name for r in changed.select] == ["run_2"]


def test_what_only_those_show_that_choose_is_fitted_to():
    asked, fitted = leaving(1.0, 5.0, 1.0)
    (chosen,), (quiet, still) = asked.select, asked.fit
    asked = dataclasses.replace(asked, select=(chosen, chosen))
    four = dataclasses.replace(fitted, residuals_select=fitted.residuals_select * 2)
    changed = exchanged(asked, four)
    assert changed.fit == (chosen, still) and changed.select == (quiet, chosen)


def test_without_recordings_to_choose_by_nothing_changes():
    asked, fitted = leaving(5.0, 1.0, 4.0)
    nothing = dataclasses.replace(asked, select=())
    assert exchanged(nothing, dataclasses.replace(fitted, residuals_select=())) is None


def test_an_effect_that_two_of_three_recordings_show_is_named_whichever_role_they_had():
    answer = found([limited(0), record(1, **QUIET), limited(2)], LIMITED, validate=[limited(3)])
    assert [s.effect for s in answer.steps] == ["command_saturation"]
    roles = {r.record: r.role for r in answer.recordings}
    assert roles == {"run_0": "fit", "run_1": "fit", "run_2": "select", "run_3": "report"}


def test_the_base_is_fitted_anew_to_its_new_recordings_and_stays_where_that_fails():
    asked = question([limited(0), record(1, **QUIET), limited(2)])
    search, fitted = searching(asked, LIMITED)
    diverging = dataclasses.replace(search, run=lambda function, jobs, stage: ["it diverges"])
    now = Structure((), fitted)
    assert fairly_split(diverging, now) is now and diverging.question is asked
    base = fairly_split(search, now)
    assert [r.name for r in search.question.fit] == ["run_0", "run_1"]
    assert base.fitted.rmse < fitted.rmse, "one of those that it cannot follow has left"


def test_an_effect_that_the_recordings_to_choose_by_do_not_confirm_gets_no_name_and_the_answer_says_so():
    search, fitted = searching(question([limited(0), limited(1), record(2, **QUIET)]), LIMITED)
    base = Structure((), fitted)
    by = {s.candidate.id: s for s in search.screened(base)[1]}
    (limit,) = search.singles(base, [by["command_saturation"]])
    unsure = dataclasses.replace(limit, evidence=dataclasses.replace(limit.evidence, paired_t=0.3))
    told = unconfirmed(search, Found(base, base, (), ((None, (), [unsure]),)))
    assert "saturation of the command at force would explain 100 % of it where the model was fitted (run_0" in told
    assert "Record more runs" in told
    assert not unconfirmed(search, Found(base, base, (), ((None, (), [limit]),))), "another reason kept it from a name"
    poor = dataclasses.replace(unsure, structure=base)
    assert not unconfirmed(search, Found(base, base, (), ((None, (), [poor]),))), "it explains nothing"
    assert not unconfirmed(search, Found(base, base, (), ()))
    taken_back = Step(Choice(limit, (limit,), {}), (), (limit,), base)
    assert unconfirmed(search, Found(base, limit.structure, (taken_back,), ())) == told, "named on the way"
    assert not unconfirmed(search, Found(base, base, (taken_back,), ()))
    kept = Found(base, base, (taken_back,), ((None, (), []), (None, (), [unsure])))
    assert unconfirmed(search, kept) == told, "looked at later, and more than what was found"


def test_the_answer_to_a_gap_without_a_name_is_what_would_explain_it(monkeypatch):
    monkeypatch.setattr(answering, "unconfirmed", lambda search, found: "a stop would, but nothing confirms it")
    told = found(records(3, pulse=150.0), ["null_bias"], validate=[record(9, pulse=150.0)])
    assert told.verdict == "unknown" and told.answer == "a stop would, but nothing confirms it"
    assert found(records(3), ["null_bias"], validate=[record(9)]).answer.startswith("No effect is missing")


def test_a_name_that_is_taken_back_stands_in_the_answer_nonetheless(monkeypatch):
    monkeypatch.setattr(answering, "verdict_of", lambda search, found: "unknown")
    told = found(records(3, dry=30.0), ["coulomb_friction"], validate=[record(9, dry=30.0)])
    assert told.verdict == "unknown" and not told.steps
    assert "Coulomb friction at mass.flange would explain 100 % of it" in told.answer


@pytest.mark.parametrize("reached", [5e-4, 5e-3, 0.05])
def test_a_stop_is_looked_for_as_deep_as_it_is_reached_be_it_barely(reached):
    way = np.sin(np.linspace(0.0, 20.0, 5000))  # from -1 to 1
    probes = EndStop.probes_for({"flange.s": way})
    high, low = [1 - p["high"] for p in probes if p["high"] < FAR], [1 + p["low"] for p in probes if p["low"] > -FAR]
    for depths in (high, low):
        assert any(reached < d < 4 * reached for d in depths), "of a range of 2"
    assert any(p["high"] < FAR and p["low"] > -FAR for p in probes), "or both ends"
