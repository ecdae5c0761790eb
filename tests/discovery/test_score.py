"""The score: noise scores nothing at any scale, a slow drift as few values, the law of a right effect is forgiven."""

import numpy as np
import pytest

from hydrotwin.discovery.evidence.deciding import DECIDING
from hydrotwin.discovery.evidence.score import Floor, Spectrum, by_output, score, sharper, spectrum

NOISE = np.array([0.1, 2.0])


def white(seed: int = 0, samples: int = 3000) -> np.ndarray:
    return NOISE * np.random.default_rng(seed).standard_normal((samples, 2))


def floor(base: Spectrum | None = None, coloured: float = 0.0, **more) -> Floor:
    return Floor(NOISE, np.array([coloured, 0.0]), base and base.variance, **more)


@pytest.mark.parametrize("samples", [1, 2, 3, 7, 1000, 1023])
def test_the_transform_keeps_lengths_and_counts_every_value_once(samples):
    runs = [white(1, samples), white(2, 5)]
    left = spectrum(runs)
    assert left.squares.sum(axis=0) == pytest.approx(sum(np.square(r).sum(axis=0) for r in runs))
    assert left.counts.sum(axis=0).tolist() == [samples + 5] * 2


def test_missing_samples_are_passed_over_and_a_run_that_diverged_is_infinite():
    runs = white()
    runs[::3, 1] = np.nan
    left = spectrum([runs])
    assert left.counts.sum(axis=0).tolist() == [3000, 2000]
    assert left.rmse[1] == pytest.approx(np.sqrt(np.nanmean(runs[:, 1] ** 2)))
    runs[5, 0] = np.inf
    assert score(spectrum([runs]), floor()) == np.inf


def test_white_noise_has_the_same_variance_at_every_scale_and_scores_next_to_nothing():
    left = spectrum([white(seed, 4096) for seed in range(8)])
    assert np.allclose(left.variance[:6] / NOISE**2, 1.0, atol=0.12)
    assert [score(spectrum([white(seed)]), floor()) for seed in range(20)] == pytest.approx([0.0] * 20, abs=4.0)


def test_a_drift_counts_as_the_few_values_it_is_and_what_moves_fast_as_many():
    drift = white() + np.linspace(-0.3, 0.3, 3000)[:, None] * [1.0, 0.0]  # three times the variance of the noise
    fast = white() * [1.4, 1.0]  # twice the variance
    assert 20 < score(spectrum([drift]), floor()) < 120
    assert score(spectrum([fast]), floor()) > 600
    assert by_output(spectrum([fast]), floor())[1] < 4


def test_a_right_law_may_leave_a_fiftieth_of_what_the_base_leaves_and_a_wrong_one_not_a_fifth():
    gap = 5.0 * np.sin(np.arange(3000) / 50)[:, None] * NOISE
    base = spectrum([white() + gap])
    assert score(spectrum([white(1) + DECIDING.law * gap]), floor(base)) < 5
    assert score(spectrum([white(1) + 0.2 * gap]), floor(base)) > 50
    assert score(spectrum([white(1) + 0.2 * gap]), floor(base, law=0.3)) < 5


def test_what_is_not_white_of_the_noise_may_stay_at_every_scale():
    resting = white() * [0.0, 1.0] + [0.05, 0.0]  # a signal at rest between two steps of 0.17
    resting[:, 0] += 0.02 * np.random.default_rng(3).standard_normal(3000)
    assert score(spectrum([resting]), floor()) > 2
    assert score(spectrum([resting]), floor(coloured=0.05)) == 0.0


def test_a_fit_that_leaves_less_than_the_noise_tells_the_noise_unless_the_user_did():
    seen, told, least = [spectrum([white() * [0.5, 1.0]])], np.array([False, False]), np.zeros(2)
    less = sharper(NOISE, seen, told, least)
    assert less == pytest.approx([0.05, 2.0], rel=0.06)
    assert sharper(NOISE, seen, ~told, least).tolist() == NOISE.tolist()
    assert sharper(NOISE, seen, told, np.array([0.08, 0.0]))[0] == 0.08
    assert sharper(NOISE, [], told, least) is NOISE


# -- by hand -----------------------------------------------------------------------------------------------------------
def test_the_floor_is_noise_with_its_chance_rounding_that_grows_with_scale_and_a_fiftieth_of_the_base():
    counts, base = np.array([[200.0], [100.0], [8.0]]), np.array([[0.0], [0.25], [4.0]])
    found = Floor(np.array([0.1]), np.array([0.03]), base).variance(counts)
    noise = [0.01 * (1.05 + 3 * np.sqrt(2 / n)) for n in (200, 100, 8)]
    rounding = [0.0009, 0.0018, 0.0036]
    law = [0.0, 0.25 * 0.0004, 4.0 * 0.0004]
    assert found[:, 0] == pytest.approx([a + b + c for a, b, c in zip(noise, rounding, law, strict=True)])


def test_every_scale_counts_half_its_values_times_the_logarithm_of_how_far_it_stands_out():
    counts = np.array([[200.0], [8.0]])
    floor = Floor(np.array([0.1]), np.zeros(1))
    allowed = floor.variance(counts)[:, 0]
    left = Spectrum(np.array([[0.5 * allowed[0] * 200], [7.0 * allowed[1] * 8]]), counts)
    assert score(left, floor) == pytest.approx(4 * np.log(7.0)), "what lies below its floor makes up for nothing"


def test_the_same_bias_is_worth_few_values_however_long_it_lasts():
    """One coefficient holds it: a hundred times the samples are a hundred times the square, and no more values."""
    short, long = (score(spectrum([NOISE * np.ones((n, 2))]), floor()) for n in (64, 6400))
    assert 0 < long - short < 2 * 6 * np.log(100)


def test_an_output_without_a_noise_or_without_a_value_has_no_say():
    left = spectrum([white() * 5])
    known = Floor(np.array([0.1, np.nan]), np.zeros(2))
    assert by_output(left, known)[1] == 0.0 < by_output(left, known)[0]
    runs = white() * 5
    runs[:, 1] = np.nan
    empty = spectrum([runs])
    assert by_output(empty, floor())[1] == 0.0 and np.isnan(empty.rmse[1])


def test_a_fit_that_diverged_and_an_unknown_noise_sharpen_nothing():
    good, lost = spectrum([white() * 0.5]), spectrum([np.full((100, 2), np.inf)])
    told, least = np.array([False, False]), np.zeros(2)
    assert sharper(NOISE, [lost], told, least) is NOISE
    assert sharper(NOISE, [lost, good], told, least) == pytest.approx(0.5 * NOISE, rel=0.06)
    assert np.isnan(sharper(np.array([0.1, np.nan]), [good], told, least)[1])
    assert sharper(NOISE, [spectrum([3 * white()])], told, least).tolist() == NOISE.tolist(), "never louder"
