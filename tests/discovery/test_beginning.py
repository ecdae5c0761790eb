"""Long recordings: beginnings are searched first, what explains those is held against all, and the rest is searched."""

import numpy as np
import pytest

import hydrotwin.discovery.structures.extent as extents
from hydrotwin.discovery.answer import so_far
from hydrotwin.discovery.answer.standing import standing
from hydrotwin.discovery.structures.beginning import likely, take_over
from hydrotwin.discovery.structures.ends import OutOfTime
from tests.discovery.slides import NOISE, begun, found, record, records
from tests.discovery.test_beside import filled
from tests.discovery.test_table import seen as looked_at

SOME = ("coulomb_friction", "null_bias", "dead_time", "sensor_bias", "sensor_scale", "command_saturation")
ALL, PART = 600, 300  # samples of a recording, and of its beginning


@pytest.fixture(autouse=True)
def long(monkeypatch):
    """Recordings of 12 s are long, and half of them is enough."""
    monkeypatch.setattr(extents, "MANY", 1000)
    monkeypatch.setattr(extents, "BRIEF", 3 * PART)


def gone_through(runs, effects=SOME):
    """The search at its end, and of every job how many samples of a recording it was asked about."""
    search, seen = begun(runs, effects), []
    run = search.run
    search.run = lambda function, jobs, stage: (
        seen.extend(len(j.question.fit[0].time) for j in jobs), run(function, jobs, stage)
    )[1]  # fmt: skip
    search.go()
    return search, standing(search.table), seen


def test_what_explains_the_beginnings_is_fitted_to_all_and_hardly_anything_else_is_run_there():
    search, said, seen = gone_through(records(3, dry=30.0))
    assert said.verdict == "named" and [c.id for c in said.order] == ["coulomb_friction"]
    assert next(v for n, v in said.best.fitted.values.items() if n.endswith(".force")) == pytest.approx(30.0, rel=0.03)
    assert sum(said.best.fitted.left.counts.sum(axis=0)) == pytest.approx(3 * ALL, rel=0.01)
    assert said.probability(said.best.key[0]) == pytest.approx(0.97, abs=0.01)
    assert seen.count(ALL) <= 4 < seen.count(PART)
    assert search.complete and search.part is None


def test_what_begins_later_is_searched_for_in_all(monkeypatch):
    """In the first half nothing rubs, so the beginnings hold none of the gap."""
    search = begun(records(3, dry=0.0, then=30.0), ("late_friction", "null_bias"))
    base = search.identify()
    monkeypatch.setattr(search.part, "go", pytest.fail)
    monkeypatch.setattr(search, "_through", out_of_time)
    search.go()
    assert search.table.score(base) > 1000.0 and search.part is None
    assert base.look and search.first, "windows of all recordings show it"


def out_of_time(*_):
    raise OutOfTime


def test_what_explains_the_beginnings_alone_gets_no_name():
    """Friction everywhere, and from the middle on a push that no effect holds."""
    search, said, seen = gone_through(records(3, dry=30.0, leaning=80.0), ("coulomb_friction", "dead_time"))
    assert said.verdict == "unknown"
    assert seen.count(ALL) > 4, "it is searched for in all"
    assert all(np.isnan(e.early) for e in search.table.entries.values()), "what was put aside there is asked again"


def test_what_may_be_the_answer_stays_in_question_until_it_was_fitted_to_all():
    part = filled(base=30.0, coulomb_friction=1.0, stribeck_friction=1.0, null_bias=1.0, dead_time=9.0)
    whole = filled(base=30.0, coulomb_friction=1.0)
    known = likely(part.table)
    assert {e.members[0].id for e in known} == {"coulomb_friction", "null_bias"}
    take_over(whole, part, known)
    by = {c.id: whole.table.entry([c]) for c in whole.table.candidates}
    assert not by["null_bias"].asked and by["stribeck_friction"].early < 0.1, "no less, for more parameters"
    assert by["dead_time"].asked and 0.01 < by["dead_time"].beside == by["dead_time"].early < 0.6


def test_beside_a_pair_single_effects_were_looked_at_and_are_told_so():
    """All that were looked at in the beginnings were told as not looked at, and counted out of the title."""
    part = filled(base=30.0, coulomb_friction_and_null_bias=1.0, coulomb_friction=20.0, null_bias=25.0)
    late = next(
        e for e in map(part.table.entry, [[c] for c in part.table.candidates]) if e.members[0].id == "dead_time"
    )
    part.table.entry().look, late.look = looked_at(30.0), looked_at(30.0)
    whole = filled(base=30.0, coulomb_friction_and_null_bias=1.0, stribeck_friction=30.0)
    take_over(whole, part, likely(part.table))
    entry = whole.table.entries[late.key]
    assert whole.table.seen_all() and not entry.asked and not entry.look
    assert entry.early == part.table.promise(late)


def test_a_structure_that_diverges_in_all_recordings_is_tried_again_where_none_explains_them(monkeypatch):
    search = begun(records(3, dry=30.0), ("coulomb_friction", "null_bias"))
    search.identify()
    run = search.run

    def diverging(function, jobs, stage):
        all_of_them = jobs and len(jobs[0].question.fit[0].time) == ALL
        return ["it diverges"] * len(jobs) if all_of_them else run(function, jobs, stage)

    monkeypatch.setattr(search, "run", diverging)
    monkeypatch.setattr(search.base, "lead", lambda: 0)
    search._begin()
    (friction,) = (e for e in search.table.entries.values() if e.key and "coulomb" in e.key[0])
    assert friction.open and not friction.failed


def test_the_base_is_not_asked_again_for_what_its_beginnings_explained(monkeypatch):
    search = begun(records(3, dry=30.0), ("coulomb_friction", "null_bias"))
    search.identify()
    asked = []
    monkeypatch.setattr(search, "_settle", asked.append)
    search._begin()
    assert search.table.explained() and not asked


def test_recordings_of_a_few_seconds_each_and_of_unequal_length_are_searched():
    runs = [record(k, dry=30.0, seconds=s) for k, s in enumerate((2.0, 2.0, 3.0, 30.0, 2.0))]
    _, said, _ = gone_through(runs, ("coulomb_friction", "null_bias"))
    assert [c.id for c in said.order] == ["coulomb_friction"] and said.verdict == "named"


def test_nothing_is_missing_where_nothing_is():
    _, said, seen = gone_through(records(3))
    assert said.verdict == "none"
    assert len(seen) < 10


def test_while_the_beginnings_are_searched_the_answer_so_far_counts_what_was_looked_at_there(monkeypatch):
    monkeypatch.setattr(so_far, "AFTER", 0.0)
    monkeypatch.setattr(so_far, "EVERY", 0.0)
    monkeypatch.setattr(so_far, "COSTS", 1.0)
    told = []
    said = found(records(3, dry=30.0), SOME, noise={"speed": NOISE}, so_far=told.append)
    assert said.verdict == "named"
    counted = [one.findings[0] for one in told]
    others = [r.reason for s in said.steps for r in s.ranked if r.fate == "not fitted"]
    assert others and all("to first order" in why or "he beginnings of the" in why for why in others)
    assert any("4 of 6 candidates were looked at so far, 1 structure fitted, in the beginnings" in c for c in counted)
    assert any("beginnings of the recordings, where Coulomb friction at mass.flange explains all" in c for c in counted)
