"""Models in python-control, controllers of python-control as blocks."""

from __future__ import annotations

import casadi as ca
import control
import numpy as np
import pytest

from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.language import DeclarationError
from hydrotwin.models.language.linearisation import linearise
from hydrotwin.records import Record
from hydrotwin.simulation import lower, simulate
from hydrotwin.simulation.control_system import from_control, to_control
from tests.simulation.small_models import oscillator


def run(block, u):
    """Outputs of a block, sample by sample from its own start."""
    u = np.atleast_2d(u)
    x = block.start(u[0], np.zeros(len(block.outputs)), [])
    seen = []
    for row in u:
        x, y = block.step(x, row, [])
        seen.append(np.array(y).ravel())
    return np.array(seen)


def test_a_model_runs_under_python_control_with_its_names():
    model = cehA.model()
    system = to_control(model)
    assert system.input_labels == ["command"] and system.state_labels[0] == model.flat.states[0].name
    assert system.isctime(strict=True) and system.name == "cehA"
    time = np.linspace(0, 0.3, 61)
    command = 2.0 * (time > 0.05)
    theirs = control.input_output_response(
        system, time, command, model.equilibrium(), solve_ivp_method="LSODA", solve_ivp_kwargs={"rtol": 1e-8}
    )
    record = Record(time, {"command": command}, {"command": "V"}, "step")
    ours = simulate(model, record)
    # python-control is linear between samples, ours holds: they meet where the command does not move
    assert theirs.outputs[2][-1] == pytest.approx(ours["rod_position"][-1], abs=2e-4)
    assert np.ptp(theirs.outputs[2]) > 1e-3


def test_a_closed_form_is_met_under_python_control():
    system = to_control(oscillator(20.0))
    time = np.linspace(0, 1, 201)
    answer = control.input_output_response(system, time, X0=[1.0, 0.0], solve_ivp_kwargs={"rtol": 1e-9, "atol": 1e-9})
    assert answer.outputs[0] == pytest.approx(np.cos(20 * time), abs=1e-6)


def test_parameters_of_a_model_are_those_of_python_control():
    system = to_control(oscillator(20.0))
    assert system.params == {"w": 20.0}
    time = np.linspace(0, 1, 201)
    options = {"rtol": 1e-9, "atol": 1e-9}
    answer = control.input_output_response(system, time, X0=[1.0, 0.0], params={"w": 7.0}, solve_ivp_kwargs=options)
    assert answer.outputs[0] == pytest.approx(np.cos(7 * time), abs=1e-6)


def test_python_control_linearises_a_model_as_we_do():
    model = cehA.model()
    x0 = model.equilibrium()
    theirs = to_control(model).linearize(x0, [0.0])
    ours = linearise(model)
    scale = np.array([s.nominal for s in model.flat.states])
    assert theirs.A * scale / scale[:, None] == pytest.approx(ours.A * scale / scale[:, None], rel=2e-2, abs=2.0)


def test_a_block_is_a_discrete_system_with_its_period():
    block = lower(cehA.model(), 0.01)
    system = to_control(block)
    assert system.dt == 0.01 and system.isdtime(strict=True)
    time = 0.01 * np.arange(30)
    command = np.sin(3 * time)
    start = cehA.model().equilibrium()
    theirs = control.input_output_response(system, time, command, start)
    ours = simulate(block, Record(time, {"command": command}, {"command": "V"}, "sine"))
    assert theirs.outputs[2] == pytest.approx(ours["rod_position"], rel=1e-9)


def test_a_dead_time_is_refused_and_the_lowered_model_is_not():
    model = spool_valve.model().with_parameters({"solenoid.dead_time": 0.02})
    with pytest.raises(DeclarationError, match=r"spool_valve\.current: .*dead time.*Lower the model first"):
        to_control(model)
    assert to_control(lower(model, 0.01)).dt == 0.01


def test_a_discrete_controller_is_taken_over_exactly():
    pi = control.ss([[1.0]], [[0.02]], [[0.5]], [[3.0]], 0.01, inputs=["error"], outputs=["command"], name="pi")
    block = from_control(pi, units={"error": "m", "command": "V"}, start={"x[0]": 0.4})
    assert (block.name, block.period, block.inputs[0].unit, block.outputs[0].unit) == ("pi", 0.01, "m", "V")
    error = np.sin(np.arange(50.0))
    total = 0.4 + 0.02 * np.concatenate([[0], np.cumsum(error)[:-1]])
    assert run(block, error[:, None])[:, 0] == pytest.approx(0.5 * total + 3 * error, rel=1e-12)


def test_a_transfer_function_filters_as_scipy_does():
    from scipy.signal import lfilter

    num, den = [0.2, 0.3, 0.1], [1.0, -0.7, 0.2]
    block = from_control(control.tf(num, den, 0.02, inputs=["u"], outputs=["y"], name="filter"))
    u = np.random.default_rng(1).normal(size=60)
    assert run(block, u[:, None])[:, 0] == pytest.approx(lfilter(num, den, u), rel=1e-10, abs=1e-12)


def test_a_continuous_controller_is_sampled_for_held_inputs():
    lag = control.tf([1.0], [0.1, 1.0], inputs=["u"], outputs=["y"], name="lag")
    block = from_control(lag, 0.02)
    time = 0.02 * np.arange(40)
    assert run(block, np.ones((40, 1)))[:, 0] == pytest.approx(1 - np.exp(-time / 0.1), abs=1e-12)
    with pytest.raises(DeclarationError, match=r"lag: the system is continuous\. Give period="):
        from_control(lag)


def saturated(t, x, u, params):
    return np.array([x[0] + params["rate"] * (u[0] - np.tanh(x[0]))])


def test_a_nonlinear_difference_equation_becomes_one_expression():
    system = control.NonlinearIOSystem(
        saturated, lambda t, x, u, params: [2 * x[0] * u[0]], params={"rate": 0.3},
        states=["memory"], inputs=["u"], outputs=["y"], name="nonlinear", dt=0.01,
    )  # fmt: skip
    block = from_control(system)
    u = np.random.default_rng(2).normal(size=40)
    x, wanted = 0.0, []
    for value in u:
        wanted.append(2 * x * value)
        x = x + 0.3 * (value - np.tanh(x))
    assert run(block, u[:, None])[:, 0] == pytest.approx(wanted, rel=1e-12)
    assert isinstance(block.step.sx_in()[0], ca.SX)


def test_a_controller_that_branches_is_refused_with_what_to_write():
    def relay(t, x, u, params):
        return [1.0 if u[0] > 0 else -1.0]

    system = control.NonlinearIOSystem(None, relay, inputs=["u"], outputs=["y"], name="relay", dt=0.01)
    with pytest.raises(DeclarationError, match=r"relay: its functions do not take symbols.*casadi\.if_else"):
        from_control(system)


def test_a_controller_that_looks_at_the_clock_is_refused():
    system = control.NonlinearIOSystem(
        None, lambda t, x, u, params: [u[0] * (1 + t)], inputs=["u"], outputs=["y"], name="clock", dt=0.01
    )
    with pytest.raises(DeclarationError, match="must not depend on time"):
        from_control(system)


def test_a_model_goes_to_python_control_and_back():
    block = lower(cehA.model(), 0.01)
    fixed = from_control(to_control(block))
    x0, u = cehA.model().equilibrium(), [1.0]
    expected = block.step(x0, u, block.parameter_vector())
    assert np.array(fixed.step(x0, u, [])[0]) == pytest.approx(np.array(expected[0]), rel=1e-12)


@pytest.mark.parametrize(
    ("system", "period", "said"),
    [
        (control.ss([[1.0]], [[1]], [[1]], [[0]], 0.01, name="c"), 0.02, "the system's own dt is 0.01"),
        (control.ss([[1.0]], [[1]], [[1]], [[0]], True, name="c"), None, "no period is known"),
        (3.0, 0.01, "float is no system"),
    ],
    ids=["two periods", "no period", "no system"],
)
def test_what_cannot_be_a_block_is_refused(system, period, said):
    with pytest.raises(DeclarationError, match=said):
        from_control(system, period)


def test_an_unknown_signal_asks_for_the_nearest():
    pi = control.ss([[1.0]], [[0.02]], [[0.5]], [[3.0]], 0.01, inputs=["error"], outputs=["command"], name="pi")
    with pytest.raises(DeclarationError, match=r"pi: no signal or state 'eror'\. Did you mean 'error'\?"):
        from_control(pi, units={"eror": "m"})
