"""The look back: both sides of a choice fitted again, what is easily confused fitted too, idle members dropped."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery import look_back
from hydrotwin.discovery.choose import Choice, choose, label
from hydrotwin.discovery.look_back import _contenders, _from_first, from_the_beginning, pruned, settled
from hydrotwin.discovery.refit import RefitJob, refit
from hydrotwin.discovery.structure import Structure, Tried
from hydrotwin.models.language import Model
from tests.discovery.slides import (
    RATE_NOISE,
    START,
    Drive,
    TwoSensors,
    better,
    drive_records,
    grown,
    one,
    question,
    records,
    searching,
    slide,
)


def test_a_base_that_came_to_rest_too_early_is_caught_by_the_look_back():
    """Nothing is missing: the base was left at a poor start, so that dry friction seems to explain a lot."""
    search, fitted = searching(question(records(3)), ("null_bias", "coulomb_friction"))
    held = {
        "mass.mass": {"value": 75.0, "bounds": (74.0, 76.0)},
        "mass.damping": {"value": 240.0, "bounds": (239, 241)},
    }
    stuck = refit(RefitJob(slide().with_settings(held, {}).flat, tuple(held), search.question))
    assert stuck.rmse[0] > 20 * fitted.rmse[0]
    poor = Structure((), stuck)
    tried = search.refitted(poor, [([one(search, "coulomb_friction")], [{"coulomb_friction.force": 20.0}])])[0]
    assert tried.evidence.passes(2), "the trap is set"
    now, (judged,) = settled(search, poor, [tried], choose([tried], 2, search.question))
    assert now.fitted.likelihood < stuck.likelihood - 100
    assert now.fitted.values["mass.mass"] == pytest.approx(50.0, rel=0.01)
    assert not judged.evidence.passes(2)


def test_the_look_back_leaves_a_base_that_was_at_rest_alone(rubbing):
    search, base, _, ranked = rubbing
    coulomb = next(s for s in ranked if s.candidate.id == "coulomb_friction")
    (tried,) = search.singles(base, [coulomb])
    now, (judged,) = settled(search, base, [tried], choose([tried], 5, search.question))
    assert now is base and judged.evidence.passes(5)


def test_the_look_back_fits_contenders_again_as_it_does_the_best(rubbing):
    search, base, _, ranked = rubbing
    by = {s.candidate.id: s for s in ranked}
    coulomb, stribeck = search.singles(base, [by["coulomb_friction"], by["stribeck_friction"]])
    fitted = stribeck.structure.fitted
    early = dataclasses.replace(fitted, likelihood=fitted.likelihood + 20)
    resting = dataclasses.replace(stribeck, structure=Structure(stribeck.structure.members, early))
    _, (_, again) = settled(search, base, [coulomb, resting], choose([coulomb], 5, search.question))
    assert again.structure.fitted.likelihood < early.likelihood - 10


def test_of_nine_that_do_alike_every_one_is_fitted_again(rubbing):
    search, base, _, ranked = rubbing
    by = {s.candidate.id: s for s in ranked}
    (coulomb,) = search.singles(base, [by["coulomb_friction"]])
    alike = [dataclasses.replace(coulomb) for _ in range(8)]
    choice = choose([coulomb], 5, search.question)
    assert len(_contenders(search, [coulomb, *alike], choice, near=True)) == 9


@pytest.mark.parametrize(("promise", "near", "again"), [(1.0, True, True), (1.0, False, False), (0.8, True, False)])
def test_near_the_noise_what_promised_as_much_as_the_best_begins_anew(rubbing, promise, near, again):
    """It may rest in the hollow of the base: the lag of a late sensor that a stiff friction has taken."""
    search, base, _, ranked = rubbing
    by = {s.candidate.id: s for s in ranked}
    coulomb, bias = search.singles(base, [by["coulomb_friction"], by["null_bias"]])
    assert not bias.evidence.passes(5)
    promised = dataclasses.replace(bias.screened, gain=promise * coulomb.screened.gain)
    bias = dataclasses.replace(bias, screened=promised)
    found = _contenders(search, [coulomb, bias], choose([coulomb, bias], 5, search.question), near=near)
    assert (bias in found) == again


def test_candidates_take_part_in_an_identification_from_the_beginning(rubbing):
    search, base, *_ = rubbing
    tried = from_the_beginning(search, base)
    best = choose(tried, 5, search.question).best
    assert label(best).startswith("coulomb_friction") and best.evidence.passes(5)
    assert best.structure.fitted.values["coulomb_friction.force"] == pytest.approx(30.0, rel=0.05)


def test_a_lower_fit_that_is_known_stays_where_one_from_the_beginning_rests_higher(rubbing):
    search, base, _, ranked = rubbing
    (known,) = search.singles(base, [next(s for s in ranked if s.candidate.id == "coulomb_friction")])
    fitted = known.structure.fitted
    lower = search.keep(Structure(known.members, dataclasses.replace(fitted, likelihood=fitted.likelihood - 5)))
    again = next(t for t in from_the_beginning(search, base) if t.members == known.members)
    assert again.structure is lower and search.singles(base, [known.screened])[0].structure is lower
    search.keep(known.structure)


def test_an_idle_member_is_dropped_and_the_one_that_works_stays(rubbing):
    search, base, *_ = rubbing
    both = grown(search, base, "null_bias", "coulomb_friction", coulomb_friction=30.0)
    assert [c.id for c in pruned(search, both, base).members] == ["coulomb_friction"]
    alone = grown(search, base, "coulomb_friction", coulomb_friction=30.0)
    assert pruned(search, alone, base) is alone


def test_two_members_that_both_work_stay():
    search, fitted = searching(question(records(3, dry=30.0, late=3)), ("coulomb_friction", "dead_time"))
    base = Structure((), fitted)
    both = grown(search, base, "dead_time", "coulomb_friction", coulomb_friction=30.0, dead_time=0.05)
    assert search.explained(both)
    assert pruned(search, both, base) is both
    assert both.fitted.values["dead_time.time"] == pytest.approx(0.06, abs=1e-3)


def test_a_member_that_closes_no_more_than_an_inexact_form_may_leave_is_dropped():
    """However sure it is: of a gap of thirty times the noise, two thousandths are more than the noise."""
    search, base = searching(question(records(3, dry=30.0, late=3)), ("coulomb_friction", "dead_time"))
    base = Structure((), base)
    both = grown(search, base, "dead_time", "coulomb_friction", coulomb_friction=30.0, dead_time=0.05)
    larger = dataclasses.replace(base.fitted, residuals_select=tuple(1e3 * r for r in base.fitted.residuals_select))
    assert len(pruned(search, both, Structure((), larger)).members) < 2


def test_what_is_easily_confused_with_the_best_is_fitted_though_the_screen_passed_it_over():
    """A base without the effect may have bent until the screen sees nothing of the right one."""
    search, fitted = searching(question(records(3, late=3)), ("dead_time", "actuator_lag", "sensor_lag", "null_bias"))
    base = Structure((), fitted)
    _, ranked = search.screened(base)
    (lag,) = search.singles(base, [s for s in ranked if s.candidate.id == "actuator_lag"])
    _, after = settled(search, base, [lag], choose([lag], 5, search.question))
    assert {t.members[0].id for t in after} == {"actuator_lag", "dead_time", "sensor_lag"}  # a null bias is no lag
    best = max(after, key=lambda t: t.evidence.bic_gain)
    assert best.members[0].id == "dead_time"
    assert best.structure.fitted.values["dead_time.time"] == pytest.approx(0.06, abs=2e-3)


@pytest.mark.parametrize(
    ("effect", "value", "starts"),
    [
        ("actuator_lag", {"time_constant": 0.004}, [0.004, 0.3]),
        ("actuator_lag", {"time_constant": 0.04}, [0.04]),
        ("command_saturation", {"limit": 0.2}, [0.2]),  # the lower a limit, the more it does
        ("command_saturation", {"limit": 9e5}, [9e5, 0.3]),
    ],
)
def test_near_the_noise_what_came_out_small_begins_once_more_as_large_as_may_be(effect, value, starts):
    """Two lags in a row may have changed places: the base has taken the long one, the effect what was the base's."""
    asked, (own,) = question(drive_records(), Model(Drive())), value
    search, fitted = searching(asked, (effect,), Model(Drive()), ("gain", "time_constant"))
    there = dataclasses.replace(fitted, values={**fitted.values, f"{effect}.{own}": value[own]})
    tried = Tried((one(search, effect),), None, Structure((one(search, effect),), there), better())
    jobs, run = [], search.run
    search.run = lambda function, asked, stage: jobs.extend(asked) or run(function, asked, stage)
    settled(search, Structure((), fitted), [tried], Choice(tried, (tried,), {}))
    assert [j.starts[0][f"{effect}.{own}"] for j in jobs if j.coarse] == starts


def test_what_is_easily_confused_takes_part_though_the_screen_called_it_invisible():
    """The screen looks from a base that stands in for the best; what shows after all is not called untestable."""
    search, fitted = searching(question(records(3, late=3)), ("dead_time", "actuator_lag"))
    base = Structure((), fitted)
    _, ranked = search.screened(base)
    (lag,) = search.singles(base, [s for s in ranked if s.candidate.id == "actuator_lag"])
    (late,) = [s for s in ranked if s.candidate.id == "dead_time"]
    search.not_testable[late.candidate.label] = late
    _, after = settled(search, base, [lag], choose([lag], 5, search.question))
    assert {t.members[0].id for t in after if t.evidence.passes(5)} >= {"dead_time"} and not search.not_testable


def test_what_the_base_does_as_well_takes_part_only_where_the_base_rests_on_a_bound(rubbing):
    """Viscous friction is the damping of the base; while that can move, adding it says nothing."""
    search, base, _, ranked = rubbing
    (best,) = search.singles(base, [s for s in ranked if s.candidate.id == "coulomb_friction"])
    assert "viscous_friction at mass.flange" in search.not_testable
    jobs, run = [], search.run
    search.run = lambda function, asked, stage: jobs.extend(asked) or run(function, asked, stage)
    try:
        assert look_back._confusable(search, base, [best], best) == [] and not jobs
        bound = Structure((), dataclasses.replace(base.fitted, at_bound=("mass.damping",)))
        (tried,) = look_back._confusable(search, bound, [best], best)
    finally:
        search.run = run
    assert tried.members[0].id == "viscous_friction"
    assert [j.coarse for j in jobs] == [False], "beside the best"


def test_what_explains_less_beside_the_best_begins_anew_only_where_the_base_may_stand_in_for_it(rubbing):
    """Far from the noise a confusable effect that closes nothing is not identified from the beginning, too."""
    search, base, _, ranked = rubbing
    (best,) = search.singles(base, [s for s in ranked if s.candidate.id == "coulomb_friction"])
    bound = Structure((), dataclasses.replace(base.fitted, at_bound=("mass.damping",)))
    jobs, run, invisible = [], search.run, search.not_testable
    search.run = lambda function, asked, stage: jobs.extend(asked) or run(function, asked, stage)
    search.not_testable, begun_anew = {}, {}
    try:
        for name, now in (("free", base), ("bound", bound)):
            jobs.clear()
            _, after = settled(search, now, [best], choose([best], 5, search.question))
            begun_anew[name] = {j.label.split(" at ")[0] for j in jobs if j.coarse}
            assert len(after) > 1, "it was fitted beside the best"
    finally:
        search.run, search.not_testable = run, invisible
    assert begun_anew["free"] == {"coulomb_friction"}
    assert begun_anew["bound"] > begun_anew["free"]
    assert jobs[1].starts[0]["mass.mass"] == START["mass.mass"]


def test_a_sensors_fault_is_no_rival_of_what_other_sensors_show():
    """Quantisation of one sensor is listed as easily confused with dry friction, which both sensors see."""
    late = lambda u: np.concatenate([u[:1], u[:1], u[:1], u[:-3]])  # noqa: E731
    both = drive_records(3, command=late, other=lambda w, time: w)
    one_only = drive_records(3, command=late)
    for runs, expected in ((both, {"dead_time"}), (one_only, {"dead_time", "sensor_delay"})):
        asked = question(runs, Model(TwoSensors()), {"rate": RATE_NOISE, "other": RATE_NOISE})
        free, effects = ("gain", "time_constant"), ("dead_time", "sensor_delay at rate")
        search, fitted = searching(asked, effects, Model(TwoSensors()), free)
        base = Structure((), fitted)
        _, ranked = search.screened(base)
        (tried,) = search.singles(base, [s for s in ranked if s.candidate.id == "dead_time"])
        _, after = settled(search, base, [tried], choose([tried], 5, search.question))
        assert {t.members[0].id for t in after} == expected


def test_members_of_a_class_go_on_from_where_the_base_of_the_most_likely_came_to_rest(rubbing):
    search, base, _, ranked = rubbing
    search = search.asking(search.question)  # other tests fit from elsewhere, and that is remembered
    by = {s.candidate.id: s for s in ranked}
    coulomb, stribeck = search.singles(base, [by["coulomb_friction"], by["stribeck_friction"]])
    fitted = stribeck.structure.fitted
    astray = {**fitted.values, "mass.mass": 90.0, "mass.damping": 400.0}
    lost = dataclasses.replace(fitted, values=astray, likelihood=fitted.likelihood + 20)
    resting = dataclasses.replace(stribeck, structure=Structure(stribeck.structure.members, lost))
    asked, run = [], search.run
    search.run = lambda function, jobs, stage: asked.extend(jobs) or run(function, jobs, stage)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(look_back, "choose", lambda *_: Choice(coulomb, (coulomb, resting), {}))
        _, again = look_back._in_one_hollow(search, base, (coulomb, resting), near=False)
    search.run = run
    (job,) = asked
    assert job.starts[0]["mass.mass"] == coulomb.structure.fitted.values["mass.mass"]
    assert again.structure.fitted.values["mass.mass"] == pytest.approx(50.0, rel=0.05)


def test_what_begins_anew_begins_where_the_base_did(rubbing):
    search, base, *_ = rubbing
    assert _from_first(search, base).starts[0] == {n: START[n] for n in search.free}
    moved = dataclasses.replace(search, first={**search.first, "mass.mass": 33.0})
    assert _from_first(moved, base).starts[0]["mass.mass"] == 33.0
    assert _from_first(search, base).size is search.first_size
    weighed = dataclasses.replace(search, first_size=np.array([0.25]))
    assert _from_first(weighed, base).size is weighed.first_size, "weighed as the base was, too"
    asked = []
    weighed.run = lambda work, jobs, what: [asked.extend(jobs), *(work(job) for job in jobs)][1:]
    from_the_beginning(weighed, base)
    coarse = [job for job in asked if job.coarse]
    assert coarse and all(job.size is weighed.first_size for job in coarse)


def test_what_a_named_effect_is_a_finer_form_of_is_no_rival_beside_it():
    """Friction that depends on the position is easily confused with dry friction, and contains it."""
    effects = ["coulomb_friction", "position_dependent_friction", "command_deadband"]
    search, base = searching(question(records(3, dry=60.0)), effects)
    now, deadband = grown(search, Structure((), base), "position_dependent_friction"), one(search, "command_deadband")
    best = search.judged(
        Tried((deadband,), None, grown(search, Structure((), base), "position_dependent_friction", deadband.id)), now
    )
    assert "coulomb_friction" in deadband.effect.confused_with
    assert look_back._confusable(search, now, [best], best) == []
    alike = look_back._confusable(
        search, Structure((), dataclasses.replace(base, at_bound=("mass.damping",))), [best], best
    )
    assert "coulomb_friction" in [t.members[0].id for t in alike], "where nothing contains it"
