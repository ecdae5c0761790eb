"""The dual Gaussian process: current to spool, spool to rate, each process told apart and both as one block."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.interpolate import BSpline

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import read_block, write_block
from hydrotwin.learned.bands import band_of
from hydrotwin.learned.block_file import LearnedBlock, assemble
from hydrotwin.learned.gaussian.compression import spline_coefficients, spline_knots
from hydrotwin.learned.gaussian.delay_lines import certification_grid, delayed_rows, input_scales, training_rows
from hydrotwin.learned.gaussian.dual import certify, learn_dual_gp
from hydrotwin.learned.gaussian.dual_block import DUAL_GAUSSIAN_PROCESS, dual_frame, spline
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import Record
from hydrotwin.simulation import predict_one_step, simulate
from tests.learned.test_gaussian_equations import in_numpy, random_gaussian_process
from tests.learned.test_gaussian_process import CURRENT, NOISE, PERIOD, POSITION, SPOOL, valve_record

QUICK = {"points": 200}


def random_dual_gp(lead: int = 1) -> LearnedBlock:
    """A dual process with random arrays: it predicts nothing, but it is a complete block."""
    rng, single = np.random.default_rng(5), random_gaussian_process()
    structure = {
        "kernel": 0,
        "lags": 3,
        "lead": lead,
        "points": 8,
        "sd_points": 6,
        "rank": 4,
        "knots": 9,
        "sd_knots": 12,
        "directions": 2,
        "rate_directions": 1,
    }
    own = {"rate_mean": rng.normal(size=9), "rate_sd": 0.1 + rng.uniform(size=12)}
    own |= {"directions": rng.normal(size=(1, 6, 2)), "rate_directions": rng.normal(size=(1, 9))}
    own |= {"run_noise": np.array([0.2]), "rate_noise": np.array(0.3), "inside": np.array([0.01])}
    own |= {"run_scale": np.array([1.5, 0.8]), "step_scale": np.array([1.0, 1.2])}
    own |= {
        "spool_range": np.array([-2.0, 2.5]),
        "spool_range_of_sd": np.array([-6.5, 7.0]),
        "period": np.array(PERIOD),
    }
    told = {"period": PERIOD, "domain": single.domain, "provenance": {"kind": "dual_gaussian_process"}}
    frame = dual_frame((CURRENT,), SPOOL, POSITION, 3, lead, 3)
    return assemble(DUAL_GAUSSIAN_PROCESS, {**single.arrays, **own}, structure, name="random dual", **frame, **told)


def in_scipy(coefficients, bounds, x):
    """Value and slope of a spline that is constant outside its bounds, from SciPy."""
    curve = BSpline(spline_knots(*bounds, len(coefficients)), coefficients, 3)
    at = np.clip(x, *bounds)
    return float(curve(at)), float(curve.derivative()(at))


SEED = 1  # with the recordings below no curve of the input takes out a drift behind the processes


@pytest.fixture(scope="module")
def recordings():
    """Unevenly sampled, the position to a millimetre."""
    return [valve_record(s, jitter=0.2) for s in (1, 3)]


@pytest.fixture(scope="module")
def validation():
    return valve_record(9, duration=30.0)


@pytest.fixture(scope="module")
def dual(recordings, validation):
    pytest.importorskip("gpytorch")
    block = learn_dual_gp(recordings, [CURRENT], [POSITION], through=SPOOL, validate=[validation], seed=SEED, **QUICK)
    assert "drift" not in block.provenance, "the tests look at the processes alone"
    return block


@pytest.mark.parametrize("x", [-3.0, -2.0, -0.77, 0.0, 0.5, 2.49, 2.5, 4.0])
def test_the_spline_is_scipys(x):
    coefficients, bounds = np.random.default_rng(0).normal(size=9), (-2.0, 2.5)
    found = [float(v) for v in spline(coefficients, np.array(bounds), x)]
    assert found == pytest.approx(in_scipy(coefficients, bounds, x), rel=1e-12, abs=1e-12)


def test_a_spline_of_sixty_knots_repeats_a_smooth_curve_to_a_millionth():
    c = spline_coefficients(np.tanh, -4.0, 4.0, 60)
    x = np.linspace(-4, 4, 777)
    assert max(abs(float(spline(c, np.array([-4.0, 4.0]), v)[0]) - np.tanh(v)) for v in x) < 2e-5


@pytest.mark.parametrize("lead", [0, 1])
def test_the_cascade_is_the_written_equation(lead):
    block, rng = random_dual_gp(lead), np.random.default_rng(2)
    for _ in range(10):
        line, y, q, old = rng.normal(size=3), rng.normal(), rng.normal(size=4), rng.normal(size=2)
        a = block.arrays
        s, s_sd, k_sd = in_numpy(block, line)
        v, slope = in_scipy(block.arrays["rate_mean"], (-2.0, 2.5), s)
        v_sd = np.hypot(in_scipy(block.arrays["rate_sd"], (-6.5, 7.0), s)[0], slope * s_sd)
        second = in_scipy(a["rate_directions"][0], (-2.0, 2.5), s)[0]
        effects = [*(slope * k_sd @ a["directions"][0]), second, np.sqrt(max(v_sd**2 - 0.01, 0))]
        x = [y, y, 0.0, *q, *(old if lead else ()), *line[1:]]
        after, seen = (part.full().ravel() for part in block.step(x, line[0], []))
        y_next = y + PERIOD * v
        held_on = q + PERIOD * np.array(effects)
        assert np.allclose(after, [y_next, y_next, 0, *held_on, *((s, s_sd) if lead else ()), *line[:2]])
        told, latent = old if lead else (s, s_sd)
        y_sd = 0.8 * np.sqrt(q @ q + 0.04)
        assert np.allclose(seen, [told, 1.5 * np.hypot(latent, a["noise"][0]), y, y_sd, v, np.hypot(v_sd, 0.3)])


def test_the_start_needs_the_measured_position_alone_and_finds_the_spool_at_rest():
    block = random_dual_gp(1)
    found = block.start(0.4, [np.nan, np.nan, 0.7, np.nan, np.nan, np.nan], []).full().ravel()
    assert np.allclose(found, [0.7, 0.7, *[0.0] * 5, *in_numpy(block, np.full(3, 0.4))[:2], 0.4, 0.4])


def test_the_spool_at_the_end_of_the_interval_explains_the_rate_of_a_valve_faster_than_the_sampling(dual, recordings):
    assert dual.provenance["lead"] == 1
    paper = learn_dual_gp(recordings, ["current"], ["position"], fit="paper", **QUICK)
    assert paper.provenance["lead"] == 0 and paper.provenance["processes"][0]["iterations"] == 100
    on_measured = [b.provenance["errors"]["training"]["slope_on_measured_spool"] for b in (dual, paper)]
    assert on_measured[0] < 0.7 * on_measured[1]


def test_the_errors_of_each_process_and_of_the_cascade_are_told_apart(dual, validation):
    rows = delayed_rows(validation, PERIOD, [CURRENT], [SPOOL, POSITION], 5)
    held = len(dual.states) - 4
    x = np.hstack([np.zeros((len(rows), held)), rows.features[:, 1:]])
    after, seen = dual.step.map(len(rows))(x.T, rows.features[:, :1].T, np.zeros((0, len(rows))))
    spool, slope = after.full()[held - 2], seen.full()[4]
    alone = [in_scipy(dual.arrays["rate_mean"], dual.arrays["spool_range"], s)[0] for s in rows.ahead[:, 0]]
    expected = {
        "spool": spool - rows.ahead[:, 0],
        "slope_on_measured_spool": alone - rows.slopes[:, 1],
        "slope_in_cascade": slope - rows.slopes[:, 1],
    }
    told = dual.provenance["errors"]["validation"]
    assert told == pytest.approx({key: np.sqrt(np.mean(e**2)) for key, e in expected.items()}, rel=1e-9)
    assert told["slope_in_cascade"] > told["slope_on_measured_spool"] > 0 and told["spool"] > NOISE


def test_the_certificate_is_of_the_whole_cascade_and_catches_a_changed_spline(dual, recordings):
    pytest.importorskip("gpytorch")
    from hydrotwin.learned.gaussian import exact as exact_gp
    from hydrotwin.learned.gaussian.training import train_process

    rng, both = np.random.default_rng(SEED), (SPOOL, POSITION)
    rows = training_rows(recordings, PERIOD, [CURRENT], both, 5, 6000, rng)
    grid = certification_grid([rows], 1, 5, rng)
    features, spool, slopes = rows.features, rows.ahead[:, :1], rows.slopes
    shared = {"fit": "default", "progress": None, "rng": rng, "compress": "auto", "bound": 0.01, **QUICK}
    names = {"kernel": "rbf", "label": "spool"}, {"kernel": "matern32", "label": "slope"}
    one = train_process(exact_gp, features, spool[:, 0], input_scales(features, 1), grid, **names[0], **shared)
    places = np.linspace(spool.min(), spool.max(), 501)[:, None]
    two = train_process(exact_gp, spool, slopes[:, 1], input_scales(spool, 1), places, **names[1], **shared)
    deviation, certificate = certify(dual, one, two, grid, 0.02)
    assert dual.certificate.holds and certificate.holds
    assert deviation == pytest.approx(dual.provenance["deviation"], rel=1e-6)
    assert all(0 <= v < 0.02 for v in deviation.values()) and deviation["slope_in_cascade_mean"] > 0
    bent = dual.arrays["rate_mean"] * np.where(np.arange(60) == 30, 1.5, 1.0) + 0.05 * (np.arange(60) == 30)
    frame = {f.name: getattr(dual, f.name) for f in dataclasses.fields(dual)}
    frame = {k: v for k, v in frame.items() if k not in ("arrays", "structure", "kind", "step", "start")}
    changed = assemble(DUAL_GAUSSIAN_PROCESS, {**dual.arrays, "rate_mean": bent}, dual.structure, **frame)
    assert not certify(changed, one, two, grid, 0.02)[1].holds


def test_the_position_follows_an_unseen_recording_without_its_spool_sensor(dual, validation):
    record = validation.select(["current", "position"])
    run = simulate(dual, record)
    error = np.sqrt(np.mean((run["position"] - record["position"]) ** 2))
    assert error < 0.15 * np.std(record["position"])
    assert error == pytest.approx(dual.provenance["validation"]["position"], rel=1e-9)
    assert np.sqrt(np.mean((run["spool"] - validation["spool"]) ** 2)) < 0.15 * np.std(validation["spool"])
    assert np.all(np.abs(run["position"] - record["position"]) < 0.06)
    assert band_of(dual, [record])["position"]["free_run"]["coverage"] >= 0.9
    assert band_of(dual, [record])["position"]["free_run"]["half_width"] < 0.1 * np.ptp(record["position"])


def test_one_step_ahead_the_error_is_near_the_resolution_of_the_sensor(dual, validation):
    ahead = predict_one_step(dual, validation)["position"] - validation["position"]
    assert np.sqrt(np.mean(ahead**2)) < 2e-3


def test_the_spool_is_known_less_well_away_from_the_data_and_the_rate_with_it(dual):
    n = len(dual.states)
    edge, beyond = (dual.step(np.full(n, level), level, [])[1].full().ravel() for level in (0.9, 1.3))
    at_edge, further = (dual.step(np.full(n, level), level, [])[0].full().ravel() for level in (0.9, 1.3))
    assert further[n - 5] > 10 * at_edge[n - 5] and beyond[5] > edge[5]
    assert {"current", "spool", "position"} == set(dual.domain.names)


def test_the_fmu_of_a_dual_process_equals_its_run(recordings, validation, tmp_path):
    pytest.importorskip("gpytorch")
    small = {"lags": 2, "compress": 5, "points": 50, "knots": 8}
    block = learn_dual_gp(recordings[:1], ["current"], ["position"], **small)
    record = validation.window(0, 10)
    found, expected = read_fmu(export_fmu(block, tmp_path / "dual.fmu")).free_run(record), simulate(block, record)
    for name in (s.name for s in block.outputs):
        assert np.abs(found[name] - expected[name]).max() <= 1e-12 * np.ptp(expected[name]), name
    assert np.ptp(expected["position"]) > 0.05


def test_a_dual_process_comes_back_from_its_file(dual, validation, tmp_path):
    again = read_block(write_block(dual, tmp_path / "dual.toml")[0])
    assert np.array_equal(simulate(again, validation)["position"], simulate(dual, validation)["position"])
    assert again.certificate == dual.certificate and again.provenance["errors"] == dual.provenance["errors"]


@pytest.mark.parametrize(
    ("change", "error", "sentence"),
    [
        ({"outputs": ["position", "spool"]}, DataError, "one output that integrates"),
        ({"through": "spol"}, DataError, "Did you mean 'spool'"),
        ({"through": "current"}, DataError, "named twice"),
        ({"lead": 2}, DeclarationError, "lead must be"),
        ({"knots": 4}, DeclarationError, "knots must be"),
        ({"kernel": ("rbf", "rbf", "rbf")}, DeclarationError, "one for each process"),
        ({"kernel": "matern52"}, DeclarationError, "no kernel 'matern52'"),
        ({"records": []}, DataError, "no recordings"),
    ],
)
def test_what_cannot_be_learnt_from_is_refused_in_a_sentence(recordings, change, error, sentence):
    pytest.importorskip("gpytorch")
    asked = {"records": recordings[:1], "inputs": ["current"], "outputs": ["position"], **QUICK} | change
    with pytest.raises(error, match=sentence):
        learn_dual_gp(asked.pop("records"), asked.pop("inputs"), asked.pop("outputs"), **asked)


def test_a_spool_that_never_moves_is_refused(recordings):
    pytest.importorskip("gpytorch")
    stuck = Record(recordings[0].time, {**recordings[0].signals, "spool": np.zeros(601)}, recordings[0].units)
    with pytest.raises(DataError, match="'spool' never changes"):
        learn_dual_gp([stuck], ["current"], ["position"], **QUICK)
