"""identify on a small linear machine: truth, intervals, bounds, what cannot be told, and what must be refused."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.identification import identify
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records.record import Record
from hydrotwin.simulation import simulate
from tests.identification.drive import drive, recorded
from tests.simulation.flat_cehA import flat_cehA

NOISE = {"position": 0.01, "motor_speed": 0.1}
OFF = {"motor.gain": 13.0, "motor.time_constant": 0.07}


def test_parameters_come_back_from_the_models_own_simulation():
    fit = identify(drive(), [recorded(drive(), 1), recorded(drive(), 2)], start=OFF)
    assert fit.values["motor.gain"] == pytest.approx(10.0, rel=1e-6)
    assert fit.values["motor.time_constant"] == pytest.approx(0.1, rel=1e-5)
    assert fit.converged


def test_a_parameter_a_thousand_times_its_nominal_moves_by_its_own_size():
    """A friction that may be nil has no logarithm; half a nominal value a step would take it thousands of steps."""
    flat = drive()
    gain = dataclasses.replace(flat.parameters[0], bounds=(0.0, 1e3), nominal=0.01)
    flat = dataclasses.replace(flat, parameters=(gain, *flat.parameters[1:]))
    fit = identify(flat, [recorded(drive(), 1)], start={"motor.gain": 0.01}, starts=1, windows=())
    assert fit.converged and fit.values["motor.gain"] == pytest.approx(10.0, rel=1e-4)


def test_the_fit_knows_where_it_started_what_it_used_and_how_long_it_took():
    train, validate = recorded(drive(), 1, noise=NOISE), recorded(drive(), 2, noise=NOISE)
    fit = identify(drive(), [train], start=OFF, validate=[validate])
    gain = fit.parameter("motor.gain")
    assert gain.start == 13.0
    assert gain.bounds == (1e-3, 1e3)
    assert gain.unit == "rad/(s.V)"
    assert gain.shift == pytest.approx((gain.value - 13.0) / 13.0)
    assert fit.provenance == {"run_1": "digest of 1", "run_2": "digest of 2"}
    assert {(r.record, r.role) for r in fit.residuals} == {("run_1", "train"), ("run_2", "validate")}
    assert 0 < fit.seconds < 60
    assert fit.flat.parameter_vector()[fit.flat.index_of("motor.gain")] == gain.value
    assert next(p for p in fit.flat.parameters if p.name == "motor.gain").sigma == gain.sigma
    assert fit.noise["position"] == pytest.approx(0.01, rel=0.15)


def test_white_residuals_are_called_explained_and_a_wrong_model_is_not():
    right = identify(drive(), [recorded(drive(), 1, noise=NOISE)])
    assert all(r.explained for r in right.residuals)
    assert not right.findings
    slow = recorded(drive(), 1, noise=NOISE, parameters={"pump.displacement": 0.19})
    wrong = identify(drive(), [slow], starts=1)
    assert not all(r.explained for r in wrong.residuals)
    assert "unexplained" in {f.kind for f in wrong.findings}


def test_sigmas_cover_the_truth_as_often_as_they_say():
    z = []
    for seed in range(60):
        fit = identify(drive(), [recorded(drive(), 100 + seed, noise=NOISE, duration=6.0)], starts=1, windows=())
        z.append([(fit.values[n] - t) / fit.sigma[n] for n, t in (("motor.gain", 10.0), ("motor.time_constant", 0.1))])
    z = np.array(z)
    assert np.all(np.abs(z.mean(axis=0)) < 4 / np.sqrt(60))
    assert np.all((z.std(axis=0) > 0.72) & (z.std(axis=0) < 1.28))


def test_short_windows_with_noisy_starts_do_not_bias_the_parameters():
    loud = {"position": 0.05, "motor_speed": 0.5}
    z = []
    for seed in range(12):
        fit = identify(drive(), [recorded(drive(), 300 + seed, noise=loud)], start=OFF, starts=1, windows=(0.5, 2.0))
        z.append((fit.values["motor.gain"] - 10.0) / fit.sigma["motor.gain"])
    assert abs(np.mean(z)) < 3.5 / np.sqrt(len(z))


def test_coloured_residuals_widen_the_interval():
    record = recorded(drive(), 1, noise=NOISE)
    random, slow = np.random.default_rng(5), np.zeros(len(record.time))
    for k in range(1, len(slow)):
        slow[k] = 0.97 * slow[k - 1] + 0.1 * random.normal()
    coloured = record.with_signals({"motor_speed": record["motor_speed"] + slow})
    fit = identify(drive(), [coloured], starts=1, noise=NOISE, outputs=["motor_speed"])
    assert fit.parameter("motor.gain").sigma > 1.5 * fit.parameter("motor.gain").sigma_white


def test_a_bound_that_cuts_off_the_truth_is_reached_and_named():
    fit = identify(drive(), [recorded(drive(), 1, noise=NOISE)], start={"motor.gain": 8.0}, starts=1,
                   bounds={"motor.gain": (5.0, 9.0)})  # fmt: skip
    gain = fit.parameter("motor.gain")
    assert gain.value == pytest.approx(9.0)
    assert gain.at_bound and not fit.parameter("motor.time_constant").at_bound
    assert any(f.kind == "at_bound" and "motor.gain rests on its upper bound" in f.sentence for f in fit.findings)


def test_a_parameter_without_effect_is_named():
    fit = identify(drive(), [recorded(drive(), 1, noise=NOISE)], free=["motor.*", "lamp"])
    finding = next(f for f in fit.findings if f.kind == "no_effect")
    assert finding.parameters == ("lamp",)
    assert finding.sentence.startswith("identify: lamp has no effect on any recorded output")
    assert np.isnan(fit.sigma["lamp"])
    assert fit.values["motor.gain"] == pytest.approx(10.0, abs=4 * fit.sigma["motor.gain"])


def test_two_parameters_that_only_act_as_a_product_are_named_with_the_missing_sensor():
    record = recorded(drive(), 1, noise=NOISE, outputs=("position",))
    fit = identify(drive(), [record], free=["motor.gain", "pump.displacement"])
    finding = next(f for f in fit.findings if f.kind == "indistinguishable")
    assert set(finding.parameters) == {"motor.gain", "pump.displacement"}
    assert "cannot be told apart in these recordings (correlation -1.0000)" in finding.sentence
    assert finding.sentence.endswith("Fix one, or record motor_speed.")
    seen = identify(drive(), [recorded(drive(), 1, noise=NOISE)], free=["motor.gain", "pump.displacement"])
    assert not [f for f in seen.findings if f.kind == "indistinguishable"]


@pytest.mark.parametrize("loss", ["soft_l1", "huber"])
def test_a_robust_loss_withstands_outliers(loss):
    record = recorded(drive(), 1, noise=NOISE)
    random = np.random.default_rng(0)
    spoiled = record["motor_speed"].copy()
    hit = random.choice(len(spoiled), 25, replace=False)
    spoiled[hit] += 8.0
    record = record.with_signals({"motor_speed": spoiled})
    plain, robust = (
        identify(drive(), [record], starts=1, loss=kind, noise=NOISE, outputs=["motor_speed"])
        for kind in ("linear", loss)
    )
    assert abs(plain.values["motor.gain"] - 10.0) > 3 * abs(robust.values["motor.gain"] - 10.0)
    assert robust.values["motor.gain"] == pytest.approx(10.0, rel=0.01)


def test_a_dead_time_is_found_from_a_start_at_zero():
    model = drive(dead_time=True)
    record = recorded(model, 3, noise=NOISE, parameters={"delay": 0.137}, period=0.01)
    fit = identify(model, [record], free=["motor.*", "delay"])
    assert fit.values["delay"] == pytest.approx(0.137, abs=4 * fit.sigma["delay"])
    assert fit.sigma["delay"] < 2e-3
    assert fit.values["motor.gain"] == pytest.approx(10.0, abs=4 * fit.sigma["motor.gain"])


def test_start_states_are_estimated_and_the_first_sample_is_not_taken_as_exact():
    loud = {"position": 0.2}
    record = recorded(drive(), 4, noise=loud, start=(3.0, 1.5))
    shifted = record["position"].copy()
    shifted[0] += 1.0
    record = record.with_signals({"position": shifted})
    auto = identify(drive(), [record], starts=1, noise={"position": 0.2, "motor_speed": 0.1})
    fixed = identify(drive(), [record], starts=1, noise={"position": 0.2, "motor_speed": 0.1}, initial_states="fixed")
    free = identify(drive(), [record], starts=1, noise={"position": 0.2, "motor_speed": 0.1}, initial_states="free")
    assert auto.records[0].start["piston.position"] == pytest.approx(1.5, abs=0.1)
    assert free.records[0].start["motor.speed"] == pytest.approx(3.0, abs=0.2)
    assert fixed.chi2 > 2 * auto.chi2


def test_an_unmeasured_start_state_is_found_unless_it_is_fixed():
    record = recorded(drive(), 4, noise=NOISE, start=(5.0, 0.0), outputs=("position",))
    free = identify(drive(), [record], initial_states="free", starts=1)
    assert free.records[0].start["motor.speed"] == pytest.approx(5.0, abs=0.5)
    auto = identify(drive(), [record], starts=1)
    assert auto.records[0].start["motor.speed"] == pytest.approx(5.0, abs=0.5)
    assert identify(drive(), [record], starts=1, initial_states="fixed").chi2 > 1.3 * free.chi2


def test_samples_that_are_missing_are_left_out():
    record = recorded(drive(), 1, noise=NOISE)
    holes = record["position"].copy()
    holes[50:200] = np.nan
    fit = identify(drive(), [record.with_signals({"position": holes})])
    assert fit.values["motor.gain"] == pytest.approx(10.0, abs=4 * fit.sigma["motor.gain"])
    assert next(r for r in fit.residuals if r.output == "position").samples == len(holes) - 150


def test_progress_names_the_stages():
    stages = []
    record = recorded(drive(), 1, noise=NOISE)
    identify(drive(), [record], start=OFF, progress=lambda stage, k, cost: stages.append(stage))
    assert stages[0] == "compile"
    assert any(s.startswith("windows of") for s in stages)
    assert "free run" in stages
    assert stages[-1] == "uncertainty"


def test_the_same_call_gives_the_same_bits():
    records = [recorded(drive(), 1, noise=NOISE), recorded(drive(), 2, noise=NOISE)]
    first, second = (identify(drive(), records, start=OFF, threads=2) for _ in range(2))
    assert first.values == second.values


def test_negative_parameters_are_fitted_too():
    model = drive(positive=False)
    record = recorded(model, 1, noise=NOISE, parameters={"motor.gain": -10.0})
    fit = identify(model, [record], start={"motor.gain": 2.0})
    assert fit.values["motor.gain"] == pytest.approx(-10.0, abs=4 * fit.sigma["motor.gain"])


def test_a_start_outside_its_bounds_is_refused():
    with pytest.raises(DeclarationError, match=r"drive\.motor\.gain: the start lies outside its bounds \(got 10 "):
        identify(drive(), [recorded(drive(), 1)], bounds={"motor.gain": (20.0, 30.0)})


def test_an_unknown_free_parameter_is_refused_with_the_nearest_name():
    with pytest.raises(DeclarationError, match=r"no parameter matches 'motor\.gian'\. Did you mean 'motor\.gain'\?"):
        identify(drive(), [recorded(drive(), 1)], free=["motor.gian"])


def test_no_recording_is_refused():
    with pytest.raises(DataError, match=r"no recording to fit drive to"):
        identify(drive(), [])


def test_a_constant_output_is_refused_unless_its_noise_is_given():
    record = recorded(drive(), 1, noise=NOISE)
    flat = record.with_signals({"position": np.full(len(record.time), 0.25)})
    with pytest.raises(DataError, match=r"output 'position' is constant in every recording \(got 0\.25\)"):
        identify(drive(), [flat])


def test_a_missing_input_and_missing_outputs_are_refused():
    record = recorded(drive(), 1)
    with pytest.raises(DataError, match=r"input 'command' .V. of drive is not recorded"):
        identify(drive(), [record.select(["position"])])
    with pytest.raises(DataError, match=r"none of the outputs of drive is recorded"):
        identify(drive(), [record.select(["command"])])


def test_an_unknown_option_is_refused_with_the_choice():
    record = recorded(drive(), 1, noise=NOISE)
    with pytest.raises(DeclarationError, match=r"no loss 'soft-l1'. Did you mean 'soft_l1'"):
        identify(drive(), [record], loss="soft-l1")
    with pytest.raises(DeclarationError, match=r"no initial_states 'fixd'. Did you mean 'fixed'"):
        identify(drive(), [record], initial_states="fixd")
    with pytest.raises(DeclarationError, match=r"drive has no output 'speed'"):
        identify(drive(), [record], noise={"speed": 1.0})


def test_a_model_object_is_taken_through_its_flat_form():
    @dataclasses.dataclass
    class Model:
        flat: object

    fit = identify(Model(drive()), [recorded(drive(), 1, noise=NOISE)], starts=1)
    assert fit.name == "drive"


def test_a_record_on_a_jittered_clock_is_fitted_as_well_as_an_even_one():
    record = recorded(drive(), 1, noise=NOISE)
    random = np.random.default_rng(1)
    kept = np.sort(random.choice(len(record.time), int(0.7 * len(record.time)), replace=False))
    kept[0] = 0
    held = Record(record.time[kept], {n: v[kept] for n, v in record.signals.items()}, record.units, name="jittered")
    fit = identify(drive(), [held], starts=1, noise=NOISE)
    assert fit.values["motor.gain"] == pytest.approx(10.0, rel=0.05)


def test_a_parameter_without_effect_stays_where_it_was_whichever_start_wins():
    """Other starts move it too; the one that wins must not leave its value in the model file."""
    time = np.arange(0, 5, 0.01)
    units = {"command": "V", "motor_speed": "rad/s"}
    record = Record(time, {"command": np.sin(time), "motor_speed": 0 * time}, units, "speed")
    model = flat_cehA()
    noise = 0.3 * np.random.default_rng(0).standard_normal(len(time))
    record = record.with_signals({"motor_speed": simulate(model, record)["motor_speed"] + noise}, units=units)
    fit = identify(model, [record], free=["motor.gain", "cylinder.friction.viscous"], start={"motor.gain": 80.0})
    assert fit.values["cylinder.friction.viscous"] == 741.36
    assert abs(fit.values["motor.gain"] - 120.0) < 4 * fit.sigma["motor.gain"]


@pytest.mark.parametrize(
    ("chi2", "lag_one", "white", "explained"),
    [(0.95, -0.02, False, True), (1.0, 0.0, True, True), (1.0, 0.4, False, False), (1.3, 0.0, True, False)],
)
def test_what_is_left_is_noise_when_its_size_is_right_and_neighbours_hardly_agree(chi2, lag_one, white, explained):
    from hydrotwin.identification import OutputResidual

    rest = OutputResidual("run", "angle", "train", 1.0, 1.0, "rad", 1000, chi2, lag_one, 1e-4, white)
    assert rest.explained is explained
