"""Inputs that go one way only are told."""

import numpy as np
import pytest

import hydrotwin as ht
from hydrotwin.learned.excitation import moves, one_way
from hydrotwin.records import Record

TIME = 0.02 * np.arange(500)


def record(command: np.ndarray) -> Record:
    """A command, and a lag of it."""
    angle = np.zeros(len(command))
    for k in range(1, len(command)):
        angle[k] = angle[k - 1] + 0.02 * (command[k - 1] - angle[k - 1])
    angle += 1e-4 * np.random.default_rng(0).standard_normal(len(command))
    return Record(TIME, {"command": command, "angle": angle}, {"command": "V", "angle": "rad"}, "made up")


@pytest.mark.parametrize(
    ("values", "count"),
    [
        (np.full(5, 0.3), 0),
        (np.repeat([0.0, 1.0], 9), 1),
        (np.linspace(-2, 5, 50), 1),
        (np.sin(np.linspace(0, 4 * np.pi, 200)), 5),
        (np.interp(np.arange(80), [0, 20, 60, 79], [0, 1, -1, 0]), 3),
        (np.concatenate([np.zeros(9), np.tile([0.4, 0.6], 9), np.ones(9)]), 1),
    ],
)
def test_a_move_is_one_that_is_not_taken_back(values, count):
    assert moves(values) == count


def test_one_step_is_told_on_the_card_and_a_command_that_comes_back_is_not():
    step, both = (TIME > 2.0).astype(float), np.sin(TIME)
    told = ht.learn("arx", [record(step)], ["command"], ["angle"]).provenance["free_run"]
    assert told["bad"] and told["says"].startswith(
        "command goes one way only (9.98 s without a way back of 40% of its range"
    )
    assert one_way([record(both)], ["command"]) == []
    again = ht.learn("arx", [record(both)], ["command"], ["angle"]).provenance["free_run"]
    assert "one way" not in again["says"]


def test_recordings_count_together_and_inputs_that_they_lack_do_not():
    up, down = record(np.zeros(500)), record(np.ones(500))
    assert len(one_way([up, down], ["command"])) == 1
    assert one_way([up, down, up], ["command", "absent"]) == []
