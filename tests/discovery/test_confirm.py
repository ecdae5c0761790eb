"""Confirm: of several effects, each must hold on the recordings that judge."""

from __future__ import annotations

import pytest

from hydrotwin.discovery.verdict import AGAINST
from tests.discovery.slides import NOISE, PERIOD, found, records

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
