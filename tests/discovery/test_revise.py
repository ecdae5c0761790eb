"""Named effects looked for again beside the others: what was chosen too early is replaced, classes computed anew."""

from __future__ import annotations

import dataclasses

import pytest

from hydrotwin.discovery import forward
from hydrotwin.discovery.answering import Found, Step
from hydrotwin.discovery.choose import Choice, label
from hydrotwin.discovery.forward import _best_of_singles_and_pairs, _pruned, _without
from hydrotwin.discovery.revise import _from_the_present, _keeping, revised
from hydrotwin.discovery.structure import Structure, Tried
from tests.discovery.slides import question, records, searching

EFFECTS = ("coulomb_friction", "dead_time", "actuator_lag", "null_bias")


@pytest.fixture(scope="module")
def late_and_rubbing():
    """30 N of dry friction and a dead time of 60 ms: search and base."""
    search, fitted = searching(question(records(3, dry=30.0, late=3)), EFFECTS)
    return search, Structure((), fitted)


def found_by(search, base, *names) -> Found:
    """As if a forward search had named these, one after the other."""
    steps, now = [], base
    for name in names:
        candidate = next(c for c in search.candidates if c.id == name)
        (tried,) = search.refitted(now, [((candidate,), candidate.probes)])
        steps.append(Step(Choice(tried, (tried,), {label(tried): 1.0}), (), (tried,), now))
        now = tried.structure
    return Found(base, now, tuple(steps), ())


def test_what_was_named_too_early_is_replaced_once_the_other_is_there(late_and_rubbing):
    search, base = late_and_rubbing
    before = found_by(search, base, "actuator_lag", "coulomb_friction")
    after, replaced = revised(search, before)
    assert replaced
    assert {c.id for c in after.last.members} == {"dead_time", "coulomb_friction"}
    assert after.last.fitted.likelihood < before.last.fitted.likelihood - 100
    assert [c.id for s in after.steps for c in s.choice.best.members] == ["dead_time", "coulomb_friction"]
    assert after.last.fitted.values["dead_time.time"] == pytest.approx(0.06, abs=2e-3)
    assert after.steps[-1].choice.best.structure is after.last
    assert search.explained(after.last)


def test_what_is_right_stays_and_its_class_is_that_beside_the_others(late_and_rubbing):
    search, base = late_and_rubbing
    before = found_by(search, base, "dead_time", "coulomb_friction")
    after, replaced = revised(search, before)
    assert not replaced and after.last is before.last
    (again,) = after.steps[0].revised.values()
    assert [c.id for c in again.before.members] == ["coulomb_friction"]
    assert {label(t) for t in again.tried} >= {"dead_time at force", "actuator_lag at force"}
    assert [label(t) for t in after.steps[0].choices()[0].members] == ["dead_time at force"]
    assert not after.steps[1].revised, "chosen with the other in place already"


@pytest.mark.parametrize(("odds", "first"), [(0.9, "dead_time"), (0.1, "actuator_lag")])
def test_of_two_that_are_hardly_told_apart_the_present_one_stays(late_and_rubbing, odds, first):
    search, _ = late_and_rubbing
    one, other = (next(c for c in search.candidates if c.id == name) for name in ("actuator_lag", "dead_time"))
    tried = (Tried((one,), None), Tried((other,), None))
    choice = Choice(tried[0], tried, {label(tried[0]): 1 / (1 + odds), label(tried[1]): odds / (1 + odds)})
    kept = _keeping(choice, other)
    assert kept.best.members[0].id == kept.members[0].members[0].id == first
    assert set(kept.members) == set(tried) and kept.probability == choice.probability


def test_a_single_effect_is_left_alone(late_and_rubbing):
    search, base = late_and_rubbing
    before = found_by(search, base, "coulomb_friction")
    assert revised(search, before) == (before, False)


def test_of_two_named_together_each_gets_a_class_of_its_own(late_and_rubbing):
    search, base = late_and_rubbing
    members = tuple(next(c for c in search.candidates if c.id == n) for n in ("dead_time", "coulomb_friction"))
    start = {n: v for c in members for n, v in c.probes[0].items()}
    (pair,) = search.refitted(base, [(members, [start])])
    step = Step(Choice(pair, (pair,), {label(pair): 1.0}), (), (pair,), base)
    after, replaced = revised(search, Found(base, pair.structure, (step,), ()))
    assert not replaced
    assert {label(c.best) for c in after.steps[0].choices()} == {c.label for c in members}


def test_a_pair_that_lost_a_member_is_a_class_of_what_is_left(late_and_rubbing):
    search, base = late_and_rubbing
    by = {c.id: c for c in search.candidates}
    late, rubs, off = by["dead_time"], by["coulomb_friction"], by["null_bias"]
    pairs = [Tried(members, None) for members in ((late, rubs), (off, rubs), (late, off))]
    alone = [Tried((late,), None), Tried((rubs,), None)]
    share = dict(zip(map(label, pairs), (0.5, 0.3, 0.2), strict=True))
    step = Step(Choice(pairs[0], tuple(pairs), share), (), (*alone, *pairs), base)
    assert _without(step, {off.label}) is step, "what the best never had"
    less = _without(step, {rubs.label})
    assert less.choice.probability == {late.label: 0.5, off.label: 0.3, label(pairs[2]): 0.2}
    assert [label(t) for t in less.choice.members] == list(less.choice.probability)
    assert [label(t) for t in less.tried] == [*less.choice.probability, rubs.label]


def test_of_a_pair_of_which_one_is_idle_the_other_is_compared_with_all_that_was_tried_alone():
    search, fitted = searching(question(records(3, dry=30.0)), EFFECTS)
    base, by = Structure((), fitted), {c.id: c for c in search.candidates}
    members = (by["null_bias"], by["coulomb_friction"])
    (pair,) = search.refitted(base, [(members, [{**members[0].probes[0], **members[1].probes[0]}])])
    alone = search.refitted(base, [((by["actuator_lag"],), by["actuator_lag"].probes)])
    step = Step(Choice(pair, (pair,), {label(pair): 1.0}), (), (*alone, pair), base)
    after = _pruned(search, Found(base, pair.structure, (step,), ()))
    (step,) = after.steps
    assert after.last.key == (by["coulomb_friction"].label,) == tuple(c.label for c in step.choice.best.members)
    assert {label(t) for t in step.tried} >= {by["coulomb_friction"].label, by["actuator_lag"].label}
    for t in step.tried:
        assert {n for c in t.members for n in c.free} <= t.structure.fitted.values.keys(), "as the report asks"
    assert step.choice.best.evidence.closed > 0.99


def test_what_is_left_of_a_pair_and_gets_no_name_is_still_known(monkeypatch):
    search, fitted = searching(question(records(3, dry=30.0)), EFFECTS)
    base, by = Structure((), fitted), {c.id: c for c in search.candidates}
    members = (by["null_bias"], by["coulomb_friction"])
    (pair,) = search.refitted(base, [(members, [{**members[0].probes[0], **members[1].probes[0]}])])
    step = Step(Choice(pair, (pair,), {label(pair): 1.0}), (), (pair,), base)
    monkeypatch.setattr(forward, "choose", lambda *_: None)  # recordings to choose by do not confirm it
    after = _pruned(search, Found(base, pair.structure, (step,), ()))
    assert not after.steps and after.last.members == ()
    assert [label(t) for t in after.screens[-1][2]] == [by["coulomb_friction"].label]


def test_what_singles_explained_is_known_after_a_pair_took_their_place(monkeypatch):
    search, fitted = searching(question(records(3, dry=30.0)), EFFECTS)
    base, cut = Structure((), fitted), search.candidates[0]
    (tried,) = search.refitted(base, [((cut,), cut.probes)])
    step = Step(Choice(tried, (tried,), {label(tried): 1.0}), (), (tried,), base)
    alone = Found(base, base, (), ((None, (), (tried,)),))
    both = Found(base, tried.structure, (step,), ((None, (), ()),))
    monkeypatch.setattr(forward, "_forward", lambda s, base, now, most, steps, **_: both if steps else alone)
    monkeypatch.setattr(forward, "choose", lambda *_: step.choice)
    monkeypatch.setattr(search, "pairs", lambda *_: [])
    assert _best_of_singles_and_pairs(search, base, 2).screens == (*alone.screens, *both.screens)


@pytest.mark.parametrize(("promise", "again"), [(1.0, True), (0.5, False)])
def test_what_promises_as_much_begins_where_the_base_stands_beside_the_present_effect(promise, again):
    """Without it the base has bent: a laminar leak rested at five times the noise beside a turbulent one at one."""
    search, fitted = searching(question(records(3, dry=30.0)), ("coulomb_friction", "asymmetric_friction"))
    base = Structure((), fitted)
    ranked = {s.candidate.id: s for s in search.screened(base)[1]}
    present, rival = search.singles(base, [ranked[name] for name in ("coulomb_friction", "asymmetric_friction")])
    at_rest = rival.structure.fitted
    bent = dataclasses.replace(at_rest, values={**at_rest.values, "mass.mass": 5e3}, likelihood=1e9)
    expected = dataclasses.replace(rival.screened, gain=promise * present.screened.gain)
    poor = dataclasses.replace(rival, screened=expected, structure=Structure(rival.members, bent))
    _, fitted_again = _from_the_present(search, base, [present, poor], present.members[0], present.structure)
    assert (fitted_again.structure.fitted.likelihood == pytest.approx(at_rest.likelihood, rel=1e-3)) is again
    assert fitted_again.evidence.passes(2) or not again
