"""Recordings take roles by their number; a lone one is cut; what can show nothing is refused in a sentence."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.discovery.recordings import quanta, split
from hydrotwin.models.language import Model
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.records import Record
from tests.discovery.slides import NOISE, PERIOD, Drive, Slide, TwoSensors, drive_records, record, records, slide


def names(runs) -> list[str]:
    return [r.name for r in runs]


def changed(run: Record, name: str | None = None, **columns) -> Record:
    """A recording with columns replaced, or left out where None."""
    signals = {k: columns.get(k, v) for k, v in run.signals.items() if columns.get(k, v) is not None}
    return Record(run.time, signals, {k: run.units[k] for k in signals}, name or run.name)


@pytest.mark.parametrize("count", [2, 3, 5])
def test_all_recordings_are_learned_from_but_those_that_judge(count):
    data = split(slide().flat, records(count), [record(20)])
    assert names(data.train) == [f"run_{k}" for k in range(count)]
    assert names(data.report) == ["run_20"] and data.findings == ()


def test_a_lone_recording_of_what_integrates_is_cut_in_twelve():
    data = split(slide().flat, [record(0)], [record(1)])
    assert len(data.train) == 12
    assert names(data.train)[0] == "run_0 (part 1)"
    assert sum(len(r.time) for r in data.train) == 600
    assert {len(r.time) for r in data.train} <= {49, 50, 51}
    assert data.train[3].time[0] == pytest.approx(data.train[2].time[-1] + PERIOD)


def test_a_lone_recording_of_what_settles_is_cut_in_two():
    data = split(Model(Drive()).flat, drive_records(1), [])
    assert [len(r.time) for r in data.train] == [360, 240]


def test_without_a_validation_recording_it_is_said_what_to_record():
    data = split(slide().flat, records(3), [])
    (said,) = data.findings
    assert "no validation recording" in said and "Record another run" in said and "--validate" in said
    assert data.report == ()


def test_a_constant_output_is_left_out_and_named():
    model = Model(Drive())
    runs = drive_records(3)
    data = split(Model(TwoSensors()).flat, [changed_with(r, "other", 4.0) for r in runs], [])
    assert data.outputs == ("rate",) and np.isfinite(data.noise).tolist() == [True, False]
    assert any("'other' is constant in every recording" in f and "record it in motion" in f for f in data.findings)
    assert np.isfinite(split(model.flat, runs, []).noise).all()


def changed_with(run: Record, name: str, value: float) -> Record:
    """A recording with one column more that never changes."""
    signals = {**run.signals, name: np.full(len(run.time), value)}
    return Record(run.time, signals, {**run.units, name: "rad/s"}, run.name)


def test_the_noise_that_is_given_wins_over_the_estimate():
    assert split(slide().flat, records(3), [], noise={"speed": 7.0}).noise == pytest.approx([7.0])
    assert split(slide().flat, records(3), []).noise[0] < 5 * NOISE


def still(value: float) -> Record:
    """A recording of a slide that nothing moves."""
    time = np.arange(0.0, 12.0, PERIOD)
    speed = NOISE * np.random.default_rng(0).standard_normal(len(time))
    return Record(time, {"force": np.full(len(time), value), "speed": speed}, {"force": "N", "speed": "m/s"}, "still")


@pytest.mark.parametrize(
    ("runs", "says", "ask"),
    [
        (lambda: [], "no recording of slide", "Give at least one, better three"),
        (lambda: records(3, seconds=1.0), "run_0 has 50 samples", "Record tens of seconds of motion"),
        (lambda: [still(20.0)], "no input of slide ever moves (force)", "Record commands in both directions"),
        (
            lambda: [changed(r, speed=np.full(600, 0.2)) for r in records(3)],
            "every recorded output of slide is constant (speed)",
            "Record motion in both directions",
        ),
        (lambda: [changed(record(0), speed=None)], "none of the outputs of slide is recorded", "speed is needed"),
        (lambda: [changed(record(0), force=None)], "input 'force' [N] of slide is not recorded", ""),
    ],
    ids=["none", "too short", "motionless", "constant", "no output", "no input"],
)
def test_recordings_that_can_show_nothing_are_refused_and_told_what_to_record(runs, says, ask):
    with pytest.raises(DataError) as refused:
        split(slide().flat, runs(), [])
    assert says in str(refused.value) and ask in str(refused.value)


def test_several_short_recordings_are_enough_together():
    data = split(slide().flat, records(3, seconds=3.0), [])
    assert len(data.train) == 3


def test_a_lone_recording_that_is_too_short_is_told_its_own_length():
    with pytest.raises(DataError, match="run_0 has 150 samples"):
        split(slide().flat, [record(0, seconds=3.0)], [])


@pytest.mark.parametrize("outputs", [["sped"], ["speed", "sped"]])
def test_an_output_that_the_model_does_not_have_is_refused(outputs):
    with pytest.raises((DataError, DeclarationError), match="sped"):
        split(slide().flat, records(3), [], outputs=outputs)


def test_pieces_of_a_lone_recording_must_be_long_enough_to_be_weighed():
    data = split(Model(Slide()).flat, [record(0, seconds=4.0)], [])
    assert min(len(r.time) for r in data.train) >= 16


def test_the_steps_of_a_coarse_sensor_are_told_and_nothing_is_looked_for_below_them():
    coarse = [changed(r, speed=0.05 * np.round(r["speed"] / 0.05)) for r in records(3)]
    data = split(slide().flat, coarse, [record(20)])
    assert quanta(data.train) == pytest.approx([0.05])
    assert data.noise == pytest.approx([0.05 / np.sqrt(12)], rel=0.2)
    assert any("speed is recorded in steps of 0.05 m/s" in f for f in data.findings)
    assert quanta(split(slide().flat, records(3), [record(20)]).train) == [0.0]
