"""The parts of an identification: loss, intervals under colour, whiteness, the bounded step."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from hydrotwin.identification import descent, horizon
from hydrotwin.identification.least_squares import minimise
from hydrotwin.identification.loss import Loss
from hydrotwin.identification.noise import output_noise, weights
from hydrotwin.identification.problem import free_parameters, recordings
from hydrotwin.identification.uncertainty import uncertainty, without_starts
from hydrotwin.records.whiteness import ljung_box
from hydrotwin.simulation import prepare
from tests.identification.drive import drive, recorded

NOISE = {"position": 0.01, "motor_speed": 0.1}


def task(loss: str = "linear", bounds=None, start=None, dead_time=False):
    model = drive(dead_time)
    free = free_parameters(model, None, start, bounds)
    measured = recordings(model, [recorded(model, 1, noise=NOISE), recorded(model, 2, noise=NOISE)], None, "record")
    propagator = prepare(model, free_parameters=free.names, free_states=[s.name for s in model.states])
    return descent.Task(
        model, free, propagator, measured, weights(output_noise(model, measured, NOISE)), Loss(loss), "auto", 1,
        lambda *report: None, output_noise(model, measured, NOISE),
    )  # fmt: skip


@pytest.mark.parametrize("bounds", [None, {"motor.gain": (2.0, 9.5)}])
@pytest.mark.parametrize("loss", ["linear", "soft_l1", "huber"])
def test_the_minimum_is_the_one_scipy_finds(loss, bounds):
    t = task(loss, bounds, {"motor.gain": 9.0})
    shooting, z = descent.whole_runs(t)
    q = t.free.scaled(t.free.start)
    ours = minimise(shooting, q, z, absolute=1e-9, most=100)

    def residuals(x):
        parts = [shooting.residuals(i, x[:2], x[2 + 2 * i : 4 + 2 * i]) for i in range(2)]
        return np.concatenate([part.ravel() for part in parts])

    low = np.concatenate([t.free.scaled(t.free.lower), np.full(4, -np.inf)])
    high = np.concatenate([t.free.scaled(t.free.upper), np.full(4, np.inf)])
    theirs = least_squares(residuals, np.concatenate([q, z.ravel()]), bounds=(low, high), loss=loss, f_scale=2.0,
                           xtol=1e-12, ftol=1e-12, x_scale="jac")  # fmt: skip
    assert ours.cost == pytest.approx(theirs.cost, rel=1e-7)
    assert ours.q == pytest.approx(theirs.x[:2], rel=1e-4)


def test_gradients_of_the_shooting_cost_are_those_of_finite_differences():
    t = task("soft_l1")
    q = t.free.scaled(t.free.start) + 0.1
    states = horizon.first_guess(t.flat, t.recordings, t.propagator, t.free.vector(q), 1.0)
    shooting, z = descent.windows(t, q, 1.0, states)
    at = shooting.linearise(q, z)
    for j in range(2):
        step = 1e-5 * np.eye(2)[j]
        slope = (shooting.cost(q + step, z) - shooting.cost(q - step, z)) / 2e-5
        assert at.gradient[:, j].sum() == pytest.approx(slope, rel=1e-4)
    step = np.zeros_like(z)
    step[3, 1] = 1e-5
    slope = (shooting.cost(q, z + step) - shooting.cost(q, z - step)) / 2e-5
    assert at.gradient[3, 3] == pytest.approx(slope, rel=1e-4)


@pytest.mark.parametrize("kind", ["linear", "soft_l1", "huber"])
def test_a_small_residual_costs_its_square_under_every_loss(kind):
    r = np.array([1e-3, -2e-3])
    assert Loss(kind).cost(r) == pytest.approx(0.5 * float(r @ r), rel=1e-5)


def test_a_large_residual_costs_less_under_a_robust_loss():
    r = np.array([50.0])
    assert Loss("huber").cost(r) < 0.1 * Loss("linear").cost(r)
    assert Loss("soft_l1").cost(r) < 0.1 * Loss("linear").cost(r)


def test_the_sandwich_covers_under_coloured_noise_where_the_white_interval_does_not():
    random, n = np.random.default_rng(3), 1500
    slow = np.cumsum(random.normal(size=(n, 1)), axis=0)
    J = slow / slow.std()
    z_white, z_sandwich = [], []
    for _ in range(120):
        e = np.zeros(n)
        e[0] = random.normal()
        for k in range(1, n):
            e[k] = 0.8 * e[k - 1] + 0.6 * random.normal()
        error = (J[:, 0] @ e) / (J[:, 0] @ J[:, 0])
        r = e - J[:, 0] * error
        known = uncertainty([r], [J], [np.arange(n)], np.array([False]))
        z_white.append(error / np.sqrt(known.white[0, 0]))
        z_sandwich.append(error / np.sqrt(known.sandwich[0, 0]))
    assert np.std(z_white) > 2.0
    assert 0.7 < np.std(z_sandwich) < 1.6


def test_start_states_take_their_share_of_the_sensitivity():
    random = np.random.default_rng(0)
    J = random.normal(size=(50, 4))
    left = without_starts(J, 2)
    assert np.abs(left.T @ J[:, 2:]).max() < 1e-12
    assert without_starts(J[:, :2], 2) is not None


def test_white_noise_is_white_and_a_drift_is_not():
    random = np.random.default_rng(0)
    noise = random.normal(size=2000)
    assert ljung_box(noise)[1] > 1e-3
    assert ljung_box(noise + np.sin(np.arange(2000) / 50))[1] < 1e-6


def test_windows_cover_every_sample_once():
    record = recordings(drive(), [recorded(drive(), 1)], None, "record")
    segments = horizon.cut(record, 0.7)
    covered = np.concatenate([np.arange(s.first, s.last) for s in segments])
    assert np.array_equal(covered, np.arange(len(record[0].time)))


def test_windows_of_a_delayed_input_begin_early():
    record = recordings(drive(), [recorded(drive(), 1)], None, "record")
    early = horizon.cut(record, 1.0, delay=0.2)
    assert early[0].begin == 0
    assert all(record[0].time[s.first] - record[0].time[s.begin] >= 0.19 for s in early[1:])


def test_an_expansion_that_is_known_is_not_made_again(monkeypatch):
    t = task()
    shooting, z = descent.whole_runs(t)
    q = t.free.scaled(t.free.start) + 0.1
    made, real = [], type(shooting).linearise
    monkeypatch.setattr(type(shooting), "linearise", lambda *words: made.append(1) or real(*words))
    plain = minimise(shooting, q, z)
    count = len(made)
    known = minimise(shooting, q, z, at=real(shooting, q, z))
    assert known.cost == plain.cost and (known.q == plain.q).all()
    assert len(made) - count == count - 1
