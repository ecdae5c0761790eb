"""Sensitivities against central finite differences of runs."""

from __future__ import annotations

import dataclasses
import platform
from collections import OrderedDict

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models.language.errors import DeclarationError, SolveError
from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable, fixed_start
from hydrotwin.simulation import prepare
from hydrotwin.simulation.control import TOLERANCE, Control
from hydrotwin.simulation.engines import engine_of
from hydrotwin.simulation.equations import directions, states_with_rows
from hydrotwin.simulation.machine import DEAR, DONE
from tests.simulation.flat_cehA import flat_cehA
from tests.simulation.small_models import lag, stiff_pair

TIME = np.sort(np.concatenate([np.arange(60) * 0.01, [0.1234, 0.3331]]))
COMMAND = (1.5 * np.sin(5 * TIME) + 0.5 * np.sin(11 * TIME))[:, None]
STATES = ("motor.speed", "cylinder.cap_pressure", "cylinder.rod_pressure", "arm.angle", "arm.angular_velocity")


@pytest.fixture(scope="module")
def machine():
    model = flat_cehA()
    p = model.parameter_vector()
    return model, p, model.start_given(["arm.angle"])(0, p, [0.1]).full().ravel()


def unit_columns(model, parameters, states):
    columns = np.zeros((len(model.states), len(parameters) + len(states)))
    names = [s.name for s in model.states]
    for c, state in enumerate(states):
        columns[names.index(state), len(parameters) + c] = 1
    return columns


def by_differences(propagator, time, u, p, x0, parameters, states, relative=1e-4):
    """dy, dx by central differences of fourth order, each free quantity moved by a small part of its size."""
    model = propagator.flat
    names = [s.name for s in model.states]
    dy, dx = [], []
    for name in (*parameters, *states):
        which, index = (0, model.index_of(name)) if name in parameters else (1, names.index(name))
        size = relative * (abs((p, x0)[which][index]) or 1e-2)
        weighted = []
        for steps, weight in ((1, 8), (-1, -8), (2, -1), (-2, 1)):
            moved = [p.copy(), x0.copy()]
            moved[which][index] += steps * size
            weighted.append([weight * value / (12 * size) for value in propagator.run(time, u, *moved)])
        dy.append(sum(y for y, _ in weighted))
        dx.append(sum(x for _, x in weighted))
    return np.stack(dy, axis=-1), np.stack(dx, axis=-1)


def assert_close(exact, differences, tolerance):
    """Per signal and direction, relative to the largest value over time; small ones to the signal's largest."""
    largest = np.abs(exact).max(axis=0)
    off = np.abs(exact - differences).max(axis=0)
    allowed = tolerance * largest + 1e-8 * largest.max(axis=-1, keepdims=True)
    assert (off <= allowed).all(), f"worst {np.max(off / (allowed + 1e-300))} times what is allowed"


@pytest.mark.parametrize("method", ["explicit", "vm"])
def test_parameters_and_start_states_of_the_actuator(machine, method):
    model, p, x0 = machine
    parameters = (*(q.name for q in model.parameters if q.free), "cylinder.cap_area", "arm.base_length")
    propagator = prepare(model, free_parameters=parameters, free_states=("arm.angle", "motor.speed"), method=method)
    states = propagator.free_states
    seeds = unit_columns(model, parameters, states)
    y, dy, x, dx = propagator.sensitivity(TIME, COMMAND, p, x0, seeds)
    assert dy.shape == (len(TIME), 6, 10) and dx.shape == (len(TIME), 5, 10)
    again = propagator.run(TIME, COMMAND, p, x0)
    assert y == pytest.approx(again[0], rel=1e-12) and x == pytest.approx(again[1], rel=1e-12)
    scaled = np.concatenate([p[[model.index_of(n) for n in parameters]], [1.0, 100.0]])
    dy_d, dx_d = by_differences(propagator, TIME, COMMAND, p, x0, parameters, states)
    assert_close(dy * scaled, dy_d * scaled, 1e-5)
    assert_close(dx * scaled, dx_d * scaled, 1e-5)


def test_implicit_steps_have_the_sensitivities_of_fine_explicit_steps(machine):
    """Its adaptive steps make finite differences rough, so the exact derivative of another method is the measure."""
    model, p, x0 = machine
    free, states = tuple(q.name for q in model.parameters if q.free), ("arm.angle", "motor.speed")
    seeds = unit_columns(model, free, states)
    answers = []
    for options in ({"method": "implicit"}, {"method": "explicit", "step": 1e-4}):
        propagator = prepare(model, free_parameters=free, free_states=states, **options)
        answers.append(propagator.sensitivity(TIME, COMMAND, p, x0, seeds))
    scaled = np.concatenate([p[[model.index_of(n) for n in free]], [1.0, 100.0]])
    assert_close(answers[0][1] * scaled, answers[1][1] * scaled, 2e-5)
    assert_close(answers[0][3] * scaled, answers[1][3] * scaled, 2e-5)


def test_every_parameter_of_the_actuator(machine):
    model, p, x0 = machine
    names = tuple(q.name for q in model.parameters)
    propagator = prepare(model, free_parameters=names, method="explicit")
    _, dy, _, none = propagator.sensitivity(TIME, COMMAND, p, x0, np.zeros((5, len(names))), with_states=False)
    assert none is None
    dy_d, _ = by_differences(propagator, TIME, COMMAND, p, x0, names, ())
    assert_close(dy * p, dy_d * p, 2e-5)
    assert (dy[:, :, names.index("precharge")] == 0).all()  # acts through the start only


def test_start_states_that_depend_on_a_parameter_are_carried_along(machine):
    model, p, _ = machine
    propagator = prepare(model, free_parameters=("precharge",), method="explicit")
    start = model.start_given(["arm.angle"])

    def outputs(precharge):
        changed = model.parameter_vector({"precharge": precharge})
        return propagator.run(TIME, COMMAND, changed, start(0, changed, [0.1]).full().ravel())[0]

    one, zero = (start(0, model.parameter_vector({"precharge": value}), [0.1]).full() for value in (1e6, 0.0))
    seeds = (one - zero) / 1e6
    _, dy, _, _ = propagator.sensitivity(TIME, COMMAND, p, start(0, p, [0.1]).full().ravel(), seeds)
    differences = (outputs(2.002e6) - outputs(1.998e6)) / 4e3
    assert np.abs(dy[:, :, 0] - differences).max(axis=0) == pytest.approx(0, abs=1e-5 * np.abs(dy).max())


@pytest.mark.parametrize("method", ["explicit", "implicit", "vm"])
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("Td", [0.0137, 0.0452])
def test_the_dead_time_has_an_exact_derivative(interpolation, Td, method):
    model = lag(interpolation, dead_time=Td)
    propagator = prepare(model, free_parameters=("Td", "k"), method=method)
    p, x0 = model.parameter_vector(), np.zeros(1)
    u = np.sin(13 * TIME)[:, None]
    _, dy, _, dx = propagator.sensitivity(TIME, u, p, x0, np.zeros((1, 2)))
    dy_d, dx_d = by_differences(propagator, TIME, u, p, x0, ("Td", "k"), (), relative=1e-6)
    assert_close(dx, dx_d, 1e-4)
    assert_close(dy, dy_d, 1e-4)
    assert np.abs(dx[:, 0, 0]).max() > 1  # it does depend on the dead time


@pytest.mark.parametrize("method", ["explicit", "vm"])
def test_at_zero_dead_time_the_derivative_points_to_longer_ones(method):
    model = lag(dead_time=0.0)
    propagator = prepare(model, free_parameters=("Td",), method=method)
    u, x0 = np.sin(13 * TIME)[:, None], np.zeros(1)
    _, _, _, dx = propagator.sensitivity(TIME, u, model.parameter_vector(), x0, np.zeros((1, 1)))
    later, now = (propagator.run(TIME, u, model.parameter_vector({"Td": Td}), x0)[1] for Td in (1e-6, 0.0))
    assert dx[:, :, 0] == pytest.approx((later - now) / 1e-6, abs=1e-3 * np.abs(dx).max())


def test_the_interpreter_gives_the_compiled_sensitivities(machine):
    model, p, x0 = machine
    free = tuple(q.name for q in model.parameters if q.free)
    seeds = unit_columns(model, free, ("arm.angle",))
    compiled, interpreted = (
        prepare(model, free_parameters=free, free_states=("arm.angle",), method=m).sensitivity(
            TIME, COMMAND, p, x0, seeds
        )
        for m in ("explicit", "vm")
    )
    for a, b in zip(compiled, interpreted, strict=True):
        assert np.abs(a - b).max(axis=0) == pytest.approx(0, abs=1e-12 * np.abs(a).max())


def test_a_stiff_model_has_the_derivative_of_its_closed_form():
    model, time = stiff_pair(fast=1e5), np.linspace(0, 2, 21)
    propagator = prepare(model, free_parameters=("w", "fast"))
    p = model.parameter_vector({"w": 1.5})
    _, dy, _, _ = propagator.sensitivity(time, np.empty((21, 0)), p, np.ones(1), np.zeros((1, 2)))
    assert propagator.method == "implicit"
    assert dy[:, 0, 0] == pytest.approx(-time * np.sin(1.5 * time), abs=1e-5)
    assert dy[:, 0, 1] == pytest.approx(0, abs=1e-9)


def test_nothing_free_means_empty_derivatives(machine):
    model, p, x0 = machine
    y, dy, _, dx = prepare(model).sensitivity(TIME, COMMAND, p, x0, np.empty((5, 0)))
    assert dy.shape == (len(TIME), 6, 0) and dx.shape == (len(TIME), 5, 0) and np.isfinite(y).all()


def test_models_that_differ_in_values_only_share_one_engine(machine):
    model = machine[0]
    other = model.with_parameters({"motor.gain": 99.0})
    assert prepare(model)._engines[False] is prepare(other)._engines[False]
    delayed = dataclasses.replace(model, inputs=(dataclasses.replace(model.inputs[0], interpolation="linear"),))
    assert prepare(model)._engines[False] is not prepare(delayed)._engines[False]


def test_unknown_names_are_refused_with_the_nearest(machine):
    with pytest.raises(DeclarationError, match=r"Did you mean 'motor\.gain'"):
        prepare(machine[0], free_parameters=("motor.gian",))
    with pytest.raises(DeclarationError, match=r"Did you mean 'arm\.angle'"):
        prepare(machine[0], free_states=("arm.angel",))


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="flushing to zero is a mode of SSE")
def test_a_derivative_that_has_decayed_never_becomes_a_slow_number_below_the_smallest():
    """exp(-t/T) falls below 1e-308 at 708 T, where a processor is ten times slower; the caller's numbers stay."""
    model = lag()
    propagator = prepare(model, free_states=["x"], step=0.01)
    time = np.arange(10_000) * 0.01
    start = np.zeros(1), np.ones((1, 1))
    _, _, _, dx = propagator.sensitivity(time, np.ones((len(time), 1)), model.parameter_vector(), *start)
    smallest = np.finfo(float).tiny
    assert dx[0, 0, 0] == 1 and dx[-1, 0, 0] < 1e-300
    assert not ((dx > 0) & (dx < smallest)).any()
    assert 0 < np.float64(smallest) / 4 < smallest


@pytest.mark.parametrize(("method", "apart"), [("explicit", 1e-12), ("implicit", 1e-4)])  # more of them: other steps
def test_free_starts_need_no_other_library(machine, method, apart, new_cache, monkeypatch):
    """Nor do units: both are told to the driver, which is compiled once for all models."""
    monkeypatch.setattr("hydrotwin.simulation.engines._kept", OrderedDict())
    model, p, x0 = machine
    free = ("motor.gain", "cylinder.oil.bulk_modulus")
    answers = []
    for states in ((), STATES):
        propagator = prepare(model, free_parameters=free, free_states=states, method=method)
        answers.append(propagator.sensitivity(TIME, COMMAND, p, x0, unit_columns(model, free, states)))
        assert len(list(new_cache.iterdir())) == 2
    size = np.abs(answers[0][1]).max(axis=0)
    assert (np.abs(answers[1][1][..., :2] - answers[0][1]) <= apart * size).all()


@pytest.mark.parametrize("method", ["explicit", "implicit", "vm"])
def test_what_is_zero_need_not_be_carried_along(method):
    """A lag that a weight of zero keeps from the output: its weight has a derivative, its own state is in no output."""
    model, p, time, u, x0, dx0 = weighted_lag(weight=0.0)
    free = ["weight", "time_constant"]
    plain = prepare(model, free_parameters=free, method=method)
    lean = prepare(model, free_parameters=free, method=method, zero=["weight"])
    there, here = (q.sensitivity(time, u, p, x0, dx0, with_states=False) for q in (plain, lean))
    np.testing.assert_allclose(here[0], there[0], rtol=1e-12)
    np.testing.assert_allclose(here[1], there[1], rtol=1e-9, atol=1e-12)
    assert np.abs(here[1][:, 0, 0]).max() > 0.1  # of the weight
    assert not here[1][:, 0, 1].any()  # of the time constant behind a weight of zero


@pytest.mark.parametrize("method", ["explicit", "vm"])
def test_no_step_is_refined_for_a_state_that_reaches_no_output(method):
    """A fast lag behind a weight of zero, shaken at every sample: the run is as short as without it."""
    model, p, _, _, x0, _ = weighted_lag(weight=0.0)
    time = np.arange(2000) * 0.01
    u, p = np.random.default_rng(1).standard_normal((2000, 1)), p + np.array([0.0, 5e-3 - 0.2])
    to = directions(model, ["weight", "time_constant"], [], zero=["weight"])
    engine = engine_of(model, to, False, method == "vm")
    plain, some = Control(model.step), Control(model.step, TOLERANCE, trials=0.1)
    status, _, y, _ = engine.propagate(time, u, p, some, x0)
    assert status == DONE
    np.testing.assert_array_equal(y, engine.propagate(time, u, p, plain, x0)[2])
    seen = engine.propagate(time, u, p + np.array([0.5, 0.0]), some, x0)  # now it reaches the output
    assert seen[0] == DEAR


def test_rows_are_kept_only_of_states_that_reach_an_output():
    model, *_ = weighted_lag(weight=0.0)
    every = directions(model, ["weight", "time_constant"], [])
    at_zero = directions(model, ["weight", "time_constant"], [], zero=["weight"])
    assert states_with_rows(model, every) == [0, 1]
    assert states_with_rows(model, at_zero) == [0]


def test_sensitivities_at_zero_are_refused_elsewhere():
    model, p, time, u, x0, dx0 = weighted_lag(weight=0.5)
    lean = prepare(model, free_parameters=["weight", "time_constant"], zero=["weight"])
    with pytest.raises(SolveError, match="prepared with parameters at zero"):
        lean.sensitivity(time, u, p, x0, dx0, with_states=False)
    with pytest.raises(SolveError, match="prepared with parameters at zero"):
        y = np.zeros((len(time), 1))
        lean.expansions(time, u, p, [[0, 0, len(time)]], x0[None], dx0[None], y)
    with pytest.raises(SolveError, match="with_states False"):
        lean.sensitivity(time, u, 0 * p, x0, dx0)


def weighted_lag(weight: float):
    """x' = -x + u + weight z,  T z' = u - z,  y = x."""
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p", 2)
    ode = [t, x, u, p], [ca.vertcat(-x[0] + u + p[0] * x[1], (u - x[1]) / p[1]), x[0]]
    model = FlatModel(
        name="weighted_lag",
        inputs=(Signal("u", "1"),),
        outputs=(Signal("y", "1"),),
        states=(StateVariable("x", "1"), StateVariable("z", "1")),
        parameters=(ParameterValue("weight", weight, "1"), ParameterValue("time_constant", 0.2, "s", (1e-3, 10.0))),
        ode=ca.Function("ode", *ode, ["t", "x", "u", "p"], ["xdot", "y"]),
        initialisation=fixed_start([0.0, 0.0], ["x", "z"], 1, 2),
        step=0.01,
    )
    return model, model.parameter_vector(), TIME, COMMAND, np.array([0.1, 0.3]), np.zeros((2, 2))
