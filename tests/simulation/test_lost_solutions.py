"""Implicit equations that have no solution any more, at the start or on the way: the run stops and says which."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu, reference_run
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, SolveError, State, Variable, der
from hydrotwin.records import Record
from hydrotwin.simulation import Diverged, prepare, simulate

METHODS = ("auto", "explicit", "vm", "implicit")
TIME = np.linspace(0, 2, 201)
RAMP = Record(TIME, {"u": 0.8 * TIME}, {"u": "1"}, "ramp")


def implicit(law, **variable) -> Model:
    """A lag behind what ``law`` makes the input from."""

    class Follower(Component):
        u = Input("1", "in", interpolation="hold")
        y = Output("1", "out")
        x = State(0.0, "1", "x")
        T = Parameter(0.1, "s", "lag")
        z = Variable("1", "z", **variable)

        def equations(self):
            yield self.T * der(self.x) == self.z - self.x
            yield law(self.z) == self.u
            yield self.y == self.z

    return Model(Follower(), "follower")


@pytest.mark.parametrize("method", METHODS)
def test_a_run_stops_where_its_equation_loses_the_solution(method):
    with pytest.raises(Diverged, match=r"follower: the equations for z have no solution at t = 1\.26 s") as stop:
        simulate(implicit(ca.sin), RAMP, method=method)
    assert stop.value.time == pytest.approx(1.26)


LAWS = {
    "fold": (lambda z: z - z**3, 2 / 27**0.5),
    "parabola": (lambda z: z - z**2, 0.25),
    "saturation": (ca.tanh, 1.0),
    "small against its nominal value": (lambda z: (z * 1e6) - (z * 1e6) ** 2, 0.25),
    "kink": (lambda z: ca.fmin(z, 1 - ca.fabs(z - 1)), 1.0),
    "hidden in large numbers": (lambda z: ca.sin(z) + 1e6 * z - 1e6 * z, 1.0),
}


@pytest.mark.parametrize(("law", "last"), LAWS.values(), ids=LAWS.keys())
def test_whatever_the_equation_it_is_solved_or_the_run_stops(law, last):
    with pytest.raises(Diverged, match="no solution") as stop:
        simulate(implicit(law), RAMP, method="vm")
    assert stop.value.time == pytest.approx(last / 0.8, abs=0.011)


@pytest.mark.parametrize("method", ("explicit", "adaptive"))
def test_an_exported_model_discards_the_step(tmp_path, method):
    fmu = export_fmu(implicit(ca.sin), tmp_path / "follower.fmu", method=method)
    with pytest.raises(SolveError, match=r"discard.* t = 1\.2[56]"):
        read_fmu(fmu).free_run(RAMP)


@pytest.mark.parametrize("steady", (False, True))
def test_there_is_no_linear_model_where_there_is_no_solution(steady):
    with pytest.raises(SolveError, match="the equations for z have no solution at this operating point"):
        implicit(ca.sin).linearize({"u": 1.6}, steady=steady)


@pytest.mark.parametrize("law", [lambda z: z * ca.fabs(z) + 1e-3 * z, lambda z: z * ca.sqrt(z**2 + 1e-6)], ids="ab")
def test_a_flow_that_turns_is_followed_through_zero(law):
    wave = Record(TIME, {"u": np.sin(7 * TIME).round(3)}, {"u": "1"}, "wave")
    flow = simulate(implicit(law, start=0.02), wave)["y"]
    assert flow.min() < -0.9 < 0.9 < flow.max()
    np.testing.assert_allclose([float(law(q)) for q in flow], wave["u"], atol=1e-8)


@pytest.mark.parametrize("method", METHODS)
def test_up_to_there_the_solution_and_its_derivatives_are_right(method):
    flat = implicit(lambda z: z + z**3).flat
    run = prepare(flat, method=method, free_parameters=("T",))
    y, dy, _, _ = run.sensitivity(TIME, RAMP["u"], flat.parameter_vector(), [0.0], np.zeros((1, 1)))
    np.testing.assert_allclose(y[:, 0] + y[:, 0] ** 3, RAMP["u"], atol=1e-8)
    assert np.isfinite(dy).all()
    root = float(flat.ode(0, [0.0], [0.5], flat.parameter_vector())[1])
    slope = ca.Function("s", flat.ode.sx_in(), [ca.jacobian(flat.ode(*flat.ode.sx_in())[1], flat.ode.sx_in()[2])])
    assert float(slope(0, [0.0], [0.5], flat.parameter_vector())) == pytest.approx(1 / (1 + 3 * root**2), rel=1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_start_that_the_initial_equations_do_not_have_is_named(method):
    class Started(Component):
        u = Input("1", "in")
        y = Output("1", "out")
        x = State(0.5, "1", "x", fixed=False)
        T = Parameter(0.1, "s", "lag")

        def equations(self):
            yield self.T * der(self.x) == self.u - self.x
            yield self.y == self.x

        def initial_equations(self):
            yield self.x**2 == -1 - self.u

    with pytest.raises(Diverged, match=r"started\.x: it has no start value .* initial equations"):
        simulate(Model(Started(), "started"), RAMP, method=method)


def test_the_run_that_an_fmu_carries_along_moves_as_far_as_there_is_a_solution(tmp_path):
    model = implicit(lambda z: z - 2 * z**2)  # up to u = 0.125
    carried = reference_run(model)
    assert np.abs(carried["u"]).max() == pytest.approx(0.02, rel=1e-3)
    fmu = export_fmu(model, tmp_path / "follower.fmu", reference=carried)
    again = read_fmu(fmu).free_run(carried)
    np.testing.assert_allclose(again["y"], carried["y"], atol=1e-9)


def test_where_there_is_none_at_rest_either_it_is_said_whose_run_that_is():
    class Filling(Component):
        u = Input("1", "in")
        y = Output("1", "out")
        x = State(0.0, "1", "x")
        T = Parameter(1.0, "s", "time")
        z = Variable("1", "z")

        def equations(self):
            yield self.T * der(self.x) == 1
            yield self.z - self.z**2 == self.x  # until x = 0.25
            yield self.y == self.z + self.u

    with pytest.raises(SolveError, match=r"that an FMU carries along .* no solution, even with the inputs at their"):
        reference_run(Model(Filling(), "filling"))
