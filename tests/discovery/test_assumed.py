"""The gap workflow doubts what it assumes about recordings before it names, or misses, an effect."""

from __future__ import annotations

import dataclasses
import json
from types import SimpleNamespace

import numpy as np
import pytest

from hydrotwin.discovery import assumed
from hydrotwin.discovery.discover import discover
from hydrotwin.discovery.evidence.gaps import has_gap
from hydrotwin.discovery.fits.job import Job
from hydrotwin.identification.assumptions import PATIENCE, Change
from hydrotwin.identification.descent import whole_runs
from hydrotwin.identification.least_squares import minimise
from hydrotwin.identification.outliers import Strays
from hydrotwin.report.gap_data import gap_data
from tests.identification.sliding import FREE, MASS, held, moved, slide, steps, wave

from . import slides
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


def spoiled(run, samples, by: float = 0.5):
    """The recording with a position that is off in some samples."""
    values = run["position"].copy()
    values[list(samples)] += by
    return run.with_signals({"position": values})


@pytest.mark.parametrize("outputs", [("position", "velocity"), ("position",)])
def test_samples_that_stand_alone_are_left_out_of_every_recording_and_told(outputs):
    spikes = [(40, 41, 300), (77,), (), (10, 200)]  # two that are fitted to, the one that chooses, one that judges
    runs = [spoiled(moved(s, held(steps(s)), outputs=outputs), spikes[s]) for s in range(3)]
    judge = spoiled(moved(3, held(steps(3)), outputs=outputs), spikes[3])
    answer = found(runs, slide("hold"), validate=[judge])
    assert answer.verdict == "none", answer.answer
    assert "stand alone, far from all others" in answer.answer and "left out" in answer.answer
    for samples, run in zip(spikes, [*runs, judge], strict=True):
        assert not samples or f"{len(samples)} in {run.name}" in answer.answer
    assert answer.fit_after.values["load.mass"] == pytest.approx(MASS, rel=2e-3)
    before = answer.outputs["validate"][0]
    assert before.rmse_after < 1.2 * before.noise


def test_the_search_without_such_samples_ends_with_its_time(monkeypatch):
    """It goes through all starts of `identify`: three recordings of two minutes took five minutes of processor."""
    plain, said = assumed.question_samples, []

    def at_once(job):
        said.append(plain(dataclasses.replace(job, seconds=0.0)))
        return said[-1]

    monkeypatch.setattr(assumed, "question_samples", at_once)
    answer = found([spoiled(moved(s, held(steps(s))), (40, 41, 300)) for s in range(3)], slide("hold"))
    assert said and not said[0].left_out and answer.verdict == "unknown"


def test_what_is_asked_of_a_fit_ends_with_the_seconds_of_its_job():
    """The doubts of one fit had taken two minutes where a fit may take forty seconds."""
    asked, begin = slides.question(slides.records(3, dry=30.0)), slides.START
    job = Job(slides.slide().flat, tuple(begin), asked, (begin,), size=asked.noise, seconds=0.0)
    task, found = assumed._ended(job.beginning())
    assert found.iterations == 1 and not found.converged
    again = minimise(whole_runs(task)[0], found.q, found.z)
    assert again.iterations == 1 and "time limit" in again.message


def test_a_recording_that_judges_alone_may_have_such_samples():
    runs = [moved(s, held(steps(s))) for s in range(3)]
    answer = found(runs, slide("hold"), validate=[spoiled(moved(3, held(steps(3))), (50, 90, 91))])
    assert answer.verdict == "none" and "3 in" in answer.answer
    plain = found(runs, slide("hold"))
    assert answer.fit_after.values == plain.fit_after.values


def test_samples_that_stand_alone_beside_a_missing_effect_are_told():
    runs = [moved(s, lambda t, s=s: held(steps(s))(np.maximum(t - 0.06, 0)), steps(s)) for s in range(3)]
    answer = found([spoiled(r, (60, 61, 250), by=5.0) for r in runs], slide("hold"))
    assert answer.verdict == "unknown" or answer.steps
    assert any("stand alone" in f and "Put nan" in f for f in answer.findings) or "left out" in answer.answer


def test_samples_of_an_input_that_stand_alone_are_told():
    runs = [moved(s, wave(s)) for s in range(3)]
    force = runs[0]["force"].copy()
    force[[40, 41, 200]] = 9999.0
    answer = found([runs[0].with_signals({"force": force}), *runs[1:]], slide())
    assert answer.verdict == "unknown"
    assert any("3 samples of input force stand alone" in f and "0.8 s" in f for f in answer.findings)


def test_few_samples_that_scatter_are_no_gap_and_many_are():
    """What a lone recording cut in twelve shows in one of them by chance was told as missing."""
    few, many = (np.sqrt(1.3 / 0.98) * np.random.default_rng(1).normal(size=(n, 1)) for n in (58, 5800))
    few *= np.sqrt(1.3) / np.sqrt(np.mean(few**2))
    assert not has_gap([few], np.ones(1))[0] and has_gap([many], np.ones(1))[0]


def asked_of(model, initial_states):
    """As much of what is asked as `fairly` looks at."""
    asked = SimpleNamespace(model=model, initial_states=initial_states, data=None)
    asked.without = asked.telling = lambda said: asked
    return asked


def doubting(monkeypatch, best, doubt):
    """Initial states of the searches that begin where ``doubt(entry)`` tells what to give up, and what was given up."""
    begun = []

    def begin(asked):
        begun.append(asked.initial_states)
        table = SimpleNamespace(entry=lambda: None, explained=lambda: False)
        return SimpleNamespace(
            part=None,
            go=lambda: None, complete=True, until=np.inf, table=table,
            take_looks=lambda before: None,
        )  # fmt: skip

    kept = SimpleNamespace(members=())
    monkeypatch.setattr(assumed, "standing", lambda table: SimpleNamespace(kept=kept, best=best))
    monkeypatch.setattr(assumed, "_questioned", lambda search, entry, asked=None: doubt(entry))
    for none in ("_stray_samples", "_stray_samples_of_judges"):
        monkeypatch.setattr(assumed, none, lambda search, data: Strays())
    *_, given_up = assumed.fairly(asked_of(object(), "auto"), asked_of, begin)
    return begun, given_up


def test_assumptions_are_given_up_a_few_times_at_most(monkeypatch):
    """What is always doubted does not hang."""
    begun, given_up = doubting(monkeypatch, None, lambda entry: Change(free_starts=True))
    assert len(given_up) == PATIENCE and begun == ["auto", *["free"] * PATIENCE]


def test_what_comes_closest_is_asked_for_its_start_though_it_is_not_named(monkeypatch):
    """A base that lacks an effect does not show that the start nobody measured is wrong; with the effect it does."""
    best, asked = SimpleNamespace(members=("friction",)), []

    def doubt(entry):
        asked.append(entry)
        return Change(free_starts=True) if entry is best and asked.count(best) == 1 else Change()

    begun, given_up = doubting(monkeypatch, best, doubt)
    assert begun == ["auto", "free"] and len(given_up) == 1


@pytest.mark.parametrize("ended", [True, False])
def test_what_was_found_stands_where_the_time_ends_a_search_that_began_anew(ended, monkeypatch):
    """A longer time limit had told less: the search under another assumption had found nothing yet."""
    made = []

    def begin(asked):
        first = not made
        table = SimpleNamespace(
            entry=lambda: "base", explained=lambda: False, kept=("leak",) if first else (), first=first
        )
        search = SimpleNamespace(
            part=None,
            go=lambda: None,
            complete=first or ended,
            until=np.inf,
            table=table,
            take_looks=lambda before: None,
        )
        made.append(search)
        return search

    monkeypatch.setattr(assumed, "standing", lambda t: SimpleNamespace(kept=SimpleNamespace(members=t.kept), best=None))
    monkeypatch.setattr(
        assumed,
        "_questioned",
        lambda search, entry, asked=None: Change(free_starts=asked is None and search is made[0]),
    )
    for none in ("_stray_samples", "_stray_samples_of_judges"):
        monkeypatch.setattr(assumed, none, lambda search, data: Strays())
    search, said, given_up = assumed.fairly(asked_of(object(), "auto"), asked_of, begin)
    assert len(made) == 2 and search is made[ended] and len(given_up) == int(ended)
    assert search.complete is ended and said.initial_states == ("free" if ended else "auto")
