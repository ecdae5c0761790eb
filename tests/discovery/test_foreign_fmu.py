"""An FMU whose inside nobody knows: what is found before its inputs and after its outputs, and what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrotwin.discovery.around.surroundings import surrounded
from hydrotwin.discovery.discover import discover
from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.export.repeated import runs_made
from hydrotwin.identification import identify
from hydrotwin.loading import load
from hydrotwin.models.effects import add_effect, candidates
from hydrotwin.models.language import Model
from hydrotwin.models.language.errors import DataError, DeclarationError, SolveError, UnitError
from hydrotwin.models.language.model_file import write_model_file
from hydrotwin.records import Record
from hydrotwin.simulation import prepare, simulate
from tests.discovery.slides import PERIOD, Drive, Inline, TwoSensors, drive_records
from tests.export.foreign import CRASHES, HANGS, fmi3_model_exchange, rewritten

LATE, SLOW = 3, 0.2  # samples, s
TRUE = {"gain": 10.0, "time_constant": 0.3}
SOME = ("dead_time", "actuator_lag", "command_deadband", "null_bias", "sensor_scale", "sensor_lag", "sensor_bias")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fmus")


@pytest.fixture(scope="module")
def two_sensors(folder):
    """The drive as it is, measured twice, as an FMU."""
    path = folder / "two_sensors.fmu"
    export_fmu(Model(TwoSensors(), step=2e-3).with_parameters(TRUE), path)
    return read_fmu(path)


@pytest.fixture(scope="module")
def one_sensor(folder):
    """The drive with another time constant than the true one, measured once, as an FMU."""
    path = folder / "one_sensor.fmu"
    export_fmu(Model(Drive(), step=2e-3).with_parameters(TRUE | {"time_constant": 0.2}), path)
    return read_fmu(path)


def same(w, time):
    """The second sensor tells the truth as well."""
    return w


def later(u):
    """A command that acts three samples late."""
    return np.concatenate([np.full(LATE, u[0]), u[:-LATE]])


def found(fmu, runs, **more):
    """What is found around an FMU, looked for in this thread."""
    return discover(fmu, runs, executor=Inline(), **more)


# -- what is named ----------------------------------------------------------------------------------------------------
@pytest.mark.proof
def test_a_dead_time_before_an_fmu_is_named_with_its_time(two_sensors):
    answer = found(two_sensors, drive_records(2, other=same, command=later), validate=drive_records(1, 7, other=same,
                   command=later))  # fmt: skip
    assert answer.verdict == "named"
    (step,) = answer.steps
    assert (step.effect, step.site) == ("dead_time", "command")
    assert step.parameters[0].value == pytest.approx(LATE * PERIOD, rel=0.02)
    assert all(o.gap_closed > 0.99 for o in answer.outputs["validate"])


def test_a_wrong_scale_of_one_sensor_behind_an_fmu_is_named_at_that_sensor(two_sensors):
    runs = drive_records(2, other=lambda w, time: 1.04 * w)
    answer = found(two_sensors, runs, effects=SOME)
    assert answer.verdict == "named"
    assert [(s.effect, s.site) for s in answer.steps] == [("sensor_scale", "other")]
    assert answer.steps[0].parameters[0].value == pytest.approx(0.04, rel=0.05)


@pytest.mark.parametrize("shows", [0, 1, 2])
def test_a_limit_before_an_fmu_that_one_recording_alone_reaches_is_named(two_sensors, shows):
    def limited(u):
        return np.clip(u, -3.5, 3.5)

    runs = [drive_records(1, k, other=same, command=limited, highest=5.0 if k == shows else 3.0)[0] for k in range(3)]
    answer = found(two_sensors, runs, effects=["command_saturation", "null_bias"])
    assert [(s.effect, s.site) for s in answer.steps] == [("command_saturation", "command")]
    assert answer.steps[0].parameters[0].value == pytest.approx(3.5, rel=0.02)


@pytest.mark.xfail(strict=True, reason="a bias is worth few values, which a large gap beside it outweighs")
def test_a_bias_of_forty_times_the_noise_is_named_beside_a_dead_time(two_sensors):
    runs = drive_records(3, command=later, other=lambda w, time: w + 0.8)
    answer = found(two_sensors, runs, effects=["dead_time", "sensor_bias"])
    assert {(s.effect, s.site) for s in answer.steps} == {("dead_time", "command"), ("sensor_bias", "other")}


def test_an_answer_around_an_fmu_is_asked_what_it_lacks(two_sensors):
    def biased(w, time):
        return w + 0.8

    first = found(two_sensors, drive_records(2, other=biased), effects=["sensor_bias", "null_bias"])
    later = found(first.model, drive_records(2, 20, other=biased, command=lambda u: u + 0.3), effects=["null_bias"])
    assert [(s.effect, s.site) for s in later.steps] == [("null_bias", "command")]
    assert [a.effect for a in later.model.additions] == ["sensor_bias", "null_bias"]
    assert later.steps[0].parameters[0].value == pytest.approx(0.3, rel=0.03)


def test_nothing_is_missing_around_an_fmu_that_is_the_machine(two_sensors):
    assert found(two_sensors, drive_records(2, other=same), effects=SOME).verdict == "none"


def test_one_recording_of_an_fmu_is_enough_though_it_starts_at_its_beginning_only(two_sensors):
    answer = found(two_sensors, drive_records(1, other=lambda w, time: w + 0.8, seconds=16.0), effects=SOME)
    assert [(s.effect, s.site) for s in answer.steps] == [("sensor_bias", "other")]
    assert answer.steps[0].parameters[0].value == pytest.approx(0.8, rel=0.03)


@pytest.mark.proof
def test_a_disturbance_inside_gets_no_name_from_outside(two_sensors):
    def disturbed(u):
        return u + 0.8 * np.sin(2 * np.pi * 0.7 * PERIOD * np.arange(len(u)))

    few = ("dead_time", "null_bias", "sensor_scale", "sensor_bias")
    answer = found(two_sensors, drive_records(2, other=same, command=disturbed), effects=few, max_effects=2)
    assert (answer.verdict, answer.steps) == ("unknown", ())
    assert answer.locations and answer.unknown


def test_with_one_noisy_sensor_a_late_command_and_a_late_reading_are_a_class(one_sensor):
    noise = np.random.default_rng(5).standard_normal(600)
    runs = [replace(r, signals={**r.signals, "rate": r["rate"] + 2.0 * noise}) for r in drive_records(2, command=later)]
    answer = found(one_sensor, runs, free=["time_constant"], effects=["dead_time", "sensor_delay", "sensor_bias"])
    assert answer.verdict == "class" and answer.experiment is None
    assert {m[0] for m in answer.steps[0].members} == {"dead_time", "sensor_delay"}
    assert any("no experiment" in f for f in answer.findings)


def test_a_freed_parameter_of_the_fmu_takes_its_true_value_and_leaves_nothing_to_name(one_sensor):
    answer = found(one_sensor, drive_records(2), free=["time_constant"], effects=SOME)
    assert answer.verdict == "none"
    (parameter,) = answer.fit_after.parameters
    assert parameter.value == pytest.approx(0.3, rel=0.01)
    held = found(one_sensor, drive_records(2), effects=["sensor_bias"])
    assert held.verdict == "unknown"
    assert any("--free" in f and "time_constant" in f for f in held.findings)


@pytest.mark.proof
def test_around_a_slow_fmu_of_another_tool_a_dead_time_beyond_those_of_machines_is_named(folder, tmp_path):
    """CasADi's own export, FMI 3.0, Model Exchange: y' = u - 2 y from y = 1, sampled five times a second."""
    fmu = read_fmu(fmi3_model_exchange(folder))
    random, runs = np.random.default_rng(3), []
    for seed in range(2):
        time = np.arange(0.0, 30.0, SLOW)
        u = np.repeat(random.uniform(-1.0, 1.0, 15), 10)
        record = Record(time, {"u": u}, {"u": "1"}, f"run_{seed}")
        y = fmu.free_run(Record(time, {"u": later(u)}, {"u": "1"}))["y"] + 1e-3 * random.standard_normal(len(time))
        runs.append(Record(time, {"u": record["u"], "y": y}, {"u": "1", "y": "1"}, record.name))
    answer = found(fmu, runs, effects=["dead_time", "sensor_bias"])
    assert [(s.effect, s.site) for s in answer.steps] == [("dead_time", "u")]
    assert answer.steps[0].parameters[0].value == pytest.approx(LATE * SLOW, rel=0.02)  # above 0.5 s
    write_model_file(tmp_path / "model.toml", fmu.path, answer.model)
    assert simulate(load(tmp_path / "model.toml"), runs[0])["y"] == pytest.approx(
        simulate(answer.model, runs[0])["y"], abs=1e-9
    )


def test_an_fmu_that_tells_no_typical_magnitude_takes_that_of_the_recordings(two_sensors, folder):
    """A sensor in thousandths, with an offset that is thousands of times the unit."""
    plain = {' nominal="10.0" />': " />"}
    fmu = read_fmu(rewritten(folder / "two_sensors.fmu", folder / "plain.fmu", xml=plain))
    assert {s.nominal for s in fmu.outputs} == {1.0}
    answer = found(fmu, drive_records(2, other=lambda w, time: w + 30.0), effects=["sensor_scale", "sensor_bias"])
    assert [(s.effect, s.site) for s in answer.steps] == [("sensor_bias", "other")]
    assert answer.steps[0].parameters[0].value == pytest.approx(30.0, rel=0.01)
    assert {s.nominal for s in answer.model.fmu.outputs} != {1.0}


# -- how it runs ------------------------------------------------------------------------------------------------------
def test_surroundings_without_effects_run_as_the_fmu_alone(two_sensors):
    (record,) = drive_records(1, other=same)
    plain, around = two_sensors.free_run(record), simulate(surrounded(two_sensors), record)
    for name in ("rate", "other"):
        assert np.array_equal(plain[name], around[name])


def test_every_effect_at_neutral_leaves_the_fmu_as_it_is(two_sensors):
    (record,) = drive_records(1, other=same)
    model = surrounded(two_sensors)
    plain = simulate(model, record)["rate"]
    for candidate in candidates(model, ["dead_time", "actuator_lag", "command_*", "rate_limit", "sensor_*"]):
        if candidate.site.through:
            there = simulate(model.plus([candidate.addition]), record)["rate"]
            assert np.abs(there - plain).max() < 2e-3 * np.ptp(plain), candidate.label


def test_what_acts_behind_the_fmu_never_runs_it_again(two_sensors):
    (record,) = drive_records(1, other=same)
    model = add_effect(surrounded(two_sensors), "sensor_lag", "other")
    simulate(model, record)
    before = runs_made(two_sensors.path)
    for time_constant in (0.01, 0.02, 0.05):
        simulate(model.with_parameters({"sensor_lag_other.time_constant": time_constant}), record)
    assert runs_made(two_sensors.path) == before
    late = add_effect(model, "dead_time", values={"time": 0.03})
    simulate(late, record)
    assert runs_made(two_sensors.path) == before + 1


def test_sensitivities_through_an_fmu_are_differences_of_runs(two_sensors):
    (record,) = drive_records(1, other=same)
    model = add_effect(surrounded(two_sensors), "dead_time", values={"time": 0.03})
    model = add_effect(model, "sensor_lag", "other", values={"time_constant": 0.05})
    flat, names = model.flat, ("time_constant", "dead_time.time", "sensor_lag_other.time_constant")
    chain, p = prepare(flat, free_parameters=names), flat.parameter_vector()
    u, start = record["command"][:, None], np.array(flat.start_given()(record["command"][:1], p, [])).ravel()
    _, dy, _, _ = chain.sensitivity(record.time, u, p, start, np.zeros((len(start), len(names))))
    for k, name in enumerate(names):
        size = 0.01 * p[flat.index_of(name)]
        high, low = (
            chain.run(record.time, u, flat.parameter_vector({name: p[flat.index_of(name)] + s}), start)[0]
            for s in (size, -size)
        )
        central = (high - low) / (2 * size)
        assert np.abs(dy[:, :, k] - central).max() < 0.03 * np.abs(central).max(), name


def test_parameters_of_an_fmu_and_of_effects_around_it_are_identified_together(two_sensors):
    runs = drive_records(2, other=lambda w, time: 1.05 * w)
    model = add_effect(surrounded(two_sensors), "sensor_scale", "other").with_parameters({"time_constant": 0.2})
    fit = identify(model, runs, free=["time_constant", "sensor_scale_other.error"])
    assert fit.converged
    assert fit.values["time_constant"] == pytest.approx(0.3, rel=1e-3)
    assert fit.values["sensor_scale_other.error"] == pytest.approx(0.05, rel=1e-2)


# -- what is refused --------------------------------------------------------------------------------------------------


def test_an_fmu_without_inputs_or_outputs_has_no_surroundings(two_sensors):
    refused = (
        (replace(two_sensors, inputs=()), "no inputs.*before inputs and after outputs"),
        (replace(two_sensors, outputs=()), "no outputs.*Name local variables"),
    )
    for fmu, words in refused:
        with pytest.raises(DeclarationError, match=words):
            discover(fmu, drive_records(1))


def test_recordings_that_lack_what_the_fmu_takes_or_gives_are_told(two_sensors):
    (record,) = drive_records(1, other=same)
    with pytest.raises(DataError, match="no column 'command'"):
        discover(two_sensors, [record.select(["rate"])])
    with pytest.raises(DataError, match="none of the outputs of twoSensors is recorded"):
        discover(two_sensors, [record.select(["command"])])
    other = Record(
        record.time, {"command": record["command"], "rate": record["rate"]}, {"command": "A", "rate": "rad/s"}
    )
    with pytest.raises(UnitError, match="command"):
        discover(two_sensors, [other])


def test_an_fmu_that_crashes_or_hangs_is_one_sentence_and_the_next_one_runs(two_sensors, folder):
    broken = read_fmu(rewritten(folder / "two_sensors.fmu", folder / "crashing.fmu", c=CRASHES))
    with pytest.raises(SolveError, match=r"the FMU ended its process \(signal SIGABRT\).*hydrotwin check"):
        found(broken, drive_records(2, other=same))
    hanging = read_fmu(rewritten(folder / "two_sensors.fmu", folder / "hanging.fmu", c=HANGS), time_limit=1.0)
    with pytest.raises(SolveError, match=r"the FMU did not come to an end \(got 1 s\)"):
        found(hanging, drive_records(2, other=same))
    assert found(two_sensors, drive_records(2, other=same), effects=["sensor_bias"]).verdict == "none"


def test_an_fmu_that_cannot_start_behind_a_hole_learns_from_what_is_before_it(two_sensors):
    """It would have to be run over the hole; nothing is missing, and nothing is named."""

    def holed(r, begin, end):
        hole = (r.time > begin) & (r.time < end)
        return replace(r, signals={n: np.where(hole, np.nan, v) for n, v in r.signals.items()})

    whole = drive_records(2, other=same)
    answer = found(two_sensors, [holed(r, 7, 8) for r in whole], effects=["null_bias", "sensor_scale"])
    assert answer.verdict == "none"
    assert any("cannot start behind a hole, so drive_0 is taken until 7 s alone" in f for f in answer.findings)
    with pytest.raises(DataError, match="cannot start behind a hole, and there are too few samples before the first"):
        found(two_sensors, [holed(whole[0], -1, 0.5), whole[1]], effects=["null_bias"])
