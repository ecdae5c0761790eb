"""Runs against answers that are known on paper."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.simulation import prepare
from tests.simulation.small_models import integrator, lag, oscillator

UNEVEN = np.cumsum(np.concatenate([[0.3], np.random.default_rng(1).uniform(0.0005, 0.013, 200)]))
NOISE = np.random.default_rng(2).normal(size=201)


def run(model, time, u=None, p=None, x0=(0.0,), **options):
    u = np.empty((len(time), 0)) if u is None else u
    p = model.parameter_vector(p)
    return prepare(model, **options).run(time, u, p, np.array(x0, dtype=float))


def integral_of(time, u, interpolation, until):
    """Closed form of the integral of a sampled input from the first sample; first value before it."""
    fine = np.union1d(time, until)
    values = np.interp(fine, time, u) if interpolation == "linear" else u[np.searchsorted(time, fine, "right") - 1]
    values[fine < time[0]] = u[0]
    pieces = np.diff(fine) * (0.5 * (values[1:] + values[:-1]) if interpolation == "linear" else values[:-1])
    total = np.concatenate([[0.0], np.cumsum(pieces)])
    return np.interp(until, fine, total) - np.interp(time[0], fine, total)


def test_an_oscillator_keeps_its_cosine_with_fourth_order_error():
    model, time = oscillator(frequency=20.0), np.linspace(0, 2, 201)
    runs = [run(model, time, x0=(1, 0), step=h, method="explicit")[0][:, 0] for h in (2e-3, 1e-3)]
    errors = [np.abs(y - np.cos(20 * time)).max() for y in runs]
    assert errors[0] < 2e-6 * 20
    assert errors[0] / errors[1] == pytest.approx(16, rel=0.05)


@pytest.mark.parametrize("time", [np.linspace(0, 1, 201), UNEVEN])
def test_a_lag_follows_a_held_input_exactly_at_the_samples(time):
    model = lag(time_constant=0.05)
    y, x = run(model, time, NOISE)
    expected = [0.0]
    for dt, u in zip(np.diff(time), NOISE[:-1], strict=True):
        expected.append(2 * u + (expected[-1] - 2 * u) * np.exp(-dt / 0.05))
    assert y[:, 0] == pytest.approx(np.array(expected), abs=1e-8)
    assert x[:, 0] == pytest.approx(y[:, 0], abs=0)


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("step", [1e-4, 3e-3, 1.0])
def test_an_integrator_sums_its_input_exactly_whatever_the_step(interpolation, step):
    """The mean over a substep leaves no half sample of delay."""
    y, _ = run(integrator(interpolation), UNEVEN, NOISE, step=step)
    assert y[:, 0] == pytest.approx(integral_of(UNEVEN, NOISE, interpolation, UNEVEN), abs=1e-13)


@pytest.mark.parametrize("engine", ["explicit", "vm", "implicit"])
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
@pytest.mark.parametrize("Td", [0.0, 0.0041, 0.1, 5.0])
def test_a_dead_time_shifts_the_input_exactly(interpolation, Td, engine):
    y, _ = run(integrator(interpolation, dead_time=0.1), UNEVEN, NOISE, p={"Td": Td}, method=engine)
    begin = integral_of(UNEVEN, NOISE, interpolation, UNEVEN[:1] - Td)
    expected = integral_of(UNEVEN, NOISE, interpolation, UNEVEN - Td) - begin
    assert y[:, 0] == pytest.approx(expected, abs=1e-11)


@pytest.mark.parametrize("engine", ["explicit", "vm"])
def test_outputs_see_the_delayed_input(engine):
    time = np.arange(50) * 0.01
    u = np.arange(50.0)
    seen = run(lag(dead_time=0.03), time, u, method=engine)[0][:, 1]
    assert seen == pytest.approx(np.maximum(np.arange(50.0) - 3, 0), abs=1e-9)
    seen = run(lag("linear", dead_time=0.035), time, u, method=engine)[0][:, 1]
    assert seen == pytest.approx(np.maximum(np.arange(50.0) - 3.5, 0), abs=1e-9)


def test_a_ramp_meets_a_lag_without_half_a_sample_of_delay():
    time = np.linspace(0, 0.5, 51)
    y, _ = run(lag("linear", time_constant=0.05), time, time, step=1e-3)
    expected = 2 * (time - 0.05 + 0.05 * np.exp(-time / 0.05))
    assert np.abs(y[:, 0] - expected).max() < 1e-5  # half a sample would be 1e-2, half a substep 1e-3


def test_a_single_sample_is_a_run():
    y, x = run(lag(), np.array([3.0]), np.array([1.0]), x0=(0.5,))
    assert (y[0, 0], x[0, 0]) == (0.5, 0.5)


def test_intervals_can_start_from_measured_states():
    model, time = lag(), np.linspace(0, 0.2, 21)
    restart = np.random.default_rng(3).normal(size=(21, 1))
    p = model.parameter_vector()
    for method in ("explicit", "vm", "implicit"):
        y, _ = prepare(model, method=method).run(time, NOISE[:21], p, np.array([7.0]), restart)
        target = 2 * NOISE[:20]
        expected = target + (restart[:20, 0] - target) * np.exp(-0.01 / 0.05)
        assert y[0, 0] == 7.0
        assert y[1:, 0] == pytest.approx(expected, abs=1e-8)
