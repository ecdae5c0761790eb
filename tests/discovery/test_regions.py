"""Region maps against residuals whose place is known, and against noise that has none."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from hydrotwin.discovery.diagnosis.regions import (
    Quantity,
    autocorrelation,
    bin_edges,
    holm,
    local_lines,
    per_second,
    quantities,
    regions,
)
from hydrotwin.identification.problem import Recording
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible

OUTPUTS = (("rod_position", "m"), ("pressure_cap", "Pa"), ("motor_speed", "rad/s"), ("tank_level", "m"))
NOISE = np.array([2e-5, 8e3, 0.5, 1e-4])
POSITION, PRESSURE, SPEED, LEVEL = range(4)
MACHINE = SimpleNamespace(inputs=(Signal("command", "V"),), outputs=tuple(Signal(*o) for o in OUTPUTS))


def motion(seed, samples=3000, period=0.01):
    """Time, command, true outputs of a rod that a motor drives with a lag of 0.3 s; the tank level never moves."""
    random = np.random.default_rng(seed)
    time = period * np.arange(samples)
    waves = zip(random.uniform(0.05, 0.4, 5), random.uniform(0.0, 6.28, 5), strict=True)
    command = sum(np.sin(2 * np.pi * f * time + p) for f, p in waves)
    drive = lfilter([period / 0.3], [1.0, period / 0.3 - 1.0], command)
    position = 0.3 + period * np.cumsum(0.04 * drive)
    pressure = 2.4e6 + 3e6 * position + 2e6 * lfilter([0.01], [1.0, -0.99], random.standard_normal(samples))
    return time, command, np.stack([position, pressure, 120 * drive, np.full(samples, 0.7)], axis=1)


def scene(gap=None, seeds=(0, 1, 2), colour=0.0, **more):
    """Recordings and residuals: noise, and ``gap(time, command, y) -> (n, ny)`` where the model is off."""
    recordings, residuals = [], []
    for seed in seeds:
        time, command, y = motion(seed, **more)
        white = np.random.default_rng(1000 + seed).standard_normal(y.shape)
        e = NOISE * lfilter([np.sqrt(1 - colour**2)], [1.0, -colour], white, axis=0)
        recordings.append(Recording(f"run_{seed}", None, time, command[:, None], y + e))
        residuals.append((0.0 if gap is None else gap(time, command, y)) - e)
    return recordings, residuals


def only(output, values):
    """Residuals (n, ny) with a gap in one output."""
    gap = np.zeros((len(values), len(OUTPUTS)))
    gap[:, output] = values
    return gap


def test_bins_where_the_model_is_off_are_significant_before_and_clean_after():
    recordings, before = scene(lambda t, u, y: only(PRESSURE, 6e4 * (y[:, POSITION] > 0.3)))
    _, after = scene()
    found = regions(MACHINE, recordings, before, after, NOISE)
    assert {r.output for r in found} == {"pressure_cap"}
    over = next(r for r in found if r.over == "rod_position")
    middle = (over.edges[:-1] + over.edges[1:]) / 2
    far, near = middle > 0.31, middle < 0.28
    assert far.any() and near.any()
    assert over.significant_before[far].all() and not over.significant_before[near].any()
    assert over.mean_before[far] == pytest.approx(6e4, rel=0.05)
    assert not over.significant_after.any()
    assert over.over_unit == "m" and over.unit == "Pa"


def test_the_quantity_that_the_residual_follows_comes_first():
    recordings, before = scene(lambda t, u, y: only(SPEED, 4.0 * np.sign(y[:, SPEED])))
    found = regions(MACHINE, recordings, before, before, NOISE)
    assert found[0].over in ("motor_speed", "sign of motor_speed", "velocity of rod_position")
    assert len(found) <= 4 and len({r.over for r in found}) == len(found)


@pytest.mark.parametrize("colour", [0.0, 0.9])
def test_noise_of_any_colour_has_no_significant_bin_in_95_percent_of_40_records(colour):
    louder = 0.95 * NOISE  # a noise estimated 5 % too small asks for maps of everything
    marked = 0
    for seed in range(40):
        recordings, left = scene(seeds=(3 * seed, 3 * seed + 1), colour=colour, samples=1200)
        found = regions(MACHINE, recordings, left, None, louder)
        marked += any(r.significant_before.any() for r in found)
        assert colour or found
    assert marked <= 2


def test_errors_count_neighbours_that_are_alike_only_once():
    errors, means = [], []
    for seed in range(60):
        recordings, left = scene(seeds=(seed,), colour=0.95, samples=2000)
        shifted = [r * [0.0, 2.0, 0.0, 0.0] for r in left]
        row = next(r for r in regions(MACHINE, recordings, shifted, None, NOISE))
        errors.append(np.nanmedian(row.error_before / NOISE[PRESSURE]))
        means.append(np.nanmedian(np.abs(row.mean_before)) / 0.6745 / NOISE[PRESSURE])
    assert 0.6 < np.mean(errors) / np.mean(means) < 1.7
    assert np.mean(errors) > 3 * 2.0 / np.sqrt(2000 / 12)  # what white noise would have


def test_a_quantity_that_never_changes_and_a_sensor_that_only_shows_noise_are_no_place():
    recordings, _ = scene()
    names = {q.name for q in quantities(MACHINE, recordings, NOISE)}
    assert {"command", "rate of command", "rod_position", "velocity of rod_position", "time"} <= names
    assert not any("tank_level" in n for n in names)


def test_pressures_are_compared_with_each_other():
    machine = SimpleNamespace(inputs=(), outputs=(Signal("p_a", "Pa"), Signal("p_b", "Pa")))
    time = np.arange(0.0, 10.0, 0.01)
    y = 1e6 + 1e5 * np.stack([np.sin(time), np.cos(time)], axis=1)
    found = {q.name: q for q in quantities(machine, [Recording("r", None, time, np.empty((1000, 0)), y)], np.ones(2))}
    difference = found["p_a - p_b"].values[0]
    assert difference[5:-5] == pytest.approx((y[:, 0] - y[:, 1])[5:-5], abs=10.0)


def test_a_velocity_is_that_of_the_motion_on_any_time_axis_with_gaps():
    time = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.015, 500))
    y = 3.0 + 0.7 * time
    y[100:130] = np.nan
    slope, gain = local_lines(time, y, 4, slope=True)
    level, _ = local_lines(time, y, 4, slope=False)
    known = np.isfinite(slope)
    assert known.sum() > 470
    assert slope[known] == pytest.approx(0.7, rel=1e-9)
    assert level[known] == pytest.approx(3.0 + 0.7 * time[known])
    assert gain == pytest.approx(1 / (0.01 * np.sqrt(60)), rel=0.2)


def test_the_noise_of_a_sample_is_no_part_of_the_place_it_is_put_at():
    time, y = np.arange(101) * 0.01, np.zeros(101)
    y[50] = 1.0
    for slope in (False, True):
        assert local_lines(time, y, 3, slope)[0][50] == pytest.approx(0.0, abs=1e-12)


def test_bins_have_an_edge_at_zero_and_direction_has_three():
    speed = Quantity("v", "m/s", "velocity", "v", (np.linspace(-0.3, 1.0, 500),))
    edges = bin_edges(speed)
    assert len(edges) == 13 and 0.0 in edges and (np.diff(edges) > 0).all()
    resting = Quantity("v", "m/s", "velocity", "v", (np.r_[np.zeros(900), np.linspace(-1, 1, 100)],))
    assert (np.diff(bin_edges(resting)) > 0).all()
    assert len(bin_edges(Quantity("d", "1", "direction", "v", (np.array([-1.0, 1.0]),)))) == 4


def test_the_unit_of_a_rate_is_a_unit():
    for unit, rate in (("m", "m/s"), ("rad/s", "rad/s2"), ("1", "1/s"), ("m3/s", "m3/s2"), ("m3/(s.Pa)", "m3/(s2.Pa)")):
        assert compatible(per_second(unit), rate)


def test_a_place_that_the_gap_itself_moves_counts_less():
    recordings, left = scene(lambda t, u, y: only(PRESSURE, 0.5 * np.std(y[:, PRESSURE]) * np.sign(y[:, SPEED])))
    weights = {q.name: q.weight for q in quantities(MACHINE, recordings, NOISE, left)}
    assert weights["pressure_cap"] < 0.5 < 0.9 < weights["motor_speed"]


def test_holm_takes_the_small_p_values_until_one_is_too_large():
    answer = holm(np.array([0.04, 0.001, 0.012, 0.3]), 0.05)
    assert answer.tolist() == [False, True, True, False]


def test_autocorrelation_bridges_missing_samples():
    series = lfilter([1.0], [1.0, -0.9], np.random.default_rng(0).standard_normal(20_000))
    series[::7] = np.nan
    rho = autocorrelation([series[:9000], series[9000:]])
    assert rho[:6] == pytest.approx(0.9 ** np.arange(6), abs=0.03)


def test_a_run_that_diverged_and_a_recording_of_three_samples_do_no_harm():
    recordings, before = scene(lambda t, u, y: only(PRESSURE, 6e4 * np.sign(u)))
    before[0][:] = np.inf
    short = Recording("short", None, np.arange(3.0), np.zeros((3, 1)), np.ones((3, 4)))
    found = regions(MACHINE, [*recordings, short], [*before, np.zeros((3, 4))], None, NOISE)
    assert any(r.significant_before.any() for r in found)


def test_without_a_gap_there_is_no_map():
    recordings, left = scene()
    assert regions(MACHINE, recordings, [0.5 * r for r in left], None, NOISE) == ()
