"""The published network of delayed inputs to a rate: its equation, its training, and what it is worth."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import learn_rate_network, read_block, write_block
from hydrotwin.learned.block_file import assemble
from hydrotwin.learned.gaussian.delay_lines import training_rows
from hydrotwin.learned.network.rate_block import RATE_NETWORK, array_shapes, rate_frame
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.simulation import simulate
from hydrotwin.simulation.block import TrainingDomain
from tests.learned.test_gaussian_process import CURRENT, PERIOD, POSITION, valve_record

LAGS, HIDDEN = 3, 4


def random_rate_network():
    """A block with random weights: it predicts nothing, but it is a complete block."""
    rng, structure = np.random.default_rng(0), {"lags": LAGS, "hidden": HIDDEN}
    arrays = {key: rng.normal(size=shape) for key, shape in array_shapes(structure, 1, 2).items()}
    arrays |= {"input_scale": np.array([0.7]), "rate_scale": np.array([0.2]), "period": np.array([PERIOD])}
    return assemble(
        RATE_NETWORK, arrays, structure, name="random", **rate_frame((CURRENT,), POSITION, LAGS), period=PERIOD,
        domain=TrainingDomain(("current", "position"), (-1.0, -0.2), (1.0, 0.2)), provenance={"kind": "rate_network"},
    )  # fmt: skip


@pytest.fixture(scope="module")
def recordings():
    return [valve_record(s, jitter=0.2) for s in (1, 2)]


@pytest.fixture(scope="module")
def learned(recordings):
    pytest.importorskip("torch")
    return learn_rate_network(recordings, [CURRENT], [POSITION], iterations=600)


def test_the_step_is_the_written_equation():
    block, rng = random_rate_network(), np.random.default_rng(1)
    a = block.arrays
    for y, *line in rng.normal(size=(20, 1 + LAGS)):
        z = (np.array(line) - a["input_centre"]) / 0.7
        h = np.maximum(a["first_weights"] @ z + a["first_bias"], 0)
        h = np.maximum(a["second_weights"] @ h + a["second_bias"], 0)
        v = (a["rate_centre"] + 0.2 * (a["output_weights"] @ h + a["output_bias"]))[0]
        after, seen = block.step([y, *line[1:]], line[0], [])
        assert np.allclose(after.full().ravel(), [y + PERIOD * v, *line[:2]], rtol=1e-13)
        assert np.allclose(seen.full().ravel(), [y, v], rtol=1e-13)
    assert block.start(0.4, [0.1, np.nan], []).full().ravel().tolist() == [0.1, 0.4, 0.4]


def test_it_has_the_published_size_and_follows_an_unseen_recording(learned):
    layers = [a for key, a in learned.arrays.items() if key.endswith(("weights", "bias"))]
    assert sum(a.size for a in layers) == 385 and "385 weights" in learned.description
    assert learned.certificate.holds and learned.certificate.difference > 0
    judge = valve_record(9, duration=30.0)
    run = simulate(learned, judge)
    assert np.sqrt(np.mean((run["position"] - judge["position"]) ** 2)) < 0.15 * np.std(judge["position"])


def test_the_start_with_the_least_training_loss_is_kept_and_more_steps_lower_it(recordings, learned):
    brief = learn_rate_network(recordings, [CURRENT], [POSITION])
    losses = brief.provenance["losses"]
    assert len(losses) == 10 and min(losses) < 0.9 * max(losses)
    rows = training_rows(recordings, PERIOD, [CURRENT], [POSITION], 5, 6000, np.random.default_rng(0))
    lines, slopes = rows.features, rows.slopes[:, 0]
    x = np.hstack([np.zeros((len(rows), 1)), lines[:, 1:]])
    found = brief.step.map(len(rows))(x.T, lines[:, :1].T, np.zeros((0, len(rows))))[1].full()[1]
    assert np.mean((found - slopes) ** 2) / np.var(slopes) == pytest.approx(min(losses), rel=1e-9)
    assert brief.provenance["iterations"] == 100 and min(losses) > 1.1 * min(learned.provenance["losses"])


def test_the_certificate_catches_a_changed_weight(learned):
    from hydrotwin.learned.network import adam
    from hydrotwin.learned.network.rate import certify

    grid = np.random.default_rng(0).uniform(-1, 1, (50, 5))
    assert certify(learned, adam, grid).holds
    off = learned.arrays["output_bias"] + 1e-9
    changed = dataclasses.replace(learned, arrays={**learned.arrays, "output_bias": off})  # its step stays as it was
    assert not certify(changed, adam, grid).holds


def test_the_same_seed_gives_the_same_network_in_its_file_too(recordings, tmp_path):
    pytest.importorskip("torch")
    one, two, other = (
        learn_rate_network(recordings[:1], [CURRENT], [POSITION], seed=s, iterations=20) for s in (3, 3, 4)
    )
    assert np.array_equal(one.arrays["first_weights"], two.arrays["first_weights"])
    assert not np.array_equal(one.arrays["first_weights"], other.arrays["first_weights"])
    again = read_block(write_block(one, tmp_path / "rate.toml")[0])
    assert np.array_equal(simulate(again, recordings[1])["position"], simulate(one, recordings[1])["position"])


def test_its_fmu_runs_to_the_same_numbers(learned, tmp_path):
    record = valve_record(9, duration=10.0)
    found, expected = read_fmu(export_fmu(learned, tmp_path / "rate.fmu")).free_run(record), simulate(learned, record)
    for name in ("position", "position.slope"):
        assert np.abs(found[name] - expected[name]).max() <= 1e-12 * np.ptp(expected[name])
    assert np.ptp(expected["position"]) > 0.05


def test_interrupting_keeps_the_best_so_far(recordings):
    pytest.importorskip("torch")
    seen = []

    def interrupt(iteration, loss):
        seen.append(loss)
        if iteration == 30:
            raise KeyboardInterrupt

    block = learn_rate_network(recordings[:1], [CURRENT], [POSITION], progress=interrupt)
    assert block.provenance["stopped"] == "interrupted" and block.provenance["iterations"] == 30
    assert min(block.provenance["losses"]) == seen[-1] == min(seen) and block.certificate.holds


@pytest.mark.parametrize(
    ("change", "error", "sentence"),
    [
        ({"outputs": ["position", "spool"]}, DataError, "one output is needed"),
        ({"outputs": ["positon"]}, DataError, "Did you mean 'position'"),
        ({"hidden": 0}, DeclarationError, "hidden must be a whole number"),
        ({"lags": 1.5}, DeclarationError, "lags must be a whole number"),
    ],
)
def test_what_cannot_be_learnt_from_is_refused_in_a_sentence(recordings, change, error, sentence):
    pytest.importorskip("torch")
    asked = {"outputs": ["position"]} | change
    with pytest.raises(error, match=sentence):
        learn_rate_network(recordings[:1], ["current"], asked.pop("outputs"), **asked)
