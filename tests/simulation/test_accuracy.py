"""Runs know their error: contacts and valves between samples, against closed forms and SciPy."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import InaccurateWarning, lower, prepare, simulate
from tests.simulation.small_models import small_model, stiff_pair

G = 9.80665
UNEVEN = np.concatenate([[0.0], np.sort(np.random.default_rng(4).uniform(0.0, 3.0, 40))])
EVERY_SECOND = np.array([0.0, 1.0, 2.0, 3.0])


def ball(stiffness=1e8, damping=0.0):
    """1 kg above a stop that only pushes, as Hunt and Crossley have it; outputs its height and speed."""

    def equations(t, x, u, p):
        push = p[0] * ca.fmax(-x[0], 0) * ca.fmax(1 - p[1] * x[1], 0)
        return ca.vertcat(x[1], push - G), x

    return small_model("ball", ["height", "speed"], {"k": stiffness, "c": damping}, equations, start=[1.0, 0.0])


def dropped(stiffness, time):
    """Height of the undamped ball: a parabola, and half a swing about the static deflection in the stop."""
    w, v, fall = np.sqrt(stiffness), np.sqrt(2 * G), np.sqrt(2 / G)
    contact = (np.pi + 2 * np.arctan(G / (w * v))) / w
    since = (time + fall) % (2 * fall + contact)  # it left the stop
    r = since - 2 * fall
    inside = (G * np.cos(w * r) - G) / w**2 - v / w * np.sin(w * r)
    return np.where(r < 0, v * since - G * since**2 / 2, inside)


def run(propagator, time, u=None, p=None, x0=(1.0, 0.0)):
    u = np.empty((len(time), 0)) if u is None else u
    p = propagator.flat.parameter_vector() if p is None else p
    return propagator.run(time, u, p, np.array(x0, dtype=float))


@pytest.mark.parametrize("method", ["auto", "implicit"])
@pytest.mark.parametrize("stiffness", [1e4, 1e6, 1e8, 1e10])
def test_a_ball_rebounds_to_the_height_it_fell_from(stiffness, method):
    """Its contacts last 31 ms to 31 us and lie between samples, whichever these are."""
    propagator = prepare(ball(), method=method)
    for time in (EVERY_SECOND, UNEVEN, np.linspace(0, 3, 301)):
        p = propagator.flat.parameter_vector({"k": stiffness})
        y, _ = run(propagator, time, p=p, x0=(1.0, 0.0))
        assert y[:, 0] == pytest.approx(dropped(stiffness, time), abs=2e-5)
        assert y[:, 0].max() < 1.0 + 1e-5


def test_energy_stays_in_ten_seconds_of_hard_contacts():
    time = np.linspace(0, 10, 1001)
    y, _ = run(prepare(ball()), time)
    energy = G * y[:, 0] + y[:, 1] ** 2 / 2 + 1e8 * np.minimum(y[:, 0], 0) ** 2 / 2
    assert energy == pytest.approx(G, rel=2e-5)


@pytest.mark.parametrize("method", ["auto", "implicit"])
@pytest.mark.parametrize("stiffness", [1e4, 1e6, 1e8])
def test_derivatives_go_through_contacts(stiffness, method):
    """How the stiffness moves the height, seconds and contacts later; the closed form's central difference."""
    model, time = ball(stiffness), np.array([0.0, 0.7, 1.4, 2.2, 3.0])
    propagator = prepare(model, free_parameters=("k",), method=method)
    arguments = time, np.empty((5, 0)), model.parameter_vector(), np.array([1.0, 0.0])
    _, dy, _, _ = propagator.sensitivity(*arguments, np.zeros((2, 1)))
    right = (dropped(1.001 * stiffness, time) - dropped(0.999 * stiffness, time)) / (2e-3 * stiffness)
    assert dy[:, 0, 0] == pytest.approx(right, abs=1e-2 * np.abs(right).max())


@pytest.mark.parametrize(("stiffness", "damping"), [(1e6, 0.05), (1e8, 0.2), (1e8, 3.0), (1e10, 0.5)])
def test_a_damped_contact_meets_scipy(stiffness, damping):
    model, time = ball(stiffness, damping), np.linspace(0, 0.8, 9)
    y, _ = run(prepare(model), time)

    def fall(t, x):
        return [x[1], stiffness * max(-x[0], 0) * max(1 - damping * x[1], 0) - G]

    tight = solve_ivp(fall, (0, 0.8), [1, 0], "LSODA", time, rtol=1e-10, atol=1e-12, max_step=1e-2)
    assert y[:, 0] == pytest.approx(tight.y[0], abs=1e-5)


def test_a_contact_met_long_after_the_method_was_chosen_is_met():
    """It lies on nothing for a second of every run before: those say nothing of a stop."""
    propagator, time = prepare(ball()), np.linspace(0, 0.2, 21)
    run(propagator, time)
    assert propagator.method == "explicit"
    y, _ = run(propagator, UNEVEN)
    assert y[:, 0] == pytest.approx(dropped(1e8, UNEVEN), abs=2e-5)


def test_parameters_that_moved_far_are_decided_again():
    model, time = stiff_pair(fast=100.0), np.linspace(0, 1, 11)
    propagator = prepare(model)
    run(propagator, time, x0=[1.0])
    assert propagator.method == "explicit"
    near, far = (model.parameter_vector({model.parameters[0].name: value}) for value in (150.0, 1e6))
    run(propagator, time, p=near, x0=[1.0])
    assert propagator.method == "explicit"
    y, _ = run(propagator, time, p=far, x0=[1.0])
    assert propagator.method == "implicit"
    assert y[:, 0] == pytest.approx(np.cos(time), abs=1e-7)
    run(propagator, time, x0=[1.0])
    assert propagator.method == "explicit"


def relief_valve():
    """A chamber of a cubic centimetre with a relief valve at 100 bar, 1e-9 m3/(s.Pa) steep: 1e6 1/s when it opens."""

    def equations(t, x, u, p):
        flow = u[0] - p[0] * ca.fmax(x[0] - 10, 0)  # pressure in MPa
        return 1e3 * flow / 1e-6, x

    flow = Signal("flow", "1", "flow in, m3/s", 1e-4)
    return small_model("relief", ["pressure"], {"steep": 1e-3}, equations, inputs=(flow,), start=[1.0])


def test_a_valve_that_opens_after_the_method_was_chosen_is_taken_over_by_the_implicit_one():
    """Closed it is an integrator; open it is stiff, and rests where it lets out what comes in."""
    model, time = relief_valve(), np.linspace(0, 2, 201)
    propagator, p = prepare(model, free_parameters=("steep",)), relief_valve().parameter_vector()
    quiet, x0 = np.full((201, 1), 1e-9), np.array([1.0])
    propagator.run(time, quiet, p, x0)
    assert propagator.method == "explicit"
    filling = np.full((201, 1), 1e-4)
    y, dy, _, _ = propagator.sensitivity(time, filling, p, x0, np.zeros((1, 1)))
    rest = time > 0.1
    assert y[rest, 0] == pytest.approx(10 + 1e-4 / 1e-3, rel=1e-6)
    assert dy[rest, 0, 0] == pytest.approx(-1e-4 / 1e-3**2, rel=1e-4)
    cuts, measured = np.array([[0, 0, 201]]), y + 0.01
    cost = propagator.costs(time, filling, p, cuts, x0[None], measured, np.ones(1))
    squares, gradient, _ = propagator.expansions(time, filling, p, cuts, x0[None], np.zeros((1, 1, 1)), measured)
    assert propagator.method == "explicit"
    assert cost[0] == pytest.approx(0.5 * 201 * 1e-4, rel=1e-4)
    assert squares[0, 0] == pytest.approx(2 * cost[0], rel=1e-4)
    assert gradient[0, 0, 0] == pytest.approx(-0.01 * dy.sum(), rel=1e-3)


def test_cost_and_gradient_belong_to_the_same_refined_steps():
    model, time = ball(1e6, 0.1), np.linspace(0, 0.8, 9)
    propagator = prepare(model, free_parameters=("k", "c"))
    p, x0, u = model.parameter_vector(), np.array([1.0, 0.0]), np.empty((9, 0))
    y, _ = propagator.run(time, u, p, x0)
    cuts, measured = np.array([[0, 0, 9]]), y + 0.1 * np.sin(time)[:, None]

    def cost(changed):
        return propagator.costs(time, u, changed, cuts, x0[None], measured, np.ones(2))[0]

    _, gradient, _ = propagator.expansions(time, u, p, cuts, x0[None], np.zeros((1, 2, 2)), measured)
    seen, _, _, _ = propagator.sensitivity(time, u, p, x0, np.zeros((2, 2)))
    assert seen == pytest.approx(y, abs=1e-12)
    for j in range(2):
        move = np.zeros(2)
        move[j] = 0.03 * p[j]
        difference = (cost(p + move) - cost(p - move)) / 2 / move[j]
        assert gradient[0, :, j].sum() == pytest.approx(difference, rel=1e-2)


def test_the_interpreter_refines_as_the_compiled_run_does(monkeypatch):
    model, time, u = ball(1e6, 0.1), np.linspace(0, 1.0, 11), np.empty((11, 0))
    arguments = time, u, model.parameter_vector(), np.array([1.0, 0.0]), np.eye(2, 1)
    expected = prepare(model, free_parameters=("k",)).sensitivity(*arguments)
    monkeypatch.setattr("hydrotwin.simulation.engines.compile_library", lambda *_: None)
    with pytest.warns(UserWarning, match="no C compiler"):
        interpreted = prepare(ball(1e6, 0.1), free_parameters=("k",))
    assert interpreted.engine == "vm"
    for got, right in zip(interpreted.sensitivity(*arguments), expected, strict=True):
        assert got == pytest.approx(right, rel=1e-7, abs=1e-9)


def test_what_a_method_was_told_to_do_is_done_and_its_error_said():
    """Plain Runge-Kutta steps of 1 ms throw the ball up; the answer says so with numbers, and auto does not."""
    record = Record(np.linspace(0, 3, 301), {"nothing": np.zeros(301)}, {"nothing": "1"})
    with pytest.warns(InaccurateWarning, match=r"ball on record: not accurate: half the step changes \w+ by \d"):
        wrong = simulate(ball(), record, method="explicit")
    assert wrong["height_seen"].max() > 1.1
    assert not wrong.accuracy.reached
    right = simulate(ball(), record)
    assert right.accuracy.reached
    assert right.accuracy.error < 1e-4
    assert str(right.accuracy).startswith("accurate to")


def test_the_accuracy_said_is_the_error_made():
    time = np.linspace(0, 2, 201)
    model = small_model(
        "swing", ["x", "v"], {"w": 30.0}, lambda t, x, u, p: (ca.vertcat(x[1], -(p[0] ** 2) * x[0]), x),
        start=[1.0, 0.0],
    )  # fmt: skip
    propagator = prepare(model, method="explicit", step=5e-3)
    y, _ = run(propagator, time)
    said = propagator.accuracy(time, np.empty((201, 0)), model.parameter_vector(), np.array([1.0, 0.0]))
    made = np.abs(y[:, 0] - np.cos(30 * time)).max()
    assert said.apart["x_seen"] == pytest.approx(made, rel=0.1)
    assert said.error == pytest.approx(made / 2, rel=0.2)


def test_a_coarse_step_that_misses_the_accuracy_is_halved():
    """Smooth motion that one step in a radian follows badly; nothing in it is stiff or has a kink."""
    time = np.linspace(0, 20, 41)
    model = small_model(
        "swing", ["x", "v"], {"w": 1.0}, lambda t, x, u, p: (ca.vertcat(x[1], -(p[0] ** 2) * x[0]), x),
        start=[1.0, 0.0], step=0.5,
    )  # fmt: skip
    propagator = prepare(model)
    y, _, reached = propagator.controlled_run(time, np.empty((41, 0)), model.parameter_vector(), np.array([1.0, 0.0]))
    assert reached.reached
    assert y[:, 0] == pytest.approx(np.cos(time), abs=2 * 1e-3)


def test_a_block_whose_steps_are_unstable_is_refused():
    with pytest.raises(DeclarationError, match=r"grows in steps of 0\.001 s.*method='implicit'"):
        lower(stiff_pair(fast=1e4), 0.01)
    assert lower(stiff_pair(fast=1e4), 0.01, method="implicit").period == 0.01
    assert lower(stiff_pair(fast=1e3), 0.01).period == 0.01


def test_a_motion_far_smaller_than_its_nominal_value_counts_as_one():
    """A tenth of a micron at 1000 rad/s, where steps of a millisecond damp it and nominal is a metre."""

    def equations(t, x, u, p):
        return ca.vertcat(x[1], -1e6 * x[0]), x

    small = small_model("small", ["position", "speed"], {"k": 1.0}, equations, start=[1e-7, 0.0])
    time = np.arange(0.0, 1.0, 0.005)
    found = simulate(small, Record(time, {}, {}, "swing"))
    assert found["position_seen"] == pytest.approx(1e-7 * np.cos(1e3 * time), abs=5e-10)
    with pytest.warns(InaccurateWarning):
        simulate(small, Record(time, {}, {}, "swing"), method="explicit")
