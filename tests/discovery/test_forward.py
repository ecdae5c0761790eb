"""Forward: when a search goes on, and what it may name then."""

import numpy as np
import pytest

from hydrotwin.discovery.forward import _part_is_left
from hydrotwin.discovery.structure import Structure, Tried
from hydrotwin.models.language import Model

from .slides import RATE_NOISE, Drive, drive_records, found, grown, question, searching

EFFECTS = ("null_bias", "direction_asymmetry")


def two_small_ones(count: int):
    """A drive with an offset of 2 mV and a gain that differs by 0.06 % of itself by direction."""
    return drive_records(count, seconds=30.0, command=lambda u: u * (1 + 6e-4 * np.sign(u)) - 2e-3)


@pytest.fixture(scope="module")
def after_one():
    """A search in which one of the two effects has been named: 1.04 of the noise is left of 1.11."""
    asked = question(two_small_ones(3), Model(Drive()))
    search, base = searching(asked, EFFECTS, Model(Drive()), ("gain", "time_constant"))
    base = Structure((), base)
    return search, base, grown(search, base, "null_bias")


def test_a_second_effect_is_named_where_little_is_left_beside_the_noise_but_much_of_the_gap():
    *runs, judged = two_small_ones(4)
    told = found(runs, EFFECTS, model=Model(Drive()), validate=[judged], noise={"rate": RATE_NOISE})
    assert {s.effect: s.parameters[0].value for s in told.steps} == pytest.approx(
        {"null_bias": -2e-3, "direction_asymmetry": 6e-4}, rel=0.1
    )


def test_a_search_goes_on_while_a_part_of_a_small_gap_is_left(after_one):
    search, base, now = after_one
    both = grown(search, base, *EFFECTS)
    assert search.explained(now) and _part_is_left(search, now, base)
    assert not _part_is_left(search, both, base) and not _part_is_left(search, base, base)


def test_what_is_left_of_a_large_gap_is_the_inexact_form_of_its_law(after_one, monkeypatch):
    search, base, now = after_one
    monkeypatch.setattr("hydrotwin.discovery.forward.closed", lambda *fits: 0.96)
    assert not _part_is_left(search, now, base)


def test_where_little_is_left_only_what_leaves_nothing_may_be_named(after_one):
    search, base, now = after_one
    both = grown(search, base, *EFFECTS)
    spotless = [search.spotless(Tried((), None, structure)) for structure in (now, both, None)]
    assert spotless == [False, True, False]
