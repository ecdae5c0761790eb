"""What a free run leaves: an input is told where it is followed, with its lag, and not where it is by chance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from hydrotwin.learned.left_over import left_over
from hydrotwin.records import Record

PERIOD = 0.01


def records(u, count=1) -> list[Record]:
    parts = np.array_split(np.asarray(u), count)
    return [Record(PERIOD * np.arange(len(p)), {"u": p}, {"u": "V"}, f"run_{k}") for k, p in enumerate(parts)]


def slow(seed: int, n: int = 4000, pole: float = 0.98) -> np.ndarray:
    return lfilter([1.0], [1.0, -pole], np.random.default_rng(seed).normal(size=n))


@pytest.mark.parametrize("count", [1, 3])
def test_what_follows_an_input_is_told_with_its_lag(count):
    u = slow(1, pole=0.8)
    noise = np.random.default_rng(2).normal(size=len(u))
    runs = records(u, count)
    late = [np.r_[np.zeros(12), r["u"][:-12]] for r in runs]
    misses = [e + n for e, n in zip(late, np.array_split(noise, count), strict=True)]
    found = left_over(misses, runs, ["u"])
    [follows] = found.follows
    assert follows.samples == 12 and follows.lag == pytest.approx(12 * PERIOD) and follows.correlation > follows.bound
    assert found.said("y").startswith("What is left of y follows 'u' 12 samples later: more lags or a richer kind")


def test_two_slow_signals_that_have_nothing_to_do_with_each_other_are_said_to_be_alike_in_one_case_of_a_hundred():
    """Without their colour in the bound, most of them would be."""
    alike = naive = 0
    for seed in range(100):
        u, e = slow(seed), slow(1000 + seed)
        [follows] = left_over([e], records(u), ["u"]).follows
        alike += abs(follows.correlation) > follows.bound
        naive += abs(follows.correlation) > 2.58 / np.sqrt(len(u))
    assert alike <= 4 and naive > 50


def test_white_is_told_from_coloured():
    noise = np.random.default_rng(3).normal(size=2000)
    assert left_over([noise], records(slow(1, 2000)), []).white > 0.01
    told = left_over([slow(4, 2000)], records(slow(1, 2000)), []).told()
    assert told["white"] < 1e-6 and told["neighbours"] > 0.9 and "follows" not in told


def test_an_input_that_rests_and_a_short_recording_say_nothing():
    assert left_over([slow(1, 500)], records(np.ones(500)), ["u"]).follows == []
    assert left_over([slow(1, 8)], records(slow(2, 8)), ["u"]).said("y") == ""
