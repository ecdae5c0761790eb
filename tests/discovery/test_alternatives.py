"""Alternatives: where a structure explains all, every other effect is asked from where that ended."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery.answer.rows import rows_of
from hydrotwin.discovery.answer.standing import standing
from hydrotwin.discovery.structures import alternatives
from hydrotwin.discovery.structures.alternatives import FIRST
from hydrotwin.discovery.structures.foreseen import Foreseen, foreseen
from hydrotwin.discovery.structures.search import OutOfTime
from tests.discovery.slides import begun, records, tried

EFFECTS = ("coulomb_friction", "presliding_friction", "null_bias", "dead_time", "sensor_scale", "command_saturation")


def entry(search, name):
    return search.table.entry([next(c for c in search.table.candidates if c.id == name)])


@pytest.fixture
def right():
    """A search among recordings with 60 N of dry friction that has fitted the base and the friction alone."""
    search = begun(records(3, dry=60.0), EFFECTS)
    search.identify()
    friction = entry(search, "coulomb_friction")
    tried(search, friction)
    return search


@pytest.fixture
def blind(right, monkeypatch):
    """The same where first order says nothing, as of an FMU."""
    monkeypatch.setattr(alternatives, "foreseen", lambda table, jobs, known: {})
    return right


def test_before_the_others_are_asked_the_right_one_is_far_from_sure(right):
    said = standing(right.table)
    assert said.best is entry(right, "coulomb_friction")
    assert said.probability(said.best.key[0]) < 0.5 < said.told()["not looked at"] + said.probability(said.best.key[0])


def test_every_other_effect_is_asked_from_where_the_right_one_ended(right):
    right.alternatives.settle()
    others = [entry(right, name) for name in EFFECTS if name != "coulomb_friction"]
    assert all(e.asked and not e.look for e in others), "no look from the bent base was needed"
    assert entry(right, "null_bias").beside > 0.5 and not entry(right, "null_bias").fitted
    assert standing(right.table).probability(entry(right, "coulomb_friction").key[0]) > 0.9
    assert right.table.unseen() == 0.0 and not right.waiting()


def test_what_promised_nothing_from_a_bent_base_is_found_from_the_right_one(right):
    """A twin is what leaves as little; its look had stood far behind."""
    twin = entry(right, "presliding_friction")
    right.alternatives.settle()
    assert twin.beside < 0.1 and twin.fitted
    assert right.table.score(twin) < 100.0 < 0.1 * right.table.score(right.table.entry())


def test_what_only_bends_the_base_goes_no_further_than_the_first_steps(blind):
    """Useless effects walk the same way as the base without any; a twin is ahead of it at once."""
    asked, run = [], blind.alternatives.run
    blind.alternatives.run = lambda jobs: (asked.extend(jobs), run(jobs))[1]
    blind.alternatives.settle()
    looks = {name: [j.iterations for j in asked if name in j.label and j.stages == (0, 0)] for name in EFFECTS[1:]}
    assert looks["null_bias"] == looks["sensor_scale"] == [FIRST]
    assert len(looks["presliding_friction"]) == 2 and looks["presliding_friction"][1] > FIRST


@pytest.fixture
def small():
    """A search in whole recordings with 2 N of dry friction, which is fitted: five times the noise."""
    search = begun(records(3, dry=2.0), EFFECTS)
    search.identify()
    search._to_whole_recordings()
    tried(search, entry(search, "coulomb_friction"))
    return search


def test_where_the_gap_is_small_first_order_foresees_what_the_best_explains(small):
    base, best = small.table.entry(), entry(small, "coulomb_friction")
    shares = foreseen(small.table, small.jobs, base)
    assert shares[best.key[0]].left == pytest.approx(float(best.fitted.rmse[0] / base.fitted.rmse[0]) ** 2, rel=0.05)


def test_first_order_says_how_large_an_effect_is_where_usual_sizes_are_thirty_times_too_large(small):
    best = entry(small, "coulomb_friction")
    name = next(n for n in best.members[0].free if n.endswith(".force"))
    assert foreseen(small.table, small.jobs, small.table.entry())[best.key[0]].start[name] == pytest.approx(
        2.0, rel=0.1
    )
    usual = small.jobs.starts_of(best.members[0], small.table.entry())
    assert min(start[name] for start in usual) > 30.0


def test_nothing_is_expected_of_what_explains_no_more_than_chance(small):
    known = foreseen(small.table, small.jobs, small.table.entry())
    scale = entry(small, "sensor_scale")
    assert known[scale.key[0]].left > 0.995 and known[scale.key[0]].start == {}
    assert small.jobs._expected(scale.members[0], small.table.entry()) == []


def test_what_was_expected_beside_another_fit_of_the_base_is_forgotten(small):
    base, best = small.table.entry(), entry(small, "coulomb_friction")
    foreseen(small.table, small.jobs, base)
    assert small.jobs._expected(best.members[0], base)
    base.fitted = dataclasses.replace(base.fitted)
    assert not small.jobs._expected(best.members[0], base)


def test_what_first_order_says_to_explain_too_little_needs_no_look(small):
    asked, run = [], small.alternatives.run
    small.alternatives.run = lambda jobs: (asked.extend(jobs), run(jobs))[1]
    small.alternatives.settle()
    assert {j.label.split(" at ")[0] for j in asked if " at " in j.label} == {"presliding_friction"}
    assert all(entry(small, name).asked for name in EFFECTS[1:]) and small.table.unseen() == 0.0
    assert entry(small, "presliding_friction").fitted and entry(small, "null_bias").beside > 0.9
    whys = {row.effect: row.reason for row in rows_of(standing(small.table), (), None)}
    assert whys["null_bias"].startswith("to first order it explains less than half")


def test_where_first_order_did_not_foresee_the_best_all_others_are_looked_at(small, monkeypatch):
    little = {c.label: Foreseen(0.99 if c.id == "coulomb_friction" else 1.0, {}) for c in small.table.candidates}
    monkeypatch.setattr(alternatives, "foreseen", lambda table, jobs, known: little)
    asked, run = [], small.alternatives.run
    small.alternatives.run = lambda jobs: (asked.extend(jobs), run(jobs))[1]
    small.alternatives.settle()
    assert {j.label.split(" at ")[0] for j in asked if " at " in j.label} == set(EFFECTS[1:])


def test_the_others_are_asked_anew_only_from_what_leaves_clearly_less(right):
    right.alternatives.settle()
    asked, run = [], right.alternatives.run
    right.alternatives.run = lambda jobs: (asked.extend(jobs), run(jobs))[1]
    right.alternatives.settled.clear()
    right.alternatives.settle()
    assert not asked


def test_what_the_limit_left_unasked_counts_as_not_looked_at(blind):
    blind.alternatives.batch = 1
    run, done = blind.alternatives.run, []

    def limited(jobs):
        done.extend(jobs)
        if len(done) > 5:
            raise OutOfTime
        return run(jobs)

    blind.alternatives.run = limited
    with pytest.raises(OutOfTime):
        blind.alternatives.settle()
    left = [e for e in blind.table.entries.values() if len(e.key) == 1 and not e.seen]
    assert left and 0.0 < standing(blind.table).told()["not looked at"] < 0.9


def test_a_run_that_diverges_from_there_costs_only_itself(blind):
    run = blind.alternatives.run

    def diverging(jobs):
        return ["slide: diverged." if "dead_time" in job.label else found
                for job, found in zip(jobs, run(jobs), strict=True)]  # fmt: skip

    blind.alternatives.run = diverging
    blind.alternatives.settle()
    late = entry(blind, "dead_time")
    assert late.asked and np.isinf(late.beside) and not late.fitted
    assert standing(blind.table).verdict == "named" and blind.table.unseen() == 0.0


def test_a_base_that_diverges_without_the_effect_dismisses_nobody(blind):
    run = blind.alternatives.run

    def diverging(jobs):
        return [
            "slide: diverged." if job.label == "slide" else found for job, found in zip(jobs, run(jobs), strict=True)
        ]

    blind.alternatives.run = diverging
    blind.alternatives.settle()
    assert entry(blind, "presliding_friction").fitted and blind.table.unseen() == 0.0
