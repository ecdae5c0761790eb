"""The equations of a Gaussian process in CasADi are those written in NumPy; no training."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.learned.block_file import LearnedBlock, assemble
from hydrotwin.learned.gaussian.kernel_block import GAUSSIAN_PROCESS, KERNELS, array_shapes, process_frame
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.simulation.block import TrainingDomain
from tests.learned.test_gaussian_process import CURRENT, FLOW, PERIOD, POSITION, SPOOL, at_lines


def random_gaussian_process(rate: int = 0, kernel: int = 0, inputs=(CURRENT,), outputs=(SPOOL,), lags: int = 3):
    """A block of processes with random arrays: it predicts nothing, but it is a complete block."""
    rng = np.random.default_rng(0)
    structure = {"kernel": kernel, "lags": lags, "rate": rate, "points": 8, "sd_points": 6, "rank": 4}
    structure["directions"] = 2 * rate
    frame = process_frame(inputs, outputs, lags, bool(rate), 2)
    shapes = array_shapes(structure, len(inputs), len(frame["outputs"]))
    arrays = {key: rng.normal(size=shape) for key, shape in shapes.items()}
    for key in ("input_scale", "lengths", "prior_variance", "noise", *[k for k in shapes if k.endswith("_scale")]):
        arrays[key] = 1.0 + rng.uniform(size=shapes[key])
    arrays["input_lower"], arrays["input_upper"] = np.full(len(inputs), -0.6), np.full(len(inputs), 0.7)
    arrays["sd_factor"] = 0.2 * np.triu(arrays["sd_factor"])
    box = TrainingDomain(tuple(s.name for s in inputs), (-1.0,) * len(inputs), (1.0,) * len(inputs))
    told = {"period": PERIOD, "domain": box, "description": "random", "provenance": {"kind": "gaussian_process"}}
    arrays |= {"period": np.array(PERIOD)} if rate else {}
    return assemble(GAUSSIAN_PROCESS, arrays, structure, name="random", **frame, **told)


def in_numpy(block: LearnedBlock, features: np.ndarray, j: int = 0) -> tuple[float, float, np.ndarray]:
    """Mean, latent deviation and correlations of process j for one delay line, as the module writes them."""
    a, kernel = block.arrays, KERNELS[block.structure["kernel"]]
    lags = len(features) // len(block.inputs)
    z = (features - np.tile(a["input_centre"], lags)) / np.tile(a["input_scale"], lags)

    def k(points, at):
        distance = np.linalg.norm(points - at / a["lengths"][j], axis=1)
        r = np.sqrt(3) * distance
        return np.exp(-(distance**2) / 2) if kernel == "rbf" else (1 + r) * np.exp(-r)

    clipped = np.clip(z, np.tile(a["input_lower"], lags), np.tile(a["input_upper"], lags))
    mean = a["output_centre"][j] + a["weights"][j] @ k(a["points"][j], clipped)
    k_sd = k(a["sd_points"][j], z)
    explained = a["sd_factor"][j] @ k_sd
    return mean, np.sqrt(max(a["prior_variance"][j] - explained @ explained, 0.0)), k_sd


def measured_in_numpy(block: LearnedBlock, features: np.ndarray, j: int = 0) -> tuple[float, float]:
    """Mean and deviation of the measured value of process j."""
    mean, latent, _ = in_numpy(block, features, j)
    return mean, np.hypot(latent, block.arrays["noise"][j])


@pytest.mark.parametrize("kernel", [0, 1])
@pytest.mark.parametrize("inputs", [(CURRENT,), (CURRENT, FLOW)])
def test_the_step_is_the_written_equation(kernel, inputs):
    block = random_gaussian_process(0, kernel, inputs, (SPOOL, POSITION))
    features = np.random.default_rng(1).normal(size=(20, 3 * len(inputs)))
    for line, y in zip(features, at_lines(block, features), strict=True):
        expected = [v for j in (0, 1) for v in measured_in_numpy(block, line, j)]
        expected[1::2] *= block.arrays["run_scale"]
        assert np.allclose(y, expected, rtol=1e-10)
    after = block.step(features[0][len(inputs) :], features[0][: len(inputs)], [])[0].full().ravel()
    assert np.array_equal(after, features[0][: 2 * len(inputs)])


def test_a_slope_is_integrated_and_every_direction_of_its_error_with_it():
    block = random_gaussian_process(rate=1)
    a = block.arrays
    current = np.random.default_rng(1).normal(size=30)
    record = Record(
        PERIOD * np.arange(30), {"current": current, "spool": np.full(30, 0.3)}, {"current": "1", "spool": "1"}
    )
    run = simulate(block, record)
    line = np.concatenate([[current[0]] * 2, current])
    found = [in_numpy(block, line[k : k + 3][::-1]) for k in range(30)]
    slopes, latents, k_sd = (np.array(part) for part in zip(*found, strict=True))
    assert np.allclose(run["spool.slope"], slopes) and np.allclose(run["spool.slope.sd"], np.hypot(latents, a["noise"]))
    assert np.allclose(run["spool"], 0.3 + PERIOD * np.concatenate([[0], np.cumsum(slopes)[:-1]]))
    outside = np.sqrt(np.maximum(latents**2 - a["inside"], 0))
    effects = np.column_stack([k_sd @ a["directions"][0], outside])
    q = PERIOD * np.vstack([0 * effects[:1], np.cumsum(effects, axis=0)[:-1]])
    assert np.allclose(run["spool.sd"], a["run_scale"] * np.sqrt(np.sum(q**2, axis=1) + a["run_noise"] ** 2))


def test_a_measured_value_in_place_of_the_state_begins_the_band_anew_with_the_noise_of_one_step():
    block = random_gaussian_process(rate=1)
    a, lags = block.arrays, np.zeros(2)
    x = np.concatenate([[0.5, 0.2, 0.0, 3.0, 4.0, 0.0], lags])
    (after, seen), same = block.step(x, 0.0, []), block.step([0.2, *x[1:]], 0.0, [])[0]
    after, same, seen = after.full().ravel(), same.full().ravel(), seen.full().ravel()
    assert seen[1] == pytest.approx(float(a["run_scale"][0] * np.hypot(5.0, a["run_noise"][0])))
    assert after[2] == 1 and same[2] == 0 and np.allclose(same[3:6] - after[3:6], [3.0, 4.0, 0.0])
    later = block.step(after, 0.0, [])[1].full().ravel()[1]
    one = np.sqrt(np.sum(after[3:6] ** 2) + (PERIOD * a["noise"][0]) ** 2)
    assert later == pytest.approx(float(a["step_scale"][0] * one))
