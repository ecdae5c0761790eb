"""Implicit steps beside SciPy's Radau: stiff problems, late inputs that jump, and their derivatives."""

import itertools

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydrotwin.models.language.flat import Signal
from hydrotwin.simulation import prepare

from .small_models import small_model


def van_der_pol():
    """mu = 1000, along its slow branch."""

    def equations(t, x, u, p):
        return ca.vertcat(x[1], p[0] * ((1 - x[0] ** 2) * x[1]) - x[0]), x

    model = small_model("van_der_pol", ["x", "v"], {"mu": 1000.0}, equations, start=[2.0, 0.0])
    return model, np.array([2.0, 0.0]), np.array([0.0, 300.0, 600.0, 780.0])


def robertson():
    """Three reactions, rates apart by 1e9."""

    def equations(t, x, u, p):
        slow, fast, back = p[0] * x[0], p[1] * x[1] ** 2, p[2] * x[1] * x[2]
        return ca.vertcat(-slow + back, slow - back - fast, fast), x

    parameters = {"k1": 0.04, "k2": 3e7, "k3": 1e4}
    model = small_model("robertson", ["a", "b", "c"], parameters, equations, start=[1.0, 0.0, 0.0])
    return model, np.array([1.0, 0.0, 0.0]), np.array([0.0, 0.4, 4.0, 40.0, 400.0])


def lagged(interpolation):
    """A slow lag behind a fast one, of an input that comes late by less than a sample, and one that does not."""

    def equations(t, x, u, p):
        return ca.vertcat(1e4 * (u[0] ** 2 + 0.5 * u[1] - x[0]), (x[0] ** 3 - x[1]) / p[1]), x

    inputs = tuple(
        Signal(name, "1", interpolation=interpolation, dead_time=late) for name, late in (("u", "Td"), ("w", None))
    )
    return small_model("lagged", ["fast", "slow"], {"Td": 0.0137, "tau": 0.2}, equations, inputs=inputs)


def by_radau(model, time, u, p, x0, interpolation="hold", delay=0.0):
    """States (n, nx) of the same equations, stopped where an input changes its course."""
    x, found = np.array(x0, dtype=float), [np.array(x0, dtype=float)]
    for a, b in itertools.pairwise(time):
        corners = np.unique(np.clip(np.r_[a, (time + delay)[(time + delay > a) & (time + delay < b)], b], a, b))
        for begin, end in itertools.pairwise(corners):

            def inputs(t, begin=begin, end=end):
                late = _between(time, u[:, :1], t - delay, 0.5 * (begin + end) - delay, interpolation)
                return np.r_[late, _between(time, u[:, 1:], t, 0.5 * (begin + end), interpolation)]

            def rate(t, x, inputs=inputs):
                return model.ode(t, x, inputs(t), p)[0].full().ravel()

            x = solve_ivp(rate, (begin, end), x, "Radau", rtol=1e-8, atol=1e-12).y[:, -1]
        found.append(x)
    return np.array(found)


def _between(time, u, t, inside, interpolation):
    """Inputs at t on the piece that holds the time `inside`; the first sample before the recording."""
    k = int(np.searchsorted(time, inside, side="right")) - 1
    if k < 0 or u.shape[1] == 0:
        return u[0]
    if interpolation == "hold" or k + 1 == len(time):
        return u[k]
    return u[k] + (t - time[k]) / (time[k + 1] - time[k]) * (u[k + 1] - u[k])


@pytest.mark.parametrize("problem", [van_der_pol, robertson])
def test_stiff_problems_end_where_radau_ends_and_so_do_their_derivatives(problem):
    model, x0, time = problem()
    p, u = model.parameter_vector(), np.empty((len(time), 0))
    names = tuple(q.name for q in model.parameters)
    propagator = prepare(model, free_parameters=names, method="implicit")
    _, x = propagator.run(time, u, p, x0)
    right = by_radau(model, time, u, p, x0)
    scale = np.abs(right).max(axis=0)
    assert np.all(np.abs(x - right) < 1e-6 * scale)
    y, dy, _, _ = propagator.sensitivity(time, u, p, x0, np.zeros((len(x0), len(names))))
    assert np.all(np.abs(y - right) < 1e-6 * scale)
    for k in range(len(names)):
        step = 1e-4 * p[k] * np.eye(len(p))[k]
        sides = [by_radau(model, time, u, p + sign * step, x0) for sign in (1, -1)]
        moved = (sides[0] - sides[1]) / (2 * step[k])
        assert np.all(np.abs(dy[:, :, k] - moved) < 1e-4 * np.abs(moved).max(axis=0) + 1e-12), names[k]


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_late_inputs_and_their_dead_time(interpolation):
    model, random = lagged(interpolation), np.random.default_rng(4)
    time = np.arange(0.0, 0.1, 0.02)
    u, p, x0 = random.normal(size=(len(time), 2)), model.parameter_vector(), np.zeros(2)
    propagator = prepare(model, free_parameters=("Td", "tau"), method="implicit")
    y, dy, _, _ = propagator.sensitivity(time, u, p, x0, np.zeros((2, 2)))
    right = by_radau(model, time, u, p, x0, interpolation, p[0])
    assert np.all(np.abs(y - right) < 1e-6 * np.abs(right).max(axis=0))
    d = 1e-5
    sides = [by_radau(model, time, u, p + s * d * np.eye(2)[0], x0, interpolation, p[0] + s * d) for s in (1, -1)]
    moved = ((sides[0] - sides[1]) / (2 * d))[:, 1]  # the slow one: the fast one is the input itself
    assert np.all(np.abs(dy[:, 1, 0] - moved) < 2e-3 * np.abs(moved).max())


def test_a_run_that_asks_for_ever_finer_steps_gives_up_soon():
    """x' = 1 / (1 - t) in disguise: x' = x^2 leaves the numbers at t = 1."""
    model = small_model("blow_up", ["x"], {"a": 1.0}, lambda t, x, u, p: (p[0] * x**2, x), start=[1.0])
    with pytest.raises(Exception, match=r"t = (0\.99|1)"):
        prepare(model, method="implicit").run(np.array([0.0, 2.0]), np.empty((2, 0)), np.ones(1), np.ones(1))
