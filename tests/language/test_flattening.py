"""Flattening against equations derived by hand."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, connect, der, time
from tests.language.parts import (
    Damper,
    FlowSource,
    Friction,
    Lag,
    Oscillator,
    PressureSource,
    Restriction,
    Volume,
    observed,
    rates,
)


def test_oscillator_is_newtons_law():
    x, v, force = 0.12, -0.7, 3.0
    expected = [v, (force - 1e4 * x - 5.0 * v) / 2.0]
    assert rates(Model(Oscillator()), [x, v], [force]) == pytest.approx(expected, rel=1e-14)


def test_lag_output_is_measured_by_name():
    flat = Model(Lag()).flat
    assert [s.measured_by for s in flat.states] == ["y"]
    assert rates(Model(Lag()), [30.0], [0.5]) == pytest.approx([(120 * 0.5 - 30) / 0.03])


class Vessel(Component):
    """A pump fills a volume that drains through a restriction."""

    flow = Input("m3/s")
    pump = FlowSource()
    vessel = Volume()
    drain = Restriction()
    tank = PressureSource()

    def equations(self):
        yield connect(self.flow, self.pump.flow)
        yield connect(self.pump.port, self.vessel.port)
        yield connect(self.vessel.port, self.drain.a)
        yield connect(self.drain.b, self.tank.port)


def test_what_flows_in_compresses_the_oil_or_drains():
    p, q = 5e6, 1e-4
    expected = 1.5e9 / 1e-3 * (q - 1e-11 * (p - 2e5))
    assert rates(Model(Vessel()), [p], [q]) == pytest.approx([expected], rel=1e-13)


def test_every_variable_can_be_observed_by_path():
    model = Model(Vessel())
    p, q = 5e6, 1e-4
    leaving = 1e-11 * (p - 2e5)
    names = ["drain.a.q", "drain.b.q", "tank.port.q", "vessel.port.p", "der(vessel.pressure)"]
    expected = [leaving, -leaving, leaving, p, 1.5e12 * (q - leaving)]
    assert observed(model, names, [p], [q]) == pytest.approx(expected, rel=1e-12)


class Chirp(Component):
    """An integrator of an explicit function of time, and an expression's derivative."""

    angle = State(0.2, "rad")
    frequency = Parameter(3.0, "rad/s")
    slope = Output("rad/s")

    def equations(self):
        yield der(self.angle) == self.frequency * ca.sin(self.frequency * time())
        yield self.slope == der(self.angle**2 * ca.cos(self.angle))


def test_time_and_derivatives_of_expressions_follow_the_chain_rule():
    model = Model(Chirp())
    a, t = 0.6, 0.4
    rate = 3 * np.sin(3 * t)
    assert rates(model, [a], t=t) == pytest.approx([rate])
    slope = (2 * a * np.cos(a) - a**2 * np.sin(a)) * rate
    assert observed(model, ["slope"], [a], t=t) == pytest.approx([slope], rel=1e-13)


def test_vectors_keep_the_order_of_declaration():
    flat = Model(Oscillator()).flat
    assert [s.name for s in flat.states] == ["mass.position", "mass.velocity"]
    assert [p.name for p in flat.parameters] == ["mass.mass", "spring.stiffness", "damper.friction.viscous"]
    assert flat.ode.name_in() == ["t", "x", "u", "p"] and flat.ode.name_out() == ["xdot", "y"]
    assert flat.parameters[2].free and not flat.parameters[0].free


class Still(Component):
    """No states at all: a static relation is a model, too."""

    u = Input("1", default=2.0)
    y = Output("1")

    def equations(self):
        yield self.y == self.u**3


def test_a_static_relation_flattens_to_zero_states():
    flat = Model(Still()).flat
    assert flat.states == ()
    assert float(flat.ode(0, [], [2.0], [])[1]) == 8.0
    assert flat.start_given()([2.0], [], []).shape[0] == 0


def test_rates_that_appear_together_are_solved_together():
    class Coupled(Component):
        x = State(0.0, "m")
        y = State(0.0, "m")
        speed = Parameter(0.7, "m/s")

        def equations(self):
            yield der(self.x) + 2 * der(self.y) == self.speed
            yield 3 * der(self.x) - der(self.y) == 2 * self.speed

    expected = np.linalg.solve([[1, 2], [3, -1]], [0.7, 1.4])
    assert rates(Model(Coupled()), [0, 0]) == pytest.approx(expected, rel=1e-14)


class Bristle(Friction):
    """Friction with memory: a bristle of stiffness k that yields, z' = v - |v| z / z0 (Dahl)."""

    stiffness = Parameter(1e5, "N/m")
    yielding = Parameter(1e-3, "m")
    deflection = State(0.0, "m", nominal=1e-4)

    def equations(self):
        v = der(self.parent.end.s)
        yield der(self.deflection) == v - ca.fabs(v) * self.deflection / self.yielding

    def force(self, v):
        return super().force(v) + self.stiffness * self.deflection


def test_a_law_may_have_a_memory_of_its_own():
    model = Model(Oscillator(damper=Damper(friction=Bristle(viscous=5.0))))
    x, v, z = 0.1, 0.2, 3e-4
    expected = [v, (3 - 1e4 * x - 5 * v - 1e5 * z) / 2, v - v * z / 1e-3]
    assert rates(model, [x, v, z], [3.0]) == pytest.approx(expected, rel=1e-13)
    assert [s.name for s in model.flat.states][-1] == "damper.friction.deflection"
