"""The new search, on slides whose exact motion is known: windows find effects from a wrong base, and fits end there."""

import dataclasses
import time

import numpy as np
import pytest

from hydrotwin.discovery.structures.search import EFFORTS, compatible
from tests.discovery.slides import NOISE, records, searched, slide

SOME = ("coulomb_friction", "null_bias", "dead_time", "sensor_bias", "sensor_scale", "command_saturation")


def explored(runs, effects=SOME, **more):
    return searched(runs, effects, **more)


@pytest.fixture(scope="module")
def rubbing():
    """30 N of dry friction."""
    return explored(records(3, dry=30.0))


def test_friction_is_found_with_its_force_from_a_base_that_is_30_percent_off(rubbing):
    search, said = rubbing
    assert said.verdict == "named"
    assert [c.id for c in said.order] == ["coulomb_friction"]
    values = said.best.fitted.values
    assert next(v for n, v in values.items() if n.endswith(".force")) == pytest.approx(30.0, rel=0.03)
    assert values["mass.mass"] == pytest.approx(50.0, rel=0.02)
    assert said.probability(said.best.key[0]) == pytest.approx(0.95, abs=0.01)
    assert search.complete


def test_every_candidate_was_looked_at_and_none_is_worse_than_the_base_it_contains(rubbing):
    search, _ = rubbing
    table = search.table
    singles = [table.entries[(c.label,)] for c in table.candidates]
    assert all(e.look or e.fitted or e.failed for e in singles)
    base = table.score(table.entry())
    assert all(table.score(e) < base + 2.0 for e in table.fitted)


def test_nothing_is_missing_where_nothing_is():
    _, said = explored(records(3))
    assert said.verdict == "none"
    assert said.told()["nothing"] > 0.95
    assert not said.kept.members


def test_a_push_that_no_effect_holds_gets_no_name():
    _, said = explored(records(3, pulse=80.0), ("null_bias", "sensor_scale", "dead_time"))
    assert said.verdict == "unknown"
    assert said.told()["something else"] > 0.9


def test_two_effects_of_which_neither_explains_the_gap_are_found_together():
    _, said = explored(records(3, dry=50.0, late=3))
    assert {c.id for c in said.order} == {"coulomb_friction", "dead_time"}
    values = said.best.fitted.values
    assert next(v for n, v in values.items() if n.endswith(".time")) == pytest.approx(0.06, abs=0.002)


def test_a_time_limit_ends_the_search_with_what_is_known():
    began = time.monotonic()
    search, said = explored(records(3, dry=30.0), time_limit=0.0)
    assert not search.complete
    assert said.verdict in ("unknown", "named")
    assert time.monotonic() - began < 30
    assert search.table.entry().fitted


def test_a_candidate_that_fails_costs_only_itself(monkeypatch):
    from hydrotwin.discovery.structures import table

    real = table.Table.model

    def broken(self, entry):
        if any("null_bias" in label for label in entry.key):
            from hydrotwin.models.language.errors import SolveError

            raise SolveError("no solution here")
        return real(self, entry)

    monkeypatch.setattr(table.Table, "model", broken)
    search, said = explored(records(3, dry=30.0), ("coulomb_friction", "null_bias"))
    assert said.verdict == "named"
    assert [e.failed for e in search.table.entries.values() if e.failed] == ["no solution here"]


def test_finer_forms_do_not_stand_beside_what_they_refine(rubbing):
    from hydrotwin.models.effects import candidates

    plain, finer = candidates(slide(), ["coulomb_friction"]), candidates(slide(), ["stribeck_friction"])
    assert not compatible((*plain, *finer))
    assert compatible(candidates(slide(), ["coulomb_friction", "dead_time"]))


def test_efforts_grow():
    small, usual, large = (dataclasses.asdict(EFFORTS[e]) for e in ("quick", "normal", "thorough"))
    assert all(small[k] <= usual[k] <= large[k] for k in ("fits", "pool", "look", "seconds", "iterations"))


def test_scores_are_finite_and_the_noise_is_the_sensors(rubbing):
    search, _ = rubbing
    assert np.isfinite(list(search.table.scores().values())).all()
    assert search.table.noise == pytest.approx([NOISE])
