"""Confirm: of several effects, each must hold on the recordings that judge."""

from __future__ import annotations

import pytest

from hydrotwin.discovery.answering import Found, Step
from hydrotwin.discovery.choose import Choice, label
from hydrotwin.discovery.confirm import confirmed
from hydrotwin.discovery.recordings import split
from hydrotwin.discovery.structure import Structure
from hydrotwin.discovery.verdict import AGAINST
from tests.discovery.slides import NOISE, PERIOD, found, one, question, records, searching, slide

EFFECTS = ("coulomb_friction", "dead_time")
DRY, LATE = 50.0, 1  # N, samples


def told(judged):
    """The answer from recordings that show dry friction and a dead time."""
    return found(records(3, dry=DRY, late=LATE), EFFECTS, validate=judged, noise={"speed": NOISE})


def values(answer):
    return {s.effect: s.parameters[0].value for s in answer.steps}


def test_what_the_recordings_that_judge_are_explained_better_without_is_taken_back():
    """What was fitted to shows a dead time, what judges none: as when an effect stands for the error of a law."""
    answer = told(records(2, first=7, dry=DRY))
    assert answer.verdict == "named"
    assert values(answer) == pytest.approx({"coulomb_friction": DRY}, rel=0.1)
    assert "dead_time" not in {p.name.split(".")[0] for p in answer.model.flat.parameters}
    (row,) = [r for r in answer.last_ranked if r.effect == "dead_time"]
    assert (row.fate, row.reason) == ("rejected", AGAINST)
    (note,) = [f for f in answer.findings if AGAINST in f]
    assert note.startswith("gap: dead_time at force would explain a part")


def test_what_they_confirm_stays():
    answer = told(records(2, first=7, dry=DRY, late=LATE))
    assert values(answer) == pytest.approx({"coulomb_friction": DRY, "dead_time": LATE * PERIOD}, rel=0.05)
    assert not [f for f in answer.findings if AGAINST in f]


def test_without_such_recordings_nothing_speaks_against_it():
    assert set(values(told(()))) == set(EFFECTS)


@pytest.mark.parametrize(("late", "left"), [(0, {"coulomb_friction"}), (LATE, set(EFFECTS))])
def test_of_a_pair_named_at_once_one_may_be_taken_back(late, left):
    runs = records(3, dry=DRY, late=LATE)
    search, base = searching(question(runs), EFFECTS)
    now, (dry, delay) = Structure((), base), (one(search, name) for name in EFFECTS)
    start = {"coulomb_friction.force": DRY, "dead_time.time": LATE * PERIOD}
    pair, *alone = search.refitted(now, [(group, [start]) for group in ((dry, delay), (dry,), (delay,))])
    step = Step(Choice(pair, (pair,), {label(pair): 1.0}), (), (pair, *alone), now)
    data = split(slide().flat, runs, records(2, first=7, dry=DRY, late=late), noise={"speed": NOISE})
    answer = confirmed(search, data, Found(now, pair.structure, (step,), ()))
    assert {c.id for c in answer.last.members} == left
    assert {c.id for s in answer.steps for c in s.choice.best.members} == left


def test_what_would_come_back_alone_stays_with_the_other(monkeypatch):
    """Of a pair all that was tried is compared again; where the one taken back wins that, nothing is gained."""
    monkeypatch.setattr("hydrotwin.discovery.confirm.reduced", lambda search, found, last: found)
    assert set(values(told(records(2, first=7, dry=DRY)))) == set(EFFECTS)
