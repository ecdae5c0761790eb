"""Confirm: of several effects, each must hold on recordings that were left out of the fit."""

from __future__ import annotations

import dataclasses
from functools import cache

import pytest

from hydrotwin.discovery.answering import Found, Step
from hydrotwin.discovery.choose import Choice, label
from hydrotwin.discovery.confirm import confirmed, folds
from hydrotwin.discovery.decide import Evidence
from hydrotwin.discovery.ranking import ranking
from hydrotwin.discovery.structure import Structure
from hydrotwin.discovery.verdict import AGAINST, findings_of
from tests.discovery.slides import one, question, record, searching

EFFECTS = ("coulomb_friction", "null_bias")
DRY = 50.0  # N
EVEN, TURNING = (6.0, 6.0, 6.0), (6.0, -12.0, 6.0)  # N, from the middle of each recording on


@cache
def pushed(forces):
    """A search in recordings with dry friction and a push that no effect describes, and a bias found in its place."""
    search, base = searching(question([record(k, dry=DRY, leaning=f) for k, f in enumerate(forces)]), EFFECTS)
    now, (dry, bias) = Structure((), base), (one(search, name) for name in EFFECTS)
    start = {"coulomb_friction.force": DRY, bias.free[0]: 3.0}
    pair, *alone = search.refitted(now, [(group, [start]) for group in ((dry, bias), (dry,), (bias,))])
    step = Step(Choice(pair, (pair,), {label(pair): 1.0}), (), (pair, *alone), now)
    return search, Found(now, pair.structure, (step,), ())


def left(found):
    return {c.id for c in found.last.members}


@pytest.mark.parametrize(("forces", "stays"), [(TURNING, {"coulomb_friction"}), (EVEN, set(EFFECTS))])
def test_an_effect_that_each_recording_speaks_against_when_it_is_left_out_is_taken_back(forces, stays):
    """Pushes of +6, -12 and +6 N: what two of them ask for makes the third worse."""
    search, found = pushed(forces)
    answer = confirmed(search, found)
    assert left(answer) == stays
    assert {c.id for s in answer.steps for c in s.choice.best.members} == stays


def test_what_was_taken_back_is_in_the_table_and_among_the_findings():
    search, found = pushed(TURNING)
    answer = confirmed(search, found)
    known = {p.name: p for p in search.big.parameters}
    rows = ranking((), answer.screens[-1][2], None, known)
    assert {(r.fate, r.reason) for r in rows if r.effect == "null_bias"} == {("rejected", AGAINST)}
    (note,) = [f for f in findings_of(search, answer, "named", 1.0, False) if AGAINST in f]
    assert note.startswith("gap: null_bias at force would explain a part")


def test_every_recording_to_learn_from_is_left_out_once():
    asked = question([record(k) for k in range(5)])
    parts = folds(asked)
    assert sorted(r.name for q in parts for r in q.select) == [f"run_{k}" for k in range(5)]
    for q in parts:
        assert sorted(r.name for r in (*q.fit, *q.select)) == [f"run_{k}" for k in range(5)]


def test_with_two_recordings_or_where_all_are_fitted_to_nothing_is_asked():
    assert not folds(question([record(0), record(1)]))
    asked = question([record(k) for k in range(3)])
    learned = (*asked.fit, *asked.select)
    assert not folds(dataclasses.replace(asked, fit=learned, select=learned))


def test_a_fit_that_diverges_speaks_against_nothing(monkeypatch):
    search, found = pushed(TURNING)
    work = search.run
    monkeypatch.setattr(search, "run", lambda function, jobs, stage: ["it diverges", *work(function, jobs, stage)[1:]])
    assert confirmed(search, found) is found


def test_what_would_come_back_alone_stays_with_the_other(monkeypatch):
    """Of a pair all that was tried is compared again; where the one taken back wins that, nothing is gained."""
    monkeypatch.setattr("hydrotwin.discovery.confirm.reduced", lambda search, found, last: found)
    search, found = pushed(TURNING)
    assert confirmed(search, found) is found


def test_little_evidence_against_it_takes_nothing_back(monkeypatch):
    search, found = pushed(TURNING)
    for against in (Evidence(0.0, 1.9, 0.9), Evidence(0.0, 9.0, 0.04)):
        monkeypatch.setattr("hydrotwin.discovery.confirm.compared", lambda *_, against=against: against)
        assert confirmed(search, found) is found
