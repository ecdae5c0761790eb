"""The search prefers the simple, looks back, joins what belongs together and drops what has become idle."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import hydrotwin
from hydrotwin.discovery import forward, refinements
from hydrotwin.discovery.answering import Found, Step
from hydrotwin.discovery.choose import Choice, choose, label
from hydrotwin.discovery.decide import Evidence, bic_needed
from hydrotwin.discovery.refinements import _beside, leans, may_be, more_than_inexact, own_part
from hydrotwin.discovery.search import Search
from hydrotwin.discovery.structure import IMPLAUSIBLE, Structure, Tried
from hydrotwin.models.effects import candidates
from tests.discovery.slides import Inline, better, found, grown, one, question, record, records, searching, slide


@pytest.fixture(scope="module")
def rubbing_finely():
    """30 N of dry friction and what refines it: search and base."""
    refined = ("stribeck_friction", "asymmetric_friction", "position_dependent_friction")
    search, fitted = searching(question(records(3, dry=30.0)), ("coulomb_friction", "null_bias", *refined))
    return search, Structure((), fitted)


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
    assert not more_than_inexact(refined, now, base, search)
    assert more_than_inexact(refined, base, base, search)


def with_own_part(search, base, excess):
    """Coulomb friction fitted, and its refinement of which so large a share is excess at low speed."""
    now = grown(search, base, "coulomb_friction", coulomb_friction=20.0)
    finer = one(search, "stribeck_friction")
    force = next(v for n, v in now.fitted.values.items() if n.endswith("force") and "coulomb" in n)
    values = dict(zip(finer.free, (force * (1 - excess), force * excess, 0.02), strict=True))
    fitted = dataclasses.replace(now.fitted, values={**now.fitted.values, **values})
    return now, Tried((finer,), None, Structure((finer,), fitted), Evidence(40.0, 1.5, 0.2))


def test_a_refinement_that_may_be_it_makes_a_class_of_the_answer(monkeypatch):
    monkeypatch.setattr(refinements, "may_be", lambda tried, now: True)
    monkeypatch.setattr(Search, "refinements", lambda search, now, ranked: list(ranked))
    told = found(records(3, dry=30.0), ("coulomb_friction", "stribeck_friction"), validate=[record(9, dry=30.0)])
    (step,) = told.steps
    assert told.verdict == "class" and [e for e, _ in step.members] == ["coulomb_friction", "stribeck_friction"]
    assert step.probability < 0.6


@pytest.mark.parametrize("evidence", [Evidence(-9.0, -1.5, 0.0), Evidence(40.0, 0.3, 0.0)])
def test_a_refinement_that_does_as_well_with_other_physics_may_be_it(rubbing, evidence):
    search, base, *_ = rubbing
    now, other = with_own_part(search, base, 0.8)
    assert own_part(other, now) == pytest.approx(0.8)
    _, trifle = with_own_part(search, base, 0.05)
    other, trifle = (dataclasses.replace(t, evidence=evidence) for t in (other, trifle))
    assert may_be(other, now)
    assert not may_be(trifle, now), "it is the simple effect by another name"


@pytest.mark.parametrize("evidence", [Evidence(-11.0, 1.5, 0.0), Evidence(40.0, -2.5, 0.0)])
def test_a_refinement_that_does_worse_is_not_it(rubbing, evidence):
    search, base, *_ = rubbing
    now, other = with_own_part(search, base, 0.8)
    assert not may_be(dataclasses.replace(other, evidence=evidence), now)


def test_a_refinement_that_explains_more_than_an_inexact_form_may_be_it_however_small_its_part(rubbing):
    search, base, *_ = rubbing
    now, trifle = with_own_part(search, base, 0.05)
    assert leans(trifle, base, base, search), "the base leaves all of the gap"
    assert not leans(trifle, now, base, search), "nothing is left"
    surely = dataclasses.replace(trifle, evidence=Evidence(40.0, 2.5, 0.5))
    assert not leans(surely, base, base, search), "then it is named instead"


def test_a_refinement_that_may_be_it_shares_the_probability_of_the_simple_effect(rubbing):
    search, base, _, ranked = rubbing
    by = {s.candidate.id: s for s in ranked}
    names = ("coulomb_friction", "stribeck_friction", "drift")
    simple, *told = search.singles(base, [by[n] for n in names])
    choice = Choice(simple, (simple,), {label(simple): 1.0})
    step = Step(choice, (), (simple,), base)
    found = _beside(dataclasses.replace(step, revised={label(simple): step}), told)
    for choice in (found.choice, found.revised[label(simple)].choice):
        assert [t.members[0].id for t in choice.members] == [*names[:2]], "a drift refines nothing here"
        assert list(choice.probability.values()) == [0.5, 0.5]
    assert _beside(found, told).choice.members == found.choice.members, "each of them once"
    assert list(step.choice.beside(told).probability.values()) == [0.5, 0.25, 0.25], "together as likely as it"


def test_at_a_dead_end_the_search_goes_on_from_another_of_the_class_and_drops_what_led_nowhere(rubbing, monkeypatch):
    search, base, _, ranked = rubbing
    by = {s.candidate.id: s for s in ranked}
    tried = search.singles(base, [by[n] for n in ("coulomb_friction", "stribeck_friction", "null_bias", "drift")])
    shares = zip(tried, (0.4, 0.3, 0.2, 0.1), strict=True)
    choice = Choice(tried[0], tuple(tried), {label(t): p for t, p in shares})
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
    assert seen == ["null_bias", "drift"], "a refinement of the best leads where the best does"
    assert found.last is tried[3].structure
    assert found.steps[0].choice.members == (tried[3],) and found.steps[0].choice.probability == {label(tried[3]): 1.0}
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
    (dry,) = search.refitted(base, [((one(search, "coulomb_friction"),), [])])
    found = forward._rejoined(search, Found(base, last, (step,), ()), 0, (dry,))
    assert found.steps[0].choice.members == (best,), "it was named beside the best, and stands for nothing in its place"


def test_several_starts_are_followed_for_a_limit_that_is_added_not_for_what_comes_beside_one():
    search, fitted = searching(question(records(3, limit=280.0)), ("command_saturation", "null_bias"))
    cut, bias = ((c,) for c in sorted(search.candidates, key=lambda c: c.id))
    followed, run = [], search.run
    search.run = lambda f, jobs, stage: followed.extend(job.follow for job in jobs) or run(f, jobs, stage)
    (limited,) = search.refitted(Structure((), fitted), [(cut, [{cut[0].free[0]: 250.0}])])
    search.refitted(limited.structure, [(bias, [{}])])
    search.refitted(Structure((), fitted), [(bias, [{}])])
    assert followed == [3, 1, 1]


@pytest.mark.parametrize("machine", ["cehA", "spool_valve"])
def test_seals_that_oil_presses_on_refine_the_dry_friction_of_the_same_rod(machine):
    known = {c.label: c for c in candidates(hydrotwin.load(machine))}
    (seals,) = [c for c in known.values() if c.id == "pressure_dependent_friction"]
    rubbing = [c for c in known.values() if c.id == "coulomb_friction"]
    assert [seals.refines(c) for c in rubbing] == [True, False][: len(rubbing)]  # the joint of the arm is another place
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


def test_the_models_of_a_screen_are_made_one_at_a_time_before_they_are_asked_for():
    search, _ = searching(question(records(3)), ("command_saturation", "rate_limit", "coulomb_friction"))
    ahead, probed = search.models_ahead(), [c for c in search.candidates if c.id != "coulomb_friction"]
    next(ahead)
    assert search._big is not None and set(search._models) == {tuple(c.label for c in search.candidates)}
    assert len(list(ahead)) == len(probed) - 1
    made = {key: id(model) for key, model in search._models.items()}
    assert len(made) == 1 + len(probed)
    assert [id(search.model([c])) for c in probed] == [made[(c.label,)] for c in probed]


def test_starts_are_the_proposal_and_the_probes_never_neutral(rubbing):
    search, _, _, ranked = rubbing
    starts = search.starts_of(next(s for s in ranked if s.candidate.id == "coulomb_friction"))
    forces = [start["coulomb_friction.force"] for start in starts]
    assert forces[0] == forces[1] and forces[2:] == [50.0, 500.0] and min(forces) > 10.0
    beside = {n: v for n, v in starts[0].items() if n in search.free}
    assert set(beside) == set(search.free)  # the base moves with it: what it had absorbed is given back


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


def test_beside_what_almost_passed_the_screen_sees_what_the_base_stood_in_for():
    """A pair of a near miss with what is found from there; nothing is tried where nothing came near."""
    search, fitted = searching(question(records(3, dry=40.0, late=5)), ("coulomb_friction", "dead_time", "drift"))
    base = Structure((), fitted)
    _, ranked = search.screened(base)
    alone = search.singles(base, [s for s in ranked if s.candidate.id == "coulomb_friction"])
    pairs = forward._beside_a_near_miss(search, base, alone)
    best = max(pairs, key=lambda t: t.evidence.bic_gain)
    assert {c.id for c in best.members} == {"coulomb_friction", "dead_time"} and search.explained(best.structure)
    assert best.evidence.bic_gain > alone[0].evidence.bic_gain, "judged against the base"
    far = [dataclasses.replace(t, evidence=Evidence(-1.0, 3.0, 0.5)) for t in alone]
    assert forward._beside_a_near_miss(search, base, far) == []


# -- screens ---------------------------------------------------------------------------------------------------------
def test_what_was_screened_last_is_not_screened_again_unless_the_question_changes(rubbing, monkeypatch):
    search, base, *_ = rubbing
    stages = []
    monkeypatch.setattr(search, "_seen", (None, None))
    monkeypatch.setattr(search, "report", lambda stage, *more: stages.append(stage))
    few = [one(search, "coulomb_friction"), one(search, "drift")]
    _, ranked = search.screened(base, few)
    assert {s.candidate.id for s in ranked} == {"coulomb_friction", "drift"} and stages.count("screen") == 1
    _, whole = search.screened(base)
    assert len(whole) == len(search.candidates) and stages.count("screen") == 2, "it holds more"
    _, again = search.screened(base, few)
    assert stages.count("screen") == 2 and [s.candidate for s in again] == [s.candidate for s in ranked]
    assert [s.gain for s in again] == pytest.approx([s.gain for s in ranked])
    monkeypatch.setattr(search, "question", dataclasses.replace(search.question, noise=2 * search.question.noise))
    search.screened(base, few)
    assert stages.count("screen") == 3


# -- plausibility ------------------------------------------------------------------------------------------------------
def test_a_value_far_outside_what_is_usual_is_implausible(rubbing):
    search, base, *_ = rubbing
    c = one(search, "coulomb_friction")
    for force, implausible in ((30.0, False), (1.5 * IMPLAUSIBLE * c.typical["coulomb_friction.force"][1], True)):
        fitted = dataclasses.replace(base.fitted, values={**base.fitted.values, "coulomb_friction.force": force})
        tried = Tried((c,), None, Structure((c,), fitted), better())
        assert bool(tried.implausible) == implausible
    assert "coulomb_friction.force" in tried.implausible and "2e+03" in tried.implausible


@pytest.mark.parametrize(
    ("name", "parameter", "value", "implausible"),
    [
        ("end_stop", "low", -1000.0, False),  # where it began: nothing comes there
        ("end_stop", "low", -500.0, False),
        ("end_stop", "low", 500.0, True),
        ("command_saturation", "limit", 1e5, False),
        ("rate_limit", "rate", 1e6, False),
        ("check_valve_cracking", "pressure", 1e9, True),  # absent far below zero
        ("relief_saturation", "pressure", 1e6, False),
        ("relief_saturation", "pressure", 1e4, True),  # that is a leak
    ],
)
def test_a_value_nearer_to_where_nothing_happens_than_what_is_usual_is_plausible(name, parameter, value, implausible):
    c = candidates(hydrotwin.load("cehA"), [name])[0]
    (path,) = (n for n in c.free if n.endswith(f".{parameter}"))
    fitted = SimpleNamespace(values={**{n: c.typical[n][1] for n in c.free}, path: value})
    tried = Tried((c,), None, Structure((c,), fitted), better())
    assert bool(tried.implausible) == implausible


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


def test_what_a_named_effect_refines_is_not_looked_for_again_at_its_place():
    search, base = searching(question(records(3, dry=60.0)), ["coulomb_friction", "stribeck_friction", "dead_time"])
    rough, fine = (grown(search, Structure((), base), name) for name in ("coulomb_friction", "stribeck_friction"))
    assert {s.candidate.id for s in search.screened(fine)[1]} == {"dead_time"}
    assert {s.candidate.id for s in search.screened(rough)[1]} == {"stribeck_friction", "dead_time"}
