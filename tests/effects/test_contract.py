"""What every effect of the catalogue promises, at every site of several machines."""

from __future__ import annotations

from functools import cache
from itertools import product

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.effects import CATALOGUE, candidates
from hydrotwin.models.effects.effect import neutral_difference
from hydrotwin.models.language import Parameter
from hydrotwin.models.language.component import declarations
from tests.effects import benches

MACHINES = {
    "cehA": cehA.model,
    "spool_valve": spool_valve.model,
    "pump_bench": benches.pump_bench,
    "valve_bench": benches.valve_bench,
    "axis": benches.axis,
    "tanks": benches.tanks,
}
UNIFORM = np.random.default_rng(7).uniform(-1, 1, (6, 3))
STABLE = 2.7  # |rate| x step up to which Runge-Kutta of order four decays


@cache
def machine(name):
    return MACHINES[name]()


@cache
def found(name):
    return candidates(machine(name))


@cache
def added(name, label):
    return machine(name).plus([next(c for c in found(name) if c.label == label).addition])


def inputs(model):
    """Operating points around zero, some large: (6, nu)."""
    return UNIFORM[:, : len(model.flat.inputs)] * [i.nominal for i in model.flat.inputs]


CASES = [(name, c.label) for name in MACHINES for c in found(name)]
every_effect = pytest.mark.parametrize("effect", CATALOGUE.values(), ids=list(CATALOGUE))
every_site = pytest.mark.parametrize(("name", "label"), CASES, ids=[f"{n}: {label}" for n, label in CASES])


def candidate(name, label):
    return next(c for c in found(name) if c.label == label)


@every_effect
def test_an_effect_says_what_it_is_where_it_is_from_and_how_to_tell_it_from_others(effect):
    for text in ("title", "equation", "source", "family", "experiment"):
        assert getattr(effect, text).strip(), text
    assert effect.__doc__ and effect.__doc__ != effect.__mro__[1].__doc__
    assert effect.typical and effect.probes and effect.confused_with
    assert 0 <= effect.order <= 9


@every_effect
def test_the_names_an_effect_gives_are_names_of_other_effects(effect):
    for other in (*effect.refines, *effect.confused_with):
        assert other in CATALOGUE and other != effect.id


@every_effect
def test_one_to_four_parameters_are_looked_for_and_each_has_unit_source_and_a_usual_range(effect):
    own = {k: d for k, d in declarations(effect).items() if isinstance(d, Parameter)}
    free = {k: p for k, p in own.items() if p.free}
    if not own:
        return  # it frees a parameter of the model
    assert 1 <= len(free) <= 4
    assert set(free) == set(effect.typical)
    for name, p in own.items():
        assert p.source and p.description, name
    for probe in effect.probes:
        assert set(probe) <= set(free)


@every_effect
def test_usual_ranges_and_starts_lie_within_the_bounds(effect):
    for name, p in declarations(effect).items():
        if isinstance(p, Parameter) and p.free:
            low, high = effect.typical[name]
            assert p.bounds[0] <= low < high <= p.bounds[1]
            assert all(p.bounds[0] <= probe.get(name, p.value) <= p.bounds[1] for probe in effect.probes)
            assert p.nominal and p.nominal > 0


@every_effect
def test_every_effect_fits_somewhere_on_the_machines_tested(effect):
    assert any(label.startswith(f"{effect.id} at ") for _, label in CASES)


@pytest.mark.parametrize("name", MACHINES)
def test_no_two_candidates_share_a_name(name):
    labels = [c.label for c in found(name)]
    parts = [c.name for c in found(name) if c.name]
    assert len(labels) == len(set(labels)) and len(parts) == len(set(parts))


@every_site
def test_an_effect_at_neutral_changes_nothing(name, label):
    model = machine(name)
    times = np.array([0.0, 0.1, 1.0, 10.0, 100.0, 1000.0])
    assert neutral_difference(model, candidate(name, label), inputs(model), times) <= 1e-12


@every_site
def test_the_model_itself_is_left_as_it_was(name, label):
    model, more = machine(name), added(name, label)
    assert not model.additions and len(more.additions) == 1
    assert set(p.name for p in model.flat.parameters) == set(
        p.name for p in more.flat.parameters if p.name not in _own(candidate(name, label), more)
    )


def _own(chosen, model):
    return {p.name for p in model.flat.parameters if chosen.name and p.name.startswith(f"{chosen.name}.")}


@every_site
def test_what_is_looked_for_is_free_at_neutral_and_within_bounds_that_contain_every_start(name, label):
    chosen, flat = candidate(name, label), added(name, label).flat
    parameters = {p.name: p for p in flat.parameters}
    assert chosen.free and chosen.probes
    for path in chosen.free:
        p = parameters[path]
        assert p.free and p.value == chosen.neutral[path]
        assert p.bounds[0] <= p.value <= p.bounds[1]
        for probe in chosen.probes:
            assert p.bounds[0] <= probe.get(path, p.value) <= p.bounds[1]
        low, high = chosen.typical[path]
        assert low < high
    assert any(probe[path] != chosen.neutral[path] for probe in chosen.probes for path in probe)


@every_site
def test_rates_outputs_and_their_derivatives_are_finite_at_neutral_and_at_every_start(name, label):
    chosen, flat = candidate(name, label), added(name, label).flat
    jacobian = derivatives(flat)
    for values, u in product(({}, *chosen.probes), inputs(machine(name))):
        p = flat.parameter_vector(values)
        x = flat.start_given()(u, p, [])
        assert all(np.isfinite(np.array(part)).all() for part in (*flat.ode(0.5, x, u, p), *jacobian(0.5, x, u, p)))


@every_site
def test_the_models_own_step_is_short_enough_wherever_it_is_without_the_effect(name, label):
    chosen, model = candidate(name, label), added(name, label)
    flat, base = model.flat, machine(name).flat
    for u in inputs(machine(name)):
        q = base.parameter_vector()
        if fastest(base, u, q) * model.step > STABLE:
            continue
        for values in ({}, *chosen.probes):
            assert fastest(flat, u, flat.parameter_vector(values)) * model.step <= STABLE, values


def fastest(flat, u, p):
    """Largest size of an eigenvalue [1/s] at the start."""
    x = flat.start_given()(u, p, [])
    return np.abs(np.linalg.eigvals(np.array(derivatives(flat)(0.5, x, u, p)[0]))).max(initial=0.0)


@cache
def derivatives(flat):
    """Of rates to states, and of rates and outputs to parameters and inputs."""
    t, x, u, p = flat.ode.sx_in()
    rates, outputs = flat.ode(t, x, u, p)
    both = ca.vertcat(rates, outputs)
    return ca.Function("d", [t, x, u, p], [ca.jacobian(rates, x), ca.jacobian(both, ca.vertcat(x, u, p))])


@pytest.mark.parametrize("name", MACHINES)
def test_all_candidates_in_one_model_at_neutral_are_the_model_without_them(name):
    model = machine(name)
    flat, base = model.plus([c.addition for c in found(name)]).flat, model.flat
    order = [s.name for s in flat.states]
    where = [order.index(s.name) for s in base.states]
    for u in inputs(model):
        x = flat.start_given()(u, flat.parameter_vector(), []).full().ravel()
        z = base.start_given()(u, base.parameter_vector(), []).full().ravel()
        rates, outputs = (part.full().ravel() for part in flat.ode(0.5, x, u, flat.parameter_vector()))
        expected, measured = (part.full().ravel() for part in base.ode(0.5, z, u, base.parameter_vector()))
        np.testing.assert_allclose(x[where], z, rtol=1e-12, atol=0)
        scale = np.array([s.nominal for s in base.states])
        np.testing.assert_allclose(rates[where] / scale, expected / scale, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(outputs, measured, rtol=1e-12, atol=0)


@pytest.mark.parametrize("name", MACHINES)
def test_states_that_outputs_measure_stay_measured_with_every_sensor_in_doubt(name):
    model = machine(name)
    more = model.plus([c.addition for c in found(name) if c.effect.family == "sensor"]).flat
    measured = {s.name: s.measured_by for s in more.states}
    for state in model.flat.states:
        assert measured[state.name] == state.measured_by
