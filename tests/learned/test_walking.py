"""Runs walked in CasADi one after the other are those of NumPy side by side."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

from hydrotwin.learned.gaussian import feedback_run as process
from hydrotwin.learned.gaussian.kernels import Hyper, parsed
from hydrotwin.learned.network import free_run as network
from hydrotwin.learned.network.narx import NarxShape
from hydrotwin.learned.state_network import sensitivities as states
from hydrotwin.learned.state_network.climbing import section_at
from hydrotwin.learned.state_network.equations import StateShape


@pytest.mark.parametrize(("lags", "hidden"), [(2, 3), (0, 2), (1, 0)])
def test_a_network_runs_alike_both_ways_bounds_included(monkeypatch, lags, hidden):
    shape, rng = NarxShape(1, 2, lags, 3, hidden), np.random.default_rng(0)
    bounds = [0.2, 0.3], [2, 2], [-1, -1], [1, 1], [-1.5] * shape.features, [1.2] * shape.features
    scales = network.Scales(*(np.array(v, dtype=float) for v in bounds))
    u, y = rng.normal(size=(40, 1)), rng.normal(size=(40, 2))
    (s,) = network.gather(network.cut(u, y, 9, shape, np.array([0.2, 0.3]), rest=False))
    weights, found = rng.normal(size=shape.size), []
    for narrow in (s.u.shape[1], 0):
        monkeypatch.setattr(network, "NARROW", narrow)
        found.append(network.free_run(weights, shape, scales, s))
    assert 0 < (~found[0].moving).mean() < 1
    for part in fields(network.Run):
        one, other = (getattr(run, part.name) for run in found)
        assert one.shape == other.shape and np.allclose(one, other, rtol=0, atol=1e-13)


@pytest.mark.parametrize("hidden", [3, 0])
def test_a_state_network_runs_alike_both_ways_bounds_included(monkeypatch, hidden):
    shape, rng = StateShape(2, 2, 2, hidden, 2, 2), np.random.default_rng(0)
    u, y = rng.normal(size=(30, 2)), rng.normal(size=(30, 2))
    s = section_at(u, y, y, np.array([3, 10]), 12, 2, np.array([0.3, 0.4]), still=False)
    far, rate = np.array([2.0, 2.0, 0.8, 0.8]), np.array([0.3, 0.4, 0.2, 0.1])
    net, found = states.Network(shape, rate, -far, far, 0.4 * rng.normal(size=shape.size)), []
    for narrow in (2, 0):
        monkeypatch.setattr(states, "NARROW", narrow)
        found.append(states.free_run(net, s))
    assert (np.abs(found[0]) == 0.8).any()
    assert np.allclose(*found, rtol=0, atol=1e-13)


def random_process(lags: process.Lags, kernel: str, points: int = 7):
    """A process with random functions, its weights, and two runs of 20 samples."""
    rng, ny = np.random.default_rng(0), lags.outputs
    kernel = parsed(kernel, "learn gp")
    sizes = len(kernel.terms), (len(kernel.factors), lags.features)
    hypers = [Hyper(kernel, rng.uniform(0.5, 1, sizes[0]), rng.uniform(1, 2, sizes[1])) for _ in range(ny)]
    Z, ones = rng.normal(size=(points, lags.features)), np.ones(lags.features)
    bases = tuple(process.Basis(hyper, Z, np.eye(points), np.tril(rng.normal(size=(points,) * 2))) for hyper in hypers)
    bounds, far = (np.full(ny, -2.0), np.full(ny, 1.5)), (-ones, 1.2 * ones)
    model = process.Model(lags, bases, np.full(ny, 0.3), np.full(ny, 1.0), bounds, far)
    shapes = (2, ny), (2, ny * lags.increments), (20, 2, lags.inputs * lags.samples), (20, 2, ny)
    return model, [0.3 * rng.normal(size=points) for _ in range(ny)], process.Stretch(*map(rng.standard_normal, shapes))


@pytest.mark.parametrize("lags", [(1, 1, 2), (0, 2, 1), (1, 0, 3)])
@pytest.mark.parametrize("kernel", ["linear+rbf", "linear+matern32", "linear*rbf+matern52"])
def test_a_process_runs_alike_both_ways_bounds_and_derivatives_included(monkeypatch, lags, kernel):
    model, weights, s = random_process(process.Lags(2, 2, *lags), kernel)
    found = []
    for narrow in (2, 0):
        monkeypatch.setattr(process, "NARROW", narrow)
        found.append(process.free_run(model, weights, s, derivatives=True))
    assert np.ptp(found[0][0]) > 0.1
    for one, other in zip(*found, strict=True):
        assert np.allclose(one, other, rtol=1e-7, atol=1e-9)


@pytest.mark.parametrize("narrow", [2, 0])
def test_a_process_that_leaves_the_numbers_is_none_from_there(monkeypatch, narrow):
    model, weights, s = random_process(process.Lags(1, 1, 1, 1, 2), "linear+rbf")
    s.lines[7:] = np.nan
    monkeypatch.setattr(process, "NARROW", narrow)
    found, J = process.free_run(model, weights, s, derivatives=True)
    for part in (found, J):
        assert np.isfinite(part[:7]).all() and np.isnan(part[7:]).all()
