"""Start states of a recording that takes no part: a stick that falls from near upright, by scipy's integrator."""

from __future__ import annotations

import numpy as np
import pytest
from casadi import sin
from scipy.integrate import solve_ivp

from hydrotwin.identification import descent, identify
from hydrotwin.identification.loss import Loss
from hydrotwin.identification.problem import Recording, free_parameters, recordings
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der
from hydrotwin.records import Record
from hydrotwin.simulation import prepare

NOISE, START, WRONG = 0.02, 0.02, -0.06  # rad
SQUARED, DAMPING = 9.0, 0.5  # 1/s2, 1/s


class Stick(Component):
    """a'' = c sin a - d a' + u."""

    push = Input("rad/s2", "push")
    angle = Output("rad", "measured angle")
    squared = Parameter(SQUARED, "1/s2", "c", bounds=(1.0, 100.0), free=True)
    damping = Parameter(DAMPING, "1/s", "d", bounds=(0.0, 10.0), free=True)
    fallen = State(0.0, "rad", "angle")
    rate = State(0.0, "rad/s", "rate")

    def equations(self):
        yield der(self.fallen) == self.rate
        yield der(self.rate) == self.squared * sin(self.fallen) - self.damping * self.rate + self.push
        yield self.angle == self.fallen


def measured(first: float, name: str = "fall") -> Record:
    """It falls to the side that it leans to, whatever the first sample says."""
    time = np.arange(0.0, 8.0, 0.01)
    rates = lambda t, x: [x[1], SQUARED * np.sin(x[0]) - DAMPING * x[1]]  # noqa: E731
    angle = solve_ivp(rates, (0.0, 8.0), [START, 0.0], t_eval=time, rtol=1e-9, atol=1e-12).y[0]
    angle += NOISE * np.random.default_rng(5).standard_normal(len(time))
    angle[0] = first
    return Record(time, {"push": 0.0 * time, "angle": angle}, {"push": "rad/s2", "angle": "rad"}, name)


def fallen(first: float) -> Recording:
    (recording,) = recordings(Model(Stick()).flat, [measured(first)], None, "record")
    return recording


def asked(recording: Recording, initial_states: str) -> tuple[descent.Task, np.ndarray]:
    flat = Model(Stick()).flat
    free = free_parameters(flat, None)
    propagator = prepare(flat, free_parameters=free.names, free_states=[s.name for s in flat.states])
    noise, told = np.array([NOISE]), lambda stage, number, cost: None
    task = descent.Task(
        flat, free, propagator, (recording,), 1 / noise, Loss("linear", 1.0), initial_states, 1, told, noise
    )
    return task, free.scaled(free.start)


@pytest.mark.parametrize("initial_states", ["auto", "free"])
def test_the_beginning_tells_to_which_side_it_leans_where_the_first_sample_lies(initial_states):
    task, q = asked(fallen(first=WRONG), initial_states)
    shooting, z = descent.held_out_run(task, q, task.recordings[0])
    left = shooting.residuals(0, q, z[0])
    assert np.sqrt(np.mean(left[1:] ** 2)) == pytest.approx(1.0, abs=0.1), "in units of the noise"
    whole, sampled = descent.whole_runs(task)
    trapped = descent.minimise(whole, q, sampled, hold=True, most=descent.HELD)
    assert trapped.cost > 100 * shooting.cost(q, z), "the trap is set"


def test_a_sample_that_is_right_stands_where_the_beginning_leads_astray(monkeypatch):
    task, q = asked(fallen(first=START), "auto")
    honest = descent.minimise

    def astray(shooting, q, z, **settings):
        found = honest(shooting, q, z, **settings)
        if len(shooting.recordings[0].time) < 800:
            found.z[0, 0] = WRONG / shooting.start.nominal[0]
        return found

    monkeypatch.setattr(descent, "minimise", astray)
    shooting, z = descent.held_out_run(task, q, task.recordings[0])
    assert shooting.start.nominal[0] * z[0, 0] == pytest.approx(START, abs=0.002)


def test_start_states_that_are_told_are_held():
    task, q = asked(fallen(first=WRONG), "fixed")
    shooting, z = descent.held_out_run(task, q, task.recordings[0])
    assert not shooting.locals and z[0, 0] == pytest.approx(WRONG / shooting.start.nominal[0])


def test_identify_validates_from_the_start_that_the_beginning_tells():
    judged = measured(first=WRONG, name="judged")
    fit = identify(Model(Stick()), [measured(first=START)], validate=[judged], noise={"angle": NOISE}, starts=1)
    (left,) = [r for r in fit.residuals if r.role == "validate"]
    assert left.rmse == pytest.approx(NOISE, rel=0.2)
