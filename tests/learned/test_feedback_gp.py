"""The Gaussian process with output feedback: its equations, its band against sampled functions, and what is chosen."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import band_of, learn_gp, read_block, write_block
from hydrotwin.learned.bands import with_arrays
from hydrotwin.learned.block_file import LearnedBlock, assemble
from hydrotwin.learned.gaussian.feedback import learn_feedback_gp
from hydrotwin.learned.gaussian.feedback_block import FEEDBACK, array_shapes, feedback_frame
from hydrotwin.learned.gaussian.feedback_run import Basis, Lags, Model, Stretch, free_run
from hydrotwin.learned.gaussian.kernels import Hyper, parsed
from hydrotwin.learned.gaussian.sparse import factor_of
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.simulation.block import TrainingDomain

PUMP, LEVEL, FLOW = Signal("pump", "V"), Signal("level", "m"), Signal("flow", "m3/s")
PERIOD, NOISE = 1.0, 0.01
POSITIVE = ("variances", "lengths", "increment_limit", "unexplained")
QUICK = {"points": 25, "samples": 500, "evaluations": 30, "period": PERIOD, "lags": (1, 1, 2), "kernel": "linear+rbf"}


def tank_record(seed: int, samples: int = 400, noise: float = NOISE) -> Record:
    """A tank with an outflow of the root of its level: y' = 0.1 u - 0.15 sqrt(y)."""
    rng = np.random.default_rng(seed)
    u = np.repeat(rng.uniform(0.5, 3.0, samples // 20 + 1), 20)[:samples]
    y, level = np.empty(samples), 1.0
    for k in range(samples):
        y[k] = level
        for _ in range(5):
            level = max(level + 0.2 * (0.1 * u[k] - 0.15 * np.sqrt(max(level, 0.0))), 0.0)
    signals = {"pump": u, "level": y + noise * rng.normal(size=samples)}
    return Record(
        PERIOD * np.arange(samples), signals, {"pump": "V", "level": "m"}, f"tank_{seed}", digest=f"{seed:064x}"
    )


def random_feedback(lags=(1, 1, 2), inputs=(PUMP,), outputs=(LEVEL,), formula="linear+matern32") -> LearnedBlock:
    """A block with random arrays: it predicts nothing, but it is a complete block."""
    rng, kernel, seen = np.random.default_rng(7), parsed(formula, "test"), Lags(len(inputs), len(outputs), *lags)
    structure = seen.structure() | {"points": 6, "directions": 2}
    structure |= {"factors": len(kernel.factors), "terms": len(kernel.terms)}
    arrays = {}
    for name, shape in array_shapes(structure, len(inputs), 2 * len(outputs)).items():
        positive = (
            "scale" in name or "noise" in name or name in ("variances", "lengths", "increment_limit", "unexplained")
        )
        arrays[name] = 0.5 + rng.uniform(size=shape) if positive else 0.3 * rng.normal(size=shape)
    arrays |= {"kernel": kernel.table(), "feature_lower": np.full(seen.features, -0.9)}
    arrays |= {"feature_upper": np.full(seen.features, 1.1), "output_lower": np.full(len(outputs), -9.0)}
    arrays["output_upper"] = np.full(len(outputs), 9.0)
    box = TrainingDomain(tuple(s.name for s in inputs), (-1.0,) * len(inputs), (1.0,) * len(inputs))
    frame = feedback_frame(seen, 2 + 3 * len(outputs), inputs, outputs)
    told = {"period": PERIOD, "domain": box, "description": "random", "provenance": {"kind": "gaussian_feedback"}}
    return assemble(FEEDBACK, arrays, structure, name="random", **frame, **told)


def model_of(block: LearnedBlock, ny: int = 1) -> tuple[Model, list[np.ndarray]]:
    """The numpy run of a block, and its weights."""
    a, s = block.arrays, block.structure
    kernel, bases, weights = parsed("linear+matern32", "test"), [], []
    for j in range(ny):
        hyper = Hyper(kernel, a["variances"][j], a["lengths"][j])
        L = factor_of(hyper, a["points"])
        bases.append(Basis(hyper, a["points"], L, np.linalg.inv(L)))
        weights.append(L.T @ a["weights"][j])
    lags = Lags(len(block.inputs), ny, s["level"], s["increments"], s["samples"])
    bounds = tuple((a[f"output_{side}"] - a["output_centre"]) / a["output_scale"] for side in ("lower", "upper"))
    step, features = a["increment_scale"] / a["output_scale"], (a["feature_lower"], a["feature_upper"])
    return Model(lags, tuple(bases), step, a["increment_limit"], bounds, features), weights


def started(block: LearnedBlock, u: np.ndarray, y: np.ndarray) -> Stretch:
    """A run from rest at outputs y (SI) under inputs u (n, nu), normalised."""
    a, s = block.arrays, block.structure
    u = (u - a["input_centre"]) / a["input_scale"]
    lines = np.hstack([u[np.maximum(np.arange(len(u)) - i, 0)] for i in range(s["samples"])])
    first = ((y - a["output_centre"]) / a["output_scale"])[None]
    return Stretch(first, np.zeros((1, len(y) * s["increments"])), lines[:, None], np.zeros((len(u), 1, len(y))))


@cache
def tank_block() -> LearnedBlock:
    """Learnt from two recordings."""
    return learn_feedback_gp([tank_record(s, 240) for s in (1, 2)], ["pump"], ["level"], **QUICK)


@pytest.fixture
def tank():
    return tank_block()


@pytest.mark.parametrize("lags", [(1, 0, 1), (1, 2, 3), (0, 1, 2), (0, 0, 3)])
@pytest.mark.parametrize("outputs", [(LEVEL,), (LEVEL, FLOW)])
def test_the_deployed_run_is_that_of_numpy(lags, outputs):
    block = random_feedback(lags, (PUMP,), outputs)
    rng = np.random.default_rng(1)
    u, y = rng.normal(size=(15, 1)), rng.normal(size=len(outputs))
    signals = {"pump": u[:, 0], **{s.name: np.full(15, v) for s, v in zip(outputs, y, strict=True)}}
    run = simulate(block, Record(PERIOD * np.arange(15), signals, {s.name: s.unit for s in (PUMP, *outputs)}))
    model, weights = model_of(block, len(outputs))
    found, a = free_run(model, weights, started(block, u, y))[:-1, 0], block.arrays
    expected = a["output_centre"] + a["output_scale"] * found
    assert np.allclose(run.array([s.name for s in outputs])[1:], expected, rtol=1e-5, atol=1e-6)
    assert np.ptp(expected) > 0.01


@pytest.mark.parametrize("lags", [(1, 1, 2), (0, 2, 3)])
def test_derivatives_of_a_run_are_those_of_differences(lags):
    block = random_feedback(lags)
    model, weights = model_of(block)
    s = started(block, np.random.default_rng(2).normal(size=(12, 1)), np.array([0.3]))
    found, J = free_run(model, weights, s, derivatives=True)
    for k in range(6):
        more = [weights[0] + 1e-6 * (np.arange(6) == k)]
        assert np.allclose((free_run(model, more, s) - found)[..., 0] / 1e-6, J[:, :, 0, k], atol=2e-4)


def test_the_band_is_that_of_sampled_functions_and_not_of_a_sum_of_deviations(tank):
    """Weights drawn along the block's own directions, each run freely, spread as the block says."""
    record, a, rng = tank_record(5, 120), tank.arrays, np.random.default_rng(3)
    plain = {"start_noise": 0 * a["start_noise"], "start_increment": 0 * a["start_increment"]}
    block = with_arrays(tank, plain | {"run_noise": np.zeros(1), "run_scale": np.ones(1)})
    draws = []
    for _ in range(100):
        weights = a["weights"] + np.einsum("jmr,r->jm", a["directions"], rng.normal(size=a["directions"].shape[2]))
        draws.append(simulate(with_arrays(block, {"weights": weights}), record)["level"])
    spread, told = np.std(draws, axis=0)[5:], simulate(block, record)["level.sd"][5:]
    assert 0.8 < np.median(told / spread) < 1.25 and np.abs(np.log(told / spread)).max() < np.log(2)
    assert np.any(np.diff(told) < 0)  # a sum of deviations only grows


def test_a_measured_value_in_place_of_the_state_clears_what_was_not_known_of_it(tank):
    names = [s.name for s in tank.states]
    rows = [k for k, name in enumerate(names) if name.startswith("level.by_")]
    x = tank.start(1.0, [0.8, 0.0], []).full().ravel()
    x[rows] = np.linspace(0.1, 0.2, len(rows))
    other = x.copy()
    other[rows] *= 3.0
    known, also = (tank.step(np.where(np.arange(len(x)) == 0, 0.85, s), 1.0, [])[0].full().ravel() for s in (x, other))
    assert np.array_equal(known, also) and known[names.index("level.noise")] == 1.0
    free = tank.step(x, 1.0, [])[0].full().ravel()
    assert np.abs(free[rows]).max() > 0.05 > np.abs(known[rows]).max() and free[names.index("level.noise")] == 0.0


def test_the_band_of_an_unseen_recording_covers_what_it_says(tank):
    record = tank_record(6)
    found = band_of(tank, [record])["level"]
    assert found["one_step"]["coverage"] >= 0.9 and found["free_run"]["coverage"] >= 0.9
    assert found["free_run"]["half_width"] < 4 * NOISE and found["one_step"]["half_width"] < 4 * NOISE


def test_a_tank_is_learnt_to_a_few_times_its_noise_and_the_certificate_holds(tank):
    record = tank_record(9)
    assert np.sqrt(np.mean((simulate(tank, record)["level"] - record["level"]) ** 2)) < 5 * NOISE
    assert tank.certificate.holds and tank.provenance["band"]["level"]["coverage"]["free_run"] > 0.8


def test_outside_the_data_the_band_grows(tank):
    record = tank_record(9, 100)
    stronger = record.with_signals({"pump": 4 * record["pump"]})
    assert simulate(tank, stronger)["level.sd"].max() > 3 * simulate(tank, record)["level.sd"].max()


def test_lags_and_kernel_are_chosen_by_what_was_held_out_and_validation_has_no_part(tmp_path):
    options = {"points": 12, "samples": 300, "evaluations": 8, "period": 4.0}
    records = [tank_record(1, 320)]
    blocks = [learn_gp(records, ["pump"], ["level"], validate=[tank_record(s, 100)], **options) for s in (3, 4)]
    assert all(np.array_equal(blocks[0].arrays[k], blocks[1].arrays[k]) for k in blocks[0].arrays)
    tried = blocks[0].provenance["tried"]
    best = min((t for t in tried if t["how"] == "fitted" and t["score"] != "diverged"), key=lambda t: t["score"])
    assert {k: blocks[0].provenance[k] for k in ("level", "increments", "samples", "kernel", "fitted_to")} == {
        k: best[k] for k in ("level", "increments", "samples", "kernel", "fitted_to")
    }
    again = read_block(write_block(blocks[0], tmp_path / "tank.toml")[0])
    assert again.provenance["band"] == blocks[0].provenance["band"]


def test_the_fmu_equals_the_run_with_its_band(tank, tmp_path):
    record = tank_record(9, 60)
    found, expected = read_fmu(export_fmu(tank, tmp_path / "tank.fmu")).free_run(record), simulate(tank, record)
    for name in ("level", "level.sd"):
        assert np.abs(found[name] - expected[name]).max() <= 1e-9 * np.ptp(record["level"])


@pytest.mark.parametrize(
    ("change", "error", "sentence"),
    [
        ({"kernel": "rfb"}, DeclarationError, "Did you mean 'rbf'"),
        ({"lags": (2, 1, 1)}, DeclarationError, "lags are"),
        ({"period": -1.0}, DeclarationError, "period must be positive"),
        ({"points": 2}, DeclarationError, "points must be"),
        ({"period": 20.0}, DataError, "too few samples to train on"),
        ({"compress": 10, "feedback": True}, DeclarationError, "compress is no option"),
        ({"evaluations": 5, "feedback": False, "lags": 3}, DeclarationError, "evaluations is no option"),
    ],
)
def test_what_cannot_be_learnt_is_refused_in_a_sentence(change, error, sentence):
    with pytest.raises(error, match=sentence):
        learn_gp([tank_record(1, 100)], ["pump"], ["level"], **QUICK | change)


def test_recordings_that_select_choose_in_place_of_the_parts():
    options = QUICK | {"points": 12, "samples": 200, "evaluations": 10, "starts": 1}
    train, other = [tank_record(1, 240)], [tank_record(2, 240)]
    parts, chosen = (learn_gp(train, [PUMP], [LEVEL], select=select, **options) for select in ([], other))
    assert chosen.provenance["selected_on"][0]["name"] == "tank_2"
    assert [r["name"] for r in chosen.provenance["trained_on"]] == ["tank_1"] and chosen.domain == parts.domain
    assert chosen.provenance["free_run_held_out"] != parts.provenance["free_run_held_out"]
    with pytest.raises(DeclarationError, match="select is no option of a process without output feedback"):
        learn_gp(train, [PUMP], [LEVEL], select=other, feedback=False)
