"""The table: one entry per structure, noise and floor from all fits together, what windows promise."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery.evidence.score import Spectrum, spectrum
from hydrotwin.discovery.fits.job import Fitted, Look
from hydrotwin.discovery.fits.whole import as_look
from tests.discovery.slides import NOISE, begun, records

EFFECTS = ("coulomb_friction", "null_bias", "dead_time")


def leaving(times: float) -> Fitted:
    """A fit that leaves white noise, so many times that of the sensor."""
    runs = [NOISE * times * np.random.default_rng(k).standard_normal((600, 1)) for k in range(3)]
    return Fitted({}, (), spectrum(runs), (), True, 1)


def seen(*times: float) -> Look:
    """A look whose windows, from short to long, left so many times the noise."""
    counts = np.array([[1000.0], [1500.0]])[: len(times)]
    return Look({}, counts * np.square([[NOISE * t] for t in times]), counts, np.array([NOISE * times[-1]]))


@pytest.fixture
def table():
    """The empty table of the slide, the noise not told."""
    return begun(records(3), EFFECTS, noise=None).table


@pytest.fixture
def told():
    """The same, told the noise."""
    return begun(records(3), EFFECTS).table


def singles(table):
    return [table.entry([c]) for c in table.candidates]


def test_a_structure_has_one_entry_whatever_the_order_of_its_effects(table):
    one, other, third = table.candidates
    pair = table.entry([other, one])
    assert pair is table.entry([one, other]) and pair.key == (one.label, other.label)
    assert table.entry() is table.entry([]) and table.entry().key == ()
    assert third.label not in pair.key and len(table.entries) == 2


def test_the_model_of_a_structure_has_its_effects_and_is_made_once(table):
    friction = table.entry([c for c in table.candidates if c.id == "coulomb_friction"])
    assert [a.effect for a in table.model(friction).additions] == ["coulomb_friction"]
    assert table.model(friction) is table.model(friction) and table.model(table.entry()) is table.base
    assert table.names(friction) == ("mass.mass", "mass.damping", "coulomb_friction.force")
    assert (table.parameters(table.entry()), table.parameters(friction)) == (0, 1)


def test_an_entry_is_open_until_it_is_fitted_or_failed(table):
    one, other, _ = singles(table)
    assert one.open
    one.fitted, other.failed = leaving(1.0), "it diverges"
    assert not one.open and not other.open and table.fitted == [one]


def test_the_parts_of_a_structure_are_what_is_fitted_of_it(table):
    one, other, third = singles(table)
    pair = table.entry([*one.members, *other.members])
    for entry in (table.entry(), one, third, pair):
        entry.fitted = leaving(1.0)
    assert {e.key for e in table.parts(pair)} == {(), one.key}


def test_a_fit_that_leaves_less_than_the_noise_tells_the_noise_unless_the_user_did(table, told):
    thought = table.noise[0]
    assert thought == table.question.noise[0]
    for each in (table, told):
        each.entry().fitted = leaving(0.5)
    assert table.noise[0] == pytest.approx(0.5 * NOISE, rel=0.05) and told.noise[0] == NOISE


def test_the_base_is_scored_by_noise_alone_and_a_right_law_may_keep_a_fiftieth_of_what_it_leaves(told):
    one, other, _ = singles(told)
    told.entry().fitted, one.fitted, other.fitted = leaving(60.0), leaving(1.2), leaving(6.0)
    assert told.score(told.entry()) == pytest.approx(0.5 * 1800 * np.log(60.0**2), rel=0.1)
    assert told.score(one) < 5.0, "1.2 is the root of 1 + (0.02 60)^2 at most"
    assert told.score(other) > 500.0 > told.scores(law=0.1)[other.key]
    assert told.share(one) < 0.001 < 0.1 < told.share(other) < 0.4
    assert told.scores().keys() == {(), one.key, other.key}


def test_the_posterior_is_that_of_the_scores(told):
    one, other, _ = singles(told)
    told.entry().fitted, one.fitted, other.fitted = leaving(60.0), leaving(1.0), leaving(20.0)
    assert told.posterior().best == one.key
    assert told.prices.candidates == 3 and told.prices.values == 1800


def test_a_promise_is_the_share_of_what_the_base_leaves_in_windows_as_long(told):
    base, (one, other, third) = told.entry(), singles(told)
    base.look, one.look, other.look = seen(8.0, 20.0), seen(8.0, 1.0), seen(4.0)
    assert told.promise(third) == 1.0, "nobody looked"
    assert told.promise(one) < 0.01 and told.promise(one, 1) == pytest.approx(1.0, abs=0.01)
    assert 0.4 < told.promise(other) < 0.8
    assert told.visible(1) > told.visible(0) > 1000.0


def test_a_look_that_began_in_longer_windows_is_held_against_those(told):
    """Shorter ones, which it did not go through, would seem to have left nothing."""
    base, (one, *_) = told.entry(), singles(told)
    whole = seen(8.0, 20.0)
    base.look = whole
    one.look = dataclasses.replace(whole, squares=whole.squares[1:], counts=whole.counts[1:], begin=1)
    assert [told.promise(one, most) for most in (1, 2, None)] == pytest.approx([1.0, 1.0, 1.0], abs=0.05)
    assert not told.was_right(one, 0.5)


def test_what_a_base_leaves_in_windows_is_never_more_than_the_mean_of_the_output_would(told):
    told.entry().look = seen(1e9)
    spread = np.var(np.concatenate([r.y for r in told.question.fit]))
    assert told.base_in_windows(0).variance == pytest.approx(spread)


def test_a_look_at_whole_recordings_promises_what_it_leaves_of_them(told):
    base, (one, *_) = told.entry(), singles(told)
    base.fitted = leaving(10.0)
    base.look, one.look = as_look(base.fitted), as_look(leaving(1.0))
    assert told.promise(one) < 0.01


def test_a_look_at_a_part_of_the_recordings_is_held_against_what_the_base_leaves_there(told):
    base, (one, *_) = told.entry(), singles(told)
    base.fitted = leaving(10.0)
    base.look, one.look = as_look(leaving(3.0)), as_look(leaving(3.0))
    assert told.promise(one) == pytest.approx(1.0, abs=0.01)


def test_a_base_that_diverged_has_no_part_in_the_floor(told):
    told.entry().fitted = Fitted({}, (), Spectrum(np.array([[np.inf]]), np.array([[1800.0]])), (), False, 1)
    assert told.floor().base is None


def test_of_effects_that_nobody_looked_at_as_many_explain_all_as_of_the_others(told):
    one, other, third = singles(told)
    told.entry().fitted, told.entry().look = leaving(30.0), seen(20.0, 30.0)
    one.fitted = leaving(1.0)
    assert told.unseen() == pytest.approx(2 * 0.5 / 2), "two of three were not looked at, one was and is right"
    other.fitted = leaving(1.0)
    assert told.unseen() == pytest.approx(1 * 1.5 / 3), "a twin: where there is one, there may be more"
    assert 0.1 < told.posterior().unseen < 0.5
    third.look = seen(20.0, 30.0)
    assert told.unseen() == pytest.approx(0.5), "from a base that is bent even the right one may promise nothing"
    third.beside = 0.9
    assert told.unseen() == 0.0 == told.posterior().unseen


def test_before_anything_explains_all_what_was_looked_at_is_seen(told):
    one, other, third = singles(told)
    told.entry().fitted = leaving(30.0)
    one.look, other.failed = seen(20.0, 30.0), "it diverges"
    assert told.unseen() == pytest.approx(0.5 / 3)
    third.look = seen(20.0, 30.0)
    assert told.unseen() == 0.0 and told.seen_all()


def test_in_the_place_of_each_of_a_pair_the_others_count(told):
    one, other, third = told.candidates
    told.entry().fitted, told.entry([one, other]).fitted = leaving(30.0), leaving(1.0)
    assert told.unseen() == pytest.approx(2 * 0.5 / 2)
    told.entry([one, third]).beside = 2.0
    assert told.unseen() == pytest.approx(1 * 0.5 / 3)


def test_of_two_that_are_as_good_that_counts_for_which_most_were_asked(told):
    """A twin that turns out a hair better was not asked for anything, and need not be."""
    one, other, third = told.candidates
    told.entry().fitted, told.entry([one, other]).fitted = leaving(30.0), leaving(1.01)
    told.entry([one, third]).fitted, told.entry([other, third]).beside = leaving(1.0), 0.9
    assert told.unseen() == 0.0


def coloured(times):
    """A fit that leaves white noise and a slow error of so many times its size."""
    runs = [NOISE * (np.random.default_rng(k).standard_normal(600) + times * np.sin(np.arange(600) / 40))[:, None]
            for k in range(3)]  # fmt: skip
    return Fitted({}, (), spectrum(runs), (), True, 1)


def test_no_more_of_the_noise_is_coloured_than_the_best_fit_leaves(told):
    """Rounding would allow a slow error: where one of two structures leaves none, the other has no excuse."""
    one, other, third = singles(told)
    told.coloured = np.array([0.5 * NOISE])
    told.entry().fitted, one.fitted = coloured(5.0), coloured(0.7)
    assert told.score(one) < 5.0, "as rounding may leave it"
    before = told.score(told.entry())
    other.fitted = third.fitted = coloured(0.0)
    assert told.score(one) > 10.0 and told.score(other) < 1.0
    assert told.score(told.entry()) >= before
    assert told.explained([other]) and not told.explained([one])
