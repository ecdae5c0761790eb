"""Where fits begin: stiff starts brought near, each cost once."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.discovery.recordings import split
from hydrotwin.discovery.refit import Question, RefitJob, refit
from hydrotwin.discovery.screen import Screen
from hydrotwin.discovery.starts import REACH, SHORTER, different, within_reach
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der
from hydrotwin.models.language.errors import SolveError
from hydrotwin.records import Record

NOISE = 1e-3


class Follower(Component):
    """Follows a command; a spring that stands for an effect holds it back, stiff where it is strong."""

    command = Input("1", "command", nominal=1.0)
    followed = Output("1", "what is measured", nominal=1.0)
    rate = Parameter(1.0, "1/s", "rate at which it follows", bounds=(0.1, 10.0))
    hold = Parameter(0.0, "1/s", "what holds it back", bounds=(0.0, 1e9), nominal=1.0)
    x = State(0.0, "1", "where it is", nominal=1.0)

    def equations(self):
        yield der(self.x) == self.rate * (self.command - self.x) - self.hold * self.x
        yield self.followed == self.x


def asked(hold: float) -> Question:
    """What a follower did that is held back a little, by the closed form of each step."""
    time = np.arange(0.0, 20.0, 0.05)
    command = np.where((time // 2.5) % 2 < 1, 1.0, -0.5)
    rate, x = 1.0 + hold, np.zeros(len(time))
    for k in range(len(time) - 1):
        end = command[k] / rate
        x[k + 1] = end + (x[k] - end) * np.exp(-0.05 * rate)
    x += NOISE * np.random.default_rng(0).standard_normal(len(time))
    record = Record(time, {"command": command, "followed": x}, {"command": "1", "followed": "1"}, "held")
    data = split(Model(Follower()).flat, [record], [], noise={"followed": NOISE})
    return Question(data.fit, data.select, data.noise, usual={"rate": 1.0})


def test_a_start_comes_to_where_it_costs_ten_times_what_nothing_costs():
    near = within_reach(lambda v: 1.0 + v["play"] ** 2, {"play": 100.0, "mass": 5.0}, {"play": 0.0})
    assert near == {"play": 100.0 / SHORTER**3, "mass": 5.0} and 1 + near["play"] ** 2 <= REACH
    start = {"play": 2.0, "mass": 5.0}
    assert within_reach(lambda v: 1.0 + v["play"] ** 2, start, {"play": 0.0}) == start, "near enough"
    assert within_reach(lambda v: np.inf if v["play"] else 1.0, start, {"play": 0.0})["play"] < 0.01, "not for ever"


@pytest.mark.parametrize("start", [1e5, 1e6])
def test_a_stiff_start_far_away_ends_where_a_near_one_does(start):
    question = asked(hold=0.05)
    free = ("rate", "hold")
    far = refit(RefitJob(Model(Follower()).flat, free, question, ({"hold": start},)))
    near = refit(RefitJob(Model(Follower()).flat, free, question, ({"hold": 0.2},)))
    assert near.values["hold"] == pytest.approx(0.05, rel=0.05)
    assert far.likelihood == pytest.approx(near.likelihood, abs=1.0)


class Runaway(Follower):
    """What a follower becomes when candidates that should be neutral are not."""

    def equations(self):
        yield der(self.x) == self.rate * (1e3 * self.x**3 + self.command) + self.hold
        yield self.followed == self.x


def test_candidates_that_are_together_not_neutral_are_refused_with_what_to_do():
    question = asked(hold=0.05)
    fitted = refit(RefitJob(Model(Follower()).flat, ("rate", "hold"), question, ({"hold": 0.2},)))
    with pytest.raises(SolveError, match=r"at neutral diverges\. Look for fewer of them at once"):
        Screen(Model(Runaway()).flat, ("rate", "hold"), (), fitted, question)


class Gripped(Follower):
    """Held back only while there is a command."""

    def equations(self):
        yield der(self.x) == self.rate * (self.command - self.x) - self.hold * self.command**2 * self.x
        yield self.followed == self.x


def test_a_screen_that_is_stiff_in_another_recording_than_the_first_is_right_there():
    time = np.arange(0.0, 20.0, 0.05)
    units, swing = {"command": "1", "followed": "1"}, 1e-3 * np.sin(time)
    runs = [Record(time, {"command": u + swing, "followed": swing}, units, f"at {u}") for u in (0.0, 1.0)]
    data = split(Model(Gripped()).flat, runs, [], noise={"followed": NOISE})
    question = Question((*data.fit, *data.select), (), data.noise, initial_states="fixed")
    fitted = refit(RefitJob(Model(Gripped()).flat, ("rate", "hold"), question, ({"hold": 0.0},), iterations=1))
    strong = dataclasses.replace(fitted, values={"rate": 1.0, "hold": 1e6})
    screen = Screen(Model(Gripped()).flat, ("rate", "hold"), (), strong, question)
    followed = screen.residual[len(time) + 2 :] * screen.size + swing[2:]
    assert followed == pytest.approx(1e-6, rel=0.01), "where rate and grip balance"


def test_each_cost_is_a_start_once_in_order():
    points = [(3.0, np.array([0.0])), (2.0, np.array([1.0])), (2.0 * (1 + 1e-12), np.array([2.0])), (5.0, np.zeros(1))]
    assert [float(q[0]) for q in different(points)] == [1.0, 0.0, 0.0]
