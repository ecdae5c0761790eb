"""`compare` on a toy machine: who wins, what fails, what is not scored."""

from __future__ import annotations

import dataclasses
import warnings

import numpy as np
import pytest

from hydrotwin.comparison import (
    FREE_RUN,
    MEAN,
    HoldLast,
    Wanted,
    as_contender,
    compare,
)
from hydrotwin.comparison.acceptance import acceptance
from hydrotwin.comparison.notices import notices
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from tests.comparison.toys import ANGLE, COMMAND, OUTPUTS, PRESSURE, SPEED, Toy, recording

TRUE, WRONG = Toy("true"), Toy("wrong", gain=130.0)


def run(contenders, records=None, **options):
    return compare(contenders, records or [recording(1), recording(2)], repeats=1, **options)


def scores(comparison, **wanted):
    return [s for s in comparison.scores if all(getattr(s, k) == v for k, v in wanted.items())]


def test_the_true_model_wins_and_its_error_is_the_sensor_noise():
    comparison = run([WRONG, TRUE])
    best, second = comparison.ranking("motor_speed")
    assert (best.model, second.model) == ("true", "wrong")
    assert best.rmse == pytest.approx(2.0, rel=0.1)
    assert best.relative == 1.0
    assert second.relative == pytest.approx(second.rmse / best.rmse)


def test_every_model_output_recording_and_mode_is_scored_once():
    comparison = run([WRONG, TRUE])
    keys = [(s.model, s.record, s.output, s.mode) for s in comparison.scores]
    assert len(keys) == len(set(keys)) == 2 * 2 * 3 * 2


def test_what_is_named_twice_counts_once():
    """Means had been of two recordings where there was one, and tables had stood twice."""
    twice = {"modes": [FREE_RUN] * 2, "outputs": ["arm_angle"] * 2, "rates": ["arm_angle"] * 2}
    comparison = run([TRUE], [recording(1)], **twice)
    assert [s.name for s in comparison.outputs] == ["arm_angle", "arm_angle.rate"] and comparison.modes == (FREE_RUN,)
    assert [(s.output, s.recordings) for s in comparison.means] == [("arm_angle", 1), ("arm_angle.rate", 1)]


def test_a_recording_in_a_file_of_other_bytes_is_the_same_one():
    """Saved with other line ends it had counted twice, and what a model was made from had been new to it."""
    one, other = (dataclasses.replace(recording(k), digest=f"hash {k}", name=f"run_{k}") for k in (1, 2))
    again = dataclasses.replace(one, digest="line ends", name="again")
    made = Toy("true")
    made.provenance = {"recordings": [{"role": "train", "sha256": "hash 1"}]}
    comparison = run([made], [one, other, again])
    told = " ".join(notices(comparison))
    assert "The same recording in another file: again is run_1. It counts twice" in told
    assert "true was made from run_1, again" in told
    judged = acceptance(run([made], [again], train_records=[one]), Wanted(("arm_angle.rmse < 1 rad",))).judged
    assert judged[0].seen == ("again",)
    assert "another file" not in " ".join(notices(run([made], [one, other])))


def test_a_block_that_recordings_chose_has_seen_them():
    made = Toy("true")
    one = dataclasses.replace(recording(1), digest="hash 1")
    for chosen, seen in (([{"name": "run_1", "sha256": "hash 1"}], (one.name,)), ("the training loss", ())):
        made.provenance = {"trained_on": [], "selected_on": chosen}
        judged = acceptance(run([made], [one]), Wanted(("arm_angle.rmse < 1 rad",))).judged
        assert judged[0].seen == seen


def test_means_are_those_of_the_recordings():
    comparison = run([TRUE])
    each = scores(comparison, output="arm_angle", mode="free run")
    (mean,) = [s for s in comparison.means if s.output == "arm_angle" and s.mode == "free run"]
    assert mean.record == MEAN
    assert mean.recordings == 2
    assert mean.rmse == pytest.approx(np.mean([s.rmse for s in each]))
    assert mean.maximum == max(s.maximum for s in each)


def test_one_step_ahead_a_drift_hardly_shows():
    drifting = Toy("drifting", drift=0.01)
    comparison = run([drifting])
    (free,) = [s for s in comparison.means if s.output == "arm_angle" and s.mode == "free run"]
    (step,) = [s for s in comparison.means if s.output == "arm_angle" and s.mode == "one step"]
    assert step.rmse < 0.02 * free.rmse


def test_a_model_that_has_seen_the_sample_it_predicts_is_too_good():
    class Cheat(Toy):
        def one_step(self, record):
            half_way = {
                n: 0.5 * (record[n] + super(Cheat, self).free_run(record)[n]) for n in ("arm_angle", "motor_speed")
            }
            return super().free_run(record).with_signals(half_way)

    comparison = run([TRUE, Cheat("cheat")])
    suspects = {(s.model, s.output) for s in comparison.scores if s.too_good}
    assert suspects == {("cheat", "arm_angle"), ("cheat", "motor_speed")}


def test_holding_the_last_sample_is_the_yardstick_of_one_step():
    comparison = run([HoldLast(OUTPUTS)])
    record = comparison.records[0]
    (score,) = scores(comparison, record=record.name, output="arm_angle", mode="one step")
    expected = np.r_[0.0, np.diff(record["arm_angle"])]
    assert score.rmse == pytest.approx(np.sqrt(np.mean(expected**2)))
    assert comparison.yardsticks == {"hold last sample"}


def test_a_model_that_fails_on_one_recording_is_a_row_not_the_end():
    comparison = run([TRUE, Toy("fragile", fails_on="validation_2")])
    assert {(f.model, f.record) for f in comparison.failures} == {("fragile", "validation_2")}
    assert "got nan at 1.2 s" in comparison.failures[0].sentence
    assert scores(comparison, model="fragile", record="validation_1")


def test_a_model_with_fewer_recordings_ranks_last_and_has_no_ratio():
    comparison = run([Toy("fragile", fails_on="validation_2"), WRONG])
    best, last = comparison.ranking("motor_speed")
    assert (best.model, last.model) == ("wrong", "fragile")
    assert last.rmse < best.rmse
    assert np.isnan(last.relative)


def test_errors_that_are_no_hydrotwin_errors_are_rows_too():
    class Broken(Toy):
        def free_run(self, record):
            raise ZeroDivisionError("division by zero")

    comparison = run([TRUE, Broken("broken")], modes=["free run"])
    assert comparison.failures[0].sentence == "ZeroDivisionError: division by zero"


def test_a_missing_input_names_the_column_and_the_nearest():
    record = recording(1)
    renamed = Record(
        record.time,
        {"comand": record["command"], "arm_angle": record["arm_angle"]},
        {"comand": "V", "arm_angle": "rad"},
        "renamed",
    )
    comparison = run([TRUE], [renamed, record])
    (sentence,) = {f.sentence for f in comparison.failures}
    assert "renamed: no column 'command'" in sentence
    assert "Did you mean 'comand'?" in sentence


def test_an_input_of_another_dimension_is_refused():
    record = recording(1)
    amps = dataclasses.replace(record, units={**record.units, "command": "A"}, name="amps")
    comparison = run([TRUE], [amps])
    assert "column 'command' is in A, the model needs V" in comparison.failures[0].sentence


def test_outputs_that_were_not_recorded_are_listed_not_scored():
    record = recording(1).select(["command", "arm_angle"])
    comparison = run([TRUE], [recording(2), record])
    listed = {(u.record, u.output, u.reason) for u in comparison.unscored}
    assert listed == {("validation_1", n, "not recorded") for n in ("motor_speed", "pressure_cap")}


def test_an_output_that_no_sample_knows_is_one_that_was_not_recorded():
    record = recording(1)
    unknown = record.with_signals({"pressure_cap": np.full(len(record), np.nan)}, {"pressure_cap": "Pa"})
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of numpy, on slices without a number
        comparison = run([TRUE], [recording(2), unknown])
        alone = run([TRUE], [unknown])
    assert not comparison.failures and not alone.failures
    assert {(u.record, u.output, u.reason) for u in comparison.unscored} == {
        ("validation_1", "pressure_cap", "not recorded")
    }
    assert {s.record for s in comparison.scores if s.output == "pressure_cap"} == {"validation_2"}
    assert [s.name for s in alone.outputs] == ["arm_angle", "motor_speed"]


def test_a_model_without_an_output_is_listed():
    comparison = run([TRUE, Toy("angle only", outputs=(ANGLE,))])
    reasons = {(u.model, u.output): u.reason for u in comparison.unscored}
    assert reasons["angle only", "motor_speed"] == "not an output of this model"


def test_a_prediction_with_nan_is_a_failure_of_that_output_only():
    class Half(Toy):
        def free_run(self, record):
            good = super().free_run(record)
            return good.with_signals({"arm_angle": np.full(len(record.time), np.nan)})

    comparison = run([Half("half")], modes=["free run"])
    assert all(f.sentence.startswith("arm_angle: the prediction is not finite") for f in comparison.failures)
    assert {s.output for s in comparison.scores} == {"motor_speed", "pressure_cap"}


def test_a_time_axis_that_is_not_uniform_is_scored_on_its_own_samples():
    record = recording(1)
    keep = np.sort(np.random.default_rng(0).choice(len(record.time), 300, replace=False))
    sparse = Record(record.time[keep], {n: record[n][keep] for n in record}, record.units, "sparse")
    comparison = run([HoldLast(OUTPUTS)], [sparse])
    assert all(s.samples == 300 for s in comparison.scores)


def test_a_prediction_on_another_time_axis_is_brought_to_the_recording():
    class Coarse(Toy):
        def free_run(self, record):
            return super().free_run(record).resample(period=0.02)

    comparison = run([Coarse("coarse")], [recording(1, noise=0.0)], modes=["free run"])
    (score,) = scores(comparison, output="arm_angle")
    assert score.samples == len(recording(1).time)
    assert score.rmse < 1e-4


def test_run_time_is_wall_time_per_simulated_second():
    import time

    class Slow(Toy):
        def free_run(self, record):
            time.sleep(0.2)
            return super().free_run(record)

    comparison = run([Slow("slow"), TRUE], [recording(1, duration=4.0)], modes=["free run"])
    taken = comparison.seconds_per_simulated_second
    assert 0.2 / 3.99 < taken["slow"] < 1.0 / 3.99  # a busy machine oversleeps
    assert taken["true"] < taken["slow"] / 5


def test_two_recordings_of_one_name_are_told_apart():
    comparison = run([TRUE], [recording(1), recording(1)])
    assert [r.name for r in comparison.records] == ["validation_1", "validation_1 (2)"]


def test_wrong_use_raises_with_the_nearest_name():
    with pytest.raises(DeclarationError, match="two models are called 'true'"):
        run([TRUE, Toy("true")])
    with pytest.raises(DeclarationError, match="Did you mean 'arm_angle'"):
        run([TRUE], outputs=["arm_angel"])
    with pytest.raises(DeclarationError, match="no mode 'free'"):
        run([TRUE], modes=["free"])
    with pytest.raises(DataError, match="0 recordings"):
        compare([TRUE], [])
    with pytest.raises(DataError, match="no recording holds an output"):
        run([Toy("t", outputs=(ANGLE,))], [recording(1).select(["command"])])


def test_only_the_outputs_asked_for_are_scored():
    comparison = run([TRUE], outputs=["pressure_cap"])
    assert {s.output for s in comparison.scores} == {"pressure_cap"}


def test_progress_counts_every_run():
    calls = []
    run([TRUE, WRONG], progress=lambda done, total, what: calls.append((done, total)))
    assert calls[0] == (0, 8)
    assert calls[-1] == (8, 8)
    assert [done for done, _ in calls] == [0, 2, 4, 6, 8]  # both modes of a model on a recording are one job


def test_anything_that_predicts_is_a_contender_and_can_be_renamed():
    renamed = as_contender(TRUE, "other name")
    assert (renamed.name, renamed.kind, renamed.inputs) == ("other name", "physical", (COMMAND,))
    with pytest.raises(DeclarationError, match="a str cannot take part"):
        as_contender("cehA")


@pytest.mark.parametrize("signal", [SPEED, PRESSURE])
def test_units_come_from_the_models_signals(signal: Signal):
    comparison = run([TRUE])
    assert {s.unit for s in scores(comparison, output=signal.name)} == {signal.unit}


def test_a_contender_without_one_step_is_listed_and_no_failure():
    free_runner = Toy("free runner")
    free_runner.modes = ("free run",)
    comparison = run([free_runner])
    assert not comparison.failures
    assert {s.mode for s in comparison.scores} == {"free run"}
    assert comparison.unscored and all("cannot be set" in u.reason for u in comparison.unscored)


def test_a_comparison_prints_as_one_line_not_as_its_trajectories():
    comparison = compare([Toy("a"), Toy("b")], [recording(1)], modes=["free run"])
    assert repr(comparison) == "Comparison 'Comparison of models': a, b on validation_1; 6 scores"


class Sure(Toy):
    """A toy that says how sure it is."""

    def __init__(self, name, sd, **more):
        super().__init__(name, **more)
        self.sd = sd

    def deviations(self, record):
        return {"motor_speed": np.full(len(record), self.sd)}


def test_bands_are_scored_where_a_model_has_them():
    found = run([Sure("right", 2.0), Sure("narrow", 0.5), TRUE])
    means = {s.model: s for s in found.means if (s.output, s.mode) == ("motor_speed", FREE_RUN)}
    assert 0.93 < means["right"].coverage < 0.97 and means["narrow"].coverage < 0.5
    assert np.isnan(means["true"].coverage)
    assert means["right"].crps == pytest.approx(2.0 / np.sqrt(np.pi), rel=0.05)
    assert means["right"].nlpd == pytest.approx(np.log(2.0 * np.sqrt(2 * np.pi)) + 0.5, rel=0.05)
    assert means["narrow"].nlpd > means["right"].nlpd
    one_step = [s for s in found.scores if s.mode != FREE_RUN]
    assert np.isnan([s.coverage for s in one_step]).all(), "these deviations are of free runs"
    assert found.deviation("right", "validation_1", "motor_speed").shape == (800,)
    assert found.deviation("true", "validation_1", "motor_speed") is None


def test_an_identified_model_brings_its_band_from_its_file(tmp_path):
    from hydrotwin.comparison import PhysicalContender
    from hydrotwin.identification import Spread, identify
    from tests.identification.drive import drive, recorded

    noise = {"position": 2e-3, "motor_speed": 0.05}
    fit = identify(drive(), [recorded(drive(), 1, noise=noise)], free=["motor.gain", "motor.time_constant"])
    model = PhysicalContender(fit.flat, "fitted", provenance={"spread": Spread.of(fit).told()})
    found = compare([model], [recorded(drive(), k, noise=noise) for k in range(2, 6)], repeats=1, modes=[FREE_RUN])
    assert all(0.9 < s.coverage < 0.99 for s in found.means)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"records": recording(1)}, "records takes a list .got a Record alone"),
        ({"records": ["run.csv"]}, "'run.csv' is no recording. Read it first"),
        ({"contenders": Toy("alone")}, "contenders takes a list .got a Toy alone"),
        ({"modes": "free run"}, r"modes takes a list .got a str alone.*modes=\[...\]"),
        ({"outputs": "arm_angle"}, "outputs takes a list"),
        ({"rates": "arm_angle"}, "rates takes a list"),
    ],
)
def test_one_thing_where_a_list_is_needed_is_told(given, says):
    with pytest.raises(DeclarationError, match=says):
        compare(**{"contenders": [Toy("toy")], "records": [recording(1)], **given})


@pytest.mark.parametrize("accept", ["arm_angle.rmse < 1 deg", ("arm_angle.rmse < 1 deg", 1)])
def test_criteria_are_a_list_of_texts(accept):
    with pytest.raises(DeclarationError, match="accept takes a list of criteria"):
        Wanted(accept)
