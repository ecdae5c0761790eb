"""Even sampling is seen behind printed times, and nothing else is taken for it."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.records import Record


def record(time) -> Record:
    return Record(np.asarray(time, float), {}, {})


@pytest.mark.parametrize("start", [0.0, 12.3456789, 1000.0])
@pytest.mark.parametrize(("rate", "digits"), [(300, 3), (300, 4), (600, 3), (44.1, 2), (7, 2), (1 / 7, 0), (128, 3)])
def test_the_grid_behind_printed_times_is_found(rate, digits, start):
    exact = start + np.arange(4000) / rate
    printed = record(np.round(exact, digits))
    assert printed.uniform and printed.period == pytest.approx(1 / rate, rel=1e-5)
    assert np.abs(printed.evenly().time - exact).max() < 0.51 * 10.0**-digits
    assert printed.on_grid(1 / rate)


def test_an_exact_grid_is_left_as_it_is():
    exact = record(0.01 * np.arange(1000))
    assert exact.evenly() is exact and exact.period == 0.01


@pytest.mark.parametrize(
    "time",
    [
        np.delete(np.arange(500) / 300, 250),  # a sample is missing
        np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 500)) / 300,  # samples at random
        np.round(np.cumsum(np.random.default_rng(0).uniform(0.5, 1.5, 500)) / 300, 4),
        np.concatenate([np.arange(250) / 300, 1 + np.arange(250) / 250]),  # another rate later
        np.arange(500) / 300 + 2e-4 * np.sin(np.arange(500)),  # a clock that trembles
    ],
)
def test_what_is_not_even_is_not_taken_for_it(time):
    assert not record(time).uniform and record(time).evenly().time is not None
    assert np.array_equal(record(time).evenly().time, time)


@pytest.mark.parametrize("rate", [333.0, 334.0, 249.0, 111.0, 99.9])
def test_rounding_that_drifts_slowly_against_the_grid_is_rounding(rate):
    printed = record(np.round(np.arange(3000) / rate, 3))
    assert printed.uniform and printed.period == pytest.approx(1 / rate, rel=3e-4)
