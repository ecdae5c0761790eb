"""Where fits begin: from the user's start through windows, and from where looks led, in turns until one is enough."""

from __future__ import annotations

import pytest

from hydrotwin.discovery import assumed
from hydrotwin.discovery.answer import answering
from hydrotwin.discovery.fits.whole import step
from hydrotwin.discovery.structures import search as search_module
from hydrotwin.discovery.structures.extent import beginnings
from hydrotwin.discovery.structures.jobs import EFFORTS
from tests.discovery.slides import begun, found, records
from tests.discovery.test_beside import filled
from tests.discovery.test_table import leaving

BOTH = ("coulomb_friction", "null_bias")
PLAIN, ON = "led", "step"


@pytest.fixture
def search():
    """A search whose fits leave what ``left`` says, by the way in which they begin; what was asked is in ``asked``."""
    begins = begun(records(3, dry=30.0), BOTH)
    begins.identify()
    entries = [begins.table.entry([c]) for c in begins.table.candidates]
    begins._look(entries)
    asked, left = [], {PLAIN: 50.0, ON: 50.0}

    def run(jobs, function=None):
        way = function.__name__ if function else ON
        asked.extend((way, job.label.split()[0]) for job in jobs)
        return [leaving(left[way]) for _ in jobs]

    begins.fits.run, begins.asked, begins.left, begins.ours = run, asked, left, entries
    return begins


def test_a_fit_begins_where_its_user_put_it_and_where_its_look_led_only_if_that_leaves_more_than_promised(
    search, monkeypatch
):
    promised = {"coulomb_friction": 1.0, "null_bias": 0.0}
    monkeypatch.setattr(search.table, "promise", lambda e, most=None: promised[e.members[0].id])
    monkeypatch.setattr(search.table, "share", lambda e: 0.5)
    monkeypatch.setattr(search.table, "score", lambda e: 10.0 if e.key and "null_bias" in e.key[0] else 20.0)
    monkeypatch.setattr(search.table, "explained", lambda by=(): False)
    search.fits.fit(search.ours)
    plain = [(PLAIN, "coulomb_friction"), (PLAIN, "null_bias")]
    assert sorted(search.asked[:2]) == plain and search.asked[2:] == [(ON, "null_bias")]


def test_what_left_least_is_fitted_from_where_its_look_led_too(search, monkeypatch):
    """All else builds on it: a lag had been taken for the slow pole of its machine."""
    monkeypatch.setattr(search.table, "promise", lambda e, most=None: 1.0)
    monkeypatch.setattr(search.table, "share", lambda e: 0.5)
    monkeypatch.setattr(search.table, "score", lambda e: 10.0 if e.key and "coulomb" in e.key[0] else 20.0)
    monkeypatch.setattr(search.table, "explained", lambda by=(): False)
    search.fits.fit(search.ours)
    assert search.asked[2:] == [(ON, "coulomb_friction")]


def test_looks_at_whole_recordings_are_gone_on_with_first(search, monkeypatch):
    search._to_whole_recordings()
    search._look(search.ours)
    search.asked.clear()
    monkeypatch.setattr(search.table, "promise", lambda e, most=None: 0.0)
    search.fits.fit(search.ours)
    assert [way for way, _ in search.asked] == [ON, ON, PLAIN, PLAIN]


def test_nothing_more_is_fitted_where_one_explains_all(search):
    search.left[PLAIN] = 1.0
    search.fits.fit(search.ours)
    assert [way for way, _ in search.asked] == [PLAIN, PLAIN]


def test_what_has_no_windows_is_fitted_from_where_its_look_led(search, monkeypatch):
    monkeypatch.setattr(search.table, "promise", lambda e, most=None: 0.0)
    search._to_whole_recordings()
    search.jobs.windows = None
    search._look(search.ours)
    search.asked.clear()
    search.fits.fit(search.ours)
    assert {way for way, _ in search.asked} == {ON}


def test_a_fit_that_leaves_more_is_not_kept():
    search = filled(base=100.0, coulomb_friction=10.0)
    [friction] = [e for e in search.table.fitted if e.members]
    before = friction.fitted
    search.fits._keep([friction], [leaving(40.0)])
    assert friction.fitted is before


def test_what_was_never_looked_at_is_looked_at_before_its_fit():
    """A structure without a look and without windows stayed open, and the search would never have ended."""
    search = begun(records(3, dry=30.0), BOTH)
    search.identify()
    search._to_whole_recordings()
    search.jobs.windows = None
    friction = search.table.entry([c for c in search.table.candidates if c.id == "coulomb_friction"])
    search._fit([friction])
    assert friction.look and friction.fitted


@pytest.mark.parametrize(("dry", "iterations"), [(30.0, [0, 15]), (0.0, [15])])
def test_a_base_that_is_not_kept_is_told_where_it_stands(dry, iterations, monkeypatch):
    """Its last fit had taken 75 s: while something is missing it has no minimum that anybody asks for."""
    asked, real = [], answering.conclude
    monkeypatch.setattr(answering, "conclude", lambda job: asked.append(job.iterations) or real(job))
    answer = found(records(3, dry=dry), BOTH)
    assert [s.effect for s in answer.steps] == ["coulomb_friction"] * (dry > 0) and sorted(asked) == iterations


def test_what_shows_nothing_in_a_part_of_the_recordings_is_looked_at_in_all_of_them(monkeypatch):
    search = begun(records(3, dry=30.0), BOTH)
    search.identify()
    search._to_whole_recordings()
    search.jobs.extent = beginnings(search.table.question, 0.25)
    friction, bias = (search.table.entry([c]) for c in search.table.candidates)
    monkeypatch.setattr(search_module, "testable", lambda known, c: c.id != "null_bias")
    search._look([friction, bias])
    assert not friction.look.sigmas and bias.look.sigmas


def test_what_diverged_from_one_start_and_was_fitted_from_another_has_not_failed():
    """The answer had said that it cannot be tried."""
    search = filled(base=100.0)
    entry = search.table.entry([search.table.candidates[0]])
    search.fits._keep([entry], ["it diverges"])
    assert entry.failed
    search.fits._keep([entry], [leaving(10.0)])
    assert entry.fitted and not entry.failed


def test_what_diverged_in_a_part_and_was_looked_at_from_its_own_start_does_not_end_the_search(monkeypatch):
    search = begun(records(3, dry=30.0), BOTH)
    search.identify()
    search._to_whole_recordings()
    search.jobs.extent = beginnings(search.table.question, 0.25)
    entries = [search.table.entry([c]) for c in search.table.candidates]
    own = [search.jobs.glance(e, None) for e in entries]
    monkeypatch.setattr(search, "_ran", lambda jobs, function=None: ["it diverges"] * len(jobs))
    search._look_again = lambda known: setattr(known[0], "look", step(own[0]))
    search._look(entries)
    assert entries[0].look and not entries[1].look


def test_once_the_time_is_over_last_fits_take_no_longer_than_a_look(monkeypatch):
    """Four of them had taken 128 s beyond a limit of 300 s, and the question of samples that stand alone 19 s."""
    asked = []
    for module, name in ((answering, "conclude"), (assumed, "judge_samples")):
        real = getattr(module, name)
        monkeypatch.setattr(module, name, lambda job, real=real: asked.append(job.seconds) or real(job))
    train, judges = records(3, dry=30.0), records(1, first=7, dry=30.0)
    answer = found(train, BOTH, validate=judges, time_limit=1e-3)
    assert answer.untried and set(asked) == {EFFORTS["normal"].look}
    asked.clear()
    found(train, BOTH, validate=judges)
    assert len(asked) >= 2 and set(asked) == {EFFORTS["normal"].seconds}
