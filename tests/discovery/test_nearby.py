"""Minima nearby: the lowest is found from one beside it."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest

from hydrotwin.discovery.fits.job import Job
from hydrotwin.discovery.fits.nearby import lowest_nearby
from hydrotwin.discovery.fits.whole import fit
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der
from hydrotwin.records import Record
from tests.discovery.slides import question

TURN = 0.1  # in the gain: the second sensor says the same after it
NOISE = {"rough": 0.02, "fine": 1e-3}  # m


class Vernier(Component):
    """A position that two sensors measure: a rough one, and one that is fine, and the same after every turn."""

    speed = Input("m/s", "speed", interpolation="hold")
    rough = Output("m", "rough measurement")
    fine = Output("m", "fine measurement")
    gain = Parameter(1.0, "1", "gain", bounds=(0.1, 10.0), free=True)
    position = State(0.0, "m", "position")

    def equations(self):
        yield der(self.position) == self.speed
        yield self.rough == self.gain * self.position
        yield self.fine == ca.sin(2 * np.pi / TURN * self.gain) * self.position


def recording(seed: int) -> Record:
    """A second forth and a second back, with a gain of 1.02."""
    time = np.arange(0.0, 4.0, 0.02)
    speed = np.where(np.floor(time + 1e-9).astype(int) % 2, -1.0, 1.0)
    position = np.concatenate([[0.0], np.cumsum(speed[:-1]) * 0.02])
    rng = np.random.default_rng(seed)
    signals = {
        "speed": speed,
        "rough": 1.02 * position + NOISE["rough"] * rng.standard_normal(len(time)),
        "fine": np.sin(2 * np.pi / TURN * 1.02) * position + NOISE["fine"] * rng.standard_normal(len(time)),
    }
    return Record(time, signals, {"speed": "m/s", "rough": "m", "fine": "m"}, f"run {seed}")


@pytest.mark.parametrize("turns", [-2, -1, 0, 1, 2])
def test_the_lowest_minimum_is_reached_from_one_beside_it(turns):
    model = Model(Vernier())
    asked = dataclasses.replace(question([recording(k) for k in range(3)], model=model, noise=NOISE), lengths=())
    start = {"gain": 1.02 + turns * TURN}
    job = Job(model.flat, ("gain",), asked, (start,), size=asked.noise, iterations=30, seconds=60.0)
    rests, found = fit(job), lowest_nearby(job)
    assert rests.values["gain"] == pytest.approx(start["gain"], abs=0.2 * TURN), "a fit rests where it began"
    assert found.values["gain"] == pytest.approx(1.02, abs=1e-3)
    assert found.rmse == pytest.approx(asked.noise, rel=0.1)
