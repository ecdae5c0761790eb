"""The Gaussian process: its equations in CasADi, its training with GPyTorch, and what it says away from the data."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import domain_share, read_block, write_block
from hydrotwin.learned.bands import band_of
from hydrotwin.learned.block_file import LearnedBlock
from hydrotwin.learned.gaussian.delay_lines import delayed_rows, even_period, input_scales, normalised
from hydrotwin.learned.gaussian.single import learn_gaussian_process
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests import rig

PERIOD, NOISE, STEP = 0.1, 2e-3, 1e-3
CURRENT, FLOW = Signal("current", "1", "solenoid current"), Signal("pump_flow", "m3/s", interpolation="linear")
SPOOL, POSITION = Signal("spool", "1", "spool position"), Signal("position", "m", "piston position")
UNITS = {"current": "1", "position": "m", "spool": "1"}
HIDDEN = [("command_deadband", {"width": 0.1}), ("dead_time", {"seconds": 0.12})]
QUICK = {"period": PERIOD, "points": 200}


def valve_record(seed: int, duration: float = 60.0, jitter: float = 0.0, shape: str = "steps") -> Record:
    """The valve sampled at 10 Hz, its position to 1 mm; a deadband of 0.1 and a dead time of 0.12 s are hidden."""
    time = rig.commands.jittered_time(duration, 1 / PERIOD, jitter, seed=seed)
    make = getattr(rig.commands, shape)
    current = make(time, 1.0, seed=seed, hold=(0.4, 2.0), speed=(0.104, 0.099), room=(-0.25, 0.25))
    found = rig.record(
        "spool_valve", current, time, noise={"spool": NOISE}, quantisation={"position": STEP}, seed=seed, effects=HIDDEN
    )
    return Record(time, {n: found[n] for n in UNITS}, UNITS, f"valve_{seed}", digest=f"{seed:064x}")


def at_lines(block: LearnedBlock, features: np.ndarray) -> np.ndarray:
    """Outputs (n, ny) of one step from delay lines (n, lags nu) of a block that holds nothing but its line."""
    nu, n = len(block.inputs), len(features)
    return block.step.map(n)(features[:, nu:].T, features[:, :nu].T, np.zeros((0, n)))[1].full().T


@pytest.fixture(scope="module")
def recordings():
    return [valve_record(s) for s in (1, 2)]


@pytest.fixture(scope="module")
def validation():
    return valve_record(9, duration=30.0)


@pytest.fixture(scope="module")
def spool_block(recordings, validation):
    pytest.importorskip("gpytorch")
    return learn_gaussian_process(recordings, ["current"], ["spool"], validate=[validation], **QUICK)


@pytest.fixture(scope="module")
def position_block():
    """From unevenly sampled recordings, the slopes of the position as they come."""
    pytest.importorskip("gpytorch")
    uneven = [valve_record(s, jitter=0.2) for s in (1, 2)]
    return learn_gaussian_process(uneven, [CURRENT], [POSITION], rate=True, points=200)


def test_rows_hold_past_inputs_and_raw_slopes_and_do_not_reach_over_a_pause():
    time = PERIOD * np.arange(20)
    time[10:] += 0.5
    record = Record(
        time, {"current": np.arange(20.0), "position": np.arange(20.0) ** 2}, {"current": "1", "position": "m"}
    )
    rows = delayed_rows(record, PERIOD, [CURRENT], [POSITION], lags=3)
    newest = rows.features[:, 0].astype(int)
    assert np.array_equal(newest, [*range(2, 9), *range(12, 19)])
    assert np.array_equal(rows.features, newest[:, None] - [0.0, 1.0, 2.0])
    assert np.allclose(rows.slopes[:, 0], (2 * newest + 1) / PERIOD)
    assert np.array_equal(rows.levels[:, 0], newest**2) and np.array_equal(rows.ahead[:, 0], (newest + 1) ** 2)


def test_uneven_recordings_keep_their_own_period_rounded():
    assert even_period([valve_record(1, 20.0, jitter=0.2)]) == PERIOD


def test_the_deployed_process_is_gpytorchs_own_prediction_within_the_certified_bound(
    recordings, validation, spool_block
):
    pytest.importorskip("gpytorch")
    from hydrotwin.learned.gaussian import exact as exact_gp

    parts = [delayed_rows(r, PERIOD, [CURRENT], [SPOOL], 5) for r in (*recordings, validation)]
    X, y = (np.concatenate([getattr(p, key) for p in parts[:2]]) for key in ("features", "levels"))
    scales, rng = input_scales(X, 1), np.random.default_rng(0)
    rng.permutation(len(X))  # the rows of the certificate are drawn first
    centre, scale = y.mean(), y.std()
    own = exact_gp.train(
        normalised(X, scales), (y[:, 0] - centre) / scale, kernel="rbf", fit="default", points=200,
        rng=rng,
    )  # fmt: skip
    mean, sd = own.predict(normalised(parts[2].features, scales))
    deployed = at_lines(spool_block, parts[2].features)
    certificate = spool_block.certificate
    assert certificate.holds and certificate.tolerance == 0.02 and certificate.points > 500
    assert np.abs(deployed[:, 0] - (centre + scale * mean)).max() <= certificate.difference * scale
    latent = np.sqrt((deployed[:, 1] / spool_block.arrays["run_scale"]) ** 2 - spool_block.arrays["noise"] ** 2)
    off, above, below = (latent - scale * sd) / scale, *list(spool_block.provenance["deviation"].values())[1:]
    assert -2 * below <= off.min() and off.max() <= 2 * above < 0.02, "of rows that the certificate did not see"
    assert f"{above:.1e} too large" in certificate.reference
    assert np.std(deployed[:, 0]) > 0.3 and np.std(deployed[:, 1]) > 0


def test_the_exact_mean_is_that_of_the_textbook(recordings):
    pytest.importorskip("gpytorch")
    block = learn_gaussian_process(
        recordings[:1], ["current"], ["spool"], kernel="matern32", **QUICK | {"compress": None}
    )
    rows, told = delayed_rows(recordings[0], PERIOD, [CURRENT], [SPOOL], 5), block.provenance["processes"][0]
    scaled = normalised(rows.features, input_scales(rows.features, 1)) / told["lengths"]
    r = np.sqrt(3) * np.linalg.norm(scaled[:, None] - scaled[None], axis=2)
    K = told["prior_sd"] ** 2 * (1 + r) * np.exp(-r)
    weights = np.linalg.solve(K + told["noise_sd"] ** 2 * np.eye(len(K)), rows.levels[:, 0] - told["average"])
    assert np.abs(at_lines(block, rows.features)[:, 0] - (told["average"] + K @ weights)).max() < 1e-8
    assert block.arrays["points"].shape[1] == len(rows) and block.provenance["deviation"]["mean"] < 1e-8


def test_the_shortest_length_scales_stand_at_the_dead_time(spool_block):
    lengths = np.array(spool_block.provenance["processes"][0]["lengths"])
    assert lengths[0] > 20 * lengths[1:3].min()  # 0.12 s: the current of this very sample says nothing
    assert lengths[4] > 20 * lengths[1:3].min()


def test_the_spool_of_an_unseen_recording_is_within_the_band_of_95_in_100_samples(spool_block, validation):
    found = band_of(spool_block, [validation])["spool"]
    assert 0.90 <= found["free_run"]["coverage"] <= 0.99 and found["trustworthy"]
    assert 0.90 <= found["one_step"]["coverage"] <= 0.99
    run = simulate(spool_block, validation).window(0.4, None)
    assert np.allclose(found["free_run"]["half_width"], 1.96 * np.median(run["spool.sd"]), rtol=1e-3)
    assert spool_block.provenance["validation"]["spool"] < 0.15 * np.std(validation["spool"])


def test_the_position_follows_an_unseen_recording_for_half_a_minute(position_block, validation):
    run = simulate(position_block, validation)
    error = np.sqrt(np.mean((run["position"] - validation["position"]) ** 2))
    assert error < 0.15 * np.std(validation["position"])
    assert position_block.outputs[2] == Signal("position.slope", "m/s", "rate of position over the next period")
    found = band_of(position_block, [validation])["position"]
    assert found["free_run"]["coverage"] >= 0.9 and found["one_step"]["coverage"] >= 0.9
    assert found["free_run"]["half_width"] < 0.15 * np.ptp(validation["position"])


def test_away_from_the_data_the_deviation_grows_to_its_prior_and_the_mean_keeps_its_edge_value(spool_block):
    levels = np.array([1.0, 1.1, 1.2, 1.4, 60.0]) * spool_block.domain.upper[0]
    mean, sd = at_lines(spool_block, np.repeat(levels[:, None], 5, axis=1)).T
    assert np.all(np.diff(sd) > 0) and sd[-1] > 5 * sd[0]
    told, scale = spool_block.provenance["processes"][0], spool_block.arrays["run_scale"][0]
    assert sd[-1] == pytest.approx(scale * np.hypot(told["prior_sd"], told["noise_sd"]), rel=1e-3)
    assert np.allclose(mean, mean[0], rtol=1e-12) and mean[0] > 0.7


def test_the_domain_is_the_training_range(spool_block, recordings, validation):
    assert domain_share(spool_block, recordings[0]).inside == 1.0
    stronger = validation.with_signals({"current": 2 * validation["current"]})
    assert "current" in domain_share(spool_block, stronger).beyond


def test_the_fmu_of_a_process_equals_its_run_and_tells_the_distance_from_the_data(recordings, validation, tmp_path):
    pytest.importorskip("gpytorch")
    options = QUICK | {"lags": 3, "compress": 15, "points": 100}
    block = learn_gaussian_process(recordings[:1], ["current"], ["position"], rate=True, **options)
    record = validation.window(0, 10)
    found, expected = read_fmu(export_fmu(block, tmp_path / "valve.fmu")).free_run(record), simulate(block, record)
    for name in ("position", "position.sd", "position.slope", "position.slope.sd"):
        assert np.abs(found[name] - expected[name]).max() <= 1e-12 * np.ptp(expected[name])
    assert np.ptp(expected["position"]) > 0.05 and found["training_distance"].max() < 0.2


def test_a_process_comes_back_from_its_file_and_runs_without_torch(spool_block, validation, tmp_path):
    path, _ = write_block(spool_block, tmp_path / "spool.toml")
    again = read_block(path)
    assert again.certificate == spool_block.certificate and again.provenance == spool_block.provenance
    program = f"""
        import sys
        for heavy in ("torch", "gpytorch", "pyoperon"):
            sys.modules[heavy] = None
        import numpy as np
        from hydrotwin.learned import read_block
        from hydrotwin.learned.gaussian.single import learn_gaussian_process
        from hydrotwin.models.language.errors import DeclarationError
        block = read_block({str(path)!r})
        print(repr(float(block.step([0.1, 0.2, 0.3, 0.4], 0.5, [])[1][0])))
        try:
            learn_gaussian_process([], ["u"], ["y"])
        except DeclarationError as error:
            print(error)
    """
    run = subprocess.run([sys.executable, "-c", textwrap.dedent(program)], capture_output=True, text=True, check=True)
    value, sentence = run.stdout.splitlines()
    assert float(value) == float(spool_block.step([0.1, 0.2, 0.3, 0.4], 0.5, [])[1][0])
    assert "not installed" in sentence and "hydrotwin[learned]" in sentence


def test_two_outputs_side_by_side_are_what_each_is_alone(validation):
    pytest.importorskip("gpytorch")
    both, *alone = (
        learn_gaussian_process([validation], ["current"], names, rate=True, lags=2, compress=40, period=PERIOD)
        for names in (["spool", "position"], ["spool"], ["position"])
    )
    runs = [simulate(block, validation) for block in (both, *alone)]
    assert len({block.structure["points"] for block in alone}) == 2  # the smoother one needs fewer
    for name, run in zip(("spool", "position"), runs[1:], strict=True):
        own = [signal for signal in run.names if signal.startswith(name)]
        assert len(own) == 4
        for signal in own:
            scaled = signal == f"{name}.sd"  # by the part held out, which is cut where both outputs are quiet
            assert np.allclose(run[signal], runs[0][signal], rtol=0.1 if scaled else 1e-9, atol=1e-12)


def test_the_same_seed_gives_the_same_process_and_another_seed_another(recordings):
    pytest.importorskip("gpytorch")
    one, two, other = (
        learn_gaussian_process(recordings[:1], ["current"], ["spool"], seed=s, **QUICK | {"points": 80})
        for s in (3, 3, 4)
    )
    assert all(np.array_equal(one.arrays[k], two.arrays[k]) for k in one.arrays)
    assert not np.array_equal(one.arrays["lengths"], other.arrays["lengths"])


def test_the_papers_fit_stops_far_from_the_likelihood_that_lbfgs_finds(recordings):
    pytest.importorskip("gpytorch")
    blocks = {
        fit: learn_gaussian_process(recordings[:1], ["current"], ["spool"], fit=fit, **QUICK)
        for fit in ("paper", "default")
    }
    paper, default = (blocks[fit].provenance["processes"][0] for fit in ("paper", "default"))
    assert paper["iterations"] == 100 and paper["loss"] > default["loss"] + 0.3
    assert paper["noise_sd"] > 2 * default["noise_sd"]


def test_interrupting_keeps_the_best_so_far(recordings):
    pytest.importorskip("gpytorch")
    seen = []

    def interrupt(step):
        seen.append(step)
        if len(seen) == 8:
            raise KeyboardInterrupt

    block = learn_gaussian_process(recordings[:1], ["current"], ["spool"], progress=interrupt, **QUICK)
    told = block.provenance["processes"][0]
    assert block.provenance["stopped"] == told["stopped"] == "interrupted" and told["iterations"] == 8
    assert told["loss"] == min(s.loss for s in seen) == seen[-1].best
    assert [s.iteration for s in seen] == list(range(1, 9)) and seen[-1].best < seen[0].best


def test_a_rough_process_takes_more_points_until_its_mean_keeps_the_bound_and_its_deviation_errs_on_the_safe_side():
    pytest.importorskip("gpytorch")
    u = np.random.default_rng(0).uniform(-1, 1, (900, 2))
    rough = np.sin(9 * u[:, 0]) * np.cos(9 * u[:, 1])
    signals = {"one": u[:, 0], "two": u[:, 1], "rough": rough}
    record = Record(PERIOD * np.arange(900), signals, dict.fromkeys(signals, "1"))
    options = {"lags": 1, "kernel": "matern32", "points": 100, "period": PERIOD}
    block = learn_gaussian_process([record], ["one", "two"], ["rough"], bound=0.01, **options)
    assert 200 < block.structure["points"] < 900 and block.structure["sd_points"] == 200
    assert block.certificate.holds
    deviation = block.provenance["deviation"]
    assert deviation["sd_above"] > 5 * deviation["sd_below"]


def test_noise_that_no_input_explains_cannot_be_compressed_and_the_certificate_says_so():
    pytest.importorskip("gpytorch")
    rng = np.random.default_rng(0)
    u = rng.uniform(-1, 1, (400, 3))
    rough = np.sin(20 * u[:, 0]) * np.cos(20 * u[:, 1]) + np.sin(20 * u[:, 2])
    names = ("one", "two", "three")
    signals = dict(zip(names, u.T, strict=True)) | {"rough": rough}
    record = Record(PERIOD * np.arange(400), signals, dict.fromkeys(signals, "1"))
    block = learn_gaussian_process([record], list(names), ["rough"], lags=1, compress=20, points=200, period=PERIOD)
    assert not block.certificate.holds and block.certificate.difference > 0.1


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"inputs": ["curent"]}, "Did you mean 'current'"),
        ({"outputs": ["current"]}, "named twice"),
        ({"records": []}, "no recordings"),
        ({"period": 2.0}, "too few samples to train on"),
        ({"lags": 590}, "too few samples to train on"),
    ],
)
def test_what_cannot_be_learnt_from_is_refused_in_a_sentence(recordings, change, sentence):
    pytest.importorskip("gpytorch")
    asked = {"records": recordings[:1], "inputs": ["current"], "outputs": ["spool"], **QUICK} | change
    with pytest.raises(DataError, match=sentence):
        learn_gaussian_process(asked.pop("records"), asked.pop("inputs"), asked.pop("outputs"), **asked)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [(np.zeros(601), "never changes"), (np.where(np.arange(601) == 40, np.nan, 1.0), "not numbers")],
)
def test_a_constant_and_a_missing_sample_are_refused(recordings, values, sentence):
    pytest.importorskip("gpytorch")
    with pytest.raises(DataError, match=sentence):
        learn_gaussian_process([recordings[0].with_signals({"current": values})], ["current"], ["spool"], **QUICK)


@pytest.mark.parametrize(
    "option",
    [{"kernel": "rfb"}, {"fit": "adam"}, {"lags": 0}, {"lags": 2.5}, {"points": 5}, {"compress": 1}, {"bound": -1.0},
     {"period": 0.0}, {"samples": 10}],
)  # fmt: skip
def test_impossible_options_are_refused(recordings, option):
    pytest.importorskip("gpytorch")
    with pytest.raises(DeclarationError, match=next(iter(option))):
        learn_gaussian_process(recordings[:1], ["current"], ["spool"], **QUICK | option)


def test_more_than_five_megabytes_of_c_are_refused_with_the_way_out(recordings):
    pytest.importorskip("gpytorch")
    with pytest.raises(DeclarationError, match=r"MB of C .* compress='auto'"):
        learn_gaussian_process(recordings, ["current"], ["spool"], **QUICK | {"compress": None, "lags": 400})
