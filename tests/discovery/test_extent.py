"""How much of the recordings a look goes through: beginnings that show the gap as well, or everything."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.discovery.evidence.score import spectrum
from hydrotwin.discovery.fits.job import Fitted, Look
from hydrotwin.discovery.fits.whole import as_look
from hydrotwin.discovery.structures import extent as extents
from hydrotwin.discovery.structures.extent import beginnings, enough_of
from tests.discovery.slides import begun, records
from tests.discovery.test_table import NOISE


@pytest.fixture
def table():
    return begun(records(3), ("coulomb_friction",)).table


def residuals(question, gap):
    """White noise and a gap that depends on the share of a recording that is over."""
    found = []
    for k, r in enumerate(question.fit):
        over = np.arange(len(r.time)) / 600
        noise = np.random.default_rng(k).standard_normal(len(over))
        found.append((NOISE * (noise + 20 * gap(over) * np.sin(np.arange(len(over)) / 2)))[:, None])
    return found


def extent(table, gap):
    """Samples of the first recording that a look goes through."""

    def left(question):
        return as_look(Fitted({}, (), spectrum(residuals(question, gap)), (), True, 1))

    table.entry().fitted = Fitted({}, (), spectrum(residuals(table.question, gap)), (), True, 1)
    question, look = enough_of(table, left, as_look(table.entry().fitted))
    assert look.left.counts.sum() == sum(len(r.time) for r in question.fit)
    return len(question.fit[0].time)


def test_a_gap_that_is_everywhere_shows_in_the_beginnings(table):
    assert extent(table, lambda over: np.ones(len(over))) < 600


def test_a_gap_that_comes_late_or_seldom_takes_all(table):
    assert extent(table, lambda over: over > 0.7) == 600
    assert extent(table, lambda over: (over > 0.5) & (over < 0.55)) == 600


def test_a_small_gap_takes_all(table):
    assert extent(table, lambda over: np.full(len(over), 0.03)) == 600


def test_a_base_that_diverges_in_a_part_takes_all(table):
    table.entry().fitted = Fitted({}, (), spectrum(residuals(table.question, np.ones_like)), (), True, 1)
    question, look = enough_of(table, lambda q: "slide: diverged.", as_look(table.entry().fitted))
    assert question is table.question and isinstance(look, Look)


def test_a_beginning_keeps_inputs_and_outputs_beside_their_times(table):
    part = beginnings(table.question, 0.25)
    for cut, whole in zip(part.fit, table.question.fit, strict=True):
        n = len(whole.time) // 4
        assert len(cut.time) == len(cut.u) == len(cut.y) == n and (cut.y == whole.y[:n]).all()


def test_a_small_gap_in_long_recordings_is_looked_for_in_a_part_that_holds_its_share(table, monkeypatch):
    monkeypatch.setattr(extents, "LONG", 1000)
    everywhere = extent(table, lambda over: np.full(len(over), 0.06))
    assert everywhere == 300, "half of 1800 samples; twice as much would be too long"
    assert extent(table, lambda over: 0.1 * (over > 0.7)) == 600


def test_the_beginnings_of_long_recordings_lead_the_base_and_short_ones_are_taken_whole(monkeypatch):
    def ends(runs):
        search, seen = begun(runs, ("coulomb_friction",)), []
        run = search.run
        search.run = lambda function, jobs, stage: (
            seen.extend(len(j.question.fit[0].time) for j in jobs if j.stages is None), run(function, jobs, stage)
        )[1]  # fmt: skip
        return search.identify().fitted, seen

    short, seen = ends(records(3))
    assert set(seen) == {600}
    monkeypatch.setattr(extents, "MANY", 1000)
    monkeypatch.setattr(extents, "BRIEF", 450)
    long, seen = ends(records(3))
    assert seen[0] == 150 and set(seen[1:]) == {600}, "the answer is that of all samples"
    assert long.values == pytest.approx(short.values, rel=1e-3)
