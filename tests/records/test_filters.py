"""The filters against their closed forms, scipy, and polynomials that they must not change."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import savgol_filter

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import Record, one_euro, savitzky_golay


def uneven_time(n: int, rate: float = 100.0, seed: int = 0) -> np.ndarray:
    """Samples up to 0.4 of a period off their places."""
    return (np.arange(n) + np.random.default_rng(seed).uniform(-0.4, 0.4, n)) / rate


def recording(time, **columns) -> Record:
    return Record(time, columns, dict.fromkeys(columns, "m"), "sensor")


def published_one_euro(time, x, mincutoff, beta, dcutoff):
    """Algorithms 1 to 3 of the paper, line by line."""

    def alpha(rate, cutoff):
        tau, te = 1.0 / (2 * np.pi * cutoff), 1.0 / rate
        return 1.0 / (1.0 + tau / te)

    out, hatx, hatdx = [], None, None
    for k, value in enumerate(x):
        rate = 1.0 / (time[k] - time[k - 1]) if k else 1.0
        dx = (value - hatx) * rate if k else 0.0
        hatdx = alpha(rate, dcutoff) * dx + (1 - alpha(rate, dcutoff)) * hatdx if k else dx
        a = alpha(rate, mincutoff + beta * abs(hatdx))
        hatx = a * value + (1 - a) * hatx if k else value
        out.append(hatx)
    return np.array(out)


def test_one_euro_is_the_published_algorithm_on_uneven_time():
    t = uneven_time(400)
    x = np.sin(3 * t) + 0.05 * np.random.default_rng(1).normal(size=t.size)
    found = one_euro(recording(t, position=x), ["position"], min_cutoff=0.7, beta=1.3, derivative_cutoff=2.0)
    assert found["position"] == pytest.approx(published_one_euro(t, x, 0.7, 1.3, 2.0), abs=1e-13)


def test_a_constant_passes_the_one_euro_filter_unchanged():
    t = uneven_time(200)
    found = one_euro(recording(t, position=np.full(200, 0.37)), ["position"], beta=5.0)
    assert np.array_equal(found["position"], np.full(200, 0.37))


def test_with_a_fixed_cut_off_a_step_rises_as_one_minus_the_product_of_tau_over_tau_plus_dt():
    t = uneven_time(100)
    x = np.where(np.arange(100) < 20, 0.0, 2.0)
    found = one_euro(recording(t, position=x), ["position"], min_cutoff=1.5)["position"]
    tau = 1 / (2 * np.pi * 1.5)
    expected = 2.0 * (1 - np.cumprod(tau / (tau + np.diff(t)[19:])))
    assert np.all(found[:20] == 0.0)
    assert found[20:] == pytest.approx(expected, rel=1e-12)


def test_a_ramp_comes_out_late_by_the_time_constant_and_its_rate_is_the_slope():
    t = np.arange(3000) * 1e-3
    record = recording(t, position=0.2 * t)
    late = 0.2 * t[-1] - one_euro(record, ["position"], min_cutoff=2.0)["position"][-1]
    assert late == pytest.approx(0.2 / (2 * np.pi * 2.0), rel=1e-6)
    rates = one_euro(record, ["position"], min_cutoff=1e6, derivative_cutoff=2.0, derivative=1)
    assert rates["position.rate"][-1] == pytest.approx(0.2, rel=1e-3) and rates.units["position.rate"] == "m/s"
    assert np.array_equal(rates["position"], record["position"])


def test_one_euro_knows_no_later_sample():
    t = uneven_time(300)
    x = np.random.default_rng(2).normal(size=300)
    whole = one_euro(recording(t, position=x), ["position"], beta=0.5)
    half = one_euro(recording(t[:150], position=x[:150]), ["position"], beta=0.5)
    assert np.array_equal(whole["position"][:150], half["position"])


def test_a_larger_beta_lags_less_on_fast_motion_and_smooths_alike_at_rest():
    t = np.arange(4000) * 1e-3
    x = np.where(t < 2, 0.0, np.sin(4 * (t - 2))) + 1e-3 * np.random.default_rng(3).normal(size=t.size)
    slow, quick = (one_euro(recording(t, position=x), ["position"], beta=b)["position"] for b in (0.0, 2.0))
    moving, truth = t > 2, np.where(t < 2, 0.0, np.sin(4 * (t - 2)))
    assert np.std((quick - truth)[moving]) < 0.5 * np.std((slow - truth)[moving])
    assert np.std(quick[1000:2000]) < 0.3 * np.std(x[1000:2000])


@pytest.mark.parametrize(  # scipy itself fails at (51, 11)
    ("window", "order", "derivative"), [(51, 5, 0), (51, 5, 1), (51, 5, 2), (21, 3, 0), (21, 3, 1), (5, 0, 0)]
)
def test_on_even_time_it_is_scipys_savgol_filter_without_the_ends(window, order, derivative):
    t = np.arange(300) * 0.1
    x = np.sin(0.8 * t) + 0.1 * np.random.default_rng(4).normal(size=300)
    found = savitzky_golay(recording(t, position=x), ["position"], window, order, derivative)
    expected = savgol_filter(x, window, order, deriv=derivative, delta=0.1)[window // 2 : 300 - window // 2]
    column = found["position" + ".rate" * derivative]
    assert column == pytest.approx(expected, abs=1e-7 * np.abs(expected).max())
    assert found.time == pytest.approx(t[window // 2 : 300 - window // 2])


@pytest.mark.parametrize("derivative", [0, 1, 2, 3])
def test_a_polynomial_of_the_filters_order_on_uneven_time_is_met_exactly(derivative):
    t = uneven_time(400, rate=10.0) + 1e4  # a clock that started hours ago
    middle = np.polynomial.Polynomial.fit(t, t, 1, domain=(t[0], t[-1])).domain
    wave = np.polynomial.Chebyshev(np.random.default_rng(5).normal(size=12), domain=middle)
    found = savitzky_golay(recording(t, position=wave(t)), ["position"], derivative=derivative)
    expected = wave.deriv(derivative)(found.time) if derivative else wave(found.time)
    column = found["position" + ".rate" * derivative]
    assert np.abs(column - expected).max() < 1e-8 * 10.0**derivative * np.abs(wave(t)).max()


def test_uneven_samples_treated_as_even_ones_would_be_far_off():
    t = uneven_time(200, rate=10.0)
    found = savitzky_golay(recording(t, position=t**3), ["position"], 21, 3, 1)["position.rate"]
    as_even = savgol_filter(t**3, 21, 3, deriv=1, delta=0.1)[10:-10]
    truth = 3 * t[10:-10] ** 2
    assert np.abs(found - truth).max() < 1e-9 * truth.max() < 1e-3 * np.abs(as_even - truth).max()


def test_quantised_motion_gives_a_speed_ten_times_better_than_differences():
    t = uneven_time(600, rate=10.0)
    x, v = 0.3 * np.sin(0.2 * t), 0.06 * np.cos(0.2 * t)
    seen = recording(t, position=1e-3 * np.round(x / 1e-3), other=x)
    found = savitzky_golay(seen, ["position"], 51, 5, 1)
    differences = np.diff(seen["position"]) / np.diff(t)
    truth = v[25:-25]
    assert np.std(found["position.rate"] - truth) < 0.1 * np.std(differences - (np.diff(x) / np.diff(t)))
    assert np.array_equal(found["other"], x[25:-25]) and len(found) == 550


def test_units_of_higher_derivatives():
    record = Record(np.arange(60) * 0.1, {"speed": np.ones(60)}, {"speed": "m/s"})
    found = savitzky_golay(record, ["speed"], 5, 2, 2)
    assert found.units["speed.rate.rate"] == "m/s3" and found["speed.rate.rate"] == pytest.approx(0.0, abs=1e-10)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"window": 10, "order": 3}, "must be odd and larger than the order"),
        ({"window": 11, "order": 11}, "must be odd and larger than the order"),
        ({"window": 5.5}, "window must be a whole number"),
        ({"window": 5, "order": 2, "derivative": 3}, "is zero. Raise the order"),
    ],
)
def test_windows_that_cannot_be_are_refused(options, sentence):
    with pytest.raises(DeclarationError, match=sentence):
        savitzky_golay(recording(np.arange(100.0), position=np.ones(100)), ["position"], **options)


@pytest.mark.parametrize("option", [{"min_cutoff": 0.0}, {"derivative_cutoff": -1}, {"beta": -1.0}, {"derivative": 2}])
def test_one_euro_options_that_cannot_be_are_refused(option):
    with pytest.raises(DeclarationError, match=next(iter(option))):
        one_euro(recording(np.arange(10.0), position=np.ones(10)), ["position"], **option)


@pytest.mark.parametrize("filtered", [one_euro, savitzky_golay])
def test_columns_that_cannot_be_filtered_are_refused_in_a_sentence(filtered):
    t, x = np.arange(100.0), np.ones(100)
    with pytest.raises(DataError, match="Did you mean 'position'"):
        filtered(recording(t, position=x), ["positon"])
    with pytest.raises(DataError, match="must be a list of columns"):
        filtered(recording(t, position=x), "position")
    with pytest.raises(DataError, match="1 values that are not numbers, the first at 7 s"):
        filtered(recording(t, position=np.where(t == 7, np.nan, x)), ["position"])
    with pytest.raises(DataError, match="no samples from 49 s to 150 s"):
        filtered(recording(np.where(t < 50, t, t + 100), position=x), ["position"])


def test_a_record_shorter_than_the_window_is_refused():
    with pytest.raises(DataError, match=r"got 50 samples\). savitzky_golay needs 51"):
        savitzky_golay(recording(np.arange(50.0), position=np.ones(50)), ["position"])
