"""Runs that blow up say when and where; arrays that do not fit are refused."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models.language.errors import SolveError
from hydrotwin.records import Record
from hydrotwin.simulation import Diverged, lower, prepare, simulate
from tests.simulation.small_models import explosion, lag, small_model

METHODS = ("auto", "explicit", "vm", "implicit")
TIME = np.linspace(0, 2, 201)
NO_INPUT = np.empty((201, 0))


@pytest.mark.parametrize("method", METHODS)
def test_a_run_that_blows_up_names_time_and_state(method):
    model = explosion()  # infinite at 0.5 s
    propagator = prepare(model, method=method)
    with pytest.raises(Diverged, match=r"explosion\.bang: the run .* at t = 0\.5") as stop:
        propagator.run(TIME, NO_INPUT, model.parameter_vector(), np.ones(3))
    assert stop.value.state == "bang"
    assert stop.value.time == pytest.approx(0.5, abs=0.011)
    assert isinstance(stop.value, SolveError)


@pytest.mark.parametrize("method", METHODS)
def test_a_sensitivity_that_blows_up_names_time_and_state(method):
    model = explosion()
    propagator = prepare(model, method=method, free_parameters=("rate",))
    with pytest.raises(Diverged, match=r"explosion\.bang: .* at t = 0\.5"):
        propagator.sensitivity(TIME, NO_INPUT, model.parameter_vector(), np.ones(3), np.zeros((3, 1)))


@pytest.mark.parametrize("method", ["explicit", "vm"])
def test_an_output_that_is_not_finite_is_named(method):
    model = small_model(
        "root", ["x"], {"k": 1.0}, lambda t, x, u, p: (-p[0], ca.vertcat(x, ca.sqrt(x))), outputs=("seen", "root"),
        start=[1.0],
    )  # fmt: skip
    with pytest.raises(Diverged, match=r"root\.root: the output is not finite at t = 1\.01") as stop:
        prepare(model, method=method).run(TIME, NO_INPUT, model.parameter_vector(), np.array([1.005]))
    assert stop.value.state is None


def test_a_block_that_blows_up_names_time_and_state():
    record = Record(TIME, {"other": TIME}, {"other": "1"})
    with pytest.raises(Diverged, match=r"explosion\.\w+: .* at t = 0\.5"):
        simulate(lower(explosion(), 0.01), record)


def test_arrays_that_do_not_fit_are_refused():
    model = lag()
    propagator, p, u = prepare(model, free_parameters=("k",)), model.parameter_vector(), np.ones((201, 1))
    wrong = {
        r"u must have shape \(201, 1\) \(got \(200, 1\)\)": (TIME, u[1:], p, [0.0]),
        r"p must have shape \(3,\)": (TIME, u, p[1:], [0.0]),
        r"x0 must have shape \(1,\)": (TIME, u, p, [0.0, 0.0]),
        "time must be finite and rising": (TIME[::-1], u, p, [0.0]),
        r"lag\.u: an input must be finite \(got nan at t = 0\.5": (TIME, np.where(TIME == 0.5, np.nan, 1.0), p, [0.0]),
    }
    for words, arguments in wrong.items():
        with pytest.raises(SolveError, match=words):
            propagator.run(*arguments)
    with pytest.raises(SolveError, match=r"x0_jacobian must have shape \(1, 1\)"):
        propagator.sensitivity(TIME, u, p, [0.0], np.zeros((1, 2)))
    with pytest.raises(SolveError, match=r"restart must have shape \(201, 1\)"):
        propagator.run(TIME, u, p, [0.0], restart=np.zeros((3, 1)))
