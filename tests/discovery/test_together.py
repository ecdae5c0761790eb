"""What one recording alone shows: named where it explains all recordings to the noise, looked for on both sides."""

import dataclasses

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydrotwin.discovery import forward, together
from hydrotwin.discovery.answering import Found
from hydrotwin.discovery.discover import discover
from hydrotwin.discovery.ends import both_ends, without_idle_ends
from hydrotwin.discovery.forward import _pruned
from hydrotwin.discovery.recordings import split
from hydrotwin.discovery.structure import Structure
from hydrotwin.discovery.together import _remembered, explained_together
from hydrotwin.models.effects.mechanism import FAR
from hydrotwin.models.language import Model, Output
from hydrotwin.records import Record
from tests.discovery.slides import NOISE, Inline, Slide, found, question, record, searching

LIMITED = ("command_saturation", "coulomb_friction", "null_bias", "dead_time")
QUIET = {"highest": 90.0}  # N, far below the limit
STOPS = (-0.2, 0.3)  # m
HARD, DULL = 2e6, 5.0  # N/m, s/m
PLACE_NOISE = 1e-4  # m


class Rail(Slide):
    """The pushed mass, its place measured."""

    place = Output("m", "measured place", nominal=0.3)

    def equations(self):
        yield from super().equations()
        yield self.place == self.mass.position


def rail():
    return Model(Rail())


def moved(seed: int, *pushes: float) -> Record:
    """Ten seconds on a rail with stops, integrated here: each force [N] held for a second, then its opposite."""
    time = np.arange(0.0, 10.0, 0.02)
    levels = [f for push in pushes for f in (push, -push)]
    force = np.array([levels[min(int(t), len(levels) - 1)] if t < len(levels) else 0.0 for t in time])
    low, high = STOPS

    def slope(t, x):
        above, below = max(x[0] - high, 0.0), max(low - x[0], 0.0)
        contact = HARD * (below * max(1 - DULL * x[1], 0.0) - above * max(1 + DULL * x[1], 0.0))
        return [x[1], (force[min(int(t / 0.02 + 1e-9), len(force) - 1)] - 200.0 * x[1] + contact) / 50.0]

    x = np.zeros((len(time), 2))
    for k in range(len(time) - 1):
        x[k + 1] = solve_ivp(slope, (time[k], time[k + 1] - 1e-12), x[k], rtol=1e-7, atol=1e-9).y[:, -1]
    place = x[:, 0] + PLACE_NOISE * np.random.default_rng(seed).standard_normal(len(time))
    return Record(time, {"force": force, "place": place}, {"force": "N", "place": "m"}, f"rail_{seed}")


UP, DOWN, SHORT = (30.0, 50.0, 40.0, 83.0), (-20.0, 35.0, -30.0, -60.0), (20.0, -30.0, 40.0, -20.0)


@pytest.mark.parametrize("shows", [0, 1, 2])
def test_what_one_recording_alone_shows_is_named_whichever_it_is_where_it_explains_all(shows):
    runs = [record(k) if k == shows else record(k, **QUIET) for k in range(3)]
    runs = [record(k, limit=280.0) if k == shows else r for k, r in enumerate(runs)]
    answer = found(runs, LIMITED, validate=[record(3, limit=280.0)])
    assert [s.effect for s in answer.steps] == ["command_saturation"] and answer.verdict == "named"
    assert answer.steps[0].parameters[0].value == pytest.approx(280.0, rel=0.01)
    if shows == 1:  # the others bend the base, and the second one tells
        assert {r.role for r in answer.recordings if r.record != "run_3"} == {"fit"}
        assert any("none was kept to choose by" in f for f in answer.findings)


def test_what_no_effect_explains_to_the_noise_stays_unknown_where_one_recording_alone_shows_it():
    runs = [record(0, pulse=150.0), record(1), record(2)]
    answer = found(runs, (*LIMITED, "viscous_friction", "drift"), validate=[record(3)])
    assert answer.verdict == "unknown" and not answer.steps
    assert {r.role for r in answer.recordings} == {"fit", "select", "report"}, "the roles of the search that stands"
    assert not any("none was kept to choose by" in f for f in answer.findings)


def test_what_is_left_in_one_recording_beside_an_effect_that_all_show_is_named_too():
    quiet = {"highest": 200.0, "dry": 30.0}
    runs = [record(0, **quiet), record(1, limit=280.0, dry=30.0), record(2, **quiet)]
    answer = found(runs, LIMITED, validate=[record(3, limit=280.0, dry=30.0)])
    assert {s.effect for s in answer.steps} == {"coulomb_friction", "command_saturation"}


def test_an_answer_that_other_recordings_confirm_does_not_ask_for_one():
    answer = found([record(k, limit=280.0) for k in range(3)], LIMITED, validate=[record(3, limit=280.0)])
    assert answer.verdict == "named" and not any("none was kept to choose by" in f for f in answer.findings)


@pytest.mark.parametrize(("limit", "promising"), [(280.0, True), (np.inf, False)])
def test_what_the_first_search_found_is_remembered_and_asked_whether_it_comes_near_the_noise(limit, promising):
    runs = [record(0, limit=limit), record(1, limit=limit), record(2, limit=limit, pulse=0.0 if promising else 100.0)]
    search, fitted = searching(question(runs), LIMITED)
    (cut,) = [c for c in search.candidates if c.id == "command_saturation"]
    base = Structure((), fitted)
    (known,) = search.refitted(base, [((cut,), [{cut.free[0]: 250.0}])])
    assert _remembered(search, base, known.structure) is promising
    assert ("command_saturation at force",) in search.hints


def test_what_hardly_closes_a_small_gap_is_no_reason_to_look_in_all_recordings(monkeypatch):
    """Near the noise it is, as the base is by itself."""
    search, fitted = searching(question([record(k, limit=280.0) for k in range(3)]), LIMITED)
    (cut,) = [c for c in search.candidates if c.id == "command_saturation"]
    base = Structure((), fitted)
    (known,) = search.refitted(base, [((cut,), [{cut.free[0]: 250.0}])])
    monkeypatch.setattr(together, "closed", lambda *_: 0.4)
    assert search.near_noise(known.structure) and not _remembered(search, base, known.structure)


def asked_again(monkeypatch, known, other, diverges=lambda job: False, size=None):
    """What `explained_together` answers to a search that found nothing, when it knows this and finds the other."""
    runs = [record(k, limit=280.0) for k in range(3)]
    search, fitted = searching(question(runs), LIMITED)
    (cut,) = [c for c in search.candidates if c.id == "command_saturation"]
    base = Structure((), fitted)
    (limited,) = search.refitted(base, [((cut,), [{cut.free[0]: 250.0}])])
    structures = {"base": base, "limited": limited.structure, "poor": Structure((cut,), fitted), None: None}
    found, search.first_size = Found(base, base, (), ()), size
    monkeypatch.setattr(together, "unconfirmed", lambda *_: "a limit would explain it")
    monkeypatch.setattr(together, "likeliest", lambda *_: structures[known])
    monkeypatch.setattr(together, "verdict_of", lambda s, f: "unknown" if f is found else "named")
    finds = dataclasses.replace(found, last=structures[other])
    monkeypatch.setattr(together, "searched", lambda *_: finds)
    data = split(search.base.flat, runs, [], noise={"speed": NOISE})
    search.run = lambda work, jobs, what: ["it left the finite numbers" if diverges(j) else work(j) for j in jobs]
    return explained_together(search, data, found, 2)[1] is finds


def test_a_search_in_all_recordings_counts_only_when_it_leaves_nothing(monkeypatch):
    assert asked_again(monkeypatch, None, "limited")
    assert not asked_again(monkeypatch, None, "poor")


def test_where_no_base_can_be_fitted_to_all_recordings_the_first_search_stands(monkeypatch):
    assert not asked_again(monkeypatch, None, "limited", diverges=lambda job: True)


@pytest.mark.parametrize("begun_anew", [True, False])
def test_the_base_of_all_recordings_is_begun_anew_and_goes_on_from_the_first(monkeypatch, begun_anew):
    """Begun anew it may end in a hollow that the one which explains most recordings is not in; or nowhere, as here."""
    assert asked_again(monkeypatch, None, "limited", diverges=lambda job: job.coarse is begun_anew)


def test_the_base_of_all_recordings_is_weighed_as_the_first_was(monkeypatch):
    asked = []
    asked_again(monkeypatch, None, "limited", diverges=asked.append, size=np.array([0.25]))
    (anew,) = [job for job in asked if job.coarse]
    assert anew.size.tolist() == [0.25]


def test_what_comes_nowhere_near_the_noise_is_not_searched_for_again(monkeypatch):
    assert asked_again(monkeypatch, "limited", "limited")
    monkeypatch.setattr(together, "_remembered", lambda *_: False)
    assert not asked_again(monkeypatch, "limited", "limited")


def test_a_fit_begins_at_a_hint_too():
    search, fitted = searching(question([record(k, limit=280.0) for k in range(3)]), LIMITED)
    (cut,) = [c for c in search.candidates if c.id == "command_saturation"]
    far = [{cut.free[0]: 1e4}]  # where no derivative leads on
    (lost,) = search.refitted(Structure((), fitted), [((cut,), far)])
    assert lost.structure.fitted.values[cut.free[0]] == pytest.approx(1e4)
    search.forget()
    search.hints[(cut.label,)] = {cut.free[0]: 270.0}
    (led,) = search.refitted(Structure((), fitted), [((cut,), far)])
    assert led.structure.fitted.values[cut.free[0]] == pytest.approx(280.0, rel=0.01)


def stopping(*runs, names=("end_stop", "null_bias")):
    asked = question(list(runs), rail(), {"place": PLACE_NOISE})
    asked = dataclasses.replace(asked, fit=(*asked.fit, *asked.select), select=(*asked.fit, *asked.select))
    search, fitted = searching(asked, names, rail())
    return search, Structure((), fitted)


def test_a_stop_found_at_one_end_is_looked_for_at_the_other():
    search, base = stopping(moved(0, *UP), moved(1, *DOWN))
    (stop,) = [c for c in search.candidates if c.id == "end_stop"]
    (one_end,) = search.refitted(base, [((stop,), [{"end_stop.high": 0.302, "end_stop.low": -FAR}])])
    assert one_end.structure.fitted.values["end_stop.low"] == pytest.approx(-FAR), "the trap is set"
    one_end = dataclasses.replace(one_end, evidence=dataclasses.replace(one_end.evidence, bic_gain=1e3))
    (both,) = both_ends(search, base, [one_end])
    assert both.structure.fitted.values["end_stop.low"] == pytest.approx(STOPS[0], abs=0.06), "to be fitted on from"
    assert both.structure.fitted.likelihood < one_end.structure.fitted.likelihood - 300
    assert both_ends(search, base, [both]) == [both], "nothing is left to look for"


@pytest.mark.parametrize("diverging", [True, False])
def test_the_other_end_is_fitted_from_where_it_stands_and_led_through_windows(diverging):
    """The base has bent for the end that was missing: whole recordings may rest on the way back, windows as well."""
    search, base = stopping(moved(0, *UP), moved(1, *DOWN))
    (stop,) = [c for c in search.candidates if c.id == "end_stop"]
    (one_end,) = search.refitted(base, [((stop,), [{"end_stop.high": 0.302, "end_stop.low": -FAR}])])
    one_end = dataclasses.replace(one_end, evidence=dataclasses.replace(one_end.evidence, bic_gain=1e3))
    work = search.run
    search.run = lambda function, jobs, stage: [
        "it left the finite numbers" if stage == "refit" and job.coarse is diverging else answer
        for job, answer in zip(jobs, work(function, jobs, stage), strict=True)
    ]
    (both,) = both_ends(search, base, [one_end])
    assert both.structure.fitted.values["end_stop.low"] == pytest.approx(STOPS[0], abs=0.06)


def test_an_end_that_nothing_reaches_stays_far_away():
    search, base = stopping(moved(0, *UP), moved(2, *SHORT))
    (stop,) = [c for c in search.candidates if c.id == "end_stop"]
    (one_end,) = search.refitted(base, [((stop,), [{"end_stop.high": 0.302, "end_stop.low": -FAR}])])
    (same,) = both_ends(search, base, [one_end])
    assert same.structure.fitted.values["end_stop.low"] == pytest.approx(-FAR)


def test_an_end_that_explains_nothing_is_put_far_away_again():
    search, base = stopping(moved(0, *UP), moved(2, *SHORT))
    (stop,) = [c for c in search.candidates if c.id == "end_stop"]
    (both,) = search.refitted(base, [((stop,), [{"end_stop.high": 0.302, "end_stop.low": -0.25}])])
    assert both.structure.fitted.values["end_stop.low"] > -0.5
    values = without_idle_ends(search, both.structure).fitted.values
    assert values["end_stop.low"] == pytest.approx(-FAR) and values["end_stop.high"] == pytest.approx(0.3, abs=0.02)
    reached, base = stopping(moved(0, *UP), moved(1, *DOWN))
    (kept,) = reached.refitted(base, [((stop,), [{"end_stop.high": 0.302, "end_stop.low": -0.205}])])
    assert without_idle_ends(reached, kept.structure) is kept.structure
    last = _pruned(search, Found(base, both.structure, (), ())).last
    assert last.fitted.values["end_stop.low"] == pytest.approx(-FAR), "at the end of every search"


def test_every_step_of_a_search_looks_at_the_other_ends(monkeypatch):
    seen = []
    monkeypatch.setattr(forward, "both_ends", lambda search, now, tried: seen.extend(tried) or list(tried))
    found([record(k, limit=280.0) for k in range(3)], LIMITED)
    assert "command_saturation" in {t.members[0].id for t in seen}


def test_what_is_not_worth_its_parameters_is_looked_at_no_further():
    search, base = stopping(moved(0, *UP), moved(1, *DOWN))
    (stop,) = [c for c in search.candidates if c.id == "end_stop"]
    (one_end,) = search.refitted(base, [((stop,), [{"end_stop.high": 0.302, "end_stop.low": -FAR}])])
    poor = dataclasses.replace(one_end, evidence=dataclasses.replace(one_end.evidence, bic_gain=0.0))
    assert both_ends(search, base, [poor]) == [poor]


def test_two_ends_that_two_recordings_reach_are_named_together():
    runs = [moved(0, *UP), moved(1, *DOWN), moved(2, *SHORT)]
    judging = [moved(3, 70.0, -70.0, 90.0)]
    answer = discover(rail(), runs, validate=judging, effects=["end_stop", "coulomb_friction"], executor=Inline())
    assert [s.effect for s in answer.steps] == ["end_stop"]
    values = {p.name: p.value for p in answer.steps[0].parameters}
    assert (values["end_stop.low"], values["end_stop.high"]) == pytest.approx(STOPS, abs=5e-3)
    assert {r.role for r in answer.recordings if r.record != "rail_3"} == {"fit"}
    assert any("none was kept to choose by" in f for f in answer.findings)
