"""The slope of an output, taken alike from measurement and model."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.comparison import compare
from hydrotwin.comparison.rates import rate_signal, with_rates
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from tests.comparison.toys import ANGLE, Toy, recording


def test_the_rate_of_a_straight_line_is_its_slope_also_at_the_ends_and_on_any_time_axis():
    time = np.sort(np.random.default_rng(1).uniform(0.0, 2.0, 150))
    record = with_rates(Record(time, {"arm_angle": 3.0 * time + 1.0}, {"arm_angle": "rad"}), [ANGLE])
    assert record["arm_angle.rate"] == pytest.approx(3.0)
    assert record.units["arm_angle.rate"] == "rad/s"


@pytest.mark.parametrize(("unit", "rate"), [("m", "m/s"), ("rad/s", "rad/s2"), ("Pa", "Pa/s"), ("1", "1/s")])
def test_a_rate_has_the_unit_per_second(unit, rate):
    assert rate_signal(Signal("x", unit)).unit == rate


def test_rates_are_scored_in_free_run_beside_the_outputs():
    comparison = compare([Toy("true"), Toy("wrong", gain=140.0)], [recording(1)], rates=["arm_angle"], repeats=1)
    assert {s.mode for s in comparison.scores if s.output == "arm_angle.rate"} == {"free run"}
    best, second = comparison.ranking("arm_angle.rate")
    assert (best.model, second.model) == ("true", "wrong")
    assert best.rmse == pytest.approx(np.sqrt(2) / 0.05 * 2e-4, rel=0.3)
    assert comparison.unscored == ()


def test_the_rate_of_an_output_nobody_has_is_refused():
    with pytest.raises(DeclarationError, match="Did you mean 'arm_angle'"):
        compare([Toy("true")], [recording(1)], rates=["arm_angel"])


def test_a_slow_sensor_has_its_slope_at_its_own_samples_and_none_across_a_gap():
    """It was told as a column without a sample, to be repaired."""
    record = recording(1)
    slow, holed = record["arm_angle"].copy(), record["arm_angle"].copy()
    slow[np.arange(len(slow)) % 8 > 0] = holed[300:400] = np.nan
    for values, fewest in ((slow, 95), (holed, 680)):
        one = record.with_signals({"arm_angle": values})
        found = compare([Toy("true")], [one], rates=["arm_angle"], modes=["free run"], repeats=1)
        (score,) = (s for s in found.scores if s.output == "arm_angle.rate")
        assert not found.failures and fewest <= score.samples <= np.isfinite(values).sum()
        assert score.rmse < 2 * np.sqrt(2) / 0.05 * 2e-4


@pytest.mark.parametrize("slower", [0.1, 0.2])
def test_a_clock_that_turns_slower_has_its_slope_there_too(slower):
    """By the median of all steps everything behind the turn lay in gaps: only what is fast was judged."""
    time = np.concatenate([np.arange(0.0, 20.0, 0.01), np.arange(20.0, 60.0, slower)])
    found = with_rates(Record(time, {"y": 3.0 * time}, {"y": "m"}, "r"), [Signal("y", "m")])
    known = np.isfinite(found["y.rate"])
    assert found["y.rate"][known] == pytest.approx(3.0) and known.sum() >= len(time) - 2 and known[2000:].all()
