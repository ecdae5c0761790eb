"""Runs walked in CasADi one after the other are those of NumPy side by side."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
import pytest

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
