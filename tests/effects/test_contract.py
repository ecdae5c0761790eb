"""What every effect of the catalogue promises at each kind of site that several machines have."""

from __future__ import annotations

import dataclasses
from functools import cache
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import casadi as ca
import numpy as np
import pytest

import hydrotwin
from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.effects import CATALOGUE, candidates
from hydrotwin.models.effects.effect import neutral_difference
from hydrotwin.models.language import Parameter
from hydrotwin.models.language.additions import by_end
from hydrotwin.models.language.component import declarations
from hydrotwin.models.language.places import Places
from tests.effects import benches, hoses

MACHINES = {
    "cehA": cehA.model,
    "spool_valve": spool_valve.model,
    "pump_bench": benches.pump_bench,
    "valve_bench": benches.valve_bench,
    "axis": benches.axis,
    "tanks": benches.tanks,
    "turning_table": benches.turning_table,
    "winch": lambda: hoses.winch(1),
}
EXAMPLES = {  # models of users, on which the whole catalogue is looked for
    "emps": "examples/emps/model.py:axis",
    "cascaded_tanks": "examples/cascaded_tanks/model.py:model",
    "eha_bench": "examples/eha_bench/model.py:model",
}
ROOT = Path(__file__).parents[2]
UNIFORM = np.random.default_rng(7).uniform(-1, 1, (6, 3))
STATES = np.random.default_rng(8).uniform(-0.05, 0.05, 20)
STABLE = 2.7  # |rate| x step up to which Runge-Kutta of order four decays
FINEST = 8  # by which the simulation divides the step before it turns to an implicit method


@cache
def machine(name):
    return MACHINES[name]() if name in MACHINES else hydrotwin.load(f"{ROOT / EXAMPLES[name]}")


@cache
def found(name):
    return candidates(machine(name))


@cache
def added(name, label):
    return machine(name).plus([next(c for c in found(name) if c.label == label).addition], sought=True)


def inputs(model):
    """Operating points around zero, some large: (6, nu)."""
    return UNIFORM[:, : len(model.flat.inputs)] * [i.nominal for i in model.flat.inputs]


@cache
def places_of(name):
    return Places(machine(name))


def tied(name, chosen):
    """The kind of a site: the kinds of ports, the roles and the unit of signals that a part there is tied to."""
    site, places = chosen.site, places_of(name)
    roles = {wire.path: wire.role for wire in places.wires}
    ports = (*(site.ties or {}).items(), *by_end(site.between).items())
    ends = [(end, places.node_at(port).kind.__name__) for end, port in ports]
    ends += [(end, roles.get(path)) for end, path in by_end(site.through).items()]
    return (*ends, tuple(site.reads or ()), bool(site.frees), len(site.holds), site.unit, site.also_free, site.further)


def first_of_each(kind, names=tuple(MACHINES)):
    """The candidates (machine, label) of these machines that are the first of their ``kind(name, candidate)``."""
    firsts = {}
    for name in names:
        for c in found(name):
            firsts.setdefault(kind(name, c), (name, c.label))
    return list(firsts.values())


CASES = first_of_each(lambda name, c: (c.id, type(c.addition.part).__name__, tied(name, c)))
every_effect = pytest.mark.parametrize("effect", CATALOGUE.values(), ids=list(CATALOGUE))
every_kind = pytest.mark.parametrize(("name", "label"), CASES, ids=[f"{n}: {label}" for n, label in CASES])


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
    for simple, same in effect.refines.items():
        assert set(same) <= set(effect.typical) and set(same.values()) <= set(CATALOGUE[simple].typical)


@every_effect
def test_one_to_four_parameters_are_looked_for_and_each_has_unit_source_and_a_usual_range(effect):
    own = {k: d for k, d in declarations(effect).items() if isinstance(d, Parameter)}
    free = {k: p for k, p in own.items() if p.free}
    if not own:
        return  # it frees a parameter of the model
    assert 1 <= len(free) <= 4
    assert set(free) <= set(effect.typical)  # a part for another kind of site may have more
    for name, p in own.items():
        assert p.source and p.description, name
    for probe in effect.probes:
        assert set(probe) <= set(effect.typical)


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


@every_kind
def test_an_effect_at_neutral_changes_nothing(name, label):
    base, more = bare(name), prepared(name, label)
    order = [s.name for s in more.flat.states]
    where = [order.index(s.name) for s in base.flat.states]
    for u, t in zip(inputs(machine(name)), (0.0, 0.1, 1.0, 10.0, 100.0, 1000.0), strict=True):
        x, z = more.start(inputs(machine(name))[0]), base.start(inputs(machine(name))[0])
        x[where] = z = z + STATES[: len(z)] * [s.nominal for s in base.flat.states]
        rates, outputs = more.at(t, x, u)
        expected, measured = base.at(t, z, u)
        np.testing.assert_allclose(rates[where], expected, rtol=1e-12, atol=0)
        np.testing.assert_allclose(outputs, measured, rtol=1e-12, atol=0)


def test_the_official_measure_of_neutrality_agrees_and_sees_an_effect_that_is_there():
    model = machine("axis")
    for chosen in found("axis"):
        assert neutral_difference(model, chosen, inputs(model), np.arange(6.0)) <= 1e-12
    biased = candidates(model, ["sensor_scale at position"])[0]
    there = SimpleNamespace(addition=dataclasses.replace(biased.addition, part=biased.addition.part.but(error=0.01)))
    assert neutral_difference(model, there, inputs(model)[:1], np.zeros(1)) == pytest.approx(0.01, rel=0.05)


@every_kind
def test_the_model_itself_is_left_as_it_was(name, label):
    model, more = machine(name), added(name, label)
    assert not model.additions and len(more.additions) == 1
    assert set(p.name for p in model.flat.parameters) == set(
        p.name for p in more.flat.parameters if p.name not in _own(candidate(name, label), more)
    )


def _own(chosen, model):
    own = {p.name for p in model.flat.parameters if chosen.name and p.name.startswith(f"{chosen.name}.")}
    return own | set(chosen.site.holds)


@pytest.mark.parametrize(("name", "label"), first_of_each(tied, ("pump_bench", "valve_bench", "tanks")))
def test_what_else_fits_keeps_its_name_once_an_effect_was_added(name, label):
    """One effect at each kind of site: how it is tied in decides what else finds its place."""
    again = [c.label for c in candidates(added(name, label))]
    assert again == [c.label for c in found(name) if c.label != label]


@every_kind
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


@every_kind
def test_rates_outputs_and_their_derivatives_are_finite_at_neutral_and_at_every_start(name, label):
    model = prepared(name, label)
    for values, u in product(({}, *candidate(name, label).probes), inputs(machine(name))):
        x = model.start(u, values)
        assert all(np.isfinite(part).all() for part in (*model.at(0.5, x, u, values), model.slopes(u, values)))


@every_kind
def test_the_models_own_step_or_an_eighth_of_it_is_short_enough_wherever_it_is_without_the_effect(name, label):
    base, more, step = bare(name), prepared(name, label), machine(name).step
    for u in inputs(machine(name)):
        if base.fastest(u) * step <= STABLE:
            for values in ({}, *candidate(name, label).probes):
                assert more.fastest(u, values) * step / FINEST <= STABLE, values


class Prepared:
    """A flat model with what is asked of it often."""

    def __init__(self, flat):
        self.flat, self._start = flat, flat.start_given()
        t, x, u, p = flat.ode.sx_in()
        rates, outputs = flat.ode(t, x, u, p)
        both = ca.jacobian(ca.vertcat(rates, outputs), ca.vertcat(x, u, p))
        self._slopes = ca.Function("slopes", [t, x, u, p], [both])

    def start(self, u, values=()):
        return self._start(u, self.flat.parameter_vector(dict(values)), []).full().ravel()

    def at(self, t, x, u, values=()):
        """Rates and outputs."""
        return [part.full().ravel() for part in self.flat.ode(t, x, u, self.flat.parameter_vector(dict(values)))]

    def slopes(self, u, values=()):
        """Derivatives of rates and outputs to states, inputs and parameters, at the start."""
        p = self.flat.parameter_vector(dict(values))
        return self._slopes(0.5, self.start(u, values), u, p).full()

    def fastest(self, u, values=()):
        """Largest size of an eigenvalue [1/s] at the start."""
        n = len(self.flat.states)
        return np.abs(np.linalg.eigvals(self.slopes(u, values)[:n, :n])).max(initial=0.0)


@cache
def bare(name):
    return Prepared(machine(name).flat)


@cache
def prepared(name, label):
    return Prepared(added(name, label).flat)


@pytest.mark.parametrize("name", [*MACHINES, *EXAMPLES])
def test_all_candidates_in_one_model_at_neutral_are_the_model_without_them(name):
    model = machine(name)
    more, base = Prepared(model.plus([c.addition for c in found(name)]).flat), bare(name)
    order = [s.name for s in more.flat.states]
    where = [order.index(s.name) for s in base.flat.states]
    scale = np.array([s.nominal for s in base.flat.states])
    for u in inputs(model):
        x, z = more.start(u), base.start(u)
        np.testing.assert_allclose(x[where], z, rtol=1e-12, atol=0)
        rates, outputs = more.at(0.5, x, u)
        expected, measured = base.at(0.5, z, u)
        np.testing.assert_allclose(rates[where] / scale, expected / scale, rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(outputs, measured, rtol=1e-12, atol=0)
        assert more.fastest(u) * model.step <= STABLE


@pytest.mark.parametrize("name", MACHINES)
def test_states_that_outputs_measure_stay_measured_with_every_sensor_in_doubt(name):
    model = machine(name)
    more = model.plus([c.addition for c in found(name) if c.effect.family == "sensor"]).flat
    measured = {s.name: s.measured_by for s in more.states}
    for state in model.flat.states:
        assert measured[state.name] == state.measured_by
