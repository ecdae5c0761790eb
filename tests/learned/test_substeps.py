"""Means of the inputs where a period is longer than that of the recordings: jumps between samples are not lost."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import learn, learn_narx, read_block, train_network, write_block
from hydrotwin.learned.substeps import at_period, chosen_substeps, substeps_of
from hydrotwin.learned.training_data import MANY, finest_period
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate

FINE, STEPS = 0.01, 10
U = Signal("u", "V")


def machine(seed: int, seconds: float = 30.0) -> Record:
    """dy/dt = u, exactly; u jumps at any sample, y as measured."""
    rng, n = np.random.default_rng(seed), round(seconds / FINE)
    lengths = rng.integers(20, 90, n)
    u = np.repeat(rng.uniform(-1, 1, n), lengths)[:n]
    u[: 2 * STEPS] = 0.0
    y = FINE * np.concatenate([[0.0], np.cumsum(u)[:-1]])
    return Record(FINE * np.arange(n), {"u": u, "y": y}, {"u": "V", "y": "m"}, f"machine_{seed}")


def rms(block, record: Record) -> float:
    return float(np.sqrt(np.mean((simulate(block, record)["y"] - record["y"]) ** 2)))


def learned(substeps: int, **options):
    given = {"period": STEPS * FINE, "substeps": substeps, "hidden": 0, "lags": (0, 1), "starts": 1, **options}
    return train_network([machine(1)], ["u"], ["y"], **given)


@pytest.fixture(scope="module")
def block():
    return learned(STEPS)


def test_an_integral_of_jumps_is_exact_with_means_and_drifts_with_samples(block):
    """A sample in place of the mean is off by up to a period for every jump; the sum of these is a random walk."""
    assert block.period == pytest.approx(FINE)
    assert rms(block, machine(2)) < 1e-4
    assert rms(learned(1), machine(2)) > 1e-2


def test_a_step_of_the_period_is_what_its_substeps_come_to(block):
    """By the equation of the trained step: after all substeps y is y + b + W (mean of u), and in between on the way."""
    a, u = block.arrays, np.random.default_rng(0).uniform(-1, 1, STEPS)
    x, seen = block.start(0.3, 0.2, []), []
    for value in u:
        x, y = block.step(x, value, [])
        seen.append(float(y))
    z = np.array([(0.2 - a["output_centre"][0]) / a["output_scale"][0],
                  (u.mean() - a["input_centre"][0]) / a["input_scale"][0]])  # fmt: skip
    moved = float((a["linear_weights"] @ z + a["output_bias"]).item() * a["increment_scale"][0])
    assert float(x[0]) == pytest.approx(0.2 + moved, abs=1e-6), "to what is taken out of its drift"
    assert np.array(x[1:]).ravel() == pytest.approx(0.0, abs=1e-12), "the next period begins anew"
    assert seen[0] == pytest.approx(0.2) and abs(seen[5] - 0.2) < 2 * abs(moved) + STEPS * FINE


def test_a_measured_output_stands_in_within_a_period(block):
    """From half-way on with y moved by 0.1, all that follows is moved by 0.1 where the rate does not see y."""
    walk = block.step.mapaccum("walk", STEPS // 2, 1)
    x = walk(block.start(0.3, 0.2, []), ca.repmat(ca.DM(0.3), 1, STEPS // 2), [])[0][:, -1]
    other = ca.DM(x)
    other[0] += 0.1
    ends = [float(walk(s, ca.repmat(ca.DM(0.5), 1, STEPS // 2), [])[0][0, -1]) for s in (x, other)]
    assert ends[1] - ends[0] == pytest.approx(0.1, abs=1e-6)


def test_file_and_fmu_run_as_the_block_does(block, tmp_path):
    again = read_block(write_block(block, tmp_path / "b.toml")[0])
    record = machine(3, 5.0)
    expected = simulate(block, record)["y"]
    assert np.array_equal(simulate(again, record)["y"], expected)
    found = read_fmu(export_fmu(again, tmp_path / "b.fmu")).free_run(record)["y"]
    assert found == pytest.approx(expected, abs=1e-9)


def test_a_file_with_other_counts_is_refused(block, tmp_path):
    path = write_block(block, tmp_path / "b.toml")[0]
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace(f"substeps = {STEPS}", "substeps = 0"), encoding="utf-8")
    with pytest.raises(DataError, match="substeps must be a whole number"):
        read_block(path)
    path.write_text(text.replace(f"substeps = {STEPS}\n", ""), encoding="utf-8")
    with pytest.raises(DataError, match="Write the block again"):
        read_block(path)


def test_means_are_taken_where_samples_do_not_show_what_happens_between():
    jumps, t = machine(4), FINE * np.arange(3000)
    slow = Record(t, {"u": np.sin(0.5 * t), "y": np.cos(0.5 * t)}, {"u": "V", "y": "m"}, "slow")
    assert substeps_of([jumps], [U], STEPS * FINE) == STEPS
    assert substeps_of([slow], [U], STEPS * FINE) == 1, "linear interpolation is enough"
    assert substeps_of([jumps], [U], 2.5 * FINE) == 1, "no whole number of samples"
    assert substeps_of([jumps, jumps.resample(2 * FINE)], [U], STEPS * FINE) == 1, "not alike"


def test_the_last_period_has_the_mean_of_what_there_is():
    record = Record(FINE * np.arange(25), {"u": np.arange(25.0)}, {"u": "V"}, "ramp")
    assert at_period(record, STEPS * FINE, [U], STEPS)["u"].tolist() == [4.5, 14.5, 22.0]


def test_a_period_that_is_asked_for_is_the_step_unless_substeps_are():
    jumps = [machine(4)]
    assert chosen_substeps(None, None, jumps, [U], STEPS * FINE) == STEPS, "the period was chosen by the learning"
    assert chosen_substeps(None, STEPS * FINE, jumps, [U], STEPS * FINE) == 1
    assert chosen_substeps(STEPS, STEPS * FINE, jumps, [U], STEPS * FINE) == STEPS
    for asked, period in ((5, STEPS * FINE), (STEPS, None)):
        with pytest.raises(DeclarationError, match=f"substeps={asked} are .* the period is "):
            chosen_substeps(asked, period, jumps, [U], period or 2 * STEPS * FINE)


def test_formulas_take_means_too():
    found = learn_narx([machine(1)], ["u"], ["y"], period=STEPS * FINE, substeps=STEPS, degree=1, terms=3)
    assert found.structure["substeps"] == STEPS and found.period == pytest.approx(FINE)
    assert rms(found, machine(2)) < 5e-3 and found.certificate.holds


def test_the_card_says_what_of_long_recordings_was_not_trained_on():
    long = machine(6, 1.5 * MANY * FINE)
    quick = {"period": 0.1, "lags": (1, 2), "delay": 1, "refine": False}
    says = [learn("arx", [r], ["u"], ["y"], **quick).provenance["free_run"]["says"] for r in (long, machine(1))]
    assert f"Of {len(long)} samples one every 0.1 s was trained on" in says[0]
    assert "samples one every" not in says[1]


def test_the_finest_period_leaves_no_more_samples_than_are_run_over():
    assert finest_period([machine(1)], FINE) == pytest.approx(FINE)
    long = machine(6, 1.5 * MANY * FINE)
    assert finest_period([long], FINE) == pytest.approx(2 * FINE)
