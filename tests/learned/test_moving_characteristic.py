"""Characteristics of recordings whose command never rests, as a toy knows them and as the truth rig does."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.learned import characteristic, learn_inverse
from hydrotwin.learned.inverse.curve import static_answer
from hydrotwin.records import Record
from tests import rig
from tests.learned.hidden_valve import DEAD_TIME, EFFECTS, SPOOL_DELAY, UNITS
from tests.learned.test_inverse import SPAN, recorded, speed

STILL = [e for e in EFFECTS if e[0] == "valve_overlap"]  # what a held command shows


def weaving(duration: float, period: float = 0.01, seed: int = 0) -> np.ndarray:
    """A command over the whole range that never rests: sines up to 1 Hz."""
    t, random = np.arange(0, duration, period), np.random.default_rng(seed)
    f = np.geomspace(0.08, 1.0, 6)
    u = np.sin(2 * np.pi * np.outer(t, f) + random.uniform(0, 2 * np.pi, 6)) @ (1 / np.sqrt(1 + 4 * f))
    return u / np.abs(u).max()


def test_the_curve_and_the_dead_time_come_out_of_a_command_that_never_rests():
    found = characteristic(recorded(weaving(60.0), late=0.12), "current", "position")
    assert "moving_points" in found.source
    assert found.source["delay"] == pytest.approx(0.12, abs=0.003)
    assert np.sqrt(np.mean((found.rates - speed(found.commands)) ** 2)) < 0.005 * SPAN


def test_a_level_that_follows_the_command_is_found_as_the_rate_is():
    record = recorded(weaving(60.0))
    late = np.interp(record.time - 0.1, record.time, record["current"])
    levels = record.with_signals({"force": 1e3 * speed(late)}, {"force": "N"})
    found = characteristic(levels, "current", "force")
    assert found.rate.name == "wanted_force" and found.source["delay"] == pytest.approx(0.1, abs=0.003)
    assert np.abs(found.rates / 1e3 - speed(found.commands)).max() < 0.01 * SPAN


def test_a_given_dead_time_is_taken_and_a_wrong_one_costs_accuracy():
    record, errors = recorded(weaving(60.0), late=0.12), []
    for delay in (0.12, 0.0):
        found = characteristic(record, "current", "position", delay=delay, moving=True)
        assert found.source["delay"] == delay
        errors.append(np.sqrt(np.mean((found.rates - speed(found.commands)) ** 2)))
    assert errors[0] < 0.3 * errors[1]


def test_a_staircase_is_still_read_where_it_is_steady():
    levels = np.random.default_rng(0).permutation(np.linspace(-1, 1, 41))
    found = characteristic(recorded(np.repeat(levels, 200)), "current", "position")
    assert found.source["steady_points"] >= 41 and "moving_points" not in found.source


def test_commands_that_were_never_visited_are_left_out():
    away = 0.65 + 0.35 * weaving(60.0)  # from 0.3 to 1, then at once to the other side
    found = characteristic(recorded(np.where(np.arange(6000) < 3000, away, -away)), "current", "position", moving=True)
    assert np.abs(found.commands).min() > 0.2
    assert np.sqrt(np.mean((found.rates - speed(found.commands)) ** 2)) < 0.005 * SPAN


def test_from_a_weaving_valve_with_play_and_dead_time_the_inverse_gives_the_wanted_speed():
    time = rig.commands.jittered_time(90.0, 50.0, 0.2, seed=1)
    command = np.interp(time, np.arange(0, 90.0, 0.01), weaving(90.0, seed=1)) * np.minimum(1, time)
    seen = {"noise": {"position": 2e-4}, "quantisation": {"position": 1e-3}, "seed": 1}
    columns = rig.record("spool_valve", command, time, effects=EFFECTS, **seen)
    record = Record(time, {n: columns[n] for n in UNITS}, UNITS).select(["current", "position"])
    inverse = learn_inverse(record, "current", "position")
    assert inverse.provenance["delay"] == pytest.approx(DEAD_TIME + SPOOL_DELAY, abs=0.03)
    wanted, still = np.linspace(-0.06, 0.06, 9), np.arange(0, 0.6, 0.01)
    for v, u in zip(wanted, static_answer(inverse, wanted), strict=True):
        run = rig.record("spool_valve", np.full_like(still, u), still, effects=STILL)["position"]
        assert (run[-1] - run[30]) / 0.29 == pytest.approx(v, abs=0.003)
