"""The gap workflow doubts what it assumes about recordings before it names, or misses, an effect."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pytest

from hydrotwin.discovery import assumed
from hydrotwin.discovery.decide import has_gap
from hydrotwin.discovery.discover import discover
from hydrotwin.identification.assumptions import PATIENCE, Change
from hydrotwin.report.gap_data import gap_data
from tests.identification.sliding import FREE, MASS, held, moved, slide, steps, wave

from .slides import Inline

SOME = ("coulomb_friction", "dead_time")


def found(runs, model, **more):
    return discover(model, runs, free=FREE, executor=Inline(), **{"effects": SOME, **more})


def test_a_held_input_that_was_linear_is_the_answer_and_no_effect_is_missing():
    answer = found([moved(s, wave(s)) for s in range(3)], slide("hold"))
    assert answer.verdict == "none" and not answer.steps
    assert "linear between its samples and not held as assumed" in answer.answer
    data = json.loads(json.dumps(gap_data(answer)))
    assert (data["inputs"]["force"]["interpolation"], data["inputs"]["force"]["chosen_by"]) == ("linear", "fit")
    assert len(data["assumptions"]) == 1
    assert answer.fit_after.values["load.mass"] == pytest.approx(MASS, rel=2e-3)


def test_a_start_in_motion_is_the_answer_and_no_effect_is_missing():
    runs = [moved(s, held(steps(s)), start=(0.0, 0.1 + 0.1 * s), outputs=("position",)) for s in range(3)]
    answer = found(runs, slide("hold"))
    assert answer.verdict == "none"
    assert "start of load.velocity" in answer.answer
    assert answer.fit_after.values["load.mass"] == pytest.approx(MASS, rel=2e-3)


def test_a_dead_time_is_named_and_not_taken_for_another_assumption():
    runs = [moved(s, lambda t, s=s: held(steps(s))(np.maximum(t - 0.06, 0)), steps(s)) for s in range(3)]
    answer = found(runs, slide("hold"))
    assert [s.effect for s in answer.steps] == ["dead_time"] and not answer.assumptions
    assert answer.steps[0].parameters[0].value == pytest.approx(0.06, abs=2e-3)


def test_few_samples_that_scatter_are_no_gap_and_many_are():
    """What a lone recording cut in twelve shows in one of them by chance was told as missing."""
    few, many = (np.sqrt(1.3 / 0.98) * np.random.default_rng(1).normal(size=(n, 1)) for n in (58, 5800))
    few *= np.sqrt(1.3) / np.sqrt(np.mean(few**2))
    assert not has_gap([few], np.ones(1))[0] and has_gap([many], np.ones(1))[0]


def test_assumptions_are_given_up_a_few_times_at_most(monkeypatch):
    """What is always doubted does not hang."""
    begun = []

    def asked(model, initial_states):
        return SimpleNamespace(model=model, initial_states=initial_states)

    def begin(asked):
        begun.append(asked.initial_states)
        return None, None

    monkeypatch.setattr(assumed, "questioned", lambda search, structure: Change(free_starts=True))
    found = SimpleNamespace(steps=())
    *_, given_up = assumed.fairly(asked(object(), "auto"), asked, begin, lambda search, base: found)
    assert len(given_up) == PATIENCE and begun == ["auto", *["free"] * PATIENCE]
