"""Starts of other frequencies: a spring and a mass, whose frequency is known, sqrt(k/m)."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification.frequencies import detuned
from hydrotwin.identification.problem import free_parameters, recordings
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der
from hydrotwin.records import Record

TIME = np.arange(0.0, 4.0, 0.01)


class Spring(Component):
    """A mass on a spring, pushed: m x'' + d x' + k x = F."""

    force = Input("N", "force", nominal=10.0)
    position = Output("m", "position")
    mass = Parameter(2.0, "kg", "mass", bounds=(0.1, 100.0), free=True)
    stiffness = Parameter(800.0, "N/m", "stiffness", bounds=(500.0, 1e5), free=True)
    damping = Parameter(1.0, "N.s/m", "damping", bounds=(0.01, 1e3), free=True)
    x = State(0.0, "m", "position")
    v = State(0.0, "m/s", "speed")

    def equations(self):
        yield der(self.x) == self.v
        yield self.mass * der(self.v) == self.force - self.damping * self.v - self.stiffness * self.x
        yield self.position == self.x


def starts(known, damping=1.0):
    flat = Model(Spring()).flat
    record = Record(TIME, {"force": np.sin(TIME), "position": 0 * TIME}, {"force": "N", "position": "m"}, "run")
    free = free_parameters(flat, None, {"damping": damping})
    return detuned(flat, recordings(flat, [record], None, "record"), free, dict.fromkeys(known, 1.0))


def frequency(start):
    return np.sqrt(start.get("stiffness", 800.0) / start.get("mass", 2.0))


def test_the_mode_is_slower_and_faster_by_a_quarter_and_a_half_of_ln_and_mass_and_spring_share_the_change():
    first, *others = starts(["mass", "stiffness", "damping"])
    assert first == {}
    assert np.log([frequency(s) / 20.0 for s in others[:1] + others[1:2] + others[3:]]) == pytest.approx(
        [-0.25, 0.25, 0.5], abs=0.01
    )
    faster = others[1]
    assert np.log(faster["stiffness"] / 800.0) == pytest.approx(-np.log(faster["mass"] / 2.0), rel=0.02)
    assert all(s["damping"] == pytest.approx(1.0, rel=0.02) for s in others), "it hardly moves the frequency"


def test_only_what_is_known_beforehand_moves_and_no_further_than_its_bounds():
    *_, slowest, fastest = starts(["stiffness"])
    assert slowest.keys() == fastest.keys() == {"stiffness"}
    assert slowest["stiffness"] == 500.0, "800 exp(-1) lies below the bound"
    assert fastest["stiffness"] == pytest.approx(800.0 * np.e, rel=0.02)


@pytest.mark.parametrize(("known", "damping"), [([], 1.0), (["mass", "stiffness"], 200.0)])
def test_there_is_but_one_start_where_nothing_may_move_or_nothing_rings(known, damping):
    assert starts(known, damping) == [{}]
