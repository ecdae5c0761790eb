"""Angles of a shaft that goes on turning: a sensor that begins anew is told, one that counts on is not."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.records import Record, turned_back, write_record
from tests.face.command_line import hydrotwin

TIME = np.arange(0.0, 10.0, 0.01)
TURNING = 4.0 * TIME + np.sin(TIME)  # rad, six turns
NOISE = 0.002 * np.random.default_rng(3).standard_normal(len(TIME))


def told(angle, unit="rad"):
    return turned_back(Record(TIME, {"shaft": angle}, {"shaft": unit}))


@pytest.mark.parametrize("low", [0.0, -np.pi])
@pytest.mark.parametrize("way", [1, -1])
def test_a_sensor_that_begins_anew_is_told(low, way):
    angle = (way * TURNING - low) % (2 * np.pi) + low + NOISE
    (sentence,) = told(angle)
    times = int((np.abs(np.diff(angle)) > 5).sum())
    assert f"360 deg from one sample to the next, {times} times" in sentence and "numpy.unwrap" in sentence
    assert told(np.where(np.arange(len(TIME)) % 50 == 7, np.nan, angle)), "samples that are not known hide nothing"
    assert not told(np.unwrap(angle))
    assert "begin anew" in Record(TIME, {"shaft": angle}, {"shaft": "rad"})._repr_html_()


@pytest.mark.parametrize(
    "angle",
    [
        TURNING + NOISE,
        3.0 * np.sin(TIME),  # nearly a turn, to and fro
        np.where(TIME < 5, 0.0, 3.0),  # a step of half a turn
        np.where(TIME < 5, 0.0, 20.0),  # of three turns
        np.random.default_rng(1).uniform(0, 6.28, len(TIME)),  # anything: not a shaft that is sampled well
        np.full(len(TIME), np.nan),
    ],
)
def test_what_moves_otherwise_is_not(angle):
    assert not told(angle)


def test_only_angles_turn():
    assert not told(TURNING % (2 * np.pi), "m")


def test_a_command_tells_it(tmp_path):
    file = write_record(Record(TIME, {"shaft": TURNING % (2 * np.pi)}, {"shaft": "rad"}), tmp_path / "run.csv")
    answer = hydrotwin("inspect", file)
    assert answer.code == 0 and "seems to begin anew at every turn" in " ".join(answer.said.split())
