"""What a recorded input leaves open: the curve between its samples, and the digits in which it was written."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from hydrotwin.discovery.discover import discover
from hydrotwin.identification import identify
from hydrotwin.models.components import FirstOrderLag
from hydrotwin.models.language import Component, Input, Model, Output, connect
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation.inputs import as_seen
from tests.discovery.slides import Inline
from tests.identification.sliding import FREE, MASS, NOISE, VISCOUS, moved, slide, wave


def strong(seed: int):
    """A smooth force [N] up to 1.4 Hz, far above the noise."""
    return lambda time: 8 * wave(seed)(time)


def fitted(runs, **more):
    return identify(slide(), runs, free=FREE, starts=1, **more)


UNEVEN = np.cumsum(np.random.default_rng(3).uniform(0.04, 0.06, 80))


@pytest.mark.parametrize(("time", "better"), [(np.arange(0, 4, 0.05), 15), (UNEVEN, 3)])
def test_lines_between_the_samples_of_a_smooth_input_have_the_means_of_its_curve(time, better):
    w, (a, b) = 4.0, (time[:-1], time[1:])
    exact = (np.cos(w * a) - np.cos(w * b)) / (w * (b - a))

    def off(interpolation: str) -> float:
        u = as_seen(Signal("u", "N", interpolation=interpolation), time, np.sin(w * time))
        return np.abs(((u[1:] + u[:-1]) / 2 - exact)[2:-2]).max()

    assert off("smooth") < off("linear") / better
    assert off("linear") == pytest.approx((w * np.diff(time).max()) ** 2 / 12, rel=0.2)


def test_a_smooth_force_is_found_and_does_not_bend_the_mass():
    fit = fitted([moved(1, strong(1))])
    (said,) = [str(f) for f in fit.findings]
    assert "force is smooth between its samples and not linear as assumed" in said
    assert all(r.explained for r in fit.residuals)
    for p, true in zip(fit.parameters, (MASS, VISCOUS), strict=True):
        assert abs(p.value - true) < 4 * p.sigma


def test_what_the_user_says_of_a_smooth_force_stands():
    fit = fitted([moved(1, strong(1))], interpolation={"force": "linear"})
    assert fit.flat.inputs[0].interpolation == "linear"
    assert abs(fit.values["load.mass"] - MASS) > 4 * fit.parameters[0].sigma
    fit = fitted([moved(1, strong(1))], interpolation={"force": "smooth"})
    assert all(r.explained for r in fit.residuals) and not fit.findings


@pytest.mark.parametrize("noise", [0.0, 1.0])
def test_no_effect_is_missing_under_a_smooth_force(noise):
    runs = [moved(s, strong(s), noise=noise) for s in range(3)]
    answer = discover(slide(), runs, free=FREE, effects=("coulomb_friction", "dead_time"), executor=Inline())
    assert answer.verdict == "none" and "smooth" in answer.answer


class Lagged(Component):
    """A lag, and a second one that its model may lack."""

    u = Input("1", "command")
    y = Output("1", "what follows")
    lag = FirstOrderLag(time_constant=0.2)

    def equations(self):
        yield connect(self.u, self.lag.u)
        yield self.y == self.lag.y


@pytest.mark.parametrize("levels", [(0.0, 1.0), (-5.0, 5.0), (0.0, 10.0, 20.0, 10.0, 30.0)])
@pytest.mark.parametrize("second", [0.0, 0.03])
def test_the_levels_of_a_command_are_no_digits(levels, second):
    """A relay jumps by all of its range; that was taken for the step in which the command was rounded."""
    t = np.arange(0, 3.0, 0.01)
    u = np.array(levels)[(t // 0.5).astype(int) % len(levels)]
    first, following = np.zeros(len(t)), np.zeros(len(t))
    for k in range(len(t) - 1):
        x, y = first[k], following[k]
        first[k + 1] = u[k] + (x - u[k]) * np.exp(-0.1)
        if second:  # x(t) is known: y' = (x - y) / second
            c = (x - u[k]) / (1 - second / 0.1)
            following[k + 1] = u[k] + c * np.exp(-0.1) + (y - u[k] - c) * np.exp(-0.01 / second)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(t))
    run = Record(t, {"u": u, "y": (following if second else first) + noise}, {"u": "1", "y": "1"}, "relay")
    fit = identify(Model(Lagged(), "lagged"), [run], free=["lag.time_constant"], starts=1, interpolation={"u": "hold"})
    assert fit.noise["y"] == pytest.approx(1e-3, rel=0.3)
    assert fit.residuals[0].explained == (not second)
    assert second or fit.parameters[0].sigma < 1e-3


@pytest.mark.parametrize("step", [2.0, 5.0, 20.0, 50.0])
def test_the_digits_of_a_measured_force_count_in_what_is_left_and_in_the_sigmas(step):
    true = strong(2)
    fit = fitted([moved(2, true, lambda t: step * np.round(true(t) / step))], interpolation={"force": "linear"})
    assert all(r.explained for r in fit.residuals)
    assert abs(fit.values["load.mass"] - MASS) < 4 * fit.parameters[0].sigma


@pytest.mark.parametrize(("step", "offset"), [(5e-4, 0.0), (2.5e-4, 1e-4)])
def test_a_sensor_that_moves_by_several_of_its_last_digit_is_explained_by_its_step(step, offset):
    run = moved(2, strong(2), noise=0.0)
    rounded = offset + np.round((run["position"] - offset) / step) * step
    noisy = run["velocity"] + NOISE["velocity"] * np.random.default_rng(1).standard_normal(len(run.time))
    run = dataclasses.replace(run, signals={**run.signals, "position": np.round(rounded, 10), "velocity": noisy})
    fit = fitted([run])
    assert fit.noise["position"] >= 0.999 * step / np.sqrt(12)
    assert all(r.explained for r in fit.residuals)


@pytest.mark.parametrize("turned", ("position", "force"))
def test_a_sign_that_is_turned_is_told_and_no_delay_beyond_the_recording(turned):
    run = moved(1, strong(1))
    other = run.with_signals({turned: -run[turned]}, units={turned: run.units[turned]})
    said = " ".join(map(str, fitted([other]).findings))
    assert "with its sign turned would explain most of what is left" in said
    assert "later" not in said and "earlier" not in said


def test_a_sign_that_is_right_is_not():
    assert "against" not in " ".join(str(f) for f in fitted([moved(1, strong(1))]).findings)


@pytest.mark.parametrize("offset", (0.02, -0.1))
def test_a_constant_offset_of_a_sensor_is_told_with_its_size(offset):
    run = moved(1, strong(1))
    other = run.with_signals({"velocity": run["velocity"] + offset}, units={"velocity": "m/s"})
    said = " ".join(map(str, fitted([other]).findings))
    told = re.search(r"a constant offset of (\S+) m/s of velocity would explain most", said)
    assert float(told[1]) == pytest.approx(offset, rel=0.05)


def test_samples_of_a_measured_force_that_stand_alone_are_told_with_the_first():
    run = moved(1, strong(1))
    force = run["force"].copy()
    force[[100, 250, 333]] += (400.0, -300.0, 500.0)
    said = " ".join(map(str, fitted([run.with_signals({"force": force}, units={"force": "N"})]).findings))
    assert "3 samples of input force stand alone" in said
    assert f"{run.time[100] - run.time[0]:.6g} s from its start" in said
