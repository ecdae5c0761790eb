"""Loops without a solution of their own are found when a model is built, whatever they would have been solved as."""

from __future__ import annotations

import casadi as ca
import pytest

from hydrotwin.models.components import FirstOrderLag, Gain
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


class Loop(Component):
    """Two gains that feed each other, beside a lag."""

    u = Input("1", "input")
    y = Output("1", "output")
    a = Gain(k=1.0)
    b = Gain(k=1.0)
    lag = FirstOrderLag()

    def equations(self):
        yield connect(self.u, self.lag.u)
        yield connect(self.a.y, self.b.u)
        yield connect(self.b.y, self.a.u)
        yield self.y == self.a.y


def pair(equations) -> Model:
    """Unknowns ``a`` and ``b`` tied by two equations of them, an input, a state and two parameters."""

    def all_equations(self):
        yield self.T * der(self.x) == self.u - self.x
        yield self.y == self.a
        yield from equations(self)

    content = {
        "u": Input("1"), "y": Output("1"), "x": State(0.5, "1"), "a": Variable("1"), "b": Variable("1"),
        "k": Parameter(1.0, "1"), "T": Parameter(1.0, "s"), "equations": all_equations,
    }  # fmt: skip
    return Model(type("Pair", (Component,), content)(), "pair")


def test_two_gains_of_one_that_feed_each_other_are_refused():
    with pytest.raises(TopologyError, match=r"equations for .*a\.y, b\.y.* singular at the parameter values.* a lag"):
        Model(Loop(), "loop").flat  # noqa: B018


def test_the_same_loop_with_other_gains_has_its_solution_and_loses_it_with_the_values():
    damped = Model(Loop(b=Gain(k=0.5)), "loop")
    assert float(damped.flat.ode(0, [0], [1], damped.flat.parameter_vector())[1]) == 0.0
    with pytest.raises(TopologyError, match="singular at the parameter values"):
        damped.with_parameters({"b.k": 1.0}).flat  # noqa: B018
    with pytest.raises(TopologyError, match="singular at the parameter values"):
        damped.with_parameters({"a.k": 3.0, "b.k": 1 / 3}).flat  # noqa: B018


SINGULAR = {
    "driven": lambda s: (s.a == s.k * s.b + s.u, s.b == s.k * s.a),
    "itself": lambda s: (s.k * s.a == s.a, s.b == s.a),
    "divided": lambda s: ((s.k - 1) * s.a == s.x, s.b == s.a),
    "identity": lambda s: (s.a == ca.sin(s.k) ** 2 * s.a + ca.cos(s.k) ** 2 * s.b + s.u, s.b == s.a),
    "rounding": lambda s: (s.a == 0.1 * s.b + 0.2 * s.b + 0.7 * s.b, s.b == s.a),
    "dependent": lambda s: (s.a + s.b == s.u, 2 * s.a + 2 * s.b == s.x),
    "one-sided": lambda s: (s.a == ca.fmax(s.b, 0), s.b == ca.fmax(s.a, 0)),
    "squares": lambda s: (s.a**2 == s.b**2, s.a == s.b),
}


@pytest.mark.parametrize("name", SINGULAR)
def test_a_loop_without_a_solution_of_its_own_is_refused(name):
    with pytest.raises(TopologyError, match=r"singular|nothing changes with them"):
        pair(SINGULAR[name]).flat  # noqa: B018


@pytest.mark.parametrize(
    ("equations", "a"),
    (
        (lambda s: (s.a == ca.tanh(s.b) + s.u, s.b == 0.5 * s.a), 1.68789),
        (lambda s: (s.a == 0.5 * ca.fabs(s.b) + s.u, s.b == 0.5 * s.a), 1 / 0.75),
        (lambda s: (s.a == s.x * s.b + s.u, s.b == s.a), 2.0),
        (lambda s: (1e-14 * s.k * s.a + s.b == 1e-14 * s.x, s.b == 0), 0.5),
    ),
)
def test_a_loop_with_one_solution_keeps_it(equations, a):
    flat = pair(equations).flat
    assert float(flat.ode(0, [0.5], [1.0], flat.parameter_vector())[1]) == pytest.approx(a, rel=1e-5)


def test_a_start_that_its_equation_does_not_determine_is_no_number():
    class Resting(Component):
        y = Output("1")
        x = State(0.7, "1", fixed=False)
        k = Parameter(1.0, "1")
        T = Parameter(1.0, "s")

        def equations(self):
            yield self.T * der(self.x) == -self.x
            yield self.y == self.x

        def initial_equations(self):
            yield self.k * self.x == self.x

    start = Model(Resting(), "resting").flat.start_given()
    assert start([], [1.0, 1.0], []).is_regular() is False
    assert float(start([], [2.0, 1.0], [])) == 0.0
