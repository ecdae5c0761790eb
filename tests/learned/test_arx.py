"""ARX by least squares: the truth found again where it is linear, its order and period chosen by free run."""

from __future__ import annotations

import time

import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.learned import learn_arx
from hydrotwin.learned.block_file import assemble
from hydrotwin.learned.linear.arx_block import ARX, arx_states
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import predict_one_step, simulate
from tests.learned.test_integrating import PERIOD, integral, late, recording, settled, steps

WRITTEN = {
    "constant": [0.02, 0.0],
    "level": [-0.1, 0.0],
    "increments": [[0.5, 0.3], [0.1, 0.0]],
    "inputs": [[[0.0], [0.0]], [[0.3], [0.05]], [[0.1], [0.0]]],
    "direct": [[0.0], [0.0]],
}


def written_block(**changes):
    """Two outputs: the first settles, the second integrates."""
    structure = {"increments": 2, "input_lags": 2, "direct": int("direct" in changes)}
    inputs, outputs = (Signal("u", "V"),), (Signal("speed", "m/s"), Signal("position", "m"))
    return assemble(
        ARX, WRITTEN | changes, structure, name="written", inputs=inputs, outputs=outputs, parameters=(),
        period=PERIOD, states=arx_states(structure, inputs, outputs),
    )  # fmt: skip


def rms(block, records, name="y") -> float:
    return float(np.sqrt(np.mean(np.concatenate([simulate(block, r)[name] - r[name] for r in records]) ** 2)))


def rested(answer, seed: int, noise: float = 0.0) -> Record:
    """The answer to steps that begin at rest."""
    u = np.concatenate([np.zeros(30), steps(seed)])
    y = answer(u)
    y = y + noise * np.ptp(y) * np.random.default_rng(seed).normal(size=len(y))
    return only({"u": u, "y": y}, {"u": "V", "y": "m"}, f"rested_{seed}")


def brief(samples: int) -> Record:
    """Steps of 0.1 s into a lag of as much, with noise of 1 %."""
    rng = np.random.default_rng(8)
    u = np.repeat(rng.uniform(-1, 1, samples), 5)[:samples]
    return only({"u": u, "y": settled(u, 0.1) + 0.01 * rng.normal(size=samples)}, {"u": "V", "y": "m"})


def only(columns: dict, units: dict, name="run") -> Record:
    n = len(next(iter(columns.values())))
    return Record(PERIOD * np.arange(n), columns, units, name)


def test_the_block_is_the_written_recursion():
    """By hand: increments of w from w, its own increments and late inputs."""
    u = steps(3)[:60]
    w = np.zeros((len(u), 2))
    w[0], before = (0.4, 0.1), np.zeros((2, 2))
    line = np.full(3, u[0])
    for k in range(len(u) - 1):
        line = np.array([u[k], *line[:2]])
        moved = np.array(WRITTEN["constant"]) + WRITTEN["level"] * w[k]
        moved += sum(np.array(f) * d for f, d in zip(WRITTEN["increments"], before, strict=True))
        moved += sum(np.array(b)[:, 0] * v for b, v in zip(WRITTEN["inputs"], line, strict=True))
        w[k + 1], before = w[k] + moved, np.array([moved, before[0]])
    record = only({"u": u, "speed": w[:, 0], "position": w[:, 1]}, {"u": "V", "speed": "m/s", "position": "m"})
    run = simulate(written_block(), record)
    assert run["speed"] == pytest.approx(w[:, 0], abs=1e-13) and run["position"] == pytest.approx(w[:, 1], abs=1e-13)
    direct = written_block(direct=[[0.7], [0.0]])
    again = simulate(direct, record)
    assert again["speed"][0] == pytest.approx(w[0, 0]) and direct.states[0].measured_by is None
    assert again["speed"][20:] != pytest.approx(w[20:, 0], abs=1e-3)


LINEAR = {
    "one that settles": (lambda u: settled(u, 0.1) + 3.0, False),
    "one that integrates, behind a lag": (lambda u: integral(settled(u, 0.1)), True),
    "at once": (lambda u: 2 * u + 1, False),
    "after a dead time": (lambda u: settled(late(u, 7), 0.06), False),
}


@pytest.mark.parametrize("answer", LINEAR)
def test_a_linear_machine_is_found_again_from_what_was_recorded(answer):
    machine, integrates = LINEAR[answer]
    block = learn_arx([rested(machine, k) for k in (1, 2)], ["u"], ["y"])
    fresh = rested(machine, 7)
    assert rms(block, [fresh]) < 1e-6 * np.ptp(fresh["y"])
    assert block.provenance["arx"]["y"]["rate"] is integrates
    assert block.certificate.holds


def test_noise_costs_little_and_the_form_is_right():
    machine = LINEAR["one that integrates, behind a lag"][0]
    block = learn_arx([rested(machine, k, noise=0.01) for k in (1, 2)], ["u"], ["y"])
    fresh = rested(machine, 7)
    assert block.provenance["arx"]["y"]["rate"] and rms(block, [fresh]) < 0.03 * np.ptp(fresh["y"])


def test_a_dead_time_is_told_as_one():
    block = learn_arx([recording(lambda u: settled(late(u, 9), 0.1), noise=1e-4)], ["u"], ["y"], period=PERIOD)
    window = block.provenance["arx"]["y"]["inputs"]["u"]
    assert window["delay"] + window["samples"] - 1 >= 9 and window["delay"] <= 10


def test_two_inputs_and_two_outputs_of_two_forms():
    u, v = steps(1), steps(2)
    y, z = settled(u + 0.5 * late(v, 3), 0.1), integral(v - 0.2 * u)
    record = only({"u": u, "v": v, "y": y, "z": z}, {"u": "V", "v": "Pa", "y": "Pa", "z": "1"})
    half = PERIOD * len(u) / 2
    block = learn_arx([record.window(None, half)], ["u", "v"], ["y", "z"])
    rest = record.window(half, None)
    # the rest begins in motion, which the block takes for rest: what settles forgets it
    late_part = slice(100, None)
    miss = simulate(block, rest)["y"][late_part] - rest["y"][late_part]
    assert np.abs(miss).max() < 1e-3 * np.ptp(y)
    told = block.provenance["arx"]
    assert told["z"]["rate"] and not told["y"]["rate"]


@pytest.mark.parametrize("samples", [50, 120, 1000])
def test_few_samples_get_a_small_model(samples):
    block = learn_arx([brief(samples)], ["u"], ["y"])
    assert block.provenance["arx"]["y"]["past"] <= 4
    assert rms(block, [recording(lambda u: settled(u, 0.1), 9)]) < 0.1


def test_a_longer_period_is_taken_where_it_runs_better():
    """At 1 kHz the noise of neighbours hides a lag of half a second."""
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(-1, 1, 60), 200)
    a = np.exp(-1e-3 / 0.5)
    from scipy.signal import lfilter

    y = lfilter([0.0, 1 - a], [1.0, -a], u)
    record = Record(1e-3 * np.arange(len(u)), {"u": u, "y": y + 0.02 * rng.normal(size=len(u))}, {"u": "V", "y": "1"})
    block = learn_arx([record], ["u"], ["y"])
    assert block.period >= 4e-3
    fixed = learn_arx([record], ["u"], ["y"], period=1e-3, refine=False)
    truth = record.with_signals({"y": y})
    assert rms(block, [truth]) < 1.05 * rms(fixed, [truth])


def test_it_is_stable_where_least_squares_alone_is_not():
    """An unstable plant under feedback: a recording from which one-step least squares gives a pole outside."""
    rng = np.random.default_rng(1)
    y, u = np.zeros(800), np.zeros(800)
    reference = np.repeat(rng.uniform(-1, 1, 40), 20)
    for k in range(799):
        u[k] = 2 * (reference[k] - y[k])
        y[k + 1] = 1.02 * y[k] + 0.1 * u[k] + 0.01 * rng.normal()
    block = learn_arx([only({"u": u, "y": y}, {"u": "V", "y": "1"})], ["u"], ["y"])
    long = only({"u": np.zeros(5000), "y": np.ones(5000)}, {"u": "V", "y": "1"})
    assert np.abs(simulate(block, long)["y"]).max() < 20


def test_what_chooses_may_be_given_and_is_not_fitted():
    machine = LINEAR["one that settles"][0]
    train, other = recording(machine, 1), recording(lambda u: settled(u, 0.3), 2)
    one, two = (learn_arx([train], ["u"], ["y"], select=[s], refine=False) for s in (other, other))
    assert one.provenance["selected_on"][0]["name"] == other.name
    assert all(np.array_equal(one.arrays[k], two.arrays[k]) for k in one.arrays)
    fixed = {"period": PERIOD, "lags": (2, 2), "delay": 1, "rate": False, "refine": False}
    same = [learn_arx([train], ["u"], ["y"], select=s, **fixed) for s in ([], [other])]
    drift = [np.abs(same[0].arrays[k] - same[1].arrays[k]).max() for k in same[0].arrays]
    assert max(drift) < 1e-9  # only the order could be chosen by it


def test_recordings_to_validate_with_change_nothing():
    train = [recording(LINEAR["one that settles"][0], 1)]
    blocks = [learn_arx(train, ["u"], ["y"], validate=v) for v in ([], [recording(lambda u: u, 5)])]
    assert all(np.array_equal(blocks[0].arrays[k], blocks[1].arrays[k]) for k in blocks[0].arrays)


def test_refining_in_free_run_is_kept_only_where_it_runs_better_held_out():
    """Coloured noise bends one-step least squares; the free run does not see it."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(-1, 1, 200), 10)
    from scipy.signal import lfilter

    y = lfilter([0.0, 0.1], [1.0, -0.9], u)
    seen = y + 0.2 * rng.normal(size=len(u))
    record = only({"u": u, "y": seen}, {"u": "V", "y": "1"})
    options = {"period": PERIOD, "lags": (1, 1), "delay": 1, "rate": False}
    plain, refined = (learn_arx([record], ["u"], ["y"], refine=r, **options) for r in (False, True))
    truth = record.with_signals({"y": y})
    assert rms(refined, [truth]) < 0.3 * rms(plain, [truth])
    assert refined.arrays["level"][0] == pytest.approx(-0.1, abs=0.01)


def test_ten_thousand_samples_take_well_below_a_second():
    record = recording(lambda u: integral(settled(u, 0.1)), 3)
    many = [recording(lambda u: integral(settled(u, 0.1)), k) for k in range(8)]
    assert 9000 < len(record) * 8 < 11000
    began = time.process_time()
    learn_arx(many, ["u"], ["y"], refine=False)
    assert time.process_time() - began < 2.0  # 0.3 s on a quiet core


def test_one_step_prediction_uses_the_measured_output():
    train = [recording(lambda u: settled(u, 0.1), k, noise=1e-3) for k in (1, 2)]
    block, fresh = learn_arx(train, ["u"], ["y"]), recording(lambda u: 0.3 + settled(u, 0.1), 8, noise=1e-3)
    ahead = np.sqrt(np.mean((predict_one_step(block, fresh)["y"] - fresh["y"]) ** 2))
    assert ahead < 0.3 * rms(block, [fresh])


def test_the_exported_code_runs_as_the_block_does(tmp_path):
    block = learn_arx([recording(lambda u: integral(u), 1)], ["u"], ["y"])
    fresh = recording(lambda u: integral(u), 2)
    found = read_fmu(export_fmu(block, tmp_path / "arx.fmu")).free_run(fresh)["y"]
    assert found == pytest.approx(simulate(block, fresh)["y"], abs=1e-9)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"period": 0.0}, "period must be positive"),
        ({"lags": (1, 0)}, r"lags\[1\] must be a whole number from 1 up"),
        ({"delay": -1}, "delay must be a whole number from 0 up"),
        ({"lags": (1,)}, "past values, and samples of every input"),
        ({"lags": 5}, r"got 5\). Write 2,6"),
    ],
)
def test_impossible_options_are_refused(options, says):
    with pytest.raises(DeclarationError, match=says):
        learn_arx([recording(lambda u: u)], ["u"], ["y"], **options)


def test_too_little_is_refused_with_the_number():
    with pytest.raises(DataError, match=r"too few samples to train on \(got 26\)"):
        learn_arx([brief(26)], ["u"], ["y"])
