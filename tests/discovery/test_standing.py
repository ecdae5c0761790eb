"""Standing: nothing, a name, a class or something else, read from the scores of all fits."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery.answer.standing import standing
from hydrotwin.models.language import Model
from tests.discovery.slides import RATE_NOISE, TwoSensors, begun, drive_records, records
from tests.discovery.test_table import leaving

EFFECTS = ("coulomb_friction", "null_bias", "dead_time")


@pytest.fixture
def table():
    return begun(records(3), EFFECTS).table


def fitted(table, all_seen=True, **times):
    """What a table says whose structures, ids joined by "_and_", leave so many times the noise."""
    by = {c.id: c for c in table.candidates}
    for name, left in times.items():
        members = [] if name == "base" else [by[n] for n in name.split("_and_")]
        table.entry(members).fitted = leaving(left)
    if all_seen:
        seen(table)
    return standing(table)


def seen(table):
    """Every single effect has been looked at, also in the place of those that are fitted, and comes to nothing."""
    for c in table.candidates:
        entry = table.entry([c])
        entry.failed = "" if entry.fitted else "it diverges"
    for best in table.fitted:
        for other in (table.entry(members) for one in best.members for members in table.instead(best, one)):
            other.beside = np.nan if other.fitted else 1.0


def test_a_base_at_the_noise_lacks_nothing(table):
    said = fitted(table, base=1.0, coulomb_friction=1.0)
    assert said.verdict == "none" and said.kept is table.entry()
    assert said.told()["nothing"] > 0.99
    assert said.best.members[0].id == "coulomb_friction", "the best of what may be missing is known all the same"


def test_a_base_alone_at_the_noise_has_no_best(table):
    said = fitted(table, base=1.0)
    assert (said.verdict, said.best, said.order) == ("none", None, ())
    assert said.told().keys() == {"nothing", "something else"}


def test_what_alone_explains_a_gap_is_named(table):
    said = fitted(table, base=30.0, coulomb_friction=1.0, null_bias=20.0)
    (label,) = said.best.key
    assert said.verdict == "named" and said.kept is said.best
    assert said.probability(label) == pytest.approx(0.97, abs=0.01)
    assert said.told() == pytest.approx({"nothing": 0.0, label: 0.97, "something else": 0.03}, abs=0.01)
    assert [c.id for c in said.order] == ["coulomb_friction"]


def test_two_that_explain_it_as_well_are_a_class_and_each_stands_for_the_other(table):
    said = fitted(table, base=30.0, coulomb_friction=1.0, dead_time=1.0, null_bias=20.0)
    assert said.verdict == "class" and len(said.class_) == 2
    (first,) = said.order
    assert {c.id for c in said.members(first)} == {"coulomb_friction", "dead_time"}
    assert said.members(first)[0] is first
    assert [said.probability(c.label) for c in said.members(first)] == pytest.approx([0.97 / 1.97] * 2, abs=0.01)


def test_what_leaves_much_of_the_gap_is_a_part_of_it_beside_something_else(table):
    said = fitted(table, base=30.0, coulomb_friction=10.0, null_bias=20.0)
    assert said.verdict == "unknown" and said.part and said.kept is said.best
    (label,) = said.best.key
    assert said.probability(label) == pytest.approx(0.8, abs=0.02)
    assert said.best.members[0].id == "coulomb_friction"
    assert said.posterior.else_ > 0.95


def test_a_part_is_not_told_before_every_effect_was_looked_at(table):
    """Another may be the whole of it."""
    said = fitted(table, all_seen=False, base=30.0, coulomb_friction=10.0)
    assert said.verdict == "unknown" and not said.part and said.kept is table.entry()
    assert said.best.members[0].id == "coulomb_friction", "what comes closest is known"


def test_what_leaves_a_little_has_no_name_while_what_nobody_looked_at_is_more_probable(table):
    said = fitted(table, all_seen=False, base=30.0, coulomb_friction=1.3)
    assert said.told()["not looked at"] > 0.5 and said.verdict == "unknown" and said.kept is table.entry()
    seen(table)
    assert standing(table).verdict == "named", "nothing else is left that could be better"


def test_what_leaves_less_than_a_name_costs_and_more_than_a_right_law_is_a_part(table, monkeypatch):
    """Of many candidates a name costs much. Everything was looked at, so nothing else explains as much."""
    monkeypatch.setattr(type(table), "_enough", lambda self: 160 * self.temperature)
    said = fitted(table, base=30.0, coulomb_friction=3.5)
    assert said.verdict == "unknown" and table.explained([said.best]) and not said.unasked
    assert said.part and said.kept is said.best


def test_what_leaves_nothing_is_named_though_others_were_not_looked_at(table):
    said = fitted(table, all_seen=False, base=30.0, coulomb_friction=1.0)
    assert said.verdict == "named" and said.probability(said.best.key[0]) < 0.7


def test_what_closes_less_than_half_of_the_gap_is_not_told_as_a_part(table):
    said = fitted(table, base=30.0, coulomb_friction=25.0)
    assert said.verdict == "unknown" and not said.part and said.kept is table.entry()
    assert said.members(said.best.members[0]) == [said.best.members[0]]


def test_of_a_pair_that_which_explains_most_alone_comes_first(table):
    pair = {"coulomb_friction_and_dead_time": 1.0}
    said = fitted(table, base=30.0, dead_time=12.0, coulomb_friction=20.0, **pair)
    assert said.verdict == "named" and [c.id for c in said.order] == ["dead_time", "coulomb_friction"]
    for c in said.order:
        assert said.probability(c.label) == pytest.approx(0.97, abs=0.01)
        assert said.members(c) == [c]


def test_in_the_place_of_one_of_a_pair_stands_only_what_explains_as_much_beside_the_other(table):
    pairs = {"coulomb_friction_and_dead_time": 1.0, "coulomb_friction_and_null_bias": 1.0}
    said = fitted(table, base=30.0, coulomb_friction=20.0, **pairs)
    assert said.verdict == "class"
    places = {frozenset(m.id for m in said.members(c)) for c in said.order}
    assert places == {frozenset({"coulomb_friction"}), frozenset({"dead_time", "null_bias"})}


def test_the_same_effect_at_two_places_is_named_and_no_class():
    runs = drive_records(3, other=lambda w, time: w)
    noise = {"rate": RATE_NOISE, "other": RATE_NOISE}
    search = begun(runs, ["sensor_bias"], model=Model(TwoSensors()), noise=noise)
    table, base = search.table, search.identify()
    for c in table.candidates:
        table.entry([c]).fitted = base.fitted
    louder = dataclasses.replace(base.fitted.left, squares=1e3 * base.fitted.left.squares)
    base.fitted = dataclasses.replace(base.fitted, left=louder)
    said = standing(table)
    assert said.verdict == "named" and len(said.class_) == 2
    assert {c.site.name for c in said.members(said.order[0])} == {"rate", "other"}


def test_what_leaves_nothing_gets_no_name_while_others_that_may_do_the_same_were_not_looked_at(table, monkeypatch):
    monkeypatch.setattr(type(table), "unseen", lambda self: 50.0)
    said = fitted(table, all_seen=False, base=30.0, coulomb_friction=1.0)
    assert said.told()["not looked at"] > 0.9 and said.verdict == "unknown" and not said.part
    assert [c.id for c in said.best.members] == ["coulomb_friction"] and said.kept is table.entry()
    monkeypatch.setattr(type(table), "unseen", lambda self: 0.5)
    assert standing(table).verdict == "named"


def test_a_part_is_told_with_what_closes_as_much(table):
    said = fitted(table, base=30.0, coulomb_friction=10.0, null_bias=10.0)
    (first,) = said.order
    assert said.verdict == "unknown" and said.part
    assert {c.id for c in said.members(first)} == {"coulomb_friction", "null_bias"}
    assert [said.probability(c.label) for c in said.members(first)] == pytest.approx([0.4] * 2, abs=0.02)


@pytest.mark.parametrize(("promised", "told"), [(0.95, True), (0.05, False)])
def test_a_part_is_not_told_while_more_promise_as_much_than_were_fitted(table, monkeypatch, promised, told):
    fitted(table, base=30.0, coulomb_friction=10.0)
    for c in (c for c in table.candidates if c.id != "coulomb_friction"):
        entry = table.entry([c])
        entry.failed, entry.beside, entry.look = "", np.nan, object()
    monkeypatch.setattr(table, "promise", lambda entry: promised)
    said = standing(table)
    assert said.verdict == "unknown" and said.part == told
