"""Every component of the machine packages and every shipped model, found by walking."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

import hydrotwin.models.cehA
import hydrotwin.models.spool_valve
from hydrotwin.models.language.units import compatible
from tests.components.contract import complaints, registered

PARTS = registered(hydrotwin.models.cehA) + registered(hydrotwin.models.spool_valve)
MODELS = [
    hydrotwin.models.cehA.model,
    hydrotwin.models.cehA.third_order,
    hydrotwin.models.spool_valve.model,
    hydrotwin.models.spool_valve.quasi_static,
]


@pytest.mark.parametrize("kind", PARTS)
def test_a_part_of_a_machine_declares_unit_meaning_bounds_and_source_of_all_it_holds(kind):
    assert complaints(kind) == []


@pytest.mark.parametrize("make", MODELS)
def test_every_parameter_of_a_shipped_model_says_where_it_comes_from_and_lies_within_its_bounds(make):
    for p in make().flat.parameters:
        assert p.source and p.description and p.nominal > 0, p.name
        assert np.all(np.isfinite(p.bounds)) and p.bounds[0] <= p.value <= p.bounds[1], p.name
        assert p.bounds[0] < p.value < p.bounds[1] or not p.free, p.name


@pytest.mark.parametrize("make", MODELS)
def test_a_state_that_an_output_measures_has_the_unit_of_that_output(make):
    flat = make().flat
    units = {o.name: o.unit for o in flat.outputs}
    measured = [s for s in flat.states if s.measured_by]
    assert measured
    assert all(compatible(s.unit, units[s.measured_by]) for s in measured)


@pytest.mark.parametrize("make", MODELS)
def test_a_shipped_model_and_its_slopes_are_finite_at_rest_and_far_out(make):
    model = make()
    flat, x0 = model.flat, model.equilibrium()
    t, x, u, p = flat.ode.sx_in()
    everything = ca.vertcat(*flat.ode(t, x, u, p))
    f = ca.Function("f", [t, x, u, p], [everything, ca.jacobian(everything, ca.vertcat(x, u, p))])
    sizes = np.array([s.nominal for s in flat.states]), np.array([i.nominal for i in flat.inputs])
    for far in (0.0, 1.0, -1.0, 100.0, -100.0):
        for value in f(0, x0 + far * sizes[0], far * sizes[1], flat.parameter_vector()):
            assert np.all(np.isfinite(value.full())), f"{model.name} at {far} times nominal"
