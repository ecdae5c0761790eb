"""Whole recordings: a fit ends at the noise with the true values, and nothing that judges reaches a bit of it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery.fits import first_steps, whole
from hydrotwin.discovery.fits.job import Job
from hydrotwin.discovery.fits.whole import as_look, conclude, fit, glance, trajectories
from hydrotwin.models.language import Model
from tests.discovery.slides import (
    DAMPING,
    MASS,
    NOISE,
    PERIOD,
    START,
    TwoSensors,
    Unstable,
    drive_records,
    fitted,
    question,
    record,
    records,
    slid,
    slide,
    started,
)

FREE = tuple(START)


@pytest.fixture(scope="module")
def plain():
    """Nothing is missing."""
    asked = question(records(3))
    return asked, fitted(asked)


@pytest.fixture(scope="module")
def rubbing():
    """30 N of dry friction."""
    asked = question(records(3, dry=30.0))
    return asked, fitted(asked, "coulomb_friction", starts=({"coulomb_friction.force": 50.0},))


def last(asked, known, **more) -> Job:
    """The last fit of the slide, from where it stands."""
    return Job(slide().flat, FREE, dataclasses.replace(asked, **more), (known.values,), known.states, known.rmse)


def test_a_fit_from_a_quarter_off_ends_at_the_noise_with_the_true_values(plain):
    _, found = plain
    assert found.rmse == pytest.approx([NOISE], rel=0.05) and found.converged
    assert found.values == pytest.approx({"mass.mass": MASS, "mass.damping": DAMPING}, rel=0.005)
    assert found.left.counts.sum() == 1800 and not found.at_bound


@pytest.mark.parametrize(("seconds", "precisions"), [(60.0, [True, False]), (0.0, [True])])
def test_a_fit_goes_to_its_minimum_in_rough_runs_and_ends_in_precise_ones_while_it_has_time(
    monkeypatch, seconds, precisions
):
    asked, made = [], whole.task_of
    monkeypatch.setattr(whole, "task_of", lambda *a: (asked.append(len(a) > 4 and a[4]), made(*a))[1])
    assert fitted(question(records(1)), seconds=seconds).rmse < 0.1
    assert asked == precisions


def test_an_effect_is_fitted_with_the_base(rubbing):
    _, found = rubbing
    assert found.values["coulomb_friction.force"] == pytest.approx(30.0, rel=0.02)
    assert found.values["mass.mass"] == pytest.approx(MASS, rel=0.01)
    assert found.rmse < 1.2 * NOISE


LIMIT, IDLE, TIGHT = "command_saturation.limit", 1e3, 120.0  # N, of 150 N: not reached, from where nothing leads on


def test_of_a_start_where_the_effect_does_nothing_and_a_dearer_one_the_dearer_one_is_followed():
    """A limit that nothing reaches costs as little as the base, and leads nowhere."""
    asked = question(records(3, limit=150.0))
    base = fitted(asked).values
    starts = ({**base, LIMIT: IDLE}, {**base, LIMIT: TIGHT})
    found, stuck = (fitted(asked, "command_saturation", starts=starts, tries=tries) for tries in (True, False))
    assert stuck.rmse > 2 * NOISE and stuck.values[LIMIT] == pytest.approx(IDLE), "it costs least"
    assert found.rmse < 1.1 * NOISE and found.values[LIMIT] == pytest.approx(150.0, rel=0.01)


def test_of_several_starts_that_whose_first_steps_lead_lowest_goes_on(monkeypatch):
    begun, made = [], first_steps.minimise

    def noted(shooting, q, z, **more):
        begun.append((more["most"], float(np.exp(q[0]))))
        return made(shooting, q, z, **more)

    monkeypatch.setattr(first_steps, "minimise", noted)
    starts = tuple({"mass.mass": mass, "mass.damping": 200.0} for mass in (45.0, 60.0, 45.0, 800.0))
    found = fitted(question(records(1)), starts=starts, size=np.array([10 * NOISE]))
    assert found.rmse < 1.1 * NOISE
    few, rest = begun[:-1], begun[-1]
    assert few == [(2, pytest.approx(45.0)), (2, pytest.approx(60.0))], "one twice, and one that is far too dear"
    assert rest[0] == 13 and rest[1] == pytest.approx(50.0, rel=0.2)


def test_where_every_start_diverges_the_reason_is_told():
    model = Model(Unstable())
    starts = ({"gain": 400.0}, {"gain": 500.0})
    assert "diverge" in fit(Job(model.flat, ("gain",), question(drive_records(1), model, {"rate": 0.02}), starts))


def test_starts_that_are_far_too_large_change_nothing(rubbing):
    asked, found = rubbing
    starts = tuple({"coulomb_friction.force": force} for force in (1e4, 50.0, 3e3))
    assert fitted(asked, "coulomb_friction", starts=starts).values == found.values


def test_a_start_outside_the_bounds_is_moved_inside_and_a_value_at_its_bound_is_told(plain):
    asked, _ = plain
    flat = slide().with_settings({"mass.mass": {"bounds": (55.0, 80.0)}}).flat
    found = fit(Job(flat, FREE, asked, ({"mass.mass": 1e3},)))
    assert found.values["mass.mass"] == pytest.approx(55.0) and found.at_bound == ("mass.mass",)


def test_a_sensor_that_the_model_cannot_follow_loses_its_weight_and_the_good_one_rules():
    model = Model(TwoSensors())
    runs = drive_records(3, other=lambda w, time: w + 1.5 + 1.5 * np.sin(9 * time))
    asked = question(runs, model, {"rate": 0.02, "other": 0.02})
    found = fit(Job(model.flat, ("gain", "time_constant"), asked))
    assert found.values == pytest.approx({"gain": 10.0, "time_constant": 0.3}, rel=0.01)
    assert found.rmse[0] < 1.3 * 0.02 < 1.0 < found.rmse[1]


def test_what_the_recordings_do_not_show_stays_where_the_model_came_with_it(plain):
    asked, _ = plain
    still = dataclasses.replace(asked.fit[0], u=0 * asked.fit[0].u, y=0 * asked.fit[0].y)
    usual = {"mass.mass": 40.0, "mass.damping": 260.0}
    nothing = dataclasses.replace(asked, fit=(still,), usual=usual)
    found = fitted(nothing, starts=({"mass.mass": 90.0, "mass.damping": 100.0},))
    assert found.values == pytest.approx(usual, rel=0.05)


def test_what_the_recordings_show_does_not_mind_where_the_model_came_from(plain):
    asked, found = plain
    far = fitted(dataclasses.replace(asked, usual={"mass.mass": 5.0, "mass.damping": 2000.0}))
    assert far.values == pytest.approx(found.values, rel=1e-3)


def test_a_sensor_that_fails_for_a_while_is_bridged():
    runs = records(3)
    speed = runs[1]["speed"].copy()
    speed[200:350] = np.nan
    found = fitted(question([runs[0], runs[1].with_signals({"speed": speed}), runs[2]]))
    assert found.left.counts.sum() == 1650 and found.values["mass.mass"] == pytest.approx(MASS, rel=0.01)


def test_a_model_that_diverges_is_a_sentence():
    model = Model(Unstable())
    asked = question(drive_records(2), model)
    job = Job(model.flat, ("gain",), asked, size=np.array([1.0]))
    for way in (fit, glance, conclude):
        answer = way(job)
        assert isinstance(answer, str) and "diverge" in answer


def test_a_glance_goes_a_few_steps_and_looks_at_all_that_is_left(plain):
    asked, found = plain
    seen = glance(Job(slide().flat, FREE, asked, stages=(0, 0)))
    assert seen.squares.shape == (1, 1) and seen.left.counts.sum() == 1800
    known = as_look(found)
    assert np.sqrt(known.squares[0] / known.counts[0]) == pytest.approx(found.rmse) and known.values == found.values


def test_trajectories_are_those_of_the_states_along_a_fit(plain):
    asked, found = plain
    runs = trajectories(slide().flat, asked, found)
    order = [s.name for s in slide().flat.states]
    for run, recording in zip(runs, asked.fit, strict=True):
        assert run.shape == (600, 2)
        assert np.abs(run[:, order.index("mass.speed")] - slid(recording.u[:, 0])).max() < 0.02
        way = np.gradient(run[:, order.index("mass.position")], PERIOD)
        assert np.abs(way - run[:, order.index("mass.speed")])[2:-2].mean() < 0.02


# -- the last fit ------------------------------------------------------------------------------------------------------
def test_the_last_fit_has_intervals_that_hold_the_truth_and_the_residuals_of_what_judges(plain):
    asked, found = plain
    judging = question(records(2, first=7)).fit
    concluded = conclude(last(asked, found, select=judging))
    for p, true in zip(concluded.fit.parameters, (MASS, DAMPING), strict=True):
        assert 0 < p.sigma < 0.01 * true and abs(p.value - true) < 4 * p.sigma
    assert [r.shape for r in concluded.residuals_report] == [(600, 1)] * 2
    assert np.std(np.concatenate(concluded.residuals_report)) == pytest.approx(NOISE, rel=0.06)


def test_no_bit_of_a_last_fit_depends_on_what_judges(plain):
    asked, found = plain
    far = question([record(8, highest=2e3), record(9, dry=200.0)]).fit
    alone, judged = conclude(last(asked, found)), conclude(last(asked, found, select=far))
    assert [(p.value, p.sigma) for p in alone.fit.parameters] == [(p.value, p.sigma) for p in judged.fit.parameters]
    assert all(map(np.array_equal, alone.residuals_fit, judged.residuals_fit))
    assert alone.fitted.values == judged.fitted.values and alone.fitted.states == judged.fitted.states
    assert alone.residuals_report == () and len(judged.residuals_report) == 2


def test_what_judges_and_diverges_is_infinite_and_leaves_the_fit_as_it_is(plain, monkeypatch):
    asked, found = plain
    from hydrotwin.identification.shooting import Shooting

    real = Shooting.residuals
    monkeypatch.setattr(Shooting, "residuals", lambda self, i, q, z: None if len(self.recordings) == 1 else
                        real(self, i, q, z))  # fmt: skip
    concluded = conclude(last(asked, found, select=question([record(9), record(8)]).fit[:1]))
    assert np.isinf(concluded.residuals_report[0]).all()
    assert concluded.fit.parameters[0].value == pytest.approx(MASS, rel=0.01)


def test_every_structure_has_its_free_parameters(rubbing):
    asked, found = rubbing
    flat, free, force = started("coulomb_friction")
    concluded = conclude(Job(flat, free, asked, (found.values,), found.states, found.rmse))
    assert [p.name for p in concluded.fit.parameters] == list(free) and force in free


@pytest.mark.parametrize(("known", "stages"), [((slide().flat, FREE), 1), (started("coulomb_friction")[:2], 2)])
def test_runs_are_precise_only_where_little_is_left(rubbing, monkeypatch, known, stages):
    """Without the friction the base leaves far more than an error of rough runs could be."""
    asked, _ = rubbing
    found, own = [], whole.settled
    monkeypatch.setattr(whole, "settled", lambda *given: found.append(given) or own(*given))
    assert isinstance(fit(Job(*known, asked)), whole.Fitted) and len(found) == stages
