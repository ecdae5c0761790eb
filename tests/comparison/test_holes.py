"""A recording that judges is run through in the parts between its holes, each from a start of its own."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.comparison import Wanted, acceptance, as_contender, compare, job
from hydrotwin.comparison.comparison import FREE_RUN
from hydrotwin.comparison.field import Predicted, field_metrics
from hydrotwin.comparison.notices import notices
from hydrotwin.comparison.residual import explain
from hydrotwin.comparison.starts import Started
from hydrotwin.identification.beginning import StartEstimate
from hydrotwin.models.language.errors import DataError
from hydrotwin.records import Record, noise_floor
from tests.identification.drive import drive, recorded
from tests.identification.test_holes import NOISE, unknown, without

from .toys import Toy, recording


def compared(record, modes=(FREE_RUN,), **more):
    return compare([as_contender(drive(), "right")], [record], modes=modes, repeats=0, **more)


def rmse(found) -> float:
    return next(s.rmse for s in found.scores if s.output == "position")


@pytest.mark.parametrize(
    "hole", [lambda r: without(r, (3, 5), name="run"), lambda r: unknown(r, 3, 5, "command")], ids=["rows", "input"]
)
def test_a_right_model_is_right_on_both_sides_of_a_hole(hole):
    whole = dataclasses.replace(recorded(drive(), 1, noise=NOISE), name="run")
    found = compared(hole(whole))
    assert rmse(found) < 1.2 * NOISE["position"]
    assert [r.name for r in found.records] == ["run"] == list({s.record for s in found.scores})
    assert [s.estimate.record for s in found.starts] == ["run (part 2)"]
    (said,) = [n for n in notices(found) if "hole" in n]
    assert said.startswith("run has a hole (") and "it was cut into 2 parts" in said


def test_both_modes_and_slopes_are_scored_around_a_hole():
    found = compared(without(recorded(drive(), 1, noise=NOISE), (3, 5)), (FREE_RUN, "one step"), rates=["position"])
    assert {(s.mode, s.output) for s in found.scores} >= {(FREE_RUN, "position.rate"), ("one step", "position")}
    (curve, _) = found.trajectories
    assert np.isfinite(curve.prediction["position"]).all() and len(curve.prediction) == len(found.records[0])


def test_samples_between_holes_that_are_too_few_are_not_scored_and_told():
    found = compared(without(recorded(drive(), 1, noise=NOISE), (3, 5), (5.4, 6)))
    assert found.scores[0].samples == len(found.records[0]) - 21
    assert any("samples beside them are left out" in n for n in notices(found))
    assert rmse(found) < 1.2 * NOISE["position"]


def test_every_model_is_judged_on_the_same_parts():
    """An input that one of them needs has a hole: all are cut there."""
    whole = recorded(drive(), 1, noise=NOISE)
    found = compare(
        [as_contender(drive(), "right"), Still("still")], [unknown(whole, 3, 5, "command")], modes=[FREE_RUN], repeats=0
    )
    counts = {s.model: s.samples for s in found.scores if s.output == "position"}
    assert counts["right"] == counts["still"] < len(whole)


class Still:
    """Holds the first sample."""

    inputs, kind, provenance = (), "yardstick", {}
    outputs = drive().outputs

    def __init__(self, name):
        self.name = name

    def free_run(self, record):
        held = {s.name: np.full(len(record), record[s.name][0]) for s in self.outputs}
        return dataclasses.replace(record, signals=held, units={s.name: s.unit for s in self.outputs})

    one_step = free_run


def test_a_criterion_by_the_name_of_a_recording_is_about_all_its_parts():
    holed = without(recording(5), (3, 4), name="holed")
    found = compare([Toy("good")], [recording(5), holed], modes=[FREE_RUN], repeats=0)
    (one,) = acceptance(found, Wanted(("holed: arm_angle.rmse < 9 rad",))).judged
    assert one.samples == len(holed) and "start of its own behind every hole: 3 s to 4 s" in one.caution


def test_few_missing_samples_are_told_and_not_cut():
    found = compared(without(recorded(drive(), 1, noise=NOISE), (2.99, 3.01), name="run"))
    assert not found.starts
    assert any(n.startswith("run lacks 1 sample; inputs are carried on there") for n in notices(found))


def test_a_recording_of_holes_alone_is_refused():
    torn = recorded(drive(), 1, noise=NOISE)
    holes = np.where(np.arange(len(torn)) % 60 > 40, np.nan, torn["command"])
    with pytest.raises(DataError, match="nothing to learn from or to judge by between its holes"):
        compared(torn.with_signals({"command": holes}))


def test_a_start_behind_a_hole_is_found_where_late_inputs_of_before_still_act():
    model = drive(dead_time=True).with_parameters({"delay": 0.1})
    whole = recorded(model, 1, noise={}, parameters={"delay": 0.1}, duration=20)
    found = compare([as_contender(model, "right")], [without(whole, (6, 9))], modes=[FREE_RUN], repeats=0)
    curve = found.trajectories[0].prediction
    later = curve.time > 9.6
    assert np.abs(curve["position"] - found.records[0]["position"])[later].max() < 2e-3


PAUSES = (0.0, 3.0, 30.0, 600.0)  # s between the two halves of a run, while nothing was recorded


def late(pause: float):
    """Field metrics and residual of a swing that comes 0.3 s late and too small, recorded in two halves."""
    time, random = np.arange(0.0, 20.0, 0.01), np.random.default_rng(0)
    command = random.uniform(-1, 1, 40).repeat(50)
    measured = np.convolve(command, np.exp(-np.arange(400) / 40) / 40)[: len(time)]
    predicted = 0.8 * np.concatenate([np.zeros(30), measured[:-30]])
    record = Record(
        time + np.where(time < 10, 0.0, pause), {"u": command, "y": measured}, {"u": "V", "y": "m"}, "halves"
    )
    told = field_metrics(record, Predicted("y", predicted), ["u"], noise_floor(record))
    return told, explain(record, "y", predicted, model="late")


def test_metrics_see_nothing_across_a_hole():
    """Lines over a pause are alike, whatever the model: 0.3 s late had been rated and found by them."""
    whole, *paused = [late(pause) for pause in PAUSES]
    assert whole[0].lag == pytest.approx(0.3, abs=0.01)
    for found, left in paused:
        assert found.lag == pytest.approx(whole[0].lag, abs=0.01)
        assert found.iso18571 == pytest.approx(whole[0].iso18571, abs=0.02)  # the phase is over a fifth of a part
        assert left.follows == whole[1].follows == "u"
        assert left.correlation_time == pytest.approx(whole[1].correlation_time, abs=0.01)
        assert left.strength == pytest.approx(whole[1].strength, abs=0.02)


def test_a_sensor_that_is_silent_for_a_while_is_rated_where_it_speaks():
    time = np.arange(0.0, 20.0, 0.01)
    swing = np.sin(2 * np.pi * 0.5 * time)
    silent = np.where((time > 6) & (time < 14), np.nan, swing)
    record = Record(time, {"y": silent}, {"y": "m"}, "silent")
    found = field_metrics(record, Predicted("y", 0.5 * swing), [], {})
    whole = field_metrics(record.with_signals({"y": swing}), Predicted("y", 0.5 * swing), [], {})
    assert found.iso18571 == pytest.approx(whole.iso18571, abs=0.02) and found.lag == pytest.approx(0.0, abs=1e-3)


def settling_of(lost: slice, as_nan: bool) -> float:
    """Settling of a prediction that takes 0.9 s where 0.3 s were measured, and begins anew behind a hole."""
    time = np.arange(0.0, 40.0, 0.01)
    command = np.where((time // 5).astype(int) % 2, 1.0, 0.0)
    steps = time % 5
    measured, predicted = (np.abs(1.0 - command - (1 - np.exp(-steps / T))) for T in (0.3, 0.9))
    hole = np.zeros(len(time), bool)
    for k in range(8):
        hole[500 * k + lost.start : 500 * k + lost.stop] = True
        behind = slice(500 * k + lost.stop, 500 * (k + 1))
        predicted[behind] = measured[behind]
    signals = {"u": np.where(hole, np.nan, command), "y": measured}
    record = Record(time, signals, {"u": "V", "y": "m"}, "settles")
    predicted = np.where(hole, np.nan, predicted)
    if not as_nan:
        record, predicted = record._at(time[~hole], {n: v[~hole] for n, v in signals.items()}), predicted[~hole]
    return field_metrics(record, Predicted("y", predicted), ["u"], {}).settling


@pytest.mark.parametrize("as_nan", [False, True], ids=["rows", "input"])
def test_who_begins_anew_behind_a_hole_has_not_settled_there(as_nan):
    """Restarted at what is measured, a slow prediction rests at once: it had settled as soon as the measurement."""
    assert settling_of(slice(450, 460), as_nan) == pytest.approx(1.7, abs=0.1)  # both have settled before
    assert np.isnan(settling_of(slice(40, 140), as_nan))  # it is still on its way


def test_time_that_nobody_ran_through_makes_no_model_faster(monkeypatch):
    monkeypatch.setattr(job, "_timed", lambda run, part, repeats: (run(part), [part.duration / 10]))
    whole = recorded(drive(), 1, noise=NOISE)
    pause = dataclasses.replace(whole, time=whole.time + np.where(whole.time < whole.duration / 2, 0.0, 600.0))
    for record in (whole, pause):
        (timing,) = compared(record).timings
        assert timing.seconds_per_simulated_second == pytest.approx(0.1)


def test_a_criterion_says_what_it_was_not_judged_on():
    """What follows the first hole is too short to run: that stood in no row, nor in JUnit."""
    scraps = [(5.0 + k, 5.7 + k) for k in range(5)]
    found = compared(without(recorded(drive(), 1, noise=NOISE), *scraps, name="run"))
    (one,) = acceptance(found, Wanted(("position.rmse < 1 m",))).judged
    assert not one.holes and "not judged on 79 of 330 samples of run, where position is not known" in one.caution


def test_a_run_that_cannot_be_told_where_it_goes_on_says_that_it_begins_there():
    note = StartEstimate("run (part 2)", note="no output is recorded.")
    assert "run (part 2) starts as without an estimate, as if it began there" in str(Started("m", note, "run"))
    assert "as if it began there" not in str(Started("m", dataclasses.replace(note, record="run"), "run"))
