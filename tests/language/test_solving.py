"""Blocks of equations: linear ones by elimination, small nonlinear ones by Newton, the rest refused by name."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import fsolve

from hydrotwin.models.language import (
    Component,
    Input,
    Model,
    Output,
    Parameter,
    State,
    TopologyError,
    Variable,
    connect,
    der,
)
from tests.language.parts import FlowSource, PressureSource, Restriction, observed, rates


class Bridge(Component):
    """Five laminar resistances in a Wheatstone bridge: a linear loop without any storage."""

    flow = Input("m3/s")
    pump = FlowSource()
    upper_left = Restriction(conductance=1e-11)
    upper_right = Restriction(conductance=2e-11)
    lower_left = Restriction(conductance=3e-11)
    lower_right = Restriction(conductance=5e-11)
    middle = Restriction(conductance=4e-11)
    tank = PressureSource(pressure=1e5)

    def equations(self):
        yield connect(self.flow, self.pump.flow)
        yield connect(self.pump.port, self.upper_left.a)
        yield connect(self.pump.port, self.upper_right.a)
        yield connect(self.upper_left.b, self.lower_left.a)
        yield connect(self.upper_right.b, self.lower_right.a)
        yield connect(self.upper_left.b, self.middle.a)
        yield connect(self.upper_right.b, self.middle.b)
        yield connect(self.lower_left.b, self.tank.port)
        yield connect(self.lower_right.b, self.tank.port)


def test_a_bridge_of_resistances_has_the_pressures_numpy_finds():
    q, tank = 1e-4, 1e5
    g1, g2, g3, g4, g5 = 1e-11, 2e-11, 3e-11, 5e-11, 4e-11
    nodal = np.array([[g1 + g2, -g1, -g2], [-g1, g1 + g3 + g5, -g5], [-g2, -g5, g2 + g4 + g5]])
    expected = np.linalg.solve(nodal, [q, g3 * tank, g4 * tank])
    seen = observed(Model(Bridge()), ["pump.port.p", "upper_left.b.p", "upper_right.b.p"], [], [q])
    assert seen == pytest.approx(expected, rel=1e-12)


def test_a_linear_loop_is_solved_exactly_for_every_parameter():
    model = Model(Bridge())
    names = [p.name for p in model.flat.parameters]
    p = ca.SX.sym("p", len(names))
    pressure = model.observe(["pump.port.p"])(0, [], [1e-4], p)
    slope = ca.Function("slope", [p], [ca.jacobian(pressure, p)])
    values = model.flat.parameter_vector()
    k, h = names.index("middle.conductance"), 1e-15
    up, down = (model.observe(["pump.port.p"])(0, [], [1e-4], values + d * np.eye(len(names))[k]) for d in (h, -h))
    assert float(slope(values)[k]) == pytest.approx(float(up - down) / (2 * h), rel=1e-6)


class Crossed(Component):
    """Two equations whose coefficients are all parameters: c x + 2 y = 1,  3 x + 4 y = 2, with c = 0."""

    x = Variable("1")
    y = Variable("1")
    seconds = State(0.0, "s", "a model has a state")
    absent = Parameter(0.0, "1")
    two = Parameter(2.0, "1")
    three = Parameter(3.0, "1")
    four = Parameter(4.0, "1")

    def equations(self):
        yield self.absent * self.x + self.two * self.y == 1
        yield self.three * self.x + self.four * self.y == 2
        yield der(self.seconds) == 1


def test_what_is_zero_until_it_is_looked_for_is_not_divided_by():
    assert observed(Model(Crossed()), ["x", "y"], [], []) == pytest.approx([0.0, 0.5], abs=1e-15)


class Orifices(Component):
    """Two turbulent orifices in series between a supply and a sink that holds a flow-dependent pressure."""

    supply = Input("Pa", default=10e5)
    middle = Variable("Pa", "between the orifices", nominal=1e5, start=5e5)
    flow = Variable("m3/s", "through both", nominal=1e-4, start=1e-4)
    first = Parameter(1e-7, "m3/(s.sqrt(Pa))")
    second = Parameter(2e-7, "m3/(s.sqrt(Pa))")
    seen = Output("m3/s")

    def equations(self):
        yield self.flow == self.first * ca.sqrt(self.supply - self.middle)
        yield self.flow == self.second * ca.sqrt(self.middle)
        yield self.seen == self.flow


def test_a_nonlinear_loop_has_the_root_fsolve_finds():
    ps, k1, k2 = 8e5, 1e-7, 2e-7

    def residual(z):
        return [z[1] * 1e4 - 1e4 * k1 * np.sqrt(ps - z[0] * 1e5), z[1] * 1e4 - 1e4 * k2 * np.sqrt(z[0] * 1e5)]

    root = fsolve(residual, [3.0, 1e-4], xtol=1e-13)
    seen = observed(Model(Orifices()), ["middle", "flow"], [], [ps])
    assert seen == pytest.approx([root[0] * 1e5, root[1]], rel=1e-8)


def test_orifices_in_series_obey_the_closed_form():
    ps, k1, k2 = 8e5, 1e-7, 2e-7
    assert observed(Model(Orifices()), ["flow"], [], [ps]) == pytest.approx(
        [np.sqrt(ps / (1 / k1**2 + 1 / k2**2))], rel=1e-12
    )


def test_the_root_moves_as_the_implicit_function_theorem_says():
    model = Model(Orifices())
    flat = model.flat
    u, p = ca.SX.sym("u"), ca.SX.sym("p", 2)
    flow = flat.ode(0, [], u, p)[1]
    slope = ca.Function("slope", [u, p], [ca.jacobian(flow, ca.vertcat(u, p))])
    ps, k1, k2 = 8e5, 1e-7, 2e-7
    series = 1 / k1**2 + 1 / k2**2
    q = np.sqrt(ps / series)
    expected = [q / (2 * ps), q / (series * k1**3), q / (series * k2**3)]
    assert np.array(slope(ps, [k1, k2])).ravel() == pytest.approx(expected, rel=1e-10)


def test_a_nonlinear_rate_is_found_through_newton_too():
    class Implicit(Component):
        x = State(1.0, "1", nominal=1.0)
        seconds = Parameter(1.0, "s")

        def equations(self):
            rate = self.seconds * der(self.x)
            yield rate**3 + rate == -self.x

    rate = rates(Model(Implicit()), [10.0])[0]
    assert rate == pytest.approx(-2.0, rel=1e-12)


def test_a_large_nonlinear_loop_is_refused_and_its_unknowns_are_named():
    class Ring(Component):
        a = Output("1")
        b = Output("1")
        c = Output("1")
        d = Output("1")
        e = Output("1")

        def equations(self):
            ring = [self.a, self.b, self.c, self.d, self.e]
            for k, each in enumerate(ring):
                yield each + 0.1 * each**3 + 0.1 * ca.sin(ring[(k + 1) % 5]) == 1.0

    with pytest.raises(TopologyError, match="a nonlinear loop ties a, b, c, d, e") as refused:
        Model(Ring()).flat  # noqa: B018
    assert "Break it with a small volume, an inertia or a lag" in str(refused.value)


def test_a_large_loop_is_solved_for_the_one_unknown_that_the_others_follow_from():
    class Chain(Component):
        a = Variable("1")
        b = Variable("1")
        c = Variable("1")
        d = Variable("1")
        e = Output("1")

        def equations(self):
            yield self.a == 2 * self.b
            yield self.b == self.c + 1
            yield self.c == -self.d
            yield self.d == 0.5 * self.e
            yield self.e == ca.tanh(self.a)

    flat = Model(Chain()).flat
    e = float(flat.ode(0, [], [], [])[1])
    assert e == pytest.approx(np.tanh(2 * (1 - 0.5 * e)), abs=1e-12)


def test_a_loop_without_a_root_is_refused_by_name():
    class Rootless(Component):
        y = Variable("1", start=1.0)
        z = Output("1")

        def equations(self):
            yield self.y**2 + 1 + self.z == 0
            yield self.z == self.y * 0.1

    with pytest.raises(TopologyError, match=r"nonlinear loop of .*y.* does not converge at the start values"):
        Model(Rootless()).flat  # noqa: B018


def test_a_start_where_newton_cannot_move_asks_for_another_start():
    class Flat(Component):
        y = Variable("1")
        z = Output("1")

        def equations(self):
            yield self.y**2 == 4.0 + self.z
            yield self.z == 0.1 * self.y**2

    with pytest.raises(TopologyError, match="start"):
        Model(Flat()).flat  # noqa: B018


def test_a_better_start_value_finds_the_other_root():
    class Square(Component):
        y = Variable("1", start=1.0)
        z = Output("1")

        def equations(self):
            yield self.y**2 == 4.0
            yield self.z == self.y

    class Negative(Square):
        y = Variable("1", start=-1.0)

    assert observed(Model(Square()), ["z"], []) == pytest.approx([2.0])
    assert observed(Model(Negative()), ["z"], []) == pytest.approx([-2.0])


def test_a_lever_that_vanishes_is_not_divided_by():
    class Lever(Component):
        q = State(0.0, "1")
        seconds = Parameter(1.0, "s")
        a = Output("1")
        b = Output("1")

        def equations(self):
            yield self.seconds * der(self.q) == 0
            yield self.q * self.a + self.b == 1
            yield self.a + 2 * self.b == 3

    assert observed(Model(Lever()), ["a", "b"], [0.0]) == pytest.approx([1.0, 1.0])
    expected = np.linalg.solve([[0.3, 1], [1, 2]], [1, 3])
    assert observed(Model(Lever()), ["a", "b"], [0.3]) == pytest.approx(expected, rel=1e-13)
