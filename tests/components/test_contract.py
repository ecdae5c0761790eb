"""Every component in models/components, found by walking the package, put on a test bench."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import hydrotwin.models.components
from hydrotwin.models.language import Component, HydraulicPort, Parameter
from tests.components.bench import any_bench
from tests.components.contract import complaints, registered

KINDS = registered(hydrotwin.models.components)


def test_the_walk_finds_every_exported_component():
    assert {kind.__name__ for kind in KINDS} == set(hydrotwin.models.components.__all__)


@pytest.mark.parametrize("kind", KINDS)
def test_a_component_declares_unit_meaning_bounds_and_source_of_all_it_holds(kind):
    assert complaints(kind) == []


@pytest.mark.parametrize("kind", KINDS)
def test_a_component_is_balanced_in_units_and_number_and_finite_at_zero_and_far_out(kind):
    flat = any_bench(kind()).flat  # flattening checks units and counts equations
    t, x, u, p = flat.ode.sx_in()
    everything = ca.vertcat(*flat.ode(t, x, u, p))
    slopes = ca.jacobian(everything, ca.vertcat(x, u, p))
    f = ca.Function("f", [t, x, u, p], [everything, slopes])
    sizes = np.array([s.nominal for s in flat.states]), np.array([i.nominal for i in flat.inputs])
    for far in (0.0, 1.0, -1.0, 1e3, -1e3):
        value, slope = (v.full() for v in f(0, far * sizes[0], far * sizes[1], flat.parameter_vector()))
        assert np.all(np.isfinite(value)), f"{kind.__name__} at {far} times nominal"
        assert np.all(np.isfinite(slope)), f"slope of {kind.__name__} at {far} times nominal"


def test_a_new_component_without_a_source_is_found_out():
    class Leaky(Component):
        """A component that does not say where its number comes from."""

        port = HydraulicPort("end")
        gap = Parameter(1e-5, "m", "gap", bounds=(0, 1e-3))

        def equations(self):
            yield self.port.q == self.gap * self.port.p

    assert complaints(Leaky) == ["Leaky.gap has no source"]
    with pytest.raises(AssertionError, match=r"no bench fits.*units do not balance"):
        any_bench(Leaky())
