"""What is found in recordings before any model is asked."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.records.inspection import inspect_record, together
from hydrotwin.records.matching import matched

TIME = np.arange(4000) / 1000


def record(name="run", **signals):
    units = {"command": "V", "pressure": "Pa", "position": "m", "other": "Pa"}
    return Record(TIME, signals, {n: units[n] for n in signals}, name)


def noisy(seed=0):
    """A pressure that moves, with 1e4 Pa of noise."""
    return 5e6 + 2e6 * np.sin(5 * TIME) + 1e4 * np.random.default_rng(seed).normal(size=len(TIME))


def remarks(values):
    return inspect_record(record(pressure=values)).channels[0].remarks


def test_ranges_noise_and_steps_are_told_in_the_unit_of_the_file():
    shown = Record(TIME, {"pressure": noisy()}, {"pressure": "Pa"}, "run", display_units={"pressure": "bar"})
    (channel,) = inspect_record(shown).channels
    assert channel.unit == "bar" and channel.noise == pytest.approx(0.1, rel=0.1)
    assert channel.maximum == pytest.approx(70, abs=0.5) and channel.remarks == ()


@pytest.mark.parametrize("begin", [0, 700, 3900])
def test_a_sensor_that_sticks_is_told_with_its_place(begin):
    values = noisy()
    values[begin : begin + 60] = values[begin]
    (said,) = remarks(values)
    assert f"repeats one value {min(60, 4000 - begin)} times in a row (sample {begin + 1} on)" in said


def test_a_sensor_that_saturates_is_told_at_either_edge():
    assert "stands at its largest value, 6.5e+06 Pa" in remarks(np.minimum(noisy(), 6.5e6))[0]
    assert "stands at its smallest value" in remarks(np.maximum(noisy(), 3.5e6))[0]
    assert len(remarks(np.clip(noisy(), 3.5e6, 6.5e6))) == 2


def test_a_channel_that_never_moves_is_told():
    assert "never moves" in remarks(np.full(4000, 3e5))[0]


@pytest.mark.parametrize(
    "values",
    [
        np.clip(np.sin(3 * TIME), -0.5, 0.5),  # a command with a limit
        np.round(noisy() / 2e5) * 2e5,  # a coarse converter
        np.where(TIME % 1 > 0.5, 3.0, 0.0),
        np.cumsum(np.random.default_rng(1).normal(size=4000) * (TIME % 1 > 0.5)),  # a position that rests
        noisy(),
    ],
)
def test_commands_coarse_converters_and_rests_are_no_faults(values):
    assert remarks(values) == ()


def test_gaps_and_a_clock_that_scatters_are_told():
    time = np.concatenate([TIME[:2000], TIME[2000:] + 3.0])
    hole = Record(time, {"x": time}, {"x": "1"})
    assert inspect_record(hole).remarks == ("no samples from 1.999 s to 5 s.",)
    scattered = TIME + 3e-4 * np.random.default_rng(0).uniform(-1, 1, 4000)
    assert "scatter by" in inspect_record(Record(scattered, {"x": TIME}, {"x": "1"})).remarks[0]


def test_what_differs_between_recordings_is_told():
    both = record("a", pressure=noisy(), position=TIME), record("b", pressure=noisy())
    assert together([inspect_record(r) for r in both]) == ["a: only some of the recordings have position."]


SIGNALS = [Signal("command", "V"), Signal("pressure_cap", "Pa"), Signal("rod_position", "m")]


def columns_of(**names):
    """Which column each signal gets in a record with these columns and units."""
    made = Record(TIME, dict.fromkeys(names, TIME), names)
    return {m.signal.name: (m.column, m.certain) for m in matched(SIGNALS, made)}


def test_columns_are_found_by_name_and_proposed_by_likeness_and_dimension():
    assert columns_of(command="V", pressure_cap="Pa", rod_position="m") == {s.name: (s.name, True) for s in SIGNALS}
    assert columns_of(Command="V", pressureCap="Pa", rod_pos="m") == {
        "command": ("Command", False),
        "pressure_cap": ("pressureCap", False),
        "rod_position": ("rod_pos", False),
    }
    assert columns_of(U1="V", p1="Pa", p2="Pa", x="m") == {
        "command": ("U1", False),
        "pressure_cap": (None, False),
        "rod_position": ("x", False),
    }, "of two pressures none is taken"
    assert columns_of(command_pressure="Pa")["command"] == (None, False), "a name alone does not beat the dimension"


def test_a_column_that_cannot_be_used_is_matched_with_its_reason():
    made = Record(TIME, {"x": TIME}, {"x": "1"}, refused={"command": "run.csv: column 'command' has no unit."})
    (first, *_) = matched(SIGNALS, made)
    assert first.column == "command" and "has no unit" in first.problem


def test_the_noise_of_a_saturated_sensor_is_that_of_the_rest():
    time, rng = np.arange(4000) / 100, np.random.default_rng(0)
    truth = 50 + 60 * np.sin(0.5 * time)
    values = np.clip(truth + rng.normal(0, 0.3, len(time)), 20, 80)
    (channel,) = inspect_record(Record(time, {"p": 1e5 * values}, {"p": "Pa"}, "run")).channels
    assert 0.2e5 < channel.noise < 0.4e5 and any("saturates" in r for r in channel.remarks)
