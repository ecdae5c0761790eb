"""Every number that shipped laws, components, machines and effects declare is in their flat models; so is every key."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest

import hydrotwin.models.components
import hydrotwin.models.laws
from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.components import FirstOrderLag
from hydrotwin.models.effects import candidates
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, Variable, der
from hydrotwin.models.language.component import declarations
from tests.components.bench import any_bench
from tests.components.contract import registered
from tests.laws.probe import FORMS, probe

MACHINES = (cehA.model, cehA.third_order, spool_valve.model, spool_valve.quasi_static)
COMPONENTS = registered(hydrotwin.models.components)
LAWS = [kind for kind in registered(hydrotwin.models.laws) if kind not in FORMS]
OTHER_UNIT = {"Pa": "bar", "m": "mm", "s": "ms", "kg": "t", "rad": "deg", "1": "%", "N": "kN", "V": "mV"}


def idle(model: Model) -> list[str]:
    """Parameters on which no rate, output, start value or dead time depends."""
    flat = model.flat
    t, x, u, p = flat.ode.sx_in()
    ends = ca.vertcat(*flat.ode(t, x, u, p), flat.start_given()(u, p, []))
    late = {i.dead_time for i in flat.inputs}
    return [q.name for k, q in enumerate(flat.parameters) if q.name not in late and not ca.depends_on(ends, p[k])]


def written(flat) -> str:
    """All that is in a flat model, as text."""
    nu, parts = len(flat.inputs), (flat.inputs, flat.outputs, flat.states, flat.parameters)
    start = flat.start_given()(np.full(nu, 0.3), flat.parameter_vector(), [])
    return f"{parts} {start} {flat.step} {flat.name}"


@pytest.mark.parametrize("machine", MACHINES)
def test_every_parameter_of_a_machine_acts(machine):
    assert idle(machine()) == []


@pytest.mark.parametrize("kind", COMPONENTS)
def test_every_parameter_of_a_component_acts(kind):
    assert idle(any_bench(kind())) == []


def test_every_free_parameter_of_all_effects_together_acts():
    model = spool_valve.model()
    model.flat  # noqa: B018
    every = candidates(model)
    together = idle(model.plus([c.addition for c in every], sought=True))
    assert [name for c in every for name in c.free if name in together] == []


@pytest.mark.parametrize("law", LAWS)
def test_every_parameter_of_a_law_acts(law):
    flat = probe(law())
    t, x, u, p = flat.ode.sx_in()
    answer = flat.ode(t, x, u, p)[1]
    assert all(ca.depends_on(answer, p[k]) for k in range(p.numel()))


def changes(declared) -> dict[str, object]:
    """The declaration with one of its numbers, its unit or its freedom changed, by field."""
    found = {"nominal": dataclasses.replace(declared, nominal=3.7 * (declared.nominal or 1.0))}
    point = declared.points[0] if declared.points else None
    if point and not callable(value := getattr(declared, point)):
        low, high = getattr(declared, "bounds", (-np.inf, np.inf))
        other = next(
            v for v in (1.01 * value, 0.99 * value, value + 1e-3, value - 1e-3) if v != value and low <= v <= high
        )
        found[point] = dataclasses.replace(declared, **{point: other})
        if declared.unit in OTHER_UNIT and value and np.isinf([low, high]).all():
            found["unit"] = dataclasses.replace(declared, unit=OTHER_UNIT[declared.unit])
    if isinstance(declared, (Parameter, State)):
        low, high = declared.bounds
        found["bounds"] = dataclasses.replace(declared, bounds=(low - 1.0, high + 1.0 if np.isfinite(high) else 1e12))
    if isinstance(declared, Parameter):
        found["free"] = dataclasses.replace(declared, free=not declared.free)
    return found


@pytest.mark.parametrize("kind", COMPONENTS)
def test_every_number_of_a_declaration_is_in_the_flat_model(kind):
    own = {n: d for n, d in declarations(kind).items() if isinstance(d, (Parameter, State))}
    numbers = {n: changes(d) for n, d in own.items() if not any(callable(getattr(d, point)) for point in d.points)}
    before = held(any_bench(kind()).flat)
    for field in ("value", "start", "nominal", "bounds", "free"):
        changed = {name: others[field] for name, others in numbers.items() if field in others}
        after = held(any_bench(kind(**changed)).flat) if changed else {}
        for name in changed:
            assert after[f"part.{name}"] != before[f"part.{name}"], f"{name}: {field}"


def held(flat) -> dict[str, str]:
    """What a flat model holds of every parameter and state."""
    start = flat.start_given()(np.zeros(len(flat.inputs)), flat.parameter_vector(), []).full().ravel()
    states = {s.name: f"{s} {x}" for s, x in zip(flat.states, start, strict=True)}
    return states | {p.name: str(p) for p in flat.parameters}


class Every(Component):
    """An input, an output, a state and a parameter of a model, each with all its fields."""

    u = Input("m", "u", nominal=2.0, default=0.5)
    y = Output("m", "y", nominal=3.0)
    x = State(0.25, "m", "x", nominal=4.0, bounds=(-5.0, 5.0))
    z = Variable("m", "z", nominal=1.5, start=0.75)
    k = Parameter(1.0, "m", "k", source="setting")
    lag = FirstOrderLag()

    def equations(self):
        yield self.lag.u == self.u / self.k
        yield self.z + 0.1 * self.k * ca.tanh(self.z / self.k) == self.x + self.k
        yield self.y == self.z + self.u + self.lag.y * self.k
        yield (1.0 / self.lag.time_constant) * (self.u - self.x) == der(self.x)


@pytest.mark.parametrize("name", ("u", "y", "x", "k"))
def test_every_number_of_a_signal_is_in_the_flat_model(name):
    before = written(Model(Every(), "every").flat)
    for field, other in changes(declarations(Every)[name]).items():
        assert written(Model(Every(**{name: other}), "every").flat) != before, field


def test_the_guess_and_the_size_of_an_unknown_are_those_of_its_loop():
    (block,) = Model(Every(), "every")._solved.nonlinear
    (other,) = Model(Every(z=Variable("cm", "z", nominal=150.0, start=75.0)), "every")._solved.nonlinear
    assert block.nominals == other.nominals == (1.5,)
    (moved,) = Model(Every(z=Variable("m", "z", nominal=2.5)), "every")._solved.nonlinear
    assert moved.nominals == (2.5,)


KEYS = {"value": 1.5, "bounds": (0.5, 3.0), "free": True, "source": "bench", "sigma": 0.1}


@pytest.mark.parametrize("key", KEYS)
def test_every_key_of_a_setting_is_in_the_flat_model(key):
    settings = {"k": {key: KEYS[key]}}
    assert written(Model(Every(), "every", settings=settings).flat) != written(Model(Every(), "every").flat)
    if key in ("value", "bounds", "sigma"):
        in_mm = {
            "k": {key: tuple(1e3 * np.atleast_1d(KEYS[key])) if key == "bounds" else 1e3 * KEYS[key], "unit": "mm"}
        }
        one, other = (Model(Every(), "every", settings=s).flat.parameters for s in (settings, in_mm))
        p, q = (next(p for p in some if p.name == "k") for some in (one, other))
        assert (p.value, p.sigma) == pytest.approx((q.value, q.sigma)) if p.sigma else p.value == pytest.approx(q.value)
        assert p.bounds == pytest.approx(q.bounds)
