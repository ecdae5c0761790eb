"""The new search as a method of the benchmark: its answer, and what it leaves of recordings that took no part."""

from types import SimpleNamespace

import pytest

from benchmarks.gap.explored import explored
from tests.discovery.slides import NOISE, Inline, records, slide


def answered(effects, **hidden):
    made = SimpleNamespace(model=slide(), fit=records(3, **hidden), held_out=records(2, first=10, **hidden))
    return explored(made, Inline(), effects)


def test_what_is_named_comes_with_its_class_its_values_and_what_it_leaves_of_unseen_recordings():
    said = answered(["coulomb_friction", "null_bias"], dry=30.0)
    assert said.verdict == "named"
    (one,) = said.named
    assert (one.effect, one.members[0][0]) == ("coulomb_friction", "coulomb_friction")
    assert one.parameters[0][1] == pytest.approx(30.0, rel=0.03)
    assert one.probability > 0.9
    assert said.rmse_before["speed"] > 5 * NOISE
    assert said.rmse_after["speed"] == pytest.approx(NOISE, rel=0.15)


def test_where_nothing_is_missing_both_leave_the_same():
    said = answered(["coulomb_friction", "null_bias"])
    assert (said.verdict, said.named) == ("none", ())
    assert said.rmse_before == said.rmse_after
