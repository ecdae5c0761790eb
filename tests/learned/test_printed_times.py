"""Times are printed with few digits: a block learned from them sees the samples that were measured, as its FMU does."""

from __future__ import annotations

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.export import export_fmu
from hydrotwin.learned.training_data import recorded_period, typed_period
from hydrotwin.records import Record
from hydrotwin.simulation import simulate

RATES = [(300.0, None, 0.0), (300.0, 5, 1000.0), (300.0, 4, 0.0), (300.0, 3, 1000.0), (750.0, 4, 0.0), (44.1, 2, 0.0),
         (7.0, 6, 1000.0)]  # fmt: skip


def recorded(rate: float, digits: int | None, seed: int, *, start: float = 0.0, samples: int = 3000) -> Record:
    """A lag behind held commands, sampled at ``rate`` [Hz]; times printed with so many digits after the point."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.uniform(-1, 1, samples // 20 + 1), 20)[:samples]
    y = np.zeros(samples)
    for k in range(1, samples):
        y[k] = 0.9 * y[k - 1] + 0.1 * u[k - 1]
    time = start + np.arange(samples) / rate
    return Record(
        time if digits is None else np.round(time, digits), {"u": u, "y": y}, {"u": "V", "y": "m"}, f"r{seed}"
    )


def rms(run: Record, record: Record) -> float:
    return float(np.sqrt(np.mean((run["y"] - record["y"]) ** 2)))


@pytest.mark.parametrize(("rate", "digits", "start"), RATES)
def test_a_machine_that_is_learnt_exactly_runs_exactly_over_recordings_of_any_printing(rate, digits, start):
    train = [recorded(rate, digits, 1, start=start), recorded(rate, digits, 2, start=start, samples=2500)]
    block = ht.learn("arx", train, ["u"], ["y"])
    assert abs(block.period - 1 / rate) * len(train[0]) < 0.04 / rate, "no sample early or late at the end"
    assert max(rms(simulate(block, r), r) for r in (*train, recorded(rate, None, 3))) < 1e-12


def test_the_longest_time_tells_the_period_best():
    long, short = recorded(300.0, 5, 1, samples=30_000), recorded(300.0, 5, 2, samples=200)
    assert recorded_period([long, short]) == pytest.approx(1 / 300, rel=1e-8)


@pytest.mark.parametrize(("rate", "digits"), [(300.0, 3), (300.0, None)])
def test_the_fmu_of_such_a_block_sees_the_same_samples(rate, digits, tmp_path):
    train = [recorded(rate, digits, k) for k in (1, 2)]
    block = ht.learn("arx", train, ["u"], ["y"])
    path = export_fmu(block, tmp_path / "block.fmu")
    assert rms(ht.load(str(path)).free_run(train[0]), train[0]) < 1e-9


def test_the_card_says_that_coarsely_printed_times_count_as_even():
    says = [
        ht.learn("arx", [recorded(300.0, digits, k) for k in (1, 2)], ["u"], ["y"]).provenance["free_run"]["says"]
        for digits in (3, 5)
    ]
    assert "Times of r1, r2 are printed with few digits: the samples count as even, one every 0.00333" in says[0]
    assert "printed" not in says[1]


@pytest.mark.parametrize(("typed", "meant"), [(0.00333, 1), (0.0033333, 1), (0.00667, 2), (0.01, 3), (0.0033, None)])
def test_a_period_that_is_written_short_stands_for_samples(typed, meant):
    found = typed_period(typed, [recorded(300.0, None, 1)])
    assert found == pytest.approx(typed if meant is None else meant / 300, rel=1e-12)


@pytest.mark.parametrize("apart", [2e-5, 5e-4])
def test_samples_are_counted_where_two_clocks_do_not_quite_agree(apart):
    slower = recorded(300.0 * (1 - apart), None, 2)
    block = ht.learn("arx", [recorded(300.0, None, 1), slower], ["u"], ["y"])
    assert max(rms(simulate(block, r), r) for r in (slower, recorded(300.0 * (1 + apart / 4), None, 3))) < 1e-12


def test_a_sample_that_is_missing_leaves_the_grid_of_the_others():
    whole = recorded(300.0, 3, 1)
    kept = np.delete(np.arange(len(whole)), 1500)
    lacking = Record(whole.time[kept], {n: whole[n][kept] for n in ("u", "y")}, {"u": "V", "y": "m"}, "lacking")
    assert not lacking.uniform and lacking.period == pytest.approx(1 / 300, rel=1e-5)
    exact = recorded(300.0, None, 1).time[kept]
    assert np.abs(lacking.evenly().time - exact).max() < 1e-3
    assert np.abs(np.diff(lacking.evenly().time - exact)).max() < 1e-8, "but for a constant"
