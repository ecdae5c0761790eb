"""Every law in models/laws, found by walking the package."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

import hydrotwin.models.laws
from hydrotwin.models.language import Law, Parameter, UnitError
from hydrotwin.models.laws import BulkModulusLaw, FrictionLaw, LeakageLaw, OrificeLaw, Viscous
from tests.components.contract import complaints, registered
from tests.laws.probe import FORMS, form_of, probe, slopes, values

KINDS = registered(hydrotwin.models.laws)
LAWS = [kind for kind in KINDS if kind not in FORMS]


def grid(kind) -> tuple[np.ndarray, ...]:
    """Zero, typical and far out, both signs, of every argument together."""
    sizes = [size for _, size in FORMS[form_of(kind)][1].values()]
    points = itertools.product(*[[s * k for k in (-100, -1, -1e-3, 0, 1e-3, 1, 100)] for s in sizes])
    return tuple(np.array(column) for column in zip(*points, strict=True))


def test_the_walk_finds_every_family_and_every_exported_law():
    assert set(FORMS) <= set(KINDS)
    assert {kind.__name__ for kind in KINDS} == set(hydrotwin.models.laws.__all__)


@pytest.mark.parametrize("kind", KINDS)
def test_a_law_declares_unit_meaning_bounds_and_source_of_all_it_holds(kind):
    assert complaints(kind) == []


@pytest.mark.parametrize("kind", [kind for kind in LAWS if not kind.__name__.startswith("No")])
def test_a_law_names_the_source_of_its_equation(kind):
    assert "Source:" in kind.__doc__


@pytest.mark.parametrize("kind", LAWS)
def test_a_law_and_its_slope_are_finite_at_zero_and_far_out(kind):
    law, arguments = kind(), grid(kind)
    assert np.all(np.isfinite(values(law, *arguments)))
    for along in range(len(arguments)):
        assert np.all(np.isfinite(slopes(law, *arguments, along=along)))


@pytest.mark.parametrize("kind", LAWS)
def test_the_units_of_a_law_are_checked(kind):
    probe(kind())
    if not kind.__name__.startswith("No"):  # a literal zero fits any unit
        with pytest.raises(UnitError, match="units do not balance"):
            probe(kind(), answer_unit="kg.m")


@pytest.mark.parametrize("kind", [kind for kind in LAWS if issubclass(kind, (FrictionLaw, LeakageLaw))])
def test_friction_and_leakage_never_give_energy_and_are_odd(kind):
    (x,) = grid(kind)
    y = values(kind(), x)
    assert np.all(y * x >= 0)
    assert y == pytest.approx(-values(kind(), -x), rel=1e-12)


@pytest.mark.parametrize("kind", [kind for kind in LAWS if issubclass(kind, OrificeLaw)])
def test_an_orifice_never_gives_energy_and_is_shut_at_zero_opening(kind):
    dp = np.linspace(-2e7, 2e7, 41)
    assert np.all(values(kind(), 0.5, dp) * dp >= 0)
    assert np.all(values(kind(), 0.0, dp) == 0)


@pytest.mark.parametrize("kind", [kind for kind in LAWS if issubclass(kind, BulkModulusLaw)])
def test_oil_never_gets_softer_under_pressure_and_is_never_negative(kind):
    beta = values(kind(), np.linspace(-1e6, 5e7, 60))
    assert np.all(beta > 0) and np.all(np.diff(beta) >= 0)


def test_a_new_law_without_unit_source_bounds_or_docstring_is_found_out():
    class Careless(Law):
        grip = Parameter(0.0, "bar")

    flaws = "; ".join(complaints(Careless))
    for flaw in ("no docstring", "no source", "no finite bounds", "no description", "no nominal", "not in SI"):
        assert flaw in flaws


def test_a_law_of_an_unknown_family_cannot_go_untested():
    class Magic(Law):
        """A law of no known family."""

    with pytest.raises(AssertionError, match="Magic belongs to no family"):
        form_of(Magic)
    assert form_of(Viscous) is FrictionLaw
