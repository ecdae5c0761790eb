"""An effect held while the base gives back what it took of it: the way out of a hollow that no small step leaves."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.signal import cont2discrete

from hydrotwin.discovery.look_back import _held
from hydrotwin.discovery.refit import refit
from hydrotwin.discovery.structure import Structure
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der
from hydrotwin.records import Record
from tests.discovery.slides import PERIOD, one, pushes, question, searching

FREQUENCY, DAMPING, LAG = 50.0, 0.6, 0.25  # rad/s, -, s
NOISE = 2e-3


class Loop(Component):
    """A position loop of second order: x'' + 2 D w0 x' + w0^2 x = w0^2 u."""

    command = Input("1", "wanted position")
    rate = Output("1", "position")
    natural_frequency = Parameter(40.0, "rad/s", "w0", bounds=(1.0, 1e4), free=True)
    damping = Parameter(0.8, "1", "D", bounds=(0.05, 4.0), free=True)
    position = State(0.0, "1", "x")
    velocity = State(0.0, "1/s", "x'", nominal=10.0)

    def equations(self):
        w0 = self.natural_frequency
        yield der(self.position) == self.velocity
        yield der(self.velocity) == w0**2 * (self.command - self.position) - 2 * self.damping * w0 * self.velocity
        yield self.rate == self.position


def lagging(seed: int) -> Record:
    """The loop behind a lag of first order, exactly, its command held between samples."""
    a = [[-1 / LAG, 0, 0], [0, 0, 1], [FREQUENCY**2, -(FREQUENCY**2), -2 * DAMPING * FREQUENCY]]
    step, push, *_ = cont2discrete((np.array(a), np.array([[1 / LAG], [0], [0]]), np.eye(3), np.zeros((3, 1))), PERIOD)
    time, u = pushes(seed, highest=1.0)
    x = np.zeros((len(u), 3))
    x[0, :2] = u[0]
    for k in range(len(u) - 1):
        x[k + 1] = step @ x[k] + push[:, 0] * u[k]
    y = x[:, 1] + NOISE * np.random.default_rng(seed).standard_normal(len(u))
    return Record(time, {"command": u, "rate": y}, {"command": "1", "rate": "1"}, f"loop_{seed}")


@pytest.fixture(scope="module")
def hollow():
    """A search, its base, and the lag as it comes out small beside a base that stands in for it."""
    asked = question([lagging(k) for k in range(3)], Model(Loop()), {"rate": NOISE})
    search, base = searching(asked, ["actuator_lag"], Model(Loop()), ("natural_frequency", "damping"))
    start = {"actuator_lag.time_constant": 0.01}
    (small,) = search.refitted(Structure((), base), [([one(search, "actuator_lag")], [start])])
    return search, base, small


def test_the_base_takes_a_long_lag_for_its_own_and_leaves_the_effect_a_short_one(hollow):
    """The trap: overdamped, it has a slow pole where the lag's is; no small step changes which is which."""
    search, base, small = hollow
    assert base.values["damping"] > 1.5
    assert small.structure.fitted.values["actuator_lag.time_constant"] < 0.2 * LAG
    assert search.leaves(small.structure, 1.05)


def test_held_while_the_base_gives_it_back_the_lag_is_found(hollow):
    search, base, small = hollow
    search.first = base.values  # a model that was identified before: its beginning is bent already
    found = refit(_held(search, small))
    assert found.values["actuator_lag.time_constant"] == pytest.approx(LAG, rel=0.01)
    assert found.values["natural_frequency"] == pytest.approx(FREQUENCY, rel=0.02)
    assert found.values["damping"] == pytest.approx(DAMPING, rel=0.03)
    assert found.likelihood < small.structure.fitted.likelihood - 100


def test_held_too_small_the_base_takes_it_all_back(hollow):
    """Why it is as large as the catalogue calls usual, and not a probe: half of the lag leads nowhere."""
    search, base, small = hollow
    search.first = base.values
    held = _held(search, small)
    assert held.held == ("actuator_lag.time_constant",) and held.starts[0][held.held[0]] == 0.3
    found = refit(dataclasses.replace(held, starts=({**held.starts[0], held.held[0]: 0.05},)))
    assert found.values["actuator_lag.time_constant"] < 0.2 * LAG


def test_free_from_the_first_it_is_taken_back_as_well(hollow):
    """What the held one is for: from the same start, all free at once, the fit ends in the hollow again."""
    search, base, small = hollow
    search.first = base.values
    found = refit(dataclasses.replace(_held(search, small), held=()))
    assert found.values["actuator_lag.time_constant"] < 0.2 * LAG
