"""Averaged residuals, runs in pieces, and other minima that explain as well."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.identification import descent, horizon, identify, shooting, valley
from hydrotwin.identification.answer import _widened
from hydrotwin.identification.least_squares import minimise
from hydrotwin.identification.loss import Loss
from hydrotwin.identification.noise import output_noise, weights
from hydrotwin.identification.problem import free_parameters, recordings
from hydrotwin.simulation import prepare
from tests.identification.drive import drive, recorded

NOISE = {"position": 0.01, "motor_speed": 0.1}


def task(duration: float = 60.0, outputs=("position", "motor_speed"), free=None):
    model = drive()
    parameters = free_parameters(model, free)
    record = recorded(model, 1, noise=NOISE, duration=duration, outputs=outputs)
    measured = recordings(model, [record], None, "record")
    propagator = prepare(model, free_parameters=parameters.names, free_states=[s.name for s in model.states])
    sigma = output_noise(model, measured, {n: NOISE[n] for n in outputs})
    return descent.Task(
        model, parameters, propagator, measured, weights(sigma), Loss(), "auto", 1, lambda *r: None, sigma
    )


def test_a_run_in_pieces_has_the_derivatives_of_the_whole(monkeypatch):
    t = dataclasses.replace(task(), loss=Loss("soft_l1", 10.0))
    q = t.free.scaled(t.free.start * [1.05, 0.9])
    runs, z = descent.whole_runs(t)
    in_pieces = runs.linearise(q, z)
    monkeypatch.setattr(shooting, "PIECE", 10**9)
    whole = runs.linearise(q, z)
    assert len(t.recordings[0].time) > 2500
    assert in_pieces.cost == pytest.approx(whole.cost, rel=1e-12)
    assert in_pieces.gradient == pytest.approx(whole.gradient, rel=1e-9)
    assert in_pieces.hessian == pytest.approx(whole.hessian, rel=1e-9, abs=1e-9)


def test_averaged_residuals_of_a_right_model_are_noise_of_unit_size():
    t = task()
    runs, z = descent.whole_runs(t)
    q = t.free.scaled(t.free.start)
    smooth = dataclasses.replace(runs, averaged=25)
    blocks = 2 * len(t.recordings[0].time) / 25
    found = minimise(smooth, q, z)
    assert 2 * found.cost == pytest.approx(blocks, abs=4 * np.sqrt(2 * blocks))
    assert np.exp(found.q) == pytest.approx(np.exp(q), rel=0.02)


def test_averaged_residuals_have_the_gradient_of_their_cost():
    t = task(20.0)
    runs, z = descent.whole_runs(t)
    smooth, q = dataclasses.replace(runs, averaged=7), t.free.scaled(t.free.start * [1.05, 0.9])
    gradient = smooth.linearise(q, z).gradient.sum(axis=0)[:2]
    h = 1e-6
    slope = [(smooth.cost(q + h * e, z) - smooth.cost(q - h * e, z)) / (2 * h) for e in np.eye(2)]
    assert gradient == pytest.approx(slope, rel=1e-4)


def test_what_is_known_beforehand_has_the_gradient_of_its_cost():
    known = shooting.Prior(np.array([2.0, -2.0]), np.array([3.0, 0.5]))
    t = dataclasses.replace(task(20.0), prior=known)
    runs, z = descent.whole_runs(t)
    q = t.free.scaled(t.free.start * [1.05, 0.9])
    at, plain = runs.linearise(q, z), dataclasses.replace(runs, prior=None).linearise(q, z)
    assert at.cost - plain.cost == pytest.approx(known.cost(q)) and runs.cost(q, z) == pytest.approx(at.cost)
    more = (at.gradient - plain.gradient).sum(axis=0)[:2], (at.hessian - plain.hessian).sum(axis=0)[:2, :2]
    assert more[0] == pytest.approx(known.weight * (q - known.centre), rel=1e-6)
    assert more[1] == pytest.approx(np.diag(known.weight), rel=1e-6, abs=1e-6)


def test_a_cost_that_is_rough_on_a_small_scale_is_left_after_a_few_broken_promises():
    """Where two contacts open and close a cost has steps of a tenth that its derivatives know nothing of."""
    t = task(20.0)
    runs, z = descent.whole_runs(t)
    asked = []

    class Rough:
        count, locals, free, clip, until = runs.count, runs.locals, runs.free, runs.clip, runs.until

        def cost(self, q, z, above=np.inf):
            asked.append(q)
            return runs.cost(q, z) + 0.1 * float(np.sin(3e4 * q).sum())

        def linearise(self, q, z, above=np.inf):
            return dataclasses.replace(runs.linearise(q, z), cost=self.cost(q, z))

    lowest = minimise(runs, t.free.scaled(t.free.start), z).cost
    far = t.free.scaled(t.free.start * [1.3, 0.8])
    found = minimise(Rough(), far, z, absolute=1e-9, stalled=1.0, most=100)
    assert found.converged and found.cost < lowest + 1.0
    assert len(asked) < 10, "a few steps down, three promises"


def test_a_well_determined_minimum_is_not_searched_around():
    t = task()
    runs, z = descent.whole_runs(t)
    found = minimise(runs, t.free.scaled(t.free.start), z)
    assert valley.along_the_valleys(t, found) == ([found], True)


def test_a_hollow_far_from_the_truth_is_left(monkeypatch):
    monkeypatch.setattr(valley, "LONG", 0.0)
    t = task()
    runs, z = descent.whole_runs(t)
    stuck = minimise(runs, t.free.scaled(t.free.start * [1.02, 0.8]), z, most=0)
    minima, settled = valley.along_the_valleys(t, stuck)
    assert settled
    assert minima[0].cost < stuck.cost - 100
    assert np.exp(minima[0].q) == pytest.approx([10.0, 0.1], rel=0.02)


def test_sigmas_reach_another_minimum_that_explains_as_well():
    t = task()
    runs, z = descent.whole_runs(t)
    best = minimise(runs, t.free.scaled(t.free.start), z)
    other = dataclasses.replace(best, q=best.q + np.array([0.0, 0.3]))
    covariance = np.diag([1e-6, 1e-8])
    wide, findings = _widened(covariance, t.free, [best, other])
    apart = abs(np.diff(t.free.values(best.q) - t.free.values(other.q))[0])
    assert np.sqrt(wide[1, 1]) > 0.9 * apart
    assert wide[0, 0] == pytest.approx(1e-6)
    assert findings[0].kind == "ambiguous"
    assert findings[0].parameters == ("motor.time_constant",)


def test_a_product_that_cannot_be_split_is_still_named_after_the_search():
    record = recorded(drive(), 1, noise=NOISE, outputs=("position",))
    fit = identify(drive(), [record], free=["motor.gain", "pump.displacement"])
    assert "indistinguishable" in {f.kind for f in fit.findings}
    assert horizon.fastest_oscillation(drive(), recordings(drive(), [record], None, "record"),
                                       drive().parameter_vector()) is None  # fmt: skip
