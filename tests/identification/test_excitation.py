"""What recordings can say of parameters before a fit: the sigmas of the preview are those of the fit."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification import identify
from hydrotwin.identification.excitation import excitation
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der
from hydrotwin.records import Record

TIME = np.arange(500) / 100


class Lag(Component):
    """A first order lag, and a gain that shows only together with another."""

    command = Input("V", "command")
    position = Output("m", "position")
    lag = Parameter(0.2, "s", "time constant", free=True, bounds=(1e-3, 10))
    gain = Parameter(0.1, "m/V", "gain", free=True, bounds=(1e-3, 10))
    ratio = Parameter(1.0, "1", "beside the gain", bounds=(1e-3, 10))
    x = State(0.0, "m", "position")

    def equations(self):
        yield self.lag * der(self.x) == self.gain * self.ratio * self.command - self.x
        yield self.position == self.x


def moved(u):
    x = np.zeros(len(TIME))
    for k in range(len(TIME) - 1):
        x[k + 1] = x[k] + (0.1 * u[k] - x[k]) * -np.expm1(-0.01 / 0.2)
    y = x + 1e-4 * np.random.default_rng(0).normal(size=len(TIME))
    return Record(TIME, {"command": u, "position": y}, {"command": "V", "position": "m"}, "run")


def test_the_preview_tells_the_sigmas_that_the_fit_then_has():
    record = moved(np.where(TIME % 2 > 1, 2.0, 0.0))
    rows, said = excitation(Model(Lag()), [record])
    fit = identify(Model(Lag()), [record], starts=1)
    for row, fitted in zip(rows, fit.parameters, strict=True):
        assert row.sigma == pytest.approx(fitted.sigma, rel=0.2) and row.verdict == "well"
    assert said == ()


def test_what_a_recording_does_not_excite_is_told():
    still, said = excitation(Model(Lag()), [moved(np.zeros(len(TIME)))])
    assert [row.verdict for row in still] == ["not", "not"] and "lag has no effect" in " ".join(said)
    both, said = excitation(Model(Lag()), [moved(np.where(TIME % 2 > 1, 2.0, 0.0))], ["*"])
    assert any("gain and ratio cannot be told apart" in sentence for sentence in said)
    assert {row.name: row.verdict for row in both}["lag"] == "well"
