"""A parameter that happens to be near zero is no parameter without effect: its change counts by its nominal value."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification import identify, sensitivity
from hydrotwin.identification.excitation import excitation
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der
from hydrotwin.records import Record

TIME = np.arange(500) / 100
NOISE = 1e-2


def pushed(offset: float, nominal: float | None):
    """x' = u + offset, of an offset of either sign."""

    class Pushed(Component):
        u = Input("m/s", "speed", interpolation="hold")
        y = Output("m", "position")
        offset_ = Parameter(0.0, "m/s", "offset", bounds=(-10, 10), nominal=nominal, free=True)
        x = State(0.0, "m", "position")

        def equations(self):
            yield der(self.x) == self.u + self.offset_
            yield self.y == self.x

    return Model(Pushed(offset_=offset), "pushed")


def driven() -> Record:
    u = np.where(TIME % 1 > 0.5, 1.0, -1.0)
    x = np.concatenate([[0.0], np.cumsum(u * 0.01)[:-1]])
    y = x + NOISE * np.random.default_rng(0).normal(size=len(TIME))
    return Record(TIME, {"u": u, "y": y}, {"u": "m/s", "y": "m"}, "run")


@pytest.mark.parametrize("start", [0.0, 1e-6, -1e-6])
def test_a_start_near_zero_says_nothing_of_the_effect(start):
    fit = identify(pushed(start, 1.0), [driven()], starts=1)
    assert not [f for f in fit.findings if f.kind == "no_effect"]
    (row,), said = excitation(pushed(start, 1.0), [driven()])
    assert row.verdict == "well" and said == ()


def test_what_drives_an_output_is_not_said_to_have_no_effect_and_is_known():
    found = sensitivity(pushed(1e-6, 1.0), [driven()], samples=0, over="bounds")
    assert not [f for f in found.findings if f.kind == "no_effect"]
    assert "leave open" not in " ".join(m.sentence for m in found.measurements)


@pytest.mark.parametrize(("value", "told"), [(1e-6, True), (0.0, False), (0.5, False)])
def test_a_share_of_next_to_nothing_is_told_to_be_no_interval(value, told):
    """It moves nothing, and would be said to drive nothing."""
    found = sensitivity(pushed(value, 1.0), [driven()], samples=0, over="20%")
    said = [str(f) for f in found.findings if f.kind == "near_zero"]
    assert bool(said) is told
    if told:
        assert "±20 % of that moves next to nothing" in said[0] and "--interval offset_=LOW:HIGH" in said[0]


def test_an_interval_that_was_given_is_what_a_change_is():
    """Nobody has said how large the parameter is otherwise."""
    asked = {"given": {"offset_": (-1.0, 1.0)}, "samples": 0}
    found = sensitivity(pushed(1e-6, None), [driven()], **asked)
    assert not [f for f in found.findings if f.kind == "no_effect"]


def test_what_is_seen_by_nothing_is_still_told_with_the_change_that_is_not_seen():
    fit = identify(pushed(1e-9, 1e-6), [driven()], starts=1)
    (finding,) = [f for f in fit.findings if f.kind == "no_effect"]
    assert "a change of 1e-06 m/s moves them by" in finding.sentence
