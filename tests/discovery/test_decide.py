"""Evidence counts what samples are worth, is not ruled by one bad block, and knows a gap from a noise badly known."""

from __future__ import annotations

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from hydrotwin.discovery.answering import SOUND, _weight
from hydrotwin.discovery.decide import (
    CLEARLY,
    INEXACT,
    Evidence,
    bic_gain,
    bic_needed,
    block_errors,
    closed,
    compared,
    correlation_times,
    gap_closed,
    has_gap,
    output_gap_closed,
    paired_t,
    share_closed,
)
from hydrotwin.discovery.refit import Question, Refitted, pooled_rmse
from hydrotwin.discovery.structure import Structure
from hydrotwin.discovery.verdict import CONFIRMED, closed_where_it_counts, verdict_of
from hydrotwin.identification.problem import Recording

NOISE = np.array([0.5, 2e5])
N = 2000


def white(seed: int, n: int = N) -> np.ndarray:
    """Residuals (n, 2) of the size of the noise."""
    return NOISE * np.random.default_rng(seed).standard_normal((n, 2))


def coloured(a: float, seed: int, n: int = N) -> np.ndarray:
    """AR(1) with unit variance, (n, 1)."""
    start = np.random.default_rng(seed).standard_normal((n + 500, 1))
    return lfilter([np.sqrt(1 - a * a)], [1.0, -a], start, axis=0)[500:]


def structure(fit, select=(), parameters: int = 2) -> Refitted:
    """A fitted structure that left these residuals."""
    rmse = np.sqrt(np.nanmean(np.concatenate(fit) ** 2, axis=0))
    return Refitted({}, (), np.fmax(rmse, NOISE[: len(rmse)]), tuple(fit), tuple(select), 0.0, parameters, (), True, 1)


def asked(n: int = N, outputs: int = 2) -> Question:
    """One recording to fit."""
    y = np.zeros((n, outputs))
    return Question((Recording("run", None, np.arange(n) * 0.01, y[:, :1], y),), (), NOISE[:outputs])


# -- what samples are worth ----------------------------------------------------------------------------------------
@pytest.mark.parametrize("a", [0.0, 0.5, 0.8, 0.9])
def test_the_correlation_time_of_ar1_noise_is_one_plus_a_over_one_minus_a(a):
    tau = correlation_times([coloured(a, seed, 8000) for seed in range(4)])
    assert tau == pytest.approx([(1 + a) / (1 - a)], rel=0.15)


def test_a_bias_is_correlated_for_ever_and_missing_samples_are_left_out():
    biased = 3.0 + white(0)[:, :1] / NOISE[0]
    assert correlation_times([biased])[0] > 100
    gaps = coloured(0.8, 1, 8000)
    gaps[::7] = np.nan
    assert 1.0 <= correlation_times([gaps])[0] < 12.0
    assert correlation_times([np.zeros((50, 1))]) == pytest.approx([1.0])


def test_a_parameter_that_explains_nothing_costs_the_logarithm_of_the_samples():
    left = [white(0)]
    gain = bic_gain(structure(left, parameters=3), structure(left), asked())
    assert gain == pytest.approx(-np.log(2 * N), abs=0.3)


def test_the_same_drop_is_worth_less_where_samples_repeat_each_other():
    q = asked(outputs=1)
    gains = []
    for a in (0.0, 0.9):
        left = NOISE[0] * 2 * coloured(a, 3)
        gains.append(bic_gain(structure([left]), structure([2 * left]), q))
    assert gains[0] > 1000 and gains[1] == pytest.approx(gains[0] / 19, rel=0.4)


def test_nothing_is_gained_below_the_noise():
    left = [0.9 * white(1)]
    assert bic_gain(structure([0.3 * left[0]]), structure(left), asked()) == pytest.approx(
        2 * N * 0.5 * (0.81 - 0.81 * 0.09) * 2, rel=0.1
    )
    finer = [1e-3 * left[0]]
    assert bic_gain(structure([1e-6 * left[0]]), structure(finer), asked()) < 0.01


# -- held-out blocks ---------------------------------------------------------------------------------------------------
def test_the_better_structure_has_a_positive_t_and_the_worse_the_same_negative():
    better, other = [white(0)], [1.5 * white(1)]
    t = paired_t(better, other, NOISE, NOISE)
    assert t > 5
    assert paired_t(other, better, NOISE, NOISE) == pytest.approx(-t)


def test_alike_structures_have_a_small_t():
    assert np.mean([abs(paired_t([white(2 * k)], [white(2 * k + 1)], NOISE, NOISE)) > 2 for k in range(40)]) < 0.2


def test_one_bad_block_does_not_outvote_all_the_others():
    better, other = white(0), 1.5 * white(0)
    spoilt = better.copy()
    spoilt[300:340] += 30 * NOISE
    assert np.mean(spoilt**2) > np.mean(other**2)
    assert paired_t([spoilt], [other], NOISE, NOISE) > 2


def test_what_a_few_blocks_say_is_not_hidden_by_those_in_which_nothing_is_missing():
    """An effect that shows for a tenth of the time: over all blocks t is two, however large the error there."""
    better, other = white(0), white(0)
    other[:200] *= np.linspace(5, 20, 200)[:, None]
    size = np.sqrt(np.mean(other**2, axis=0))
    everywhere = paired_t([better], [other], size, 100 * NOISE)
    assert everywhere < 2.5 and paired_t([better], [other], size, NOISE) > 3
    assert paired_t([other], [better], size, NOISE) < -3


def test_where_all_recordings_are_fitted_to_a_block_at_each_end_of_a_stop_is_enough():
    """Two blocks of forty: kept out of the fit they are too few to decide, and the 38 others say nothing."""
    better, other = white(0), white(0)
    other[[400, 1200]] += 40 * NOISE
    a, b = structure([better], [better]), structure([other], [other])
    together = dataclasses.replace(asked(), select=asked().fit)
    apart = dataclasses.replace(asked(), select=(dataclasses.replace(asked().fit[0], name="other"),))
    assert together.held_out is False and apart.held_out is True
    assert compared(a, b, together).paired_t > 3 and compared(b, a, together).paired_t < -3
    assert compared(a, b, apart).paired_t < 2


def test_without_held_out_recordings_there_is_no_t():
    assert np.isnan(paired_t([], [], NOISE, NOISE))


def test_a_run_that_diverges_on_held_out_recordings_loses():
    diverged = [np.full((N, 2), np.inf)]
    assert paired_t(diverged, [white(0)], NOISE, NOISE) < -10
    assert paired_t([white(0)], diverged, NOISE, NOISE) > 10


def test_a_sensor_that_fails_for_a_while_on_held_out_recordings_does_not_end_the_comparison():
    better, other = white(0), 1.5 * white(1)
    for r in (better, other):
        r[400:700] = np.nan
    assert paired_t([better], [other], NOISE, NOISE) > 5


def test_blocks_cover_recordings_of_any_length_and_skip_what_was_not_measured():
    short, long = white(0, 30), white(1, 4000)
    long[:, 1] = np.nan
    errors = block_errors([short, long], NOISE)
    assert len(errors) == 1 + 4000 // (4030 // 40) and np.isfinite(errors).all()
    assert np.exp(errors).mean() == pytest.approx(1.0, rel=0.15)


# -- how much of the gap -----------------------------------------------------------------------------------------------
def test_a_gap_closed_to_the_noise_counts_one_untouched_nought_and_worsened_negative():
    before = 5 * NOISE
    assert gap_closed(before, NOISE, NOISE) == pytest.approx(1.0)
    assert gap_closed(before, before, NOISE) == pytest.approx(0.0)
    assert gap_closed(before, 0.5 * NOISE, NOISE) == 1.0
    assert gap_closed(before, 6 * NOISE, NOISE) < 0
    assert gap_closed(before, np.sqrt(13) * NOISE, NOISE) == pytest.approx(0.5)


def test_a_diverged_run_closes_ten_times_nothing_and_no_gap_cannot_be_closed():
    assert gap_closed(5 * NOISE, np.full(2, np.inf), NOISE) == -10.0
    assert gap_closed(1.005 * NOISE, 0.9 * NOISE, NOISE) == 0.0
    assert np.isnan(output_gap_closed(1.005 * 0.5, 0.4, 0.5))
    assert output_gap_closed(2.5, 0.5, 0.5) == 1.0
    assert np.isnan(output_gap_closed(np.inf, np.inf, 0.5)) and np.isnan(output_gap_closed(2.5, np.inf, 0.5))
    assert output_gap_closed(np.inf, 0.5, 0.5) == 1.0


def test_what_no_longer_diverges_has_closed_the_gap():
    assert gap_closed(np.full(2, np.inf), NOISE, NOISE) == pytest.approx(1.0)


def test_an_output_without_a_gap_and_one_not_measured_have_no_say():
    before, after = np.array([5.0, 1.0, np.nan]), np.array([1.0, 3.0, np.nan])
    assert gap_closed(before, after, np.array([1.0, 1.0, np.nan])) == pytest.approx(1.0)


def test_the_best_sensor_does_not_rule_alone():
    share = gap_closed(np.array([100.0, 10.0]), np.array([1.0, 10.0]), np.ones(2))
    assert share == pytest.approx(2 / 3)


def test_held_out_recordings_judge_where_there_are_some():
    q = asked()
    good, bad = white(0), 5 * white(1)
    assert closed(structure([bad], [good]), structure([bad], [bad]), q) == pytest.approx(1.0, abs=0.02)
    assert closed(structure([good]), structure([bad]), q) == pytest.approx(1.0, abs=0.02)


def test_a_noise_estimated_too_large_does_not_hide_what_is_left_to_close():
    """Ten times the noise, twice it, once: the noise thought to be three times what the best leaves."""
    base, now, best = (structure([k * white(seed)]) for seed, k in enumerate((10, 2, 1)))
    q = dataclasses.replace(asked(), noise=3 * NOISE)
    assert share_closed(base, now, best, q) == pytest.approx(1 - 3 / 99, abs=0.005)
    assert share_closed(base, base, best, q) == 0.0
    assert share_closed(base, best, best, q) == pytest.approx(1.0)


def test_a_later_effect_is_trusted_by_its_share_of_the_whole_gap():
    base, first, second = (Structure((), structure([k * white(s)])) for s, k in enumerate((30, 1.5, 1)))
    search = SimpleNamespace(question=asked())

    def weight(before, after):
        step = SimpleNamespace(before=before, choice=SimpleNamespace(best=SimpleNamespace(structure=after)))
        return _weight(search, base, step)

    assert weight(base, first) == pytest.approx(SOUND, abs=0.005)
    share = 1.25 / 899
    assert weight(first, second) == pytest.approx(SOUND * share / (share + INEXACT), abs=0.05)
    assert weight(first, second) < 0.5
    assert weight(second, second) < 0.02


# -- is there a gap ----------------------------------------------------------------------------------------------------
def test_a_white_bias_is_a_gap():
    biased = [white(k) + NOISE * np.array([0.8, 0.0]) for k in range(3)]
    assert has_gap(biased, NOISE).tolist() == [True, False]


def test_white_residuals_a_little_above_an_estimated_noise_are_none():
    for seed in range(10):
        assert not has_gap([1.03 * white(10 * seed + k) for k in range(3)], NOISE).any()


def test_a_small_coloured_residual_is_a_gap_unless_it_must_be_clear():
    wave = 0.35 * NOISE * np.sin(np.arange(N) / 30.0)[:, None]
    left = [white(k) + wave for k in range(3)]
    assert has_gap(left, NOISE).all()
    assert not has_gap(left, NOISE, CLEARLY).any()
    assert has_gap([white(k) + 2 * wave for k in range(3)], NOISE, CLEARLY).all()


def test_an_output_that_was_not_measured_has_no_gap_and_a_diverged_run_has_one():
    unseen = [white(0) * np.array([1.0, np.nan])]
    assert has_gap(unseen, np.array([NOISE[0], np.nan])).tolist() == [False, False]
    assert has_gap([np.full((N, 2), np.inf)], NOISE).all()


# -- a name ------------------------------------------------------------------------------------------------------------
def test_a_larger_library_needs_more_evidence():
    assert bic_needed(1) == pytest.approx(10.0) and bic_needed(0) == pytest.approx(10.0)
    assert bic_needed(60) == pytest.approx(10 + 2 * np.log(60))


@pytest.mark.parametrize("change", [{"bic_gain": 15.0}, {"paired_t": 1.9}, {"closed": 0.04}, {"paired_t": np.nan}])
def test_a_name_needs_all_three_kinds_of_evidence(change):
    good = Evidence(100.0, 10.0, 0.9)
    assert good.passes(60)
    assert not dataclasses.replace(good, **change).passes(60)


def test_a_structure_that_fits_the_noise_of_the_fit_recordings_fails_on_the_others():
    fitted = structure([0.6 * white(0)], [1.1 * white(2)], parameters=12)
    plain = structure([white(0)], [white(2)])
    assert not compared(fitted, plain, asked()).passes(1)


def test_a_noise_estimated_too_large_does_not_hide_what_a_better_structure_explains():
    better, other = structure([0.7 * white(0)], [0.7 * white(1)]), structure([0.9 * white(0)], [0.9 * white(1)])
    before, after = (pooled_rmse(f.residuals_select) for f in (other, better))
    assert gap_closed(before, after, NOISE) == 0.0, "both lie under the estimate"
    assert closed(better, other, asked()) == pytest.approx(1.0)
    assert closed(other, better, asked()) <= 0.0


def test_a_name_must_hold_on_recordings_that_took_no_part():
    """What was closed on the recordings of the search is taken back where those that judge show the gap as before."""

    def concluded(factor):
        return SimpleNamespace(residuals_report=(factor * white(3),))

    judged = SimpleNamespace(report=("r",), noise=NOISE)
    assert closed_where_it_counts(concluded(10.0), concluded(1.0), judged) > 0.99
    assert closed_where_it_counts(concluded(10.0), concluded(9.0), judged) < CONFIRMED
    assert closed_where_it_counts(concluded(1.0), concluded(1.0), judged) == 1.0  # there is no gap to close
    assert closed_where_it_counts(concluded(10.0), concluded(9.0), SimpleNamespace(report=(), noise=NOISE)) == 1.0


@pytest.mark.parametrize(
    ("fit", "select", "verdict"),
    [(1.0, 0.6, "named"), (3.0, 0.6, "unknown"), (3.0, 0.9, "named"), (1.0, 0.4, "unknown")],
)
def test_what_leaves_but_noise_where_it_was_fitted_may_miss_the_rest_by_more(fit, select, verdict):
    """``select``: share closed of a gap of 10 on what was held out; a slightly wrong rate misses a faster recording."""
    base = Structure((), structure([10 * coloured(0.9, 1) * NOISE], [10 * coloured(0.9, 2) * NOISE]))
    left = np.sqrt(1 + (1 - select) * 99)
    last = Structure(
        (), structure([fit * (coloured(0.9, 1) if fit > 1 else white(1) / NOISE) * NOISE], [left * white(2)])
    )
    step = SimpleNamespace(choices=lambda: [SimpleNamespace(members=())])
    search = SimpleNamespace(question=asked())
    assert verdict_of(search, SimpleNamespace(base=base, last=last, steps=(step,))) == verdict


def test_an_output_with_hardly_a_gap_says_nothing_of_a_five_hundredth():
    """One output falls from eighty times the noise to twice and then once; the other rises from 1.02 to 1.03."""
    falls = [structure([white(seed) * factors]) for seed, factors in enumerate(([80, 1.02], [2, 1.03], [1, 1]))]
    base, now, best = falls
    assert 1 - share_closed(base, now, best, asked()) == pytest.approx(3 / 6399, rel=0.2)
    faint = [structure([white(seed) * k]) for seed, k in enumerate((1.04, 1.02, 1.0))]
    assert 0 < share_closed(*faint, asked()) < 1, "where no gap is clear, all that can be measured count"
