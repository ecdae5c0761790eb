"""Types of time in Parquet: seconds to the last bit, or refused."""

from __future__ import annotations

import datetime
from decimal import Decimal

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import stamps
from tests.records.whole import whole

pa = pytest.importorskip("pyarrow")
pd = pytest.importorskip("pandas")
import pyarrow.parquet as parquet  # noqa: E402

X = {"x [bar]": np.arange(5.0)}
STEP_MS = 10


def read(tmp_path, frame):
    path = tmp_path / "a.parquet"
    frame.to_parquet(path) if isinstance(frame, pd.DataFrame) else parquet.write_table(frame, path)
    return whole(path)


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
@pytest.mark.parametrize("name", ["time [s]", "time", None])
@pytest.mark.parametrize("kind", ["duration", "stamp", "stamp with zone"])
def test_an_index_of_a_type_of_time_is_time_in_seconds(kind, name, unit, tmp_path):
    steps = (np.arange(5) * STEP_MS).astype("timedelta64[ms]").astype(f"timedelta64[{unit}]")
    if kind == "duration":
        index = pd.TimedeltaIndex(steps)
    else:
        zone = "Europe/Berlin" if "zone" in kind else None
        index = pd.DatetimeIndex(np.datetime64("2026-03-29T00:59:59.98", unit) + steps, tz="UTC").tz_convert(zone)
    record = read(tmp_path, pd.DataFrame(X, index=index.rename(name)))
    assert record.time.tolist() == [0.0, 0.01, 0.02, 0.03, 0.04]
    assert record.names == ("x",)


def test_columns_of_every_type_of_time_are_exact(tmp_path):
    columns = {
        "duration": pa.array([0, 1_234_567_891, 86_400_000_000_001], pa.duration("ns")),
        "clock": pa.array([1, 2, 86_399_999], pa.time32("ms")),
        "clock_ns": pa.array([1, 2_000, 86_399_999_999_999], pa.time64("ns")),
        "day": pa.array([datetime.date(2026, 1, d) for d in (1, 2, 4)]),
        "stamp": pa.array([2**62, 2**62 + 1, 2**62 + 10**9], pa.timestamp("ns")),
    }
    record = read(tmp_path, pa.table({"time [s]": [0.0, 1.0, 2.0], **columns}))
    assert record["duration"].tolist() == [0, 1.234567891, 86400.000000001]
    assert record["clock"].tolist() == [1e-3, 2e-3, 86399.999]
    assert record["clock_ns"].tolist() == [1e-9, 2e-6, 86399.999999999]
    assert record["day"].tolist() == [0, 86400, 3 * 86400]
    assert record["stamp"].tolist() == [0, 1e-9, 1]
    assert set(record.units.values()) == {"s"}


def test_whole_numbers_beyond_those_of_a_float_are_counted_from_the_first(tmp_path):
    epoch = (1_700_000_000_000_000_001 + np.arange(5) * 10_000_000).astype("uint64")
    record = read(tmp_path, pd.DataFrame({**X, "time [ns]": epoch}))
    np.testing.assert_allclose(record.time, np.arange(5) * 0.01, rtol=1e-15)


def test_an_index_without_a_name_that_is_no_time_is_no_signal(tmp_path):
    frame = pd.DataFrame({**X, "time [s]": np.arange(5) * 0.1})
    assert read(tmp_path, frame[frame["x [bar]"] != 1]).names == ("x",)


def test_a_type_of_time_under_another_unit_is_refused(tmp_path):
    with pytest.raises(
        DataError, match=r"column 'time': its type is duration.*, named in \[ms\].*name it 'time \[s\]'"
    ):
        read(tmp_path, pd.DataFrame({**X, "time [ms]": pd.to_timedelta(np.arange(5), unit="s")}))


def test_a_stamp_that_is_missing_is_a_missing_time(tmp_path):
    stamps = [pd.Timestamp(2026, 1, 1), pd.NaT, *pd.date_range("2026-01-02", periods=3)]
    with pytest.raises(DataError, match="row 2, column 'time': no value"):
        read(tmp_path, pd.DataFrame({**X, "time": stamps}))


EPOCH = 1_700_000_000


@pytest.mark.parametrize(
    ("unit", "first", "step"),
    [
        ("us", f"{EPOCH}000000", 1e-6),
        ("ns", f"{EPOCH}000000000", 1e-6),
        ("ms", f"{EPOCH}000", 1e-3),
        ("ms", f"{EPOCH}000.125", 1e-6),
        ("s", f"{EPOCH}.000001", 1e-6),
        ("s", f"-{EPOCH}", 1e-6),
    ],
)
@pytest.mark.parametrize("sign", [".", ","])
def test_time_since_1970_in_a_text_keeps_every_digit_of_its_steps(unit, first, step, sign, tmp_path):
    inside = Decimal(str(step)) / Decimal({"s": "1", "ms": "1e-3", "us": "1e-6", "ns": "1e-9"}[unit])
    cells = [f"{Decimal(first) + k * inside:f}".replace(".", sign) for k in range(4)]
    path = tmp_path / "a.csv"
    path.write_text(f"time [{unit}];x [1]\n" + "".join(f"{cell};0{sign}5\n" for cell in cells))
    np.testing.assert_allclose(whole(path).time, np.arange(4) * step, rtol=1e-14)


@pytest.mark.parametrize("kind", ["int64", "uint64", "float64"])
def test_whole_microseconds_since_1970_keep_every_digit_of_their_steps(kind, tmp_path):
    count = (EPOCH * 1_000_000 + np.arange(5)).astype(kind)
    record = read(tmp_path, pd.DataFrame({**X, "time [us]": count}))
    np.testing.assert_allclose(record.time, np.arange(5) * 1e-6, rtol=1e-14)


def test_seconds_since_1970_that_have_lost_their_steps_are_refused(tmp_path):
    frame = pd.DataFrame({**X, "time [s]": EPOCH + np.arange(5) * 1e-6})
    with pytest.raises(DataError, match=r"column 'time' begins at 1700000000 s.* rounded to 2.4e-07 s.*from the start"):
        read(tmp_path, frame)
    coarse = read(tmp_path, frame.assign(**{"time [s]": EPOCH + np.arange(5) * 0.01}))
    assert coarse.time[0] == EPOCH  # its steps are good to 1e-4: the clock of the logger stays


@pytest.mark.parametrize("cells", [["nan", "nan", "nan"], ["inf", "inf", "1"], ["5", "5", "5"]])
def test_a_time_that_is_none_is_refused_and_not_warned_about(cells, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("time [s],x [1]\n" + "".join(f"{cell},1\n" for cell in cells))
    with pytest.raises(DataError, match=r"a.csv: row 2|a.csv: row 3"):
        whole(path)


@pytest.mark.parametrize(
    "form",
    ["%Y-%m-%d %H:%M:%S.%f", "%d.%m.%Y %H:%M:%S,%f", "%m/%d/%Y %H:%M:%S", "%H:%M:%S.%f", "%Y-%m-%dT%H:%M:%S.%f-05:30",
     "%d Mar %Y %H:%M:%S", "%Y%m%dT%H%M%S.%fZ", "%Y-%m-%d %H:%M:%S CEST", "%d/%m/%Y %I:%M:%S PM"],
)  # fmt: skip
def test_stamps_taken_apart_at_once_are_what_they_are_one_by_one(form):
    start, rng = datetime.datetime(2020, 1, 1), np.random.default_rng(1)
    cells = [(start + datetime.timedelta(seconds=float(s))).strftime(form) for s in rng.uniform(0, 6e7, 200)]
    assert stamps._evenly_written(cells)
    at_once, one_by_one = stamps.nanoseconds(cells)[0], stamps.nanoseconds([*cells, ""])[0][:-1]
    np.testing.assert_array_equal(at_once, one_by_one)
    assert stamps._evenly_written([*cells, f" {cells[0]}"]) is None
