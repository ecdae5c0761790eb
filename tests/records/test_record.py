"""What a Record is, and how it moves to another time axis."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError, UnitError
from hydrotwin.records import Record, distinct, read_record


@pytest.fixture
def record():
    t = np.arange(1001) * 0.01
    signals = {"x": 3 - 2 * t, "command": np.floor(t), "p": np.sin(t)}
    return Record(t, signals, {"x": "m", "command": "V", "p": "Pa"}, "run", display_units={"p": "bar"})


def test_a_record_is_a_read_only_copy(record):
    with pytest.raises(ValueError, match="read-only"):
        record["x"][0] = 1.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        record.name = "other"
    values = np.zeros(3)
    copy = Record([0, 1, 2], {"x": values}, {"x": "m"})
    values[:] = 7
    assert copy["x"].tolist() == [0, 0, 0]


def test_a_record_prints_as_one_line_not_as_its_samples():
    record = Record(np.arange(101) / 10, {"u": np.zeros(101), "x": np.zeros(101)}, {"u": "V", "x": "m"}, "run_1")
    assert repr(record) == "Record 'run_1': 101 samples in 10 s; u [V], x [m]"


def test_a_record_knows_its_time(record):
    assert record.duration == 10.0
    assert record.period == pytest.approx(0.01)
    assert record.uniform
    assert len(record) == 1001
    assert not Record([0, 1, 2.1], {}, {}).uniform
    assert Record([0, 1, 2.001], {}, {}).uniform


def test_columns_come_in_the_order_asked(record):
    np.testing.assert_array_equal(record.array(["p", "x"]), np.column_stack([record["p"], record["x"]]))
    assert record.array([]).shape == (1001, 0)
    assert record.select(["p", "x"]).names == ("p", "x")
    assert "x" in record and "y" not in record
    with pytest.raises(DataError, match=r"no column 'comand'. Did you mean 'command'\?"):
        record["comand"]


@pytest.mark.parametrize(
    ("time", "signals", "units", "error", "says"),
    [
        ([0, 1, 1], {"x": [1, 2, 3]}, {"x": "m"}, DataError, "time must grow .got 1 s after 1 s"),
        ([0, 2, 1], {"x": [1, 2, 3]}, {"x": "m"}, DataError, "time must grow .got 1 s after 2 s"),
        ([0, np.nan, 1], {"x": [1, 2, 3]}, {"x": "m"}, DataError, "time must grow"),
        ([0, 1], {"x": [1, 2, 3]}, {"x": "m"}, DataError, "column 'x' has 3 values, time has 2"),
        ([0, 1], {"x": [[1], [2]]}, {"x": "m"}, DataError, "column 'x': one value per sample"),
        ([0, 1], {"x": ["a", "b"]}, {"x": "m"}, DataError, "column 'x': not numbers"),
        ([0, 1], {"time": [1, 2]}, {"time": "s"}, DataError, "cannot be named 'time'"),
        ([0, 1], {"x": [1, 2]}, {}, UnitError, "column 'x' has no unit"),
        ([0, 1], {"x": [1, 2]}, {"x": "bar"}, UnitError, "is in bar, a record holds SI. Convert it to Pa"),
    ],
)
def test_a_record_that_makes_no_sense_is_refused(time, signals, units, error, says):
    with pytest.raises(error, match=says):
        Record(time, signals, units)


def test_holes_in_time_are_listed_and_nothing_is_filled(tmp_path):
    path = tmp_path / "a.csv"
    times = [*np.arange(50) * 0.01, *(2.0 + np.arange(50) * 0.01)]
    path.write_text("time [s],x [m]\n" + "".join(f"{t:.2f},1\n" for t in times))
    record = read_record(path)
    assert len(record) == 100
    assert not record.uniform
    (gap,) = record.gaps
    assert (gap.start, gap.end, gap.index) == (0.49, 2.0, 49)
    assert str(gap) == "no samples from 0.49 s to 2 s"
    assert record.window(0, 1).gaps == ()


def test_a_jittered_time_axis_has_no_gaps():
    rng = np.random.default_rng(1)
    assert Record(np.cumsum(rng.exponential(0.01, 500) + 1e-3), {}, {}).gaps == ()


def test_a_window_keeps_the_samples_inside_and_the_clock(record):
    part = record.window(2.0, 3.0)
    assert part.time[0] == 2.0
    assert part.time[-1] == 3.0
    assert part.display_units == {"p": "bar"}
    np.testing.assert_allclose(part["x"], 3 - 2 * part.time)
    assert record.window(end=1.0).duration == 1.0
    assert record.window(start=9.0).duration == pytest.approx(1.0)
    with pytest.raises(DataError, match=r"no sample in the window .got 20 s to 30 s.*0 s to 10 s"):
        record.window(20, 30)


def test_resampling_is_exact_for_lines_and_for_held_commands(record):
    finer = record.resample(period=0.003, hold=["command"])
    np.testing.assert_allclose(finer["x"], 3 - 2 * finer.time, atol=1e-12)
    expected = np.floor(np.floor(finer.time / 0.01 + 1e-5) * 0.01 + 1e-9)
    np.testing.assert_array_equal(finer["command"], expected)
    assert finer.period == pytest.approx(0.003)
    coarse = record.resample(times=[0.5, 0.505, 7.25])
    np.testing.assert_allclose(coarse["x"], [2.0, 1.99, -11.5])


def test_a_held_value_changes_at_its_sample_even_when_the_grid_rounds_down(record):
    same = record.resample(times=record.time * (1 - 1e-12), hold=["command"])
    np.testing.assert_array_equal(same["command"], record["command"])


def test_the_even_grid_ends_inside_the_record(record):
    assert record.resample(period=0.01).time[-1] == 10.0
    assert len(record.resample(period=0.01)) == 1001
    assert record.resample(period=0.7).time[-1] == pytest.approx(9.8)


def test_nothing_is_extrapolated(record):
    with pytest.raises(DataError, match=r"outside the record .got 9 s to 11 s.*0 s to 10 s"):
        record.resample(times=[9.0, 11.0])
    with pytest.raises(DataError, match="either a period or times"):
        record.resample()
    with pytest.raises(DataError, match="must be positive"):
        record.resample(period=0.0)
    with pytest.raises(DataError, match="no column 'comand'"):
        record.resample(period=0.1, hold=["comand"])


@pytest.mark.parametrize("jitter", [0.0, 3e-4])
def test_anti_aliasing_removes_what_the_new_rate_cannot_carry(jitter):
    rng = np.random.default_rng(2)
    t = np.arange(20_000) * 1e-3 + jitter * rng.uniform(-1, 1, 20_000)
    slow, fast = np.sin(2 * np.pi * 1.0 * t), np.sin(2 * np.pi * 97.0 * t)
    record = Record(t, {"x": slow + fast, "u": slow + fast}, {"x": "m", "u": "V"})
    aliased = record.resample(period=0.02)
    clean = record.resample(period=0.02, anti_alias=True, hold=["u"])
    inner = slice(50, -50)
    truth = np.sin(2 * np.pi * clean.time)
    assert np.abs(aliased["x"] - truth)[inner].max() > 0.9
    assert np.abs(clean["x"] - truth)[inner].max() < 0.03  # linear interpolation already costs the fast part 3 %
    assert np.abs(clean["u"] - truth)[inner].max() > 0.9


def test_anti_aliasing_passes_ramps_and_changes_nothing_going_up(record):
    down = record.resample(period=0.1, anti_alias=True)
    np.testing.assert_allclose(down["x"], 3 - 2 * down.time, atol=1e-9)
    np.testing.assert_array_equal(record.resample(period=0.01, anti_alias=True)["p"], record["p"])
    np.testing.assert_allclose(
        record.resample(period=0.004, anti_alias=True)["p"], record.resample(period=0.004)["p"], atol=0
    )


def test_signals_can_be_added_and_replaced(record):
    more = record.with_signals({"x": record["x"] + 1, "q": record["p"] * 2}, units={"q": "m3/s"})
    assert more.names == ("x", "command", "p", "q")
    np.testing.assert_allclose(more["x"] - record["x"], 1.0)
    assert more.units["q"] == "m3/s"
    with pytest.raises(UnitError, match="'q' has no unit"):
        record.with_signals({"q": record["p"]})


def test_recordings_of_one_name_are_told_apart_over_all_groups():
    time = np.arange(3.0)
    first, second, third, other = (Record(time, {}, {}, name) for name in ("run", "run (2)", "run", "walk"))
    (one, two), (three, four) = distinct([first, second], [third, other])
    assert [one, two, four] == [first, second, other] and three.name == "run (3)"
