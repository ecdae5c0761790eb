"""What is tried beside the best structure, how parts of what is missing compare, and when windows give way."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

from hydrotwin.discovery import assumed
from hydrotwin.discovery.answer.standing import standing
from hydrotwin.discovery.evidence.deciding import DECIDING
from hydrotwin.discovery.fits.job import WINDOWS
from hydrotwin.discovery.structures.search import OutOfTime
from hydrotwin.identification.assumptions import Change
from hydrotwin.identification.outliers import Strays
from tests.discovery.slides import begun, records, tried
from tests.discovery.test_standing import seen
from tests.discovery.test_table import leaving

EFFECTS = ("coulomb_friction", "stribeck_friction", "null_bias", "dead_time")


def filled(**times):
    """A search whose structures, ids joined by "_and_", leave so many times the noise."""
    search = begun(records(3), EFFECTS)
    by = {c.id: c for c in search.table.candidates}
    for name, left in times.items():
        members = [] if name == "base" else [by[n] for n in name.split("_and_")]
        search.table.entry(members).fitted = leaving(left)
    return search


def out_of_time():
    raise OutOfTime


def beside(search, *best: str) -> set[str]:
    members = [c for c in search.table.candidates if c.id in best]
    best = search.table.entry(members)
    return {"_and_".join(sorted(c.id for c in e.members)) for e in search.alternatives.less(best)}


def test_the_plainer_form_stands_beside_the_best():
    search = filled(base=30.0, stribeck_friction=1.0, null_bias=2.0, dead_time=25.0)
    assert beside(search, "stribeck_friction") == {"coulomb_friction"}


def test_what_leaves_as_little_is_not_tried_again():
    search = filled(base=30.0, stribeck_friction=1.0, coulomb_friction=1.0)
    assert "coulomb_friction" not in beside(search, "stribeck_friction")


def test_a_pair_is_tried_without_each_of_its_effects():
    search = filled(base=30.0, null_bias_and_dead_time=1.0, null_bias=20.0, dead_time=25.0)
    assert beside(search, "null_bias", "dead_time") == {"null_bias", "dead_time"}


def test_beside_something_else_a_second_effect_must_do_more_than_follow_the_rest():
    search = filled(base=100.0, coulomb_friction=25.0, coulomb_friction_and_null_bias=20.0)
    seen(search.table)
    said = standing(search.table)
    assert said.verdict == "unknown" and said.part
    assert [c.id for c in said.best.members] == ["coulomb_friction"]


def test_what_closes_much_more_beside_something_else_is_told_with_it():
    search = filled(base=100.0, coulomb_friction=60.0, coulomb_friction_and_null_bias=25.0)
    seen(search.table)
    said = standing(search.table)
    assert said.part and {c.id for c in said.best.members} == {"coulomb_friction", "null_bias"}


def test_at_the_end_of_the_time_a_pair_is_held_against_its_effects_alone(monkeypatch):
    """Where looks had promised more of the pair, it was named with an effect that nothing needs."""
    search = begun(records(3, dry=200.0), EFFECTS)
    search.identify()
    by = {c.id: c for c in search.table.candidates}
    pair = search.table.entry([by["coulomb_friction"], by["null_bias"]])
    tried(search, pair)
    monkeypatch.setattr(search, "_go", out_of_time)
    search.go()
    assert search.table.entry([by["coulomb_friction"]]).fitted
    assert [c.id for c in standing(search.table).best.members] == ["coulomb_friction"]


def test_what_promises_alone_is_led_on_alone_and_what_promises_alike_together(monkeypatch):
    """Fits of what promises nothing, beside the one that does, were a third of a search."""
    search, led = filled(base=100.0), []
    promised = {"coulomb_friction": 0.2, "null_bias": 0.99, "dead_time": 0.98, "stribeck_friction": 0.99}
    entries = [search.table.entry([c]) for c in search.table.candidates]

    def fit(chosen, later=False):
        led.append({e.members[0].id for e in chosen})
        for entry in chosen:
            entry.fitted = leaving(90.0)

    monkeypatch.setattr(search.table, "promise", lambda e, most=None: promised[e.members[0].id])
    monkeypatch.setattr(search, "_fit", fit)
    search._climb(entries)
    assert led == [{"coulomb_friction"}]  # pairs with it come before what promises nothing
    search._climb(entries, later=1)
    assert led[1] == set(promised) - led[0]


def test_no_pair_is_formed_before_every_single_effect_was_looked_at(monkeypatch):
    """A pair that bends far enough stood for an effect that nobody had looked at."""
    search, order = filled(base=100.0), []
    entries = [search.table.entry([c]) for c in search.table.candidates]
    search.effort = dataclasses.replace(search.effort, together=1)

    def look(chosen):
        order.extend("look" for e in chosen)
        chosen[0].fitted = chosen[0].fitted or leaving(20.0)

    monkeypatch.setattr(search, "_look", look)
    monkeypatch.setattr(search, "_fit_as_it_stands", lambda entries: None)
    monkeypatch.setattr(search.growth, "grow", lambda first: order.append("grow"))
    search._looked(entries)
    assert order == ["grow", *["look"] * len(entries)]  # before them, of what smaller structures left


@pytest.mark.parametrize("explained", [True, False])
def test_whole_recordings_take_over_where_windows_explain_nothing(monkeypatch, explained):
    search, asked = begun(records(3, dry=200.0), EFFECTS), []
    by = {c.id: c for c in search.table.candidates}

    def through(most):
        asked.append((most, bool(search.first)))
        entry = search.table.entry([by["coulomb_friction"]])
        if explained:
            tried(search, entry)
        return []

    monkeypatch.setattr(search, "_through", through)
    monkeypatch.setattr(search, "_climb", lambda entries, later=0: None)
    monkeypatch.setattr(search.alternatives, "settle", lambda: None)
    search.go()
    assert asked == [(2, True), (3, explained)]
    assert bool(search.table.question.lengths) == explained
    assert search.jobs.extent is None  # what windows do not show is slow: all of it is looked at


def test_no_more_windows_are_looked_through_than_show_the_gap():
    small, large = begun(records(3, dry=0.3), EFFECTS), begun(records(3, dry=200.0), EFFECTS)
    for search in (small, large):
        search.identify()
    assert large.table.question.windows < small.table.question.windows == WINDOWS
    assert large.table.visible(large.first - 1) > DECIDING.visible


@pytest.mark.parametrize(("early", "all_of_them"), [(None, True), (True, True), (True, False), (False, True)])
def test_a_start_that_nobody_measured_is_asked_before_any_effect(early, all_of_them, monkeypatch):
    """Of long recordings the beginnings are asked first, and all of them where those blame the start."""
    done, questioned = [], []

    def asked(model, initial_states):
        one = SimpleNamespace(model=model, initial_states=initial_states, data=None)
        one.without = one.telling = lambda said: one
        return one

    def begin(one):
        done.append(("begin", one.initial_states))
        table = SimpleNamespace(entry=lambda: None, explained=lambda: one.initial_states == "free")
        part = SimpleNamespace(table=table, free=early) if early is not None else None
        return SimpleNamespace(
            go=lambda: done.append(("go", one.initial_states)),
            complete=True,
            until=np.inf,
            table=table,
            part=part,
            free=all_of_them,
            take_looks=lambda before: None,
        )

    def question(search, entry, asked=None):
        questioned.append(search)
        return Change(free_starts=search.free)

    monkeypatch.setattr(assumed, "standing", lambda table: SimpleNamespace(kept=SimpleNamespace(members=())))
    monkeypatch.setattr(assumed, "_in_doubt", lambda search, said: False)
    monkeypatch.setattr(assumed, "_questioned", question)
    monkeypatch.setattr(assumed, "_stray_samples_of_judges", lambda search, data: Strays())
    *_, given_up = assumed.fairly(asked(object(), "auto"), asked, begin)
    assert [search.free for search in questioned] == [each for each in (early, all_of_them) if each is not None][
        : 1 if early is False else 2
    ]
    if early is False or not all_of_them:
        assert done == [("begin", "auto"), ("go", "auto")] and not given_up
    else:
        assert done == [("begin", "auto"), ("begin", "free"), ("go", "free")] and len(given_up) == 1


def test_when_the_time_is_over_before_any_fit_the_most_promising_are_fitted(monkeypatch):
    search = begun(records(3, dry=200.0), ("null_bias", "dead_time", "sensor_scale"))

    def through(most):
        search._look([search.table.entry([c]) for c in search.table.candidates])
        raise OutOfTime

    monkeypatch.setattr(search, "_through", through)
    search.go()
    assert not search.complete
    fitted = [e for e in search.table.fitted if e.members]
    assert 1 <= len(fitted) <= 2
    assert max(map(search.table.promise, fitted)) <= min(map(search.table.promise, search.waiting()))
