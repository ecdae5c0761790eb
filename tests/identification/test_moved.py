"""Whether errors are a draw of what a fit does not know: calibrated where nothing is missing, and small where it is."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification.moved import WIDE, Moved

TIME = np.linspace(0.0, 20.0, 1000)
ROOT = np.column_stack([0.3 * np.ones_like(TIME), 0.02 * TIME, 0.1 * np.sin(TIME), 1e-6 * np.cos(TIME)])
OUTPUT = Moved(ROOT, 0.1)


def drawn(seed):
    rng = np.random.default_rng(seed)
    return ROOT @ rng.standard_normal(ROOT.shape[1]) + OUTPUT.left * rng.standard_normal(len(TIME))


def inside(error):
    return np.mean(np.abs(error) <= WIDE * OUTPUT.deviation)


def test_the_deviation_is_that_of_draws():
    found = np.std([drawn(seed) for seed in range(4000)], axis=0)
    assert OUTPUT.deviation == pytest.approx(found, rel=0.06)


def test_draws_of_what_is_not_known_have_their_chance_however_little_lies_inside():
    errors = [drawn(seed) for seed in range(400)]
    chances = np.array([OUTPUT.chance(e) for e in errors])
    assert 0.02 < np.mean(chances < 0.05) < 0.09 and chances.min() > 1e-4
    unlucky = min(errors, key=inside)
    assert inside(unlucky) < 0.6 and OUTPUT.chance(unlucky) > 1e-3


def test_a_move_along_what_is_not_known_by_more_than_that_allows_has_none():
    for seed in range(20):
        assert OUTPUT.chance(drawn(seed) + ROOT @ [0.0, 10.0, 0.0, 0.0]) < 1e-6


def test_what_lies_beside_it_has_none_and_slow_errors_count_as_few():
    rng = np.random.default_rng(0)
    noise = OUTPUT.left * rng.standard_normal(len(TIME))
    assert OUTPUT.chance(noise + 0.2 * np.sin(9 * TIME)) < 1e-6
    own = Moved(np.zeros((len(TIME), 1)), 1.0)  # nothing but what is left
    slow = np.repeat(rng.standard_normal(20), 50)  # twenty samples of their own, three of them outside
    slow[:150] = np.repeat([2.2, -2.3, 2.5], 50)
    white = rng.permutation(slow)
    assert own.chance(white) < 1e-6 < 1e-3 < own.chance(slow)


def test_samples_that_were_not_measured_do_not_count():
    error = drawn(1)
    error[::2] = np.nan
    half = Moved(ROOT[1::2], OUTPUT.left)
    assert OUTPUT.chance(error) == pytest.approx(half.chance(error[1::2]))
    assert np.isnan(OUTPUT.chance(np.full(len(TIME), np.nan)))


def test_rounding_at_rest_is_no_error():
    """Of noise of half a step 8 % lie outside, or 1 %, by where between two steps an output rests: no chance of either
    says that something is missing. An error of two steps does."""
    rng, step = np.random.default_rng(3), 0.18
    own = Moved(np.zeros((5000, 1)), float(np.hypot(0.1, step / np.sqrt(12))))
    between = np.full(5000, step / 2)
    reading = step * np.round((between + 0.1 * rng.standard_normal(5000)) / step)
    assert own.chance(reading - between) < 1e-3 < 0.1 < own.chance(reading - between, step)
    assert own.chance(reading - between + 2 * step, step) < 1e-6


def test_what_moves_beyond_numbers_has_no_chance():
    """A reading of 1e200 had ended a comparison with a traceback."""
    far = Moved(ROOT * 1e200, OUTPUT.left)
    assert np.isnan(far.chance(np.ones(len(TIME))))
