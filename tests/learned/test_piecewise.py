"""The piecewise linear characteristic: six numbers and a dead time, found again where they are the truth."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import read_block, write_block
from hydrotwin.learned.block_file import assemble
from hydrotwin.learned.piecewise.block import PIECEWISE, piecewise_states
from hydrotwin.learned.piecewise.learn import learn_piecewise
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests.learned.hidden_valve import DEAD_TIME, OVERLAP, ramps_record, steps_record

EDGES, RATES, PERIOD = (-0.7, -0.12, 0.05, 0.6), (-0.08, 0.11), 0.02


def curve(u):
    """The truth, written with interpolation."""
    return np.interp(u, EDGES, [RATES[0], 0.0, 0.0, RATES[1]])


def true_record(dead_time=0.05, seconds=60.0, seed=0, noise=0.0) -> Record:
    """Steps held for a third of a second through the curve, after the dead time, integrated exactly."""
    rng, n = np.random.default_rng(seed), round(seconds / PERIOD)
    u = np.repeat(rng.uniform(-1, 1, n // 15 + 1), 15)[: n + 1]
    fine = 4  # a quarter of a period: dead times fall on it
    late = np.concatenate([np.full(round(dead_time * fine / PERIOD), u[0]), np.repeat(u, fine)])
    position = np.concatenate([[0.3], 0.3 + np.cumsum(curve(late)) * PERIOD / fine])[: fine * n + 1 : fine]
    columns = {"current": u, "position": position + noise * rng.normal(size=n + 1), "velocity": curve(u)}
    return Record(PERIOD * np.arange(n + 1), columns, {"current": "1", "position": "m", "velocity": "m/s"}, "truth")


def written_block(dead_time=0.05, integrating=1):
    structure = {"delay": int(dead_time / PERIOD) + 1, "integrating": integrating}
    current, position = Signal("current", "1"), Signal("position", "m")
    return assemble(
        PIECEWISE, {"edges": EDGES, "rates": RATES, "dead_time": [dead_time], "period": [PERIOD]}, structure,
        name="written", inputs=(current,), outputs=(position,), parameters=(), period=PERIOD,
        states=piecewise_states(structure, current, position),
    )  # fmt: skip


@pytest.mark.parametrize("dead_time", [0.0, 0.015, 0.04, 0.05])
def test_the_block_is_the_written_curve_after_the_dead_time(dead_time):
    record = true_record(dead_time, seconds=10.0)
    run = simulate(written_block(dead_time), record)["position"]
    assert run == pytest.approx(record["position"], abs=1e-13)


def test_an_output_that_does_not_integrate_is_the_curve_itself():
    record = true_record(seconds=10.0)
    run = simulate(written_block(0.0, integrating=0), record)["position"]
    assert run == pytest.approx(curve(record["current"]), abs=1e-15)


@pytest.mark.parametrize("dead_time", [0.0, 0.015, 0.05])
def test_a_known_truth_is_recovered_exactly(dead_time):
    block = learn_piecewise([true_record(dead_time)], ["current"], ["position"], period=PERIOD)
    assert block.arrays["edges"] == pytest.approx(EDGES, abs=1e-6)
    assert block.arrays["rates"] == pytest.approx(RATES, abs=1e-7)
    assert block.provenance["identified"]["dead_time"] == pytest.approx(dead_time, abs=1e-6)
    assert block.provenance["identified"]["slope above"] == pytest.approx(RATES[1] / 0.55, rel=1e-5)
    assert block.certificate.holds


def test_from_a_recorded_speed_the_same_truth_is_recovered():
    block = learn_piecewise([true_record()], ["current"], ["velocity"], period=PERIOD, integrating=False, dead_time=0.0)
    assert block.arrays["edges"] == pytest.approx(EDGES, abs=1e-6)
    assert block.arrays["rates"] == pytest.approx(RATES, abs=1e-7)


def test_a_truth_that_falls_is_recovered_too():
    record = true_record()
    turned = record.with_signals({"position": -record["position"]})
    block = learn_piecewise([turned], ["current"], ["position"], period=PERIOD, starts=1)
    assert block.arrays["rates"] == pytest.approx([-r for r in RATES], abs=1e-7)
    assert block.certificate.holds and block.provenance["identified"]["slope above"] < 0


def test_noise_costs_little_where_the_curve_is_true():
    block = learn_piecewise([true_record(noise=1e-3)], ["current"], ["position"], period=PERIOD)
    assert block.arrays["edges"] == pytest.approx(EDGES, abs=0.02)
    assert block.arrays["rates"] == pytest.approx(RATES, rel=0.02)


@pytest.fixture(scope="module")
def learned():
    return learn_piecewise([steps_record()], ["current"], ["position"])


def test_overlap_and_dead_time_of_a_valve_are_found_from_quantised_uneven_positions(learned):
    found = learned.provenance["identified"]
    assert found["dead_time"] == pytest.approx(DEAD_TIME, abs=0.03)
    assert found["deadband to"] - found["deadband from"] == pytest.approx(2 * OVERLAP, abs=0.03)
    assert -1.0 <= found["saturated below"] < found["saturated above"] <= 1.0
    assert found["slope above"] == pytest.approx(0.104, rel=0.1)


def test_a_dead_time_can_be_given_and_none_costs_accuracy_on_ramps(learned):
    ramps = ramps_record()
    without = learn_piecewise([steps_record()], ["current"], ["position"], dead_time=0.0)
    assert without.provenance["identified"]["dead_time"] == 0.0 and without.structure["delay"] == 1
    paper = learn_piecewise([steps_record()], ["current"], ["position"], fit="paper")
    assert all(np.array_equal(without.arrays[key], array) for key, array in paper.arrays.items())
    errors = []
    for block in (learned, without):
        run = simulate(block, ramps)
        rate = np.diff(run["position"]) / np.diff(run.time)
        errors.append(np.sqrt(np.mean((rate - (ramps["velocity"][1:] + ramps["velocity"][:-1]) / 2) ** 2)))
    assert errors[0] < 0.9 * errors[1]


def test_it_comes_back_from_its_file_and_its_fmu_runs_to_the_same_numbers(learned, tmp_path):
    record = steps_record(4, duration=10.0).resample(learned.period, hold=["current"])
    expected = simulate(learned, record)["position"]
    again = read_block(write_block(learned, tmp_path / "curve.toml")[0])
    assert np.array_equal(simulate(again, record)["position"], expected)
    assert again.certificate == learned.certificate and again.provenance == learned.provenance
    found = read_fmu(export_fmu(learned, tmp_path / "curve.fmu")).free_run(record)["position"]
    assert np.abs(found - expected).max() < 1e-9 * np.ptp(expected)


def test_interrupting_keeps_the_best_so_far():
    seen = []

    def interrupt(step):
        seen.append(step)
        if len(seen) == 7:
            raise KeyboardInterrupt

    block = learn_piecewise([true_record()], ["current"], ["position"], period=PERIOD, progress=interrupt)
    assert block.provenance["stopped"] == "interrupted" and block.provenance["evaluations"] == 7
    assert block.certificate.holds


@pytest.mark.parametrize(
    ("change", "error", "sentence"),
    [
        ({"outputs": ["positon"]}, DataError, "Did you mean 'position'"),
        ({"outputs": ["position", "velocity"]}, DataError, "one output is needed"),
        ({"outputs": ["current"]}, DataError, "named both as input and output"),
        ({"records": []}, DataError, "no recordings"),
        ({"period": 10.0}, DataError, "too few samples to train on"),
        ({"starts": 0}, DeclarationError, "starts"),
        ({"fit": "papier"}, DeclarationError, "no fit 'papier'"),
        ({"fit": "paper", "dead_time": 0.1}, DeclarationError, "has no dead time"),
        ({"dead_time": -0.1}, DeclarationError, "dead_time must not be negative"),
        ({"period": 0.0}, DeclarationError, "period must be positive"),
    ],
)
def test_what_cannot_be_learnt_is_refused_in_a_sentence(change, error, sentence):
    asked = {"records": [true_record(seconds=10.0)], "inputs": ["current"], "outputs": ["position"]} | change
    with pytest.raises(error, match=sentence):
        learn_piecewise(asked.pop("records"), asked.pop("inputs"), asked.pop("outputs"), **asked)
