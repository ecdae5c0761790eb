"""The search prefers the simple, looks back, joins what belongs together and drops what has become idle."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

import hydrotwin
from hydrotwin.discovery import forward
from hydrotwin.discovery.answering import Found, Step
from hydrotwin.discovery.choose import Choice, choose, label
from hydrotwin.discovery.decide import Evidence, bic_needed
from hydrotwin.discovery.forward import _more, _with_undecided
from hydrotwin.discovery.look_back import from_the_beginning, pruned, settled
from hydrotwin.discovery.refit import RefitJob, refit
from hydrotwin.discovery.search import IMPLAUSIBLE, Structure, Tried
from hydrotwin.models.effects import candidates
from tests.discovery.slides import Inline, better, found, question, records, searching, slide


@pytest.fixture(scope="module")
def rubbing():
    """30 N of dry friction: search, base, screen and ranking."""
    effects = ("coulomb_friction", "stribeck_friction", "null_bias", "drift", "viscous_friction")
    search, fitted = searching(question(records(3, dry=30.0)), effects)
    base = Structure((), fitted)
    return search, base, *search.screened(base)


@pytest.fixture(scope="module")
def rubbing_finely():
    """30 N of dry friction and what refines it: search and base."""
    refined = ("stribeck_friction", "asymmetric_friction", "position_dependent_friction")
    search, fitted = searching(question(records(3, dry=30.0)), ("coulomb_friction", "null_bias", *refined))
    return search, Structure((), fitted)


def one(search, name):
    return next(c for c in search.candidates if c.id == name)


def grown(search, now: Structure, *names: str, **values: float) -> Structure:
    """``now`` with effects added and fitted, from ``values`` by effect."""
    members = tuple(one(search, name) for name in names)
    start = {c.free[0]: values.get(c.id, c.probes[0].get(c.free[0], 0.0)) for c in members}
    return search.refitted(now, [(members, [start])])[0].structure


# -- the simple before the refined -----------------------------------------------------------------------------------
def test_a_refinement_that_promises_no_more_than_the_simple_effect_waits(rubbing):
    search, _, _, ranked = rubbing
    ids = [s.candidate.id for s in search.shortlist(ranked)]
    assert ids[0] == "coulomb_friction" and "stribeck_friction" not in ids


def test_the_simple_effect_is_refitted_beside_a_refinement_that_promises_more(rubbing):
    search, _, _, ranked = rubbing
    by = {s.candidate.id: s for s in ranked}
    strong = dataclasses.replace(by["stribeck_friction"], evidence=4 * by["coulomb_friction"].evidence)
    chosen = search.shortlist(sorted([*(s for s in ranked if s.candidate.id != "stribeck_friction"), strong],
                                     key=lambda s: -s.evidence))  # fmt: skip
    assert {"coulomb_friction", "stribeck_friction"} <= {s.candidate.id for s in chosen}


def test_a_refinement_is_not_preferred_without_gain(rubbing):
    search, base, _, ranked = rubbing
    by = {s.candidate.id: s for s in ranked}
    tried = search.singles(base, [by["coulomb_friction"], by["stribeck_friction"]])
    assert all(t.evidence.passes(5) for t in tried)
    choice = choose(tried, 5, search.question)
    assert label(choice.best) == "coulomb_friction at mass.flange"
    assert [label(t) for t in choice.members] == ["coulomb_friction at mass.flange"]


def test_a_refinement_takes_the_place_of_the_simple_effect_at_its_site(rubbing):
    search, base, *_ = rubbing
    simple, refined, bias = (one(search, n) for n in ("coulomb_friction", "stribeck_friction", "null_bias"))
    now = Structure((simple, bias), base.fitted)
    assert [c.id for c in search.joined(now, [refined])] == ["null_bias", "stribeck_friction"]
    assert [c.id for c in search.joined(base, [simple])] == ["coulomb_friction"]


@pytest.mark.parametrize("name", ["stribeck_friction", "asymmetric_friction", "position_dependent_friction"])
def test_a_refinement_starts_where_the_simple_effect_ended_and_never_fits_worse(rubbing_finely, name):
    search, base = rubbing_finely
    now = grown(search, base, "coulomb_friction", coulomb_friction=20.0)
    screened = next(s for s in search.screened(now)[1] if s.candidate.id == name)
    (refined,) = search.singles(now, [screened])
    assert [c.id for c in refined.structure.members] == [name]
    assert refined.structure.fitted.likelihood < now.fitted.likelihood + 0.1


def test_refinements_of_what_explains_almost_as_much_as_the_most_are_tried(rubbing_finely):
    search, base = rubbing_finely
    _, ranked = search.screened(base)
    coulomb = next(s for s in ranked if s.candidate.id == "coulomb_friction")
    (tried,) = search.singles(base, [coulomb])
    more = dataclasses.replace(tried.evidence, closed=tried.evidence.closed + 0.02)
    ahead = dataclasses.replace(tried, members=(one(search, "null_bias"),), evidence=more)
    found = {t.members[0].id for t in search.finer(base, ranked, [tried, ahead])}
    assert found == {"stribeck_friction", "asymmetric_friction", "position_dependent_friction"}
    assert not search.finer(base, ranked, [tried]), "the most is refined once it is named"
    far = dataclasses.replace(ahead, evidence=dataclasses.replace(more, closed=tried.evidence.closed + 0.2))
    assert not search.finer(base, ranked, [tried, far])


def test_a_refinement_must_close_more_of_the_gap_than_an_inexact_form_leaves(rubbing):
    search, base, *_ = rubbing
    now = grown(search, base, "coulomb_friction", coulomb_friction=20.0)
    refined = Tried(now.members, None, now)
    assert not _more(refined, now, base, search)
    assert _more(refined, base, base, search)


def test_a_refinement_that_may_or_may_not_be_it_is_told_beside_the_simple_effect(rubbing):
    search, base, _, ranked = rubbing
    by = {s.candidate.id: s for s in ranked}
    simple, refined, other = search.singles(base, [by[n] for n in ("coulomb_friction", "stribeck_friction", "drift")])
    step = Step(Choice(simple, (simple,), {label(simple): 1.0}), (), (simple,), base)
    leaning, against = Evidence(40.0, 1.5, 0.2), Evidence(40.0, -1.5, 0.2)
    told = [dataclasses.replace(t, evidence=e) for t, e in ((refined, leaning), (other, leaning))]
    (found,) = _with_undecided((step,), told)
    assert [label(t) for t in found.choice.members] == [label(simple), label(refined)]
    assert found.choice.probability == {label(simple): 0.5, label(refined): 0.5}
    (left,) = _with_undecided((step,), [dataclasses.replace(refined, evidence=against)])
    assert left.choice.members == (simple,)


def test_at_a_dead_end_the_search_goes_on_from_another_of_the_class_and_drops_what_led_nowhere(rubbing, monkeypatch):
    search, base, _, ranked = rubbing
    by = {s.candidate.id: s for s in ranked}
    tried = search.singles(base, [by[n] for n in ("coulomb_friction", "stribeck_friction", "drift")])
    choice = Choice(tried[0], tuple(tried), {label(t): p for t, p in zip(tried, (0.5, 0.3, 0.2), strict=True)})
    step, seen, asked = Step(choice, (), tuple(tried), base), [], search.question.noise.copy()
    monkeypatch.setattr(forward, "reconsidered", lambda search, now: now)

    def leading(search, base, now, most, steps, turning):
        seen.append(now.members[0].id)
        search.ask(2 * asked)
        more = (step,) if now.members[0].id in onwards else ()
        return Found(base, now, (*steps, *more), ())

    monkeypatch.setattr(forward, "_forward", leading)
    monkeypatch.setattr(forward, "_rejoined", lambda search, found, number, left: found)
    onwards = {"drift"}
    found = forward._turned(search, base, 3, (step,))
    assert seen == ["stribeck_friction", "drift"] and found.last is tried[2].structure
    assert found.steps[0].choice.members == (tried[2],) and found.steps[0].choice.probability == {label(tried[2]): 1.0}
    search.ask(asked)
    onwards = set()
    assert forward._turned(search, base, 3, (step,)) is None
    assert np.array_equal(search.question.noise, asked), "as if nothing had been tried"


def test_what_led_nowhere_stays_in_the_class_when_it_does_as_well_beside_what_was_found():
    runs = [r.with_signals({"force": r.signals["force"] - 40.0}) for r in records(3, dry=30.0)]  # 40 N are not recorded
    search, fitted = searching(question(runs), ("coulomb_friction", "null_bias", "constant_load", "drift"))
    base = Structure((), fitted)
    alone = {n: search.refitted(base, [((one(search, n),), [])])[0] for n in ("null_bias", "constant_load", "drift")}
    last = grown(search, base, "null_bias", "coulomb_friction", null_bias=30.0)
    best = alone["null_bias"]
    step = Step(Choice(best, (best,), {label(best): 1.0}), (), (best,), base)
    found = forward._rejoined(search, Found(base, last, (step,), ()), 0, (alone["constant_load"], alone["drift"]))
    assert [t.members[0].id for t in found.steps[0].choice.members] == ["null_bias", "constant_load"]


@pytest.mark.parametrize("machine", ["cehA", "spool_valve"])
def test_seals_that_oil_presses_on_refine_the_dry_friction_of_the_same_rod(machine):
    known = {c.label: c for c in candidates(hydrotwin.load(machine))}
    (seals,) = [c for c in known.values() if c.id == "pressure_dependent_friction"]
    rubbing = [c for c in known.values() if c.id == "coulomb_friction"]
    assert [seals.refines(c) for c in rubbing] == [True]
    force = seals.containing(rubbing[0], {f"{rubbing[0].name}.force": 7.0})
    assert force == {f"{seals.name}.force": 7.0}


# -- refits ------------------------------------------------------------------------------------------------------------
def test_a_structure_is_fitted_once_and_known_again(rubbing):
    search, base, *_ = rubbing
    counted = []
    counting = dataclasses.replace(search)
    counting.run = lambda f, jobs, stage: counted.append(len(jobs)) or [f(j) for j in jobs]
    counting._known = {}
    first, again = (grown(counting, base, "coulomb_friction") for _ in range(2))
    assert again is first and counted == [1, 0]


def test_starts_are_the_proposal_and_the_probes_never_neutral(rubbing):
    search, _, _, ranked = rubbing
    starts = search.starts_of(next(s for s in ranked if s.candidate.id == "coulomb_friction"))
    forces = [start["coulomb_friction.force"] for start in starts]
    assert forces[0] == forces[1] and forces[2:] == [50.0, 500.0] and min(forces) > 10.0
    beside = {n: v for n, v in starts[0].items() if n in search.free}
    assert set(beside) == set(search.free)  # the base moves with it: what it had absorbed is given back


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


def test_candidates_take_part_in_an_identification_from_the_beginning(rubbing):
    search, base, *_ = rubbing
    tried = from_the_beginning(search, base)
    best = max(tried, key=lambda t: t.evidence.bic_gain)
    assert label(best).startswith("coulomb_friction") and best.evidence.passes(5)
    assert best.structure.fitted.values["coulomb_friction.force"] == pytest.approx(30.0, rel=0.05)


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


def test_a_gap_is_explained_only_at_the_noise(rubbing):
    search, base, *_ = rubbing
    assert not search.explained(base)
    assert search.explained(grown(search, base, "coulomb_friction", coulomb_friction=30.0))
    assert search.needed == pytest.approx(bic_needed(5))


def test_what_cannot_be_added_is_left_out_with_its_reason(rubbing):
    search, fitted = searching(question(records(3)), ("null_bias", "coulomb_friction"))
    good = candidates(slide(), ["null_bias"])
    broken = dataclasses.replace(
        candidates(slide(), ["coulomb_friction"])[0],
        site=dataclasses.replace(search.candidates[0].site, ties={"flange": "mass.nowhere"}, through=None),
    )
    search.candidates = (*good, broken)
    search._big = None
    _, ranked = search.screened(Structure((), fitted))
    assert [s.candidate.id for s in ranked] == ["null_bias"]
    ((name, why),) = search.unusable.items()
    assert name.startswith("coulomb_friction") and "nowhere" in why


def test_a_pair_that_explains_only_together_is_tried():
    """A late force and dry friction: neither alone leaves the noise."""
    search, fitted = searching(question(records(3, dry=40.0, late=5)), ("coulomb_friction", "dead_time", "drift"))
    base = Structure((), fitted)
    screen, ranked = search.screened(base)
    pairs = search.pairs(base, screen, ranked, search.singles(base, ranked))
    best = max(pairs, key=lambda t: t.evidence.bic_gain)
    assert {c.id for c in best.members} == {"coulomb_friction", "dead_time"}
    assert search.explained(best.structure)


# -- plausibility ------------------------------------------------------------------------------------------------------
def test_a_value_far_outside_what_is_usual_is_implausible(rubbing):
    search, base, *_ = rubbing
    c = one(search, "coulomb_friction")
    for force, implausible in ((30.0, False), (1.5 * IMPLAUSIBLE * c.typical["coulomb_friction.force"][1], True)):
        fitted = dataclasses.replace(base.fitted, values={**base.fitted.values, "coulomb_friction.force": force})
        tried = Tried((c,), None, Structure((c,), fitted), better())
        assert bool(tried.implausible) == implausible
    assert "coulomb_friction.force" in tried.implausible and "2e+03" in tried.implausible


def test_the_order_in_which_effects_were_found_does_not_change_the_model(rubbing):
    search, *_ = rubbing
    friction, bias = one(search, "coulomb_friction"), one(search, "null_bias")
    one_way, other = search.model([friction, bias]).flat, search.model([bias, friction]).flat
    assert [p.name for p in one_way.parameters] == [p.name for p in other.parameters]
    x, p = np.array([0.1] * len(one_way.states)), one_way.parameter_vector()
    assert np.array_equal(one_way.ode(0, x, [5.0], p)[0].full(), other.ode(0, x, [5.0], p)[0].full())


def test_forward_and_back_by_hand_are_what_discover_does():
    d = found(records(3, dry=30.0), ["coulomb_friction", "null_bias", "drift"], executor=Inline())
    assert d.verdict == "named" and [s.effect for s in d.steps] == ["coulomb_friction"]


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


def test_a_refit_never_moves_what_only_another_structure_frees():
    """A displacement freed as an effect is a number again in the structures without that effect."""
    search, fitted = searching(question(records(3)), ("null_bias",), free=("mass.damping",))
    there = Structure((), dataclasses.replace(fitted, values={**fitted.values, "mass.mass": 99.0}))
    job = search._job(there, (one(search, "null_bias"),), [{"null_bias.offset": 0.1}])
    assert all("mass.mass" not in start for start in job.starts)


def test_a_structure_that_costs_many_times_the_base_is_followed_from_one_start(monkeypatch):
    """Dry friction on a rod without mass is a loop to be solved at every step: nine times the operations."""
    search, fitted = searching(question(records(3)), ("coulomb_friction", "stribeck_friction"))
    now, members = Structure((), fitted), (one(search, "stribeck_friction"),)
    assert search._job(now, members, [{}]).follow > 1
    monkeypatch.setattr("hydrotwin.discovery.search.HEAVY", 0.5)
    assert search._job(now, members, [{}]).follow == 1
