"""Bands of an identified model: they cover what sensors read, agree with draws, and say where not to trust them."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.comparison import compare
from hydrotwin.identification import Spread, deviations, identify
from hydrotwin.identification.beginning import StartEstimate, StartState, estimate_start
from hydrotwin.models import cehA
from hydrotwin.models.effects import add_effect
from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.provenance import SINCE, SPREAD, made_from
from hydrotwin.simulation import simulate, simulate_many
from tests.identification.drive import drive, recorded

NOISE = {"position": 2e-3, "motor_speed": 0.05}
FREE = ("motor.gain", "motor.time_constant", "pump.displacement")


@pytest.fixture(scope="module")
def fit():
    return identify(drive(), [recorded(drive(), 1, noise=NOISE)], free=list(FREE))


def test_bands_cover_95_percent_of_what_sensors_read_on_other_recordings(fit):
    spread = Spread.of(fit)
    assert spread.explained == {"position", "motor_speed"}
    inside = {name: [] for name in NOISE}
    for seed in range(2, 42):
        record = recorded(drive(), seed, noise=NOISE)
        run, sd = simulate(fit.flat, record), deviations(fit.flat, record, spread)
        for name in NOISE:
            inside[name].append(np.abs(record[name] - run[name]) < 1.96 * sd[name])
    for name in NOISE:
        assert 0.92 < np.mean(inside[name]) < 0.98, name


def test_the_parameters_share_is_that_of_a_thousand_draws(fit):
    """By simulate_many, the start states given: no sensitivities take part."""
    spread = dataclasses.replace(Spread.of(fit), noise={}, left=dict.fromkeys(NOISE, 0.0))
    spread = dataclasses.replace(spread, covariance=100 * spread.covariance)  # large enough to be seen beside rounding
    record = recorded(drive(), 3)
    sd = deviations(fit.flat, record, spread)
    middle = np.array([fit.values[n] for n in spread.names])
    draws = np.random.default_rng(0).multivariate_normal(middle, spread.covariance, 1000)
    many = simulate_many(fit.flat, [dict(zip(spread.names, d, strict=True)) for d in draws], record)
    for name in NOISE:
        drawn = many[name].std(axis=0)
        assert sd[name][50:] == pytest.approx(drawn[50:], rel=0.1, abs=1e-3 * drawn.max()), name


def test_noise_in_the_first_sample_goes_through_the_run(fit):
    spread = Spread.of(fit)
    sharp = dataclasses.replace(spread, noise=dict.fromkeys(NOISE, 0.0))
    record = recorded(drive(), 3)
    with_noise, without = (deviations(fit.flat, record, s)["position"] for s in (spread, sharp))
    assert with_noise[0] == pytest.approx(np.hypot(without[0], NOISE["position"]), rel=0.05)
    assert (with_noise[-1] > 1.2 * without[-1]) and np.all(with_noise >= without)
    given = deviations(fit.flat, record, spread, {"piston.position": 0.0, "motor.speed": 0.0})["position"]
    assert given == pytest.approx(without, rel=1e-9)


def test_an_output_of_which_more_than_noise_is_left_is_not_trusted_and_its_band_is_as_wide():
    record = recorded(drive(), 1, noise=NOISE)
    wave = 0.05 * np.sin(3.0 * record.time)
    record = record.with_signals({"position": record["position"] + wave})
    found = identify(drive(), [record], free=list(FREE))
    spread = Spread.of(found)
    assert "position" not in spread.explained
    assert spread.left["position"] > 10 * NOISE["position"]
    assert deviations(found.flat, record, spread)["position"].min() >= spread.left["position"]


def test_it_goes_into_a_file_and_back(fit):
    spread = Spread.of(fit)
    again = Spread.from_told(spread.told())
    assert (again.names, again.noise, again.left, again.explained) == (
        spread.names, spread.noise, spread.left, spread.explained
    )  # fmt: skip
    assert np.array_equal(again.covariance, spread.covariance)
    for told in ({}, {**spread.told(), "covariance": [1.0]}, {**spread.told(), "noise": 3}):
        with pytest.raises(DataError, match="garbled"):
            Spread.from_told(told)


def test_an_estimated_start_is_as_unsure_as_its_draws(fit):
    """Two states that are unsure together, one of them measured; by runs from drawn starts."""
    spread = dataclasses.replace(Spread.of(fit), left=dict.fromkeys(NOISE, 0.0))
    spread = dataclasses.replace(spread, covariance=0.0 * spread.covariance)
    record = recorded(drive(), 3, noise=NOISE)
    sizes, both = np.array([4e-3, 3.0]), np.array([[1.0, -0.8], [-0.8, 1.0]])
    names = ("piston.position", "motor.speed")
    for order in (names, names[::-1]):
        at = [names.index(n) for n in order]
        covariance = (both * np.outer(sizes, sizes))[np.ix_(at, at)]
        states = tuple(StartState(n, 0.1, float(sizes[names.index(n)]), 0.0, "1") for n in order)
        told = StartEstimate(record.name, states, covariance=tuple(map(tuple, covariance.tolist())))
        sd = deviations(fit.flat, record, spread, None, told)["position"]
        draws = np.random.default_rng(0).multivariate_normal([0.1, 0.1], covariance, 400)
        runs = [simulate(fit.flat, record, start=dict(zip(order, d, strict=True)))["position"] for d in draws]
        assert sd == pytest.approx(np.std(runs, axis=0), rel=0.12)


def test_the_start_that_is_estimated_is_off_by_what_it_says(fit):
    """Over many recordings that start at rest: the spread of the estimates is that of their covariance."""
    found = [estimate_start(fit.flat, recorded(drive(), k, noise=NOISE), "free") for k in range(2, 42)]
    values = np.array([[s.value for s in one.states] for one in found])
    told = np.mean([one.covariance for one in found], axis=0)
    assert np.sqrt(np.diag(told)) == pytest.approx([s.sigma for s in found[0].states], rel=0.3)
    assert np.std(values, axis=0) == pytest.approx(np.sqrt(np.diag(told)), rel=0.35)
    assert np.corrcoef(values.T)[0, 1] == pytest.approx(told[0, 1] / np.sqrt(told[0, 0] * told[1, 1]), abs=0.3)


def test_the_flat_model_of_a_fit_knows_where_it_comes_from_until_a_value_is_another(fit):
    """Compared from Python, it had neither bands nor a caution on the recordings that it was fitted to."""
    train = dataclasses.replace(recorded(drive(), 1, noise=NOISE), digest="a" * 64)
    fitted = identify(drive(), [train], free=["motor.gain"]).flat
    (one,) = compare([fitted], [train], modes=["free run"]).entrants
    assert made_from(one.provenance) == {"a" * 64} and {b.output for b in one.bands} == set(NOISE)
    assert fitted.with_parameters({"motor.gain": 2.0}).provenance == {SINCE: ["motor.gain set"]}


def test_a_model_of_which_something_is_another_still_follows_its_recordings_and_has_no_band():
    """One value set in a scenario, and its criteria no longer said that they were judged on what it was fitted to; one
    effect taken out, and the band was that of the fit with it."""
    train = dataclasses.replace(recorded(drive(), 1, noise=NOISE), digest="a" * 64)
    fitted = identify(drive(), [train], free=["motor.*"]).flat
    (one,) = compare([fitted.with_parameters({"motor.gain": 9.0})], [train], modes=["free run"]).entrants
    assert made_from(one.provenance) == {"a" * 64} and not one.bands
    set_, kept = (next(p for p in one.parameters if p.name == f"motor.{n}") for n in ("gain", "time_constant"))
    assert (set_.sigma, set_.source) == (None, "") and kept.sigma and kept.source.startswith("identified")
    model = cehA.model()
    settings = {name: {"value": 110.0, "source": "identified"} for name in ("motor.gain",)}
    known = model.with_settings(settings, fitted.provenance)
    fitted_model = model.with_settings({"motor.gain": {"value": 110.0, "sigma": 1.0, "source": "identified"}})
    leaking = add_effect(known, "internal_leakage", values={"conductance": 1e-12})
    again = leaking.with_settings({}, fitted.provenance)
    changed = (
        leaking,
        again.without(again.additions),
        known.with_parameters({"arm.extra_mass": 41.0}),
        known.but(name="x"),
    )
    assert [SPREAD in m.provenance for m in changed] == [False, False, False, True]
    typed = fitted_model.with_parameters({"motor.gain": 90.0}).flat
    assert (typed.parameters[typed.index_of("motor.gain")].sigma, typed.provenance) == (None, {})
    assert all(made_from(m.provenance) == {"a" * 64} for m in changed)
