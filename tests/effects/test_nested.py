"""Effects on machines whose parts sit inside subsystems: they act where the part is, once, or are refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models import cehA
from hydrotwin.models.components import Cylinder, LinearLoad, Pump, SpeedSource
from hydrotwin.models.effects import candidates
from hydrotwin.models.effects.effect import add_effect
from hydrotwin.models.language import (
    Component,
    Flange,
    HydraulicPort,
    Input,
    Model,
    Output,
    TopologyError,
    connect,
)


class Drive(Component):
    """A cylinder and nothing else, behind ports of its own."""

    cap = HydraulicPort("cap side")
    annulus = HydraulicPort("rod side")
    rod = Flange("rod")
    cylinder = Cylinder(cap_pressure=3e6, rod_pressure=2e6)

    def equations(self):
        yield connect(self.cap, self.cylinder.cap)
        yield connect(self.annulus, self.cylinder.annulus)
        yield connect(self.rod, self.cylinder.rod)


class Twice(Drive):
    """The same, one level further down."""

    cylinder = Drive()

    def equations(self):
        yield connect(self.cap, self.cylinder.cap)
        yield connect(self.annulus, self.cylinder.annulus)
        yield connect(self.rod, self.cylinder.rod)


class Press(Component):
    """A pump at a measured speed moves a load."""

    speed = Input("rad/s", "measured speed", nominal=100.0, interpolation="linear", default=10.0)
    position = Output("m", "stroke", nominal=0.1)
    motor = SpeedSource()
    pump = Pump(return_ratio=0.8)
    drive = Cylinder(cap_pressure=3e6, rod_pressure=2e6)
    load = LinearLoad(mass=200.0)

    def equations(self):
        yield connect(self.speed, self.motor.speed)
        yield connect(self.motor.shaft, self.pump.shaft)
        yield connect(self.pump.cap, self.drive.cap)
        yield connect(self.pump.rod, self.drive.annulus)
        yield connect(self.drive.rod, self.load.flange)
        yield self.position == self.load.position


def press(drive: Component) -> Model:
    changed = type("Press", (Press,), {"drive": drive})
    return Model(changed(), "press")


FLAT, NESTED = press(Cylinder(cap_pressure=3e6, rod_pressure=2e6)), (press(Drive()), press(Twice()))


@pytest.mark.parametrize("model", NESTED, ids=("once", "twice"))
@pytest.mark.parametrize(
    ("effect", "values"), (("entrained_air", {"fraction": 0.02}), ("cavitation", {"pressure": 1.9e6}))
)
def test_oil_of_a_nested_cylinder_is_as_soft_as_that_of_a_cylinder_beside_the_pump(model, effect, values):
    rates = []
    for one in (FLAT, model):
        flat = add_effect(one, effect, values=values).flat
        x = [3e6, 1.5e6, 0.1, 0.02]
        rates.append(flat.ode(0, x, [50.0], flat.parameter_vector())[0].full().ravel())
    bare = FLAT.flat.ode(0, x, [50.0], FLAT.flat.parameter_vector())[0].full().ravel()
    assert rates[1] == pytest.approx(rates[0], rel=1e-12)
    assert np.max(np.abs(rates[0][:2] / bare[:2] - 1)) > 0.01


@pytest.mark.parametrize("model", NESTED, ids=("once", "twice"))
def test_a_nested_machine_has_the_candidates_of_the_flat_one(model):
    def kinds(one):
        return sorted(c.id for c in candidates(one))

    assert kinds(model) == kinds(FLAT)


@pytest.mark.parametrize("model", NESTED, ids=("once", "twice"))
def test_every_candidate_that_acts_on_the_flat_machine_acts_on_the_nested_one(model):
    for one in candidates(model):
        added = model.plus([one.addition], sought=True).flat
        t, x, u, p = added.ode.sx_in()
        late = {i.dead_time for i in added.inputs}
        ends = ca.vertcat(*added.ode(t, x, u, p))
        acts = [n in late or ca.depends_on(ends, p[added.index_of(n)]) for n in one.free]
        assert all(acts), one.label


def test_an_effect_that_changes_nothing_is_refused_and_may_be_looked_for():
    with pytest.raises(TopologyError, match=r"'line_friction' at 'cylinder\.cap' changes nothing: .*laminar"):
        add_effect(cehA.model(), "line_friction", "cylinder.cap").flat  # noqa: B018
    assert not candidates(cehA.model(), ["line_friction at cylinder.cap"])
    sought = next(c for c in candidates(cehA.model(), ["line_friction at cylinder.cap"], merged=False))
    assert cehA.model().plus([sought.addition], sought=True).flat.states[-1].name.endswith("flow_0")


def test_what_acts_on_nothing_but_the_start_or_a_dead_time_acts():
    model = cehA.model()
    for effect, site in (
        ("dead_time", "command"),
        ("payload_error", "arm.extra_mass"),
        ("linkage_error", "arm.base_length"),
    ):
        assert add_effect(model, effect, site).flat.parameters
