"""Loops whose equations jump or have a root of zero in them: solved, or refused, never answered from the wrong side."""

from __future__ import annotations

import itertools

import casadi as ca
import numpy as np
import pytest

from hydrotwin.identification import identify
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, Variable, der
from hydrotwin.models.language.jumps import jumps
from hydrotwin.records import Record
from hydrotwin.simulation import Diverged, simulate

TIME = np.linspace(0, 1, 101)


def loop(equation, nominal: float = 1.0, start: float = 0.0) -> Model:
    """A variable that ``equation(variable, input)`` makes zero."""

    class Loop(Component):
        u = Input("1", "in", interpolation="hold")
        y = Output("1", "out")
        a = Variable("1", "a", nominal=nominal, start=start)

        def equations(self):
            yield equation(self.a, self.u) == 0
            yield self.y == self.a

    return Model(Loop(), "loop")


def answer(model: Model, level: float = 1.0, method: str = "vm") -> np.ndarray:
    """The output; not compiled, unless the method says so."""
    return simulate(model, Record(TIME, {"u": np.full(101, level)}, {"u": "1"}, "level"), method=method)["y"]


STEPS = {
    "greater": (lambda a, u: a + 0.5 * (a > 1) - 3 * u, 2.5),
    "sign": (lambda a, u: a + 2 * ca.sign(a) - 5 * u, 3.0),
    "cases": (lambda a, u: a + ca.if_else(a > 1, 0.5, 0) - 3 * u, 2.5),
    "floor": (lambda a, u: a - ca.floor(a / 2) - 3 * u, 5.0),
    "both": (lambda a, u: a + 0.5 * ca.logic_and(a > 1, a < 9) - 3 * u, 2.5),
    "copied sign": (lambda a, u: a + 0.5 * ca.copysign(1, a - 1) - 3 * u, 2.5),
}


@pytest.mark.parametrize(("equation", "right"), STEPS.values(), ids=STEPS.keys())
def test_a_step_of_the_unknown_is_taken_where_the_unknown_is(equation, right):
    np.testing.assert_allclose(answer(loop(equation)), right, rtol=1e-9)


def test_compiled_it_is_the_same():
    for equation, *rest, right in (STEPS["both"], ROOTS["two orifices of either sign"]):
        np.testing.assert_allclose(answer(loop(equation, *rest), method="auto"), right, rtol=1e-9)


def signed_root(a):
    return ca.sign(a) * ca.sqrt(ca.fabs(a))


ROOTS = {
    "throttle": (lambda a, u: 3e-7 * ca.sqrt(a) - 5e-4 * u, 1e6, (5e-4 / 3e-7) ** 2),
    "two orifices": (lambda a, u: 3e-7 * ca.sqrt(1e7 * u - a) - 1e-7 * ca.sqrt(a), 1e6, 9e6),
    "two orifices that close": (
        lambda a, u: 3e-7 * ca.sqrt(ca.fmax(1e7 * u - a, 0)) - 1e-7 * ca.sqrt(ca.fmax(a, 0)), 1e6, 9e6,
    ),
    "two orifices of either sign": (lambda a, u: 3e-7 * signed_root(1e7 * u - a) - 1e-7 * signed_root(a), 1e6, 9e6),
    "power": (lambda a, u: a**0.5 - 2 * u, 1.0, 4.0),
    "logarithm": (lambda a, u: ca.log(a) - u, 1.0, np.e),
}  # fmt: skip


@pytest.mark.parametrize(("equation", "nominal", "right"), ROOTS.values(), ids=ROOTS.keys())
def test_a_root_that_starts_at_zero_is_solved(equation, nominal, right):
    np.testing.assert_allclose(answer(loop(equation, nominal)), right, rtol=1e-9)


@pytest.mark.parametrize("nominal", (1e5, 1e7))
@pytest.mark.parametrize(
    "root", (ca.sqrt, lambda x: ca.sqrt(ca.fmax(x, 0)), signed_root), ids=("plain", "shut", "signed")
)
def test_orifices_in_series_share_the_pressure(root, nominal):
    K, supply = np.array([3e-7, 1e-7, 2e-7, 4e-7]), 2e7

    class Series(Component):
        u = Input("1", "in", interpolation="hold")
        y = Output("1", "out")
        a = Variable("1", "a", nominal=nominal)
        b = Variable("1", "b", nominal=nominal)
        c = Variable("1", "c", nominal=nominal)

        def equations(self):
            p = [supply * self.u, self.a, self.b, self.c, 0]
            flow = [k * root(here - there) for k, here, there in zip(K, p[:-1], p[1:], strict=True)]
            for before, after in itertools.pairwise(flow):
                yield before == after
            yield self.y == self.a

    np.testing.assert_allclose(answer(Model(Series(), "series")), supply * (1 - K[0] ** -2 / sum(K**-2)), rtol=1e-9)


def test_a_throttle_without_flow_has_no_pressure():
    flow = Record(TIME, {"u": np.where(TIME > 0.5, 1.0, 0.0)}, {"u": "1"}, "opened")
    pressure = simulate(loop(*ROOTS["throttle"][:2]), flow)["y"]
    assert pressure[0] == 0 and pressure[-1] == pytest.approx(ROOTS["throttle"][2])


def test_a_solution_at_the_start_has_its_derivatives():
    rooted = loop(lambda a, u: ca.sqrt(1 + a) - (1 + u))  # a = (1 + u)^2 - 1; no number below -1
    linear = rooted.linearize({"u": 0.0})
    np.testing.assert_allclose(linear.D, [[2.0]], rtol=1e-9)


def test_dry_friction_that_holds_is_no_solution_of_its_sign():
    slider = loop(lambda a, u: a + 2 * ca.sign(a) - u)
    with pytest.raises(Diverged, match="the equations for a have no solution"):
        answer(slider, 1.0)  # between -2 and 2 no speed fulfils it
    np.testing.assert_allclose(answer(slider, -5.0), -3.0)


def test_dry_friction_without_mass_is_identified():
    class Slider(Component):
        force = Input("N", "force", nominal=100.0, interpolation="hold")
        position = Output("m", "position")
        x = State(0.0, "m", "x", nominal=0.1)
        b = Parameter(700.0, "N.s/m", "damper", bounds=(10, 1e5), free=True)
        F = Parameter(20.0, "N", "dry friction", bounds=(0, 1e3), free=True)

        def equations(self):
            v = der(self.x)
            yield self.force == self.b * v + self.F * ca.sign(v)
            yield self.position == self.x

    force = 200 * np.sign(np.sin(9 * TIME + 0.01)) + 80 * np.sin(31 * TIME)
    speed = (force - 50 * np.sign(force)) / 1000  # |force| > 50 throughout
    position = np.concatenate([[0], np.cumsum(speed[:-1]) * (TIME[1] - TIME[0])])
    noise = np.random.default_rng(0).normal(0, 1e-5, len(TIME))
    record = Record(TIME, {"force": force, "position": position + noise}, {"force": "N", "position": "m"}, "slide")
    fit = identify(Model(Slider(), "slider"), [record])
    values = {p.name: p.value for p in fit.parameters}
    assert values["b"] == pytest.approx(1000, rel=0.02) and values["F"] == pytest.approx(50, rel=0.05)


def test_which_expressions_jump():
    a, u = ca.SX.sym("a"), ca.SX.sym("u")
    assert jumps(ca.fmod(a, 2), a) and jumps(u * (a > 1), a) and jumps(ca.if_else(a > 1, u, 0), a)
    assert not jumps(a * (u > 1) + ca.fabs(a) + ca.tanh(a), a)
    assert not jumps(ca.if_else(u > 1, a, 0), a)
