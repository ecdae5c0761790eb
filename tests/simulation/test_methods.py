"""Explicit, implicit and interpreted runs agree with each other and with tight-tolerance CVODES."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.simulation import prepare, stiffness
from tests.simulation.flat_cehA import flat_cehA
from tests.simulation.small_models import oscillator, stiff_pair

TIME = np.arange(151) * 0.01
COMMAND = (1.5 * np.sin(2 * np.pi * 0.8 * TIME) + 0.5 * np.sin(11 * TIME))[:, None]


@pytest.fixture(scope="module")
def machine():
    model = flat_cehA()
    p = model.parameter_vector()
    return model, p, model.start_given(["arm.angle"])(0, p, [0.1]).full().ravel()


@pytest.fixture(scope="module")
def reference(machine):
    """Outputs by CVODES, restarted at every sample of the held command, states in nominal units."""
    model, p, x = machine
    t, xs, u, ps = ca.SX.sym("t"), ca.SX.sym("x", 5), ca.SX.sym("u"), ca.SX.sym("p", len(p))
    scale = np.array([s.nominal for s in model.states])
    dae = {"t": t, "x": xs, "u": u, "p": ps, "ode": model.ode(t, scale * xs, u, ps)[0] / scale}
    cvodes = ca.integrator("f", "cvodes", dae, 0, 0.01, {"reltol": 1e-11, "abstol": 1e-12, "max_num_steps": 100000})
    states = [x]
    for u_k in COMMAND[:-1, 0]:
        states.append(cvodes(x0=states[-1] / scale, u=u_k, p=p)["xf"].full().ravel() * scale)
    return model.ode(TIME[None, :], np.array(states).T, COMMAND.T, p)[1].full().T


def error(y, reference):
    return np.abs(y - reference).max(axis=0) / np.ptp(reference, axis=0)


def test_implicit_steps_meet_cvodes_within_a_millionth_of_the_range(machine, reference):
    model, p, x0 = machine
    y, _ = prepare(model, method="implicit").run(TIME, COMMAND, p, x0)
    assert error(y, reference).max() < 1e-6


def test_explicit_steps_meet_cvodes_within_a_millionth_of_the_range(machine, reference):
    model, p, x0 = machine
    motion = slice(0, 3)  # at the model's own step; the pressures ring at 30 Hz and need a finer one
    y, _ = prepare(model, method="explicit").run(TIME, COMMAND, p, x0)
    assert error(y, reference)[motion].max() < 1e-6
    y, _ = prepare(model, method="explicit", step=1e-4).run(TIME, COMMAND, p, x0)
    assert error(y, reference).max() < 1e-6


def test_the_interpreter_gives_the_compiled_run(machine):
    """To the last digits: the driver has a tanh of its own."""
    model, p, x0 = machine
    compiled, interpreted = prepare(model, method="explicit"), prepare(model, method="vm")
    assert (compiled.engine, interpreted.engine) == ("c", "vm")
    for a, b in zip(compiled.run(TIME, COMMAND, p, x0), interpreted.run(TIME, COMMAND, p, x0), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-11, atol=1e-13 * np.abs(b).max())


def test_auto_takes_explicit_steps_for_the_oscillating_machine(machine):
    model, p, x0 = machine
    propagator = prepare(model)
    propagator.run(TIME, COMMAND, p, x0)
    assert propagator.method == "explicit"


def test_auto_refuses_explicit_steps_for_a_stiff_model():
    model, time = stiff_pair(fast=1e5), np.linspace(0, 3, 31)
    propagator = prepare(model)
    y, _ = propagator.run(time, np.empty((31, 0)), model.parameter_vector(), np.ones(1))
    assert propagator.method == "implicit"
    assert y[:, 0] == pytest.approx(np.cos(time), abs=1e-7)


def test_auto_weighs_eigenvalues_against_the_step():
    """The limit is 2.785 / 2000 s = 1.39 ms; finer steps are tried first, the implicit method from 11 ms on."""
    model, time = stiff_pair(fast=2000.0), np.linspace(0, 0.5, 11)
    chosen = {}
    for step in (1e-3, 2e-3, 5e-3, 2e-2):
        propagator = prepare(model, step=step)
        y, _ = propagator.run(time, np.empty((11, 0)), model.parameter_vector(), np.ones(1))
        assert y[:, 0] == pytest.approx(np.cos(time), abs=1e-6)
        chosen[step] = (propagator.method, propagator.step)
    assert chosen == {
        1e-3: ("explicit", 1e-3),
        2e-3: ("explicit", 1e-3),
        5e-3: ("explicit", 1.25e-3),
        2e-2: ("implicit", 2e-2),
    }


@pytest.mark.parametrize(("states", "chosen"), [(1, ("implicit", 2e-2)), (32, ("explicit", 2e-2 / 16))])
def test_the_more_states_the_finer_steps_are_tried(states, chosen):
    """A step of the implicit method takes a system of as many equations."""
    model, time = stiff_pair(fast=2000.0, idle=states - 1), np.linspace(0, 0.5, 11)
    propagator = prepare(model, step=2e-2)
    start = model.start_given(())(0, model.parameter_vector(), []).full().ravel()
    y, _ = propagator.run(time, np.empty((11, 0)), model.parameter_vector(), start)
    assert y[:, 0] == pytest.approx(np.cos(time), abs=1e-6)
    assert (propagator.method, propagator.step) == chosen


def test_growth_of_the_step_is_that_of_its_test_equation():
    model = oscillator(frequency=100.0)
    h = 0.02
    _, x = prepare(model, step=h, method="explicit").run(
        np.array([0.0, h]), np.empty((2, 0)), model.parameter_vector(), np.array([1.0, 0.0])
    )
    amplitude = np.hypot(x[1, 0], x[1, 1] / 100.0)
    assert stiffness.growth(np.array(100j * h)) == pytest.approx(amplitude, rel=1e-12)


def test_a_wrong_method_names_the_right_one(machine):
    with pytest.raises(DeclarationError, match="Did you mean 'implicit'"):
        prepare(machine[0], method="implict")


def test_a_wrong_step_is_refused(machine):
    with pytest.raises(DeclarationError, match=r"positive \(got -1"):
        prepare(machine[0], step=-1)


def test_what_was_decided_at_other_parameters_is_decided_again(machine):
    model, p, x0 = machine
    first = prepare(model)
    first.run(TIME, COMMAND, p, x0)
    stiff = p.copy()
    stiff[model.index_of("motor.time_constant")] = 1e-6
    again = first.undecided()
    assert (first.method, again.method, again.step) == ("explicit", "auto", model.step)
    again.run(TIME[:20], COMMAND[:20], stiff, x0)
    assert (again.method, first.method) == ("implicit", "explicit")
