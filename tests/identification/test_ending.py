"""A minimum is believed where the runs follow their derivatives; elsewhere no sigma is told."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest

from hydrotwin.identification import identify, search
from hydrotwin.identification.shooting import Shooting
from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable, fixed_start
from hydrotwin.records import Record
from hydrotwin.simulation import prepare

from .drive import drive, recorded

NOISE = {"position": 0.01, "motor_speed": 0.1}
OFF = {"motor.gain": 13.0}


def require_no_sigma(fit):
    assert not fit.converged and fit.message == "no minimum was found"
    assert all(np.isnan(p.sigma) for p in fit.parameters)
    assert [f for f in fit.findings if f.kind == "no_minimum" and "No sigma is given" in str(f)]


def system(name, states, parameters, rate, start, *, output=0, step=2e-3) -> FlatModel:
    """A flat model that is driven by u and shows one state; parameters map names to (value, low, high)."""
    t, x, u, p = (ca.SX.sym(letter, n) for letter, n in zip("txup", (1, len(states), 1, len(parameters)), strict=True))
    return FlatModel(
        name=name,
        inputs=(Signal("u", "1"),),
        outputs=(Signal("seen", "1"),),
        states=tuple(StateVariable(s, "1", measured_by="seen" if k == output else None) for k, s in enumerate(states)),
        parameters=tuple(ParameterValue(n, v, "1", (low, high), free=True) for n, (v, low, high) in parameters.items()),
        ode=ca.Function("ode", [t, x, u, p], [rate(x, u, p), x[output]], ["t", "x", "u", "p"], ["xdot", "y"]),
        initialisation=fixed_start(start, states, 1, len(parameters)),
        step=step,
    )


def lorenz() -> FlatModel:
    def rate(x, u, p):
        return ca.vertcat(p[0] * (x[1] - x[0]), x[0] * (p[1] - x[2]) - x[1], x[0] * x[1] - p[2] * x[2] + u)

    free = {"s": (9.0, 1.0, 50.0), "r": (26.0, 1.0, 100.0), "b": (2.5, 0.1, 20.0)}
    return system("lorenz", ["a", "b", "c"], free, rate, [1.0, 1.0, 20.0])


def run_of(model, values, seconds, period, noise, u=0.0) -> Record:
    """The model's own run with white noise."""
    time = np.arange(0.0, seconds, period)
    driven = np.full(len(time), u)
    start = np.array(model.start_given(())(driven[:1], values, [])).ravel()
    y, _ = prepare(model).run(time, driven[:, None], np.array(values), start)
    seen = y[:, 0] + noise * np.random.default_rng(0).normal(size=len(time))
    return Record(time, {"u": driven, "seen": seen}, {"u": "1", "seen": "1"}, model.name)


def test_a_chaotic_run_gives_no_sigma_and_a_short_one_the_truth():
    truth = [10.0, 28.0, 8 / 3]
    long = identify(lorenz(), [run_of(lorenz(), truth, 20.0, 0.02, 0.1)], starts=1, windows=(), iterations=30)
    require_no_sigma(long)
    short = identify(lorenz(), [run_of(lorenz(), truth, 2.0, 0.02, 0.1)])
    assert short.converged
    for p, value in zip(short.parameters, truth, strict=True):
        assert abs(p.value - value) < 4 * p.sigma < value


@pytest.mark.parametrize("stiffness", [1e6, 1e8])
def test_a_ball_on_a_stiff_stop_is_right_or_without_a_sigma(stiffness):
    def rate(x, u, p):
        return ca.vertcat(x[1], u - 9.81 + p[0] * ca.fmax(-x[0], 0.0))

    fall = np.sqrt(2 / 9.81)
    time = np.arange(0.0, 3.0, 0.01)
    phase = (time + fall) % (2 * fall) - fall
    height = 1 - 0.5 * 9.81 * phase**2 + 1e-3 * np.random.default_rng(0).normal(size=len(time))
    record = Record(time, {"u": 0 * time, "seen": height}, {"u": "1", "seen": "1"}, "bounces")
    model = system("ball", ["height", "speed"], {"k": (2 * stiffness, 1.0, 1e12)}, rate, [1.0, 0.0], step=1e-3)
    try:
        fit = identify(model, [record], starts=2)
    except SolveError as error:
        assert "diverges" in str(error)  # said, which is right as well
        return
    told = {f.kind for f in fit.findings}
    assert told & {"no_minimum", "unexplained", "no_effect"} or fit.sigma["k"] > 0.01 * stiffness


def test_derivatives_that_explode_become_no_small_sigma(monkeypatch):
    linearise, rows = Shooting.linearise, Shooting.sensitivities

    def exploded(self, q, z, above=np.inf):
        at = linearise(self, q, z, above)
        return dataclasses.replace(at, gradient=1e10 * at.gradient, hessian=1e20 * at.hessian)

    def exploded_rows(self, i, q, z):
        r, J, dy = rows(self, i, q, z)
        return r, 1e10 * J, 1e10 * dy

    monkeypatch.setattr(Shooting, "linearise", exploded)
    monkeypatch.setattr(Shooting, "sensitivities", exploded_rows)
    require_no_sigma(identify(drive(), [recorded(drive(), 1, noise=NOISE)], start=OFF, starts=1, windows=()))


def test_derivatives_beyond_double_precision_are_none():
    shooting, z, q = one_run()
    assert shooting.sensitivities(0, q, z[0]) is not None and not shooting.linearise(q, z).diverged.any()
    finest = dataclasses.replace(shooting, weights=1e20 * shooting.weights)
    assert finest.sensitivities(0, q, z[0]) is None and finest.linearise(q, z).diverged.all()


def one_run():
    """A whole run of the drive, its start states and the scaled true parameters."""
    from hydrotwin.identification import descent
    from hydrotwin.identification.loss import Loss
    from hydrotwin.identification.noise import output_noise, weights
    from hydrotwin.identification.problem import free_parameters, recordings

    flat = drive()
    free, measured = free_parameters(flat, None), recordings(flat, [recorded(flat, 1, noise=NOISE)], None, "record")
    noise = output_noise(flat, measured)
    propagator = prepare(flat, free_parameters=free.names, free_states=[s.name for s in flat.states])
    task = descent.Task(flat, free, propagator, measured, weights(noise), Loss(), "auto", 1, print, noise)
    shooting, z = descent.whole_runs(task)
    return shooting, z, free.scaled(free.start)


def growing() -> FlatModel:
    """x' = a x^3 - x + u: it leaves the finite numbers where a is large."""
    return system("growing", ["x"], {"a": (0.05, -1.0, 200.0)}, lambda x, u, p: p[0] * x**3 - x + u, [1.0], step=0.01)


@pytest.mark.parametrize("lost", [[0], [1, 2], [0, 1, 2]])
@pytest.mark.parametrize("weights", ["auto", "noise"])
def test_a_start_whose_runs_diverge_costs_itself_only(lost, weights, monkeypatch):
    record = run_of(growing(), [0.1], 8.0, 0.02, 1e-3, u=0.5)
    drifting = record.with_signals({"seen": record["seen"] + 0.02 * np.sin(record.time)})  # all starts are tried
    descend, calls = search.descend, []

    def astray(task, q, *rest):
        found = descend(task, q, *rest)
        calls.append(len(calls))
        return dataclasses.replace(found, q=np.full(1, 150.0 / task.free.unit[0])) if calls[-1] in lost else found

    monkeypatch.setattr(search, "descend", astray)
    fit = identify(growing(), [drifting], starts=6, weights=weights)
    assert max(calls) > max(lost) or 0 not in lost
    assert abs(fit.values["a"]) < 1.0 and np.isfinite(fit.cost)


def test_where_every_start_diverges_a_sentence_says_so(monkeypatch):
    descend = search.descend

    def astray(task, q, *rest):
        return dataclasses.replace(descend(task, q, *rest), q=np.full(1, 150.0 / task.free.unit[0]))

    monkeypatch.setattr(search, "descend", astray)
    with pytest.raises(SolveError, match=r"every run of growing diverges where the fit ended\. Start elsewhere"):
        identify(growing(), [run_of(growing(), [0.1], 8.0, 0.02, 1e-3, u=0.5)], starts=4)
