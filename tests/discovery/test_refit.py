"""A fit finds the machine, weighs outputs by what it leaves, and pays for every parameter."""

from __future__ import annotations

import dataclasses
import sys

import numpy as np
import pytest

from hydrotwin.discovery.decide import bic_gain, correlation_times
from hydrotwin.discovery.discover import _runner
from hydrotwin.discovery.refit import LONGEST, RefitJob, conclude, likelihood, pooled_rmse, refit
from hydrotwin.discovery.resume import key_of
from hydrotwin.identification.descent import descend, whole_runs
from hydrotwin.identification.least_squares import minimise
from hydrotwin.models.effects import candidates
from hydrotwin.models.language import Model
from hydrotwin.simulation import prepare
from tests.discovery.slides import (
    DAMPING,
    MASS,
    NOISE,
    RATE_NOISE,
    Drive,
    Inline,
    TwoSensors,
    Unstable,
    question,
    record,
    records,
    slide,
    started,
)
from tests.discovery.slides import drive_records as driven

FREE = ("mass.mass", "mass.damping")
MODULE = sys.modules["hydrotwin.discovery.refit"]  # the function has its name in the package


@pytest.fixture(scope="module")
def plain():
    """Recordings without any hidden effect, as a question."""
    return question(records(3))


@pytest.fixture(scope="module")
def fitted(plain):
    return refit(RefitJob(slide().flat, FREE, plain, coarse=True))


def test_mass_and_damping_are_recovered_from_starts_a_quarter_off(fitted):
    assert fitted.values["mass.mass"] == pytest.approx(MASS, rel=3e-3)
    assert fitted.values["mass.damping"] == pytest.approx(DAMPING, rel=3e-3)
    assert fitted.converged and not fitted.at_bound and fitted.parameters == 2


def test_what_is_left_is_the_noise_on_recordings_fitted_and_held_out(fitted):
    assert fitted.rmse == pytest.approx([NOISE], rel=0.06)
    assert pooled_rmse(fitted.residuals_select) == pytest.approx([NOISE], rel=0.06)
    assert len(fitted.residuals_fit) == 2 and len(fitted.residuals_select) == 1


def test_what_is_left_is_that_of_the_values_given_however_early_the_fit_stops(plain, monkeypatch):
    for limit in ("ROUNDS", "FEWEST"):
        monkeypatch.setattr(f"hydrotwin.discovery.refit.{limit}", 1)  # so that its last step still moves
    flat = slide().flat
    early = refit(RefitJob(flat, FREE, plain, iterations=1))
    for recording, states, left in zip(plain.fit, early.states, early.residuals_fit, strict=True):
        p, u = flat.parameter_vector(early.values), recording.u
        x = np.array([states.get(s.name, 0.0) for s in flat.states])
        y, _ = prepare(flat).run(recording.time, u, p, x)
        np.testing.assert_allclose(left, y - recording.y, rtol=1e-9, atol=1e-12)
    assert early.size == pytest.approx(np.fmax(early.rmse, plain.noise))


def test_what_a_minimum_summed_is_what_is_left(plain):
    """One sample is missing, and one output is not used."""
    model, runs = Model(TwoSensors()), driven(3, other=lambda y, t: y)
    asked = question(runs, model, {"rate": RATE_NOISE, "other": np.inf})
    asked.fit[0].y[5, 0] = np.nan
    task = MODULE.weighed(RefitJob(model.flat, ("gain", "time_constant"), asked), asked.noise)
    found = minimise(*_first_point(task), most=2)
    assert found.at.squares is not None
    summed = MODULE._rmse(task, found)
    np.testing.assert_allclose(summed, pooled_rmse(MODULE.residuals_of(task, found)), rtol=1e-9)
    assert np.isnan(summed[1])
    given_up = dataclasses.replace(found, at=dataclasses.replace(found.at, squares=np.full((2, 2), np.nan)))
    np.testing.assert_allclose(MODULE._rmse(task, given_up), summed, rtol=1e-9)  # its runs are finite all the same


def _first_point(task):
    shooting, z = whole_runs(task)
    return shooting, task.free.scaled(task.free.start), z


def test_a_residual_is_never_weighed_by_less_than_the_noise(plain):
    large = dataclasses.replace(plain, noise=np.array([0.05]))
    assert refit(RefitJob(slide().flat, FREE, large, coarse=True)).size == pytest.approx([0.05])


def test_a_sensor_that_the_model_cannot_follow_loses_its_weight_and_the_good_one_rules():
    model, runs = Model(TwoSensors()), driven(3, other=lambda y, t: 1.5 + 1.5 * np.sin(9.0 * t) + y)
    asked = question(runs, model, {"rate": RATE_NOISE, "other": RATE_NOISE})
    found = refit(RefitJob(model.flat, ("gain", "time_constant"), asked, coarse=True))
    assert found.size[0] == pytest.approx(RATE_NOISE, rel=0.1) and found.size[1] > 20 * RATE_NOISE
    assert found.values["gain"] == pytest.approx(10.0, rel=1e-3)
    assert found.values["time_constant"] == pytest.approx(0.3, rel=5e-3)


def test_a_useless_parameter_costs_the_logarithm_of_the_worth_of_the_samples(plain, fitted):
    from hydrotwin.models.effects import candidates

    (deadband,) = candidates(slide(), ["command_deadband"])
    flat = slide().plus([deadband.addition]).flat
    job = RefitJob(flat, (*FREE, *deadband.free), plain, ({**fitted.values, deadband.free[0]: 1.0},))
    more = refit(job)
    n = plain.counts.sum() / correlation_times(more.residuals_fit)[0]
    assert bic_gain(more, fitted, plain) == pytest.approx(-np.log(n), abs=4.0)
    assert bic_gain(more, fitted, plain) < 0
    assert abs(more.values[deadband.free[0]]) < 3.0


def test_a_structure_at_the_noise_has_half_its_samples_as_likelihood(plain, fitted):
    assert likelihood(plain.noise, plain) == pytest.approx(plain.counts.sum() / 2)
    assert likelihood(2 * plain.noise, plain) == pytest.approx(plain.counts.sum() * (np.log(2.0) + 0.5))
    assert fitted.likelihood == pytest.approx(plain.counts.sum() / 2, rel=0.1)
    assert likelihood(0.5 * plain.noise, plain) < likelihood(plain.noise, plain)


def test_of_several_starts_the_one_in_the_right_valley_is_followed():
    late = question(records(3, late=6))
    flat, free, delay = started("dead_time")
    best = refit(RefitJob(flat, free, late, ({delay: 0.0}, {delay: 0.4}, {delay: 0.1})))
    assert best.values[delay] == pytest.approx(0.12, abs=2e-3)


def test_starts_that_nothing_reaches_do_not_keep_one_that_does_something_from_being_followed():
    """Three limits far above every force cost what none costs; one far too low costs more, and leads to the true."""
    runs = [record(k, limit=280.0) for k in range(3)]
    model, asked = slide(), question(runs)
    (limit,) = [c for c in candidates(model, ["command_saturation"])]
    (path,) = limit.free
    flat = model.plus([limit.addition]).flat
    starts = [{path: value} for value in (1e4, 2e4, 3e4, 60.0)]
    found = refit(RefitJob(flat, (*FREE, path), asked, tuple(starts), follow=3))
    assert found.values[path] == pytest.approx(280.0, rel=0.01)


def test_of_several_starts_that_are_followed_only_the_likeliest_is_fitted_to_the_end(monkeypatch):
    late = question(records(3, late=6))
    flat, free, delay = started("dead_time")
    settled, ends = MODULE._settled, []
    monkeypatch.setattr(MODULE, "_settled", lambda *a: ends.append(a) or settled(*a))
    best = refit(RefitJob(flat, free, late, ({delay: 0.4}, {delay: 0.1}, {delay: 0.0}), follow=3))
    assert best.values[delay] == pytest.approx(0.12, abs=2e-3)
    assert len(ends) == 1


def test_a_job_alone_may_use_all_cores_and_its_answer_is_the_same_to_the_last_bit(plain):
    """Three recordings of 12 s go to two threads; a memory knows the job whatever it runs on."""
    jobs = [RefitJob(slide().flat, FREE, plain, coarse=True, threads=n) for n in (1, 2)]
    one, two = (refit(job) for job in jobs)
    assert one.values == two.values and one.likelihood == two.likelihood
    assert all(np.array_equal(a, b) for a, b in zip(one.residuals_fit, two.residuals_fit, strict=True))
    assert key_of(jobs[0]) == key_of(jobs[1])
    assert key_of(jobs[0]) != key_of(dataclasses.replace(jobs[0], coarse=False))


@pytest.mark.parametrize("threads", [[4], [2, 2], [1, 1, 1], [1, 1, 1, 1, 2, 2], []])
def test_the_last_jobs_share_the_cores_that_they_would_leave_idle(plain, threads):
    jobs = [RefitJob(slide().flat, FREE, plain)] * len(threads)
    run = _runner(Inline(), lambda *said: None, None, cores=4)
    assert run(threads_of, jobs, "refit") == threads


def threads_of(job):
    return job.threads


def spied(monkeypatch, **changes):
    """What every minimisation of a fit was given: weights (ny,) and iterations; ``changes`` to what it finds."""
    minimise, asked = MODULE.minimise, []

    def spy(shooting, q, z, *, most, **rest):
        found = minimise(shooting, q, z, most=most, **rest)
        asked.append((shooting.weights, most, rest.get("hold", False)))
        return dataclasses.replace(found, iterations=most) if changes.get("tired") else found

    monkeypatch.setattr(MODULE, "minimise", spy)
    return asked


def test_far_from_the_noise_a_first_fit_is_weighed_by_what_may_be_left_too(monkeypatch, plain, fitted):
    asked = spied(monkeypatch)
    refit(RefitJob(slide().flat, FREE, plain, (fitted.values,), fitted.states, 50 * plain.noise))
    (one, _, _), (other, _, _) = asked[:2]
    assert one == pytest.approx(1 / plain.noise) and other == pytest.approx(0.02 / plain.noise)
    asked.clear()
    refit(RefitJob(slide().flat, FREE, plain, (fitted.values,), fitted.states, fitted.size))
    assert asked[1][0] == pytest.approx(1 / fitted.size), "near it the noise alone is enough"


def test_a_cost_that_never_comes_to_rest_does_not_take_every_iteration_of_every_round(monkeypatch, plain, fitted):
    asked = spied(monkeypatch, tired=True)
    slow = dataclasses.replace(plain, noise=plain.noise / 50)
    refit(RefitJob(slide().flat, FREE, slow, ({"mass.mass": 20.0},), fitted.states))
    rounds = [most for _, most, hold in asked[1:] if not hold]
    assert sum(rounds) <= LONGEST


def test_a_fit_may_look_along_its_valleys_and_takes_only_what_is_lower(monkeypatch, plain, fitted):
    minimise, looks = MODULE.minimise, []

    def look(task, found, rounds, averaged):
        looks.append(averaged)
        values = np.array([seen[n] for n in task.free.names])
        return [dataclasses.replace(found, q=task.free.scaled(values))], False

    monkeypatch.setattr(MODULE, "minimise", lambda *a, most, **k: minimise(*a, most=0, **k))  # it rests where it is
    monkeypatch.setattr(MODULE, "along_the_valleys", look)
    start = {**fitted.values, "mass.mass": 60.0}
    job = RefitJob(slide().flat, FREE, plain, (start,), fitted.states, valley=2.0)
    seen = fitted.values
    assert refit(job).values == pytest.approx(fitted.values)
    seen = {**start, "mass.mass": 70.0}
    assert refit(job).values["mass.mass"] == pytest.approx(60.0)
    refit(dataclasses.replace(job, valley=None))
    assert looks == [[2.0], [2.0]]


def test_what_the_recordings_do_not_show_stays_where_the_model_came_with_it(plain, fitted):
    """Mass and damping of one motionless recording: nothing but the prior speaks, and it asks for a factor of two."""
    still = dataclasses.replace(plain.fit[0], u=0 * plain.fit[0].u, y=0 * plain.fit[0].y)
    nothing = dataclasses.replace(plain, fit=(still,), select=(), usual={"mass.mass": 40.0, "mass.damping": 260.0})
    found = refit(RefitJob(slide().flat, FREE, nothing, ({"mass.mass": 90.0, "mass.damping": 100.0},)))
    assert found.values == pytest.approx({"mass.mass": 40.0, "mass.damping": 260.0}, rel=0.05)


def test_what_the_recordings_show_does_not_mind_where_the_model_came_from(plain, fitted):
    far = dataclasses.replace(plain, usual={"mass.mass": 5.0, "mass.damping": 2000.0})
    found = refit(RefitJob(slide().flat, FREE, far, coarse=True))
    assert found.values == pytest.approx(fitted.values, rel=1e-3)
    asked = 0.5 * ((np.log(MASS / 5.0) / np.log(2)) ** 2 + (np.log(DAMPING / 2000.0) / np.log(2)) ** 2)
    assert found.likelihood - fitted.likelihood == pytest.approx(asked, abs=0.5)


def test_a_start_outside_the_bounds_is_moved_inside_and_a_value_at_its_bound_is_told():
    tight = Model(Drive()).with_settings({"gain": {"value": 5.0, "bounds": (1.0, 6.0)}}, {})
    asked = question(driven(3), tight)
    found = refit(RefitJob(tight.flat, ("gain", "time_constant"), asked, ({"gain": 50.0},)))
    assert found.values["gain"] == pytest.approx(6.0) and "gain" in found.at_bound


def test_a_model_that_diverges_is_a_sentence():
    model = Model(Unstable())
    said = refit(RefitJob(model.flat, ("gain",), question(driven(3), model), coarse=True))
    assert isinstance(said, str) and "diverge" in said
    said = conclude(RefitJob(model.flat, ("gain",), question(driven(3), model)))
    assert isinstance(said, str) and "diverge" in said


def test_the_final_fit_has_intervals_that_hold_the_truth_and_unseen_residuals(plain, fitted):
    everything = dataclasses.replace(plain, fit=(*plain.fit, *plain.select), select=())
    done = conclude(RefitJob(slide().flat, FREE, everything, (fitted.values,), size=fitted.size))
    for p, true in zip(done.fit.parameters, (MASS, DAMPING), strict=True):
        assert 0 < p.sigma < 0.01 * true
        assert abs(p.value - true) < 4 * p.sigma
    assert done.residuals_report == ()


def test_pooled_rmse_counts_what_was_measured_and_is_infinite_where_a_run_diverged():
    one = np.array([[3.0, np.nan, np.nan], [4.0, np.nan, 1.0]])
    assert pooled_rmse([one])[[0, 2]] == pytest.approx([np.sqrt(12.5), 1.0]) and np.isnan(pooled_rmse([one])[1])
    assert np.isinf(pooled_rmse([one, np.full((2, 3), np.inf)])).all()


def test_an_interrupted_measurement_is_bridged(plain):
    held = dataclasses.replace(plain.fit[0], y=plain.fit[0].y.copy())
    held.y[100:250] = np.nan
    asked = dataclasses.replace(plain, fit=(held, plain.fit[1]))
    found = refit(RefitJob(slide().flat, FREE, asked, coarse=True))
    assert found.values["mass.mass"] == pytest.approx(MASS, rel=5e-3)
    assert np.isnan(found.residuals_fit[0][100:250]).all() and asked.counts[0] == plain.counts[0] - 150


def test_where_a_fit_comes_to_a_stiff_place_it_is_integrated_as_that_asks():
    """Explicit steps of 5 ms follow a lag of 50 ms, where the fit begins, and would explode at one of 1 ms."""
    model = Model(Drive()).with_settings({"time_constant": {"value": 0.05, "bounds": (1e-4, 10.0)}})
    asked = dataclasses.replace(question(driven(3), model, {"rate": RATE_NOISE}), step=5e-3)
    task = MODULE.weighed(RefitJob(model.flat, ("gain", "time_constant"), asked), asked.noise)
    easy, z = _first_point(task)[1:]
    assert np.isfinite(whole_runs(task)[0].residuals(0, easy, z[0])).all() and task.propagator.method == "explicit"
    stiff = task.free.scaled(np.array([10.0, 1e-3]))
    assert np.isfinite(minimise(whole_runs(task)[0], stiff, z, most=2).cost)
    for lengths in ([], [1.0]):
        assert np.isfinite(descend(task, stiff, lengths, 2, thorough=False).cost)
    there = dataclasses.replace(minimise(*_first_point(task), most=1), q=stiff)
    assert np.isfinite(MODULE.residuals_of(task, there, asked.select)[0]).all()


def test_a_stiff_structure_is_not_looked_along_its_valleys(monkeypatch):
    """A lag that explicit steps of 5 ms follow at 50 ms, and at a twentieth of a millisecond no eighth of them does."""
    looks = []
    monkeypatch.setattr(MODULE, "along_the_valleys", lambda task, found, **k: looks.append(0) or ([found], True))
    for value in (0.05, 5e-5):
        settings = {"time_constant": {"value": value, "bounds": (0.9 * value, 1.1 * value)}}
        model = Model(Drive()).with_settings(settings)
        asked = dataclasses.replace(question(driven(3), model, {"rate": RATE_NOISE}), step=5e-3)
        refit(RefitJob(model.flat, ("gain", "time_constant"), asked, valley=2.0, iterations=2))
        assert len(looks) == 1
