"""Start values: fixed, from static equilibrium, or given from outside."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models.language import (
    Component,
    DeclarationError,
    Input,
    Model,
    Output,
    Parameter,
    SolveError,
    State,
    TopologyError,
    der,
)
from tests.language.parts import Mass, Oscillator


class RestingMass(Mass):
    """A mass that starts where its acceleration is zero."""

    position = State(0.0, "m", "position", nominal=0.1, fixed=False)

    def initial_equations(self):
        yield der(self.velocity) == 0


def start(model, u=(), given=None, **parameters):
    given = given or {}
    flat = model.flat
    p = flat.parameter_vector({k.replace("__", "."): v for k, v in parameters.items()})
    return np.array(flat.start_given(tuple(given))(list(u), p, list(given.values()))).ravel()


def test_fixed_states_start_as_declared():
    assert start(Model(Oscillator()), [0.0]) == pytest.approx([0.1, 0.0])


def test_a_mass_rests_where_the_spring_carries_the_first_force():
    model = Model(Oscillator(mass=RestingMass()))
    assert start(model, [50.0]) == pytest.approx([50.0 / 1e4, 0.0])
    assert start(model, [50.0], spring__stiffness=2e4) == pytest.approx([50.0 / 2e4, 0.0])


def test_equilibrium_holds_the_load_and_the_ode_stands_still():
    model = Model(Oscillator(mass=RestingMass()))
    x = model.equilibrium(inputs={"force": 50.0})
    rate = model.flat.ode(0, x, [50.0], model.flat.parameter_vector())[0]
    assert np.array(rate).ravel() == pytest.approx([0.0, 0.0], abs=1e-12)


def test_a_given_state_drops_the_equation_that_determined_it():
    model = Model(Oscillator(mass=RestingMass()))
    assert start(model, [50.0], {"mass.position": 0.3}) == pytest.approx([0.3, 0.0])
    assert start(model, [50.0], {"mass.velocity": 2.0}) == pytest.approx([(50 - 5 * 2.0) / 1e4, 2.0])


def test_the_derivative_of_the_start_follows_the_parameters():
    flat = Model(Oscillator(mass=RestingMass())).flat
    p = ca.SX.sym("p", len(flat.parameters))
    slope = ca.Function("slope", [p], [ca.jacobian(flat.start_given()([50.0], p, []), p)])
    k = [q.name for q in flat.parameters].index("spring.stiffness")
    assert float(slope(flat.parameter_vector())[0, k]) == pytest.approx(-50.0 / 1e8)


class Pendulum(Component):
    """Hangs against a torque: the start angle is the root of a nonlinear equation."""

    torque = Input("N.m")
    weight = Parameter(20.0, "N.m")
    inertia = Parameter(2.0, "kg.m2")
    angle = State(0.1, "rad", fixed=False)
    speed = State(0.0, "rad/s")

    def equations(self):
        yield der(self.angle) == self.speed
        yield self.inertia * der(self.speed) == self.torque - self.weight * ca.sin(self.angle)

    def initial_equations(self):
        yield der(self.speed) == 0


def test_a_pendulum_starts_where_its_weight_balances_the_torque():
    assert start(Model(Pendulum()), [10.0]) == pytest.approx([np.arcsin(0.5), 0.0], rel=1e-12)


def test_the_guess_of_a_start_may_be_a_function():
    class Upright(Pendulum):
        rough = Parameter(2.5, "rad")
        angle = State(lambda pendulum: pendulum.rough, "rad", fixed=False)

    assert start(Model(Upright()), [10.0]) == pytest.approx([np.pi - np.arcsin(0.5), 0.0], rel=1e-12)


def test_an_equilibrium_that_does_not_exist_is_refused_by_name():
    class Overloaded(Pendulum):
        torque = Input("N.m", default=30.0)

    with pytest.raises(SolveError, match=r"overloaded: no static equilibrium found for angle"):
        Model(Overloaded()).equilibrium()
    assert np.isnan(start(Model(Overloaded()), [30.0])[0])
    assert start(Model(Overloaded()), [10.0])[0] == pytest.approx(np.arcsin(0.5))


def test_starts_in_a_circle_are_refused_by_name():
    class Circle(Component):
        seconds = Parameter(1.0, "s")
        a = State(lambda c: 2 * c.b, "1")
        b = State(lambda c: 2 * c.a, "1")

        def equations(self):
            yield self.seconds * der(self.a) == -self.a
            yield self.seconds * der(self.b) == -self.b

    with pytest.raises(DeclarationError, match=r"circle\.[ab]: its start follows itself"):
        Model(Circle()).equilibrium()


def test_a_loose_state_needs_an_initial_equation():
    class Loose(Pendulum):
        def initial_equations(self):
            return ()

    with pytest.raises(TopologyError, match=r"0 initial equations for 1 states with fixed=False \(angle\)"):
        Model(Loose()).flat  # noqa: B018


def test_an_initial_equation_too_many_is_refused():
    class Crowded(Pendulum):
        angle = State(0.1, "rad")

    with pytest.raises(TopologyError, match=r"1 initial equations for 0 states with fixed=False \(none\)"):
        Model(Crowded()).flat  # noqa: B018


def test_an_initial_equation_that_says_nothing_of_the_loose_state_is_refused():
    class Idle(Pendulum):
        def initial_equations(self):
            yield self.speed == 0

    with pytest.raises(TopologyError, match="the initial equations do not determine angle"):
        Model(Idle()).flat  # noqa: B018


def test_two_pressures_balance_together():
    class Cylinder(Component):
        """Two chambers on one piston under a load, the rod side precharged."""

        load = Input("N")
        precharge = Parameter(2e6, "Pa")
        cap = Parameter(8e-4, "m2")
        rod = Parameter(6e-4, "m2")
        mass = Parameter(40.0, "kg")
        lag = Parameter(1.0, "s")
        p1 = State(1e6, "Pa", nominal=1e6, fixed=False)
        p2 = State(1e6, "Pa", nominal=1e6, fixed=False)
        v = State(0.0, "m/s")
        y = Output("N")

        def equations(self):
            yield self.mass * der(self.v) == self.p1 * self.cap - self.p2 * self.rod - self.load
            yield self.lag * der(self.p1) == 0
            yield self.lag * der(self.p2) == 0
            yield self.y == self.p1 * self.cap

        def initial_equations(self):
            yield der(self.v) == 0
            yield self.p2 == self.precharge

    model = Model(Cylinder())
    assert start(model, [500.0]) == pytest.approx([(500 + 2e6 * 6e-4) / 8e-4, 2e6, 0.0])
    assert start(model, [500.0], {"p2": 3e6}) == pytest.approx([(500 + 3e6 * 6e-4) / 8e-4, 3e6, 0.0])


def test_a_start_may_follow_the_start_of_another_state():
    class Follower(Component):
        seconds = Parameter(1.0, "s")
        leader = State(3.0, "1")
        follower = State(lambda c: 2 * c.leader, "1")

        def equations(self):
            yield self.seconds * der(self.leader) == -self.leader
            yield self.seconds * der(self.follower) == self.leader - self.follower

    model = Model(Follower())
    assert start(model) == pytest.approx([3.0, 6.0])
    assert start(model, (), {"leader": 5.0}) == pytest.approx([5.0, 10.0])


def test_an_unknown_given_state_asks_for_the_nearest():
    with pytest.raises(DeclarationError, match=r"no state 'angel'\. Did you mean 'angle'\?"):
        Model(Pendulum()).flat.start_given(("angel",))


def test_a_fixed_start_may_follow_one_that_equilibrium_finds():
    class Tied(Component):
        seconds = Parameter(1.0, "s")
        level = State(0.0, "1", fixed=False)
        twin = State(lambda c: 2 * c.level, "1")
        last = State(lambda c: 3 * c.twin, "1")

        def equations(self):
            yield self.seconds * der(self.level) == 18 - self.level - self.twin - self.last
            yield self.seconds * der(self.twin) == -self.twin
            yield self.seconds * der(self.last) == -self.last

        def initial_equations(self):
            yield der(self.level) == 0

    assert start(Model(Tied())) == pytest.approx([2.0, 4.0, 12.0])
    assert start(Model(Tied()), (), {"twin": 1.0}) == pytest.approx([14.0, 1.0, 3.0])
