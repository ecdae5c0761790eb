"""The network: its equations in CasADi, and its training on free runs."""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np
import pytest

from hydrotwin.learned import domain_share, read_block, train_network, write_block
from hydrotwin.learned.network import free_run as training
from hydrotwin.learned.network.form import Form
from hydrotwin.learned.network.learn import certify
from hydrotwin.learned.network.narx import NarxShape
from hydrotwin.learned.network.search import LOOK, Asked, Search
from hydrotwin.learned.network.series import series
from hydrotwin.learned.network.training import Meter, Problem
from hydrotwin.learned.training_data import as_signals
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import predict_one_step, simulate
from tests.learned.toy_machine import ANGLE, COMMAND, NOISE, PERIOD, SPEED, toy_record, untrained_block

QUICK = {"period": PERIOD, "hidden": 6, "starts": 1, "lags": (2, 4), "effort": 0.4}
BRIEF = QUICK | {"effort": 0.1}


def rmse(prediction, record, name="arm_angle"):
    return float(np.sqrt(np.mean((prediction[name] - record[name]) ** 2)))


@pytest.fixture(scope="module")
def recordings():
    return [toy_record(s) for s in (1, 2, 3)]


@pytest.fixture(scope="module")
def validation():
    return toy_record(9, name="validation")


@pytest.fixture(scope="module")
def trained(recordings):
    return train_network(recordings, [COMMAND], [ANGLE], **QUICK)


@pytest.mark.parametrize(("output_lags", "hidden"), [(2, 4), (1, 3), (0, 2), (2, 0)])
def test_the_step_is_the_written_equation(output_lags, hidden):
    block = untrained_block(hidden=hidden, output_lags=output_lags)
    a, rng = block.arrays, np.random.default_rng(0)
    for _ in range(20):
        y, d, u = rng.normal(size=2), rng.normal(size=2 * output_lags), rng.normal(size=3)
        z = np.concatenate(
            [
                (y - a["output_centre"]) / a["output_scale"],
                d / np.tile(a["increment_scale"], output_lags),
                (u - a["input_centre"]) / a["input_scale"],
            ]
        )
        h = np.tanh(a["hidden_weights"] @ np.clip(z, a["feature_lower"], a["feature_upper"]) + a["hidden_bias"])
        o = a["output_weights"] @ h + a["linear_weights"] @ z + a["output_bias"]
        o = np.clip(o, -a["increment_limit"], a["increment_limit"]) * a["increment_scale"]
        expected = [np.clip(y + o, a["output_lower"], a["output_upper"]), np.r_[o, d][: len(d)], u[:2]]
        x_next, y_now = block.step(np.concatenate([y, d, u[1:]]), u[0], [])
        assert np.allclose(x_next.full().ravel(), np.concatenate(expected), rtol=1e-13)
        assert np.array_equal(y_now.full().ravel(), y)


def test_a_free_run_stays_in_its_bounds_whatever_the_weights_and_inputs():
    record = toy_record(1, duration=10.0)
    wild = record.with_signals({"command": 1e6 * record["command"]})
    run = simulate(untrained_block(), wild)
    for name in ("arm_angle", "motor_speed"):
        assert run[name][1:].min() >= -3.0 and run[name][1:].max() <= 4.0


def test_the_start_is_the_first_measured_output_at_rest_with_the_first_input_in_the_line():
    x = untrained_block().start(0.7, [0.1, 5.0], []).full().ravel()
    assert np.array_equal(x, [0.1, 5.0, 0, 0, 0, 0, 0.7, 0.7])


def test_states_name_the_outputs_that_measure_them():
    states = untrained_block().states
    assert [s.measured_by for s in states[:2]] == ["arm_angle", "motor_speed"]
    assert all(s.measured_by is None for s in states[2:])
    assert states[2].name == "arm_angle.increment_1" and states[-1].name == "command.lag_2"


def free_run_case():
    """Scales, stretches and weights that meet every clip."""
    shape = NarxShape(1, 2, 2, 3, 3)
    bounds = [0.2, 0.3], [2, 2], [-1, -1], [1, 1], [-1.5] * 9, [1.2] * 9
    scales = training.Scales(*(np.array(v, dtype=float) for v in bounds))
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=(40, 1)), rng.normal(size=(40, 2))
    (stretches,) = training.gather(training.cut(u, y, 9, shape, np.array([0.2, 0.3]), rest=False))
    return shape, scales, stretches, rng.normal(size=shape.size)


def test_the_derivatives_carried_along_agree_with_differences():
    shape, scales, stretches, weights = free_run_case()
    every = np.arange(shape.size)
    run = training.free_run(weights, shape, scales, stretches)
    assert 0 < (~run.inside).mean() < 1 and 0 < (~run.moving).mean() < 1
    found = np.concatenate([J for _, J in training.derivatives(weights, shape, scales, stretches, run, every)])
    for k, step in enumerate(1e-6 * np.eye(shape.size)):
        after, before = (training.free_run(weights + s, shape, scales, stretches).outputs for s in (step, -step))
        assert np.allclose(found[..., k], (after - before) / 2e-6, atol=1e-7)


def test_normal_equations_are_sums_of_the_derivatives_of_the_trained_weights_alone():
    shape, scales, stretches, weights = free_run_case()
    some = np.arange(0, shape.size, 3)
    run = training.free_run(weights, shape, scales, stretches)
    J = np.concatenate([J for _, J in training.derivatives(weights, shape, scales, stretches, run, some)])
    rows, e = J[1::2].reshape(-1, len(some)), (run.outputs - stretches.target)[1::2].reshape(-1)
    JJ, Je, ee, count = training.normal_equations(weights, shape, scales, stretches, 2, some)
    assert np.allclose(JJ, rows.T @ rows) and np.allclose(Je, rows.T @ e)
    assert ee == pytest.approx(float(e @ e)) and count == len(e)


def test_the_free_run_of_the_network_follows_an_unseen_recording_within_a_third_of_a_degree(trained, validation):
    run = simulate(trained, validation)
    assert run["arm_angle"][0] == validation["arm_angle"][0]
    assert np.degrees(rmse(run, validation)) < 0.33
    assert np.degrees(np.std(validation["arm_angle"])) > 5.0


def test_the_hidden_layer_halves_the_error_of_the_best_linear_model(trained, recordings, validation):
    linear = train_network(recordings, [COMMAND], [ANGLE], **QUICK | {"hidden": 0})
    assert linear.description.startswith("NARX, linear")
    assert rmse(simulate(linear, validation), validation) > 2 * rmse(simulate(trained, validation), validation)


def test_one_step_ahead_the_error_is_near_the_sensor_noise(trained, validation):
    assert rmse(predict_one_step(trained, validation), validation) < 2 * NOISE


def test_the_certificate_holds_and_catches_a_changed_weight(trained):
    assert trained.certificate.holds and 0 < trained.certificate.difference <= 1e-12
    shape = NarxShape(1, 1, **trained.structure)
    weights = np.concatenate([trained.arrays[name].ravel() for name in shape.weights])
    assert certify(trained, weights, shape) == trained.certificate
    weights[3] += 1e-6
    assert not certify(trained, weights, shape).holds


def test_a_trained_network_comes_back_from_its_file(trained, validation, tmp_path):
    again = read_block(write_block(trained, tmp_path / "arm.toml")[0])
    assert np.array_equal(simulate(again, validation)["arm_angle"], simulate(trained, validation)["arm_angle"])
    assert again.certificate == trained.certificate


def test_provenance_names_recordings_seed_and_versions(trained, recordings):
    p = trained.provenance
    assert [r["sha256"] for r in p["trained_on"]] == [r.digest for r in recordings]
    assert p["seed"] == 0 and p["stopped"] == "finished" and {"numpy", "casadi"} <= set(p["versions"])


def test_the_domain_is_the_training_range_and_a_stronger_command_leaves_it(trained, recordings, validation):
    assert domain_share(trained, recordings[0]).inside == 1.0
    stronger = validation.with_signals({"command": 5 * validation["command"]})
    assert "command" in domain_share(trained, stronger).beyond


def test_the_same_seed_gives_the_same_network_and_another_seed_another(recordings):
    one, two, other = (train_network(recordings[:1], [COMMAND], [ANGLE], seed=s, **BRIEF) for s in (3, 3, 4))
    assert all(np.array_equal(one.arrays[k], two.arrays[k]) for k in one.arrays)
    assert not np.array_equal(one.arrays["hidden_weights"], other.arrays["hidden_weights"])


def test_a_candidate_that_can_no_longer_be_the_best_goes_no_further(recordings):
    """It ended after the last of the parts held out; now after that with which its error is too much."""
    search = Search(recordings[:1], [], (COMMAND,), (ANGLE,), Asked(period=0.1), Meter(None, None))
    problem = search.problem(search._forms()[0])

    def held_out(beat: float):
        before = search.meter.iterations
        found = search._held_out(problem, lambda pieces: (problem.least_squares(pieces),) * 2, LOOK, 0.0, 0, beat=beat)
        return found.error, search.meter.iterations - before

    error, iterations = held_out(np.inf)
    assert held_out(1.001 * error) == (error, iterations), "what may still win is judged on all parts"
    assert held_out(1e-3 * error)[0] == np.inf and held_out(1e-3 * error)[1] < iterations


def test_interrupting_keeps_the_best_so_far(recordings):
    seen = []

    def interrupt(step):
        seen.append(step)
        if len(seen) == 10:
            raise KeyboardInterrupt

    block = train_network(recordings[:1], [COMMAND], [ANGLE], progress=interrupt, **QUICK)
    assert block.provenance["stopped"] == "interrupted" and block.provenance["iterations"] == 10
    assert block.provenance["held_out_error"] == seen[-1].best and block.certificate.holds


def test_a_time_limit_ends_the_training_early_and_is_told(recordings):
    block = train_network(recordings[:1], [COMMAND], [ANGLE], budget=1e-3, **QUICK)
    assert block.provenance["stopped"] == "time limit of 0.001 s after 1 iterations"
    assert block.provenance["iterations"] == 1 and block.certificate.holds


def test_progress_reports_a_falling_best_error(recordings):
    steps = []
    train_network(recordings[:1], [COMMAND], [ANGLE], progress=steps.append, **BRIEF)
    best = [s.best for s in steps]
    assert best == sorted(best, reverse=True) and best[-1] < 0.8 * best[0]


def test_every_seed_s_held_out_error_is_told(trained):
    told = trained.provenance["seeds"]
    assert [row["seed"] for row in told] == [0] and told[0]["held_out_error"] == trained.provenance["held_out_error"]


def test_a_recording_to_validate_with_changes_nothing_and_one_to_select_with_does(recordings):
    def arrays(**given):
        return train_network(recordings[:2], [COMMAND], [ANGLE], **BRIEF, **given).arrays

    plain, judged, other = arrays(), arrays(validate=[toy_record(5)]), arrays(validate=[toy_record(6)])
    assert all(plain[k].tobytes() == judged[k].tobytes() == other[k].tobytes() for k in plain)
    selected = arrays(select=[toy_record(5, name="shift").with_signals({"arm_angle": toy_record(6)["arm_angle"]})])
    assert any(plain[k].shape != selected[k].shape or plain[k].tobytes() != selected[k].tobytes() for k in plain)


def test_two_outputs_are_learnt_together_and_selection_on_given_recordings_is_recorded(recordings, validation):
    names = ["arm_angle", "motor_speed"]
    block = train_network(recordings, ["command"], names, select=[toy_record(5)], **QUICK)
    run = simulate(block, validation)
    assert np.degrees(rmse(run, validation)) < 1.0
    assert rmse(run, validation, "motor_speed") < 0.1 * np.std(validation["motor_speed"])
    assert block.outputs == (Signal("arm_angle", "rad"), Signal("motor_speed", "rad/s"))
    assert block.provenance["selected_on"][0]["name"] == "toy_5"


def test_uneven_fast_recordings_are_brought_onto_a_chosen_period(validation):
    rng, uneven = np.random.default_rng(0), []
    for seed in (1, 2):
        record = toy_record(seed)
        times = np.sort(rng.choice(len(record), round(0.95 * len(record)), replace=False))
        uneven.append(record.resample(times=record.time[times], hold=["command"]))
    options = {key: value for key, value in QUICK.items() if key != "period"}
    block = train_network(uneven, [COMMAND], [ANGLE], **options | {"effort": 0.2})
    assert block.period >= PERIOD
    assert np.degrees(rmse(simulate(block, validation), validation)) < 2.0


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"outputs": ["arm_angel"]}, "Did you mean 'arm_angle'"),
        ({"outputs": ["command"]}, "named both as input and output"),
        ({"outputs": "arm_angle"}, "must be a list"),
        ({"outputs": []}, "must be a list"),
        ({"hidden": 500}, r"too few samples for \d+ weights"),
        ({"period": 2.0}, "too few samples to train on"),
        ({"records": []}, "no recordings"),
    ],
)
def test_what_cannot_be_learnt_from_is_refused_in_a_sentence(recordings, change, sentence):
    asked = {"records": recordings[:1], "inputs": ["command"], "outputs": ["arm_angle"], **QUICK} | change
    with pytest.raises(DataError, match=sentence):
        train_network(asked.pop("records"), asked.pop("inputs"), asked.pop("outputs"), **asked)


@pytest.mark.parametrize(
    "option", [{"hidden": -1}, {"starts": 0}, {"lags": (-1, 2)}, {"effort": 0}, {"period": -0.01}, {"hidden": 2.5}]
)
def test_impossible_options_are_refused(recordings, option):
    with pytest.raises(DeclarationError, match=next(iter(option))):
        train_network(recordings[:1], ["command"], ["arm_angle"], **QUICK | option)


def test_a_block_without_a_domain_has_no_share(trained, validation):
    with pytest.raises(DataError, match="no training domain"):
        domain_share(dataclasses.replace(trained, domain=None), validation)


def test_the_speed_signal_keeps_its_own_unit_when_named_as_a_signal(recordings):
    block = train_network(recordings[:1], [COMMAND], [SPEED], **BRIEF | {"hidden": 0})
    assert block.outputs == (SPEED,) and block.states[0].unit == "rad/s"


def test_a_network_without_past_increments_steps_like_any():
    block = untrained_block(outputs=(ANGLE,), output_lags=0)
    x, y = block.step(np.zeros(len(block.states)), 0.5, [])
    assert x.shape == (len(block.states), 1) and y.shape == (1, 1)


def tank(samples: int = 400, period: float = 4.0) -> Record:
    """A level behind two lags, sampled so slowly that a few hundred samples are all there is."""
    rng = np.random.default_rng(2)
    u = np.repeat(rng.uniform(1, 5, samples), rng.integers(5, 30, samples))[:samples]
    upper, lower = np.zeros(samples), np.zeros(samples)
    for k in range(samples - 1):
        upper[k + 1] = upper[k] + 0.1 * (u[k] - upper[k])
        lower[k + 1] = lower[k] + 0.1 * (upper[k] - lower[k])
    level = lower + 0.01 * rng.normal(size=samples)
    return Record(period * np.arange(samples), {"pump": u, "level": level}, {"pump": "V", "level": "V"}, "tank")


def test_few_slow_samples_get_a_small_model_and_no_refusal():
    whole = tank()
    block = train_network([whole.window(0, 1200.0)], ["pump"], ["level"], starts=1, effort=0.3)
    assert block.provenance["stopped"] == "finished" and block.provenance["form"]["integrates"] is False
    assert rmse(simulate(block, whole), whole, "level") < 0.05 * np.std(whole["level"])


def test_what_only_changes_with_its_input_is_found_to_integrate_and_late_inputs_are_found():
    """A counter of a late input: held-out free runs find that it integrates, and by how much it is late."""
    rng = np.random.default_rng(4)
    u = np.repeat(rng.uniform(-1, 1, 200), rng.integers(6, 30, 200))[:1500]
    late = np.concatenate([np.full(8, u[0]), u[:-8]])
    y = np.concatenate([[0.0], np.cumsum(0.05 * np.tanh(late[:-1]))]) + 1e-3 * rng.normal(size=1500)
    record = Record(0.1 * np.arange(1500), {"u": u, "y": y}, {"u": "V", "y": "m"}, "counter")
    block = train_network([record], ["u"], ["y"], period=0.1, hidden=0)
    form = block.provenance["form"]
    assert form["delay"] in (5, 8) and form["input_lags"] > 8
    assert rmse(simulate(block, record), record, "y") < 0.05 * np.std(y)


def test_a_linear_model_whose_free_run_grows_is_not_taken():
    """A pole of 1.0001 outlives any held-out part, and no longer run; where the output integrates it is 1."""
    form = Form(0.1, 1, 2)
    u = np.random.default_rng(0).normal(size=(300, 1))
    y = np.concatenate([[0.0], np.cumsum(0.1 * u[:-1, 0])])
    record = Record(0.1 * np.arange(300), {"u": u[:, 0], "y": y}, {"u": "V", "y": "m"}, "rod")
    inputs, outputs = (as_signals([n], record, "signals") for n in "uy")
    for integrates, change, grows in ((False, 1e-4, True), (False, -1e-4, False), (True, 0.0, False)):
        problem = Problem.of(replace(form, integrates=integrates), series([record], [], inputs, outputs, 0.1))
        weights = np.zeros(problem.shape.size)
        training.weight_arrays(weights, problem.shape)[3][0, 0] = change / problem.scales.increment[0]
        assert problem.grows(weights) is grows
