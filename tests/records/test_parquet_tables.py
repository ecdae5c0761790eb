"""Parquet as pandas and polars write it: the index that is time, stamps, and columns that hold no numbers."""

from __future__ import annotations

import datetime
import re

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import read_record
from hydrotwin.records.binary_files import read_parquet

pd = pytest.importorskip("pandas")
pl = pytest.importorskip("polars")

P = np.arange(4.0)
SECONDS = [0.0, 0.01, 0.02, 0.03]


def columns(tmp_path, frame):
    path = tmp_path / "a.parquet"
    frame.to_parquet(path) if isinstance(frame, pd.DataFrame) else frame.write_parquet(path)
    return {c.name: c for c in read_parquet(path).columns}


def test_a_nameless_index_that_grows_in_fractions_is_the_time(tmp_path):
    found = columns(tmp_path, pd.DataFrame({"p [bar]": P}, index=SECONDS))
    assert found["time"].unit == "s" and found["time"].values.tolist() == SECONDS


@pytest.mark.parametrize("index", [[3, 7, 8, 11], [0.5, 0.1, 0.2, 0.3]])
def test_a_nameless_index_of_row_numbers_or_disorder_is_no_time(index, tmp_path):
    assert list(columns(tmp_path, pd.DataFrame({"p [bar]": P, "Zeit [s]": SECONDS}, index=index))) == ["p", "Zeit"]


def test_a_named_index_keeps_its_name_and_unit(tmp_path):
    found = columns(tmp_path, pd.DataFrame({"p [bar]": P}, index=pd.Index(SECONDS, name="Zeit [s]")))
    assert found["Zeit"].unit == "s" and found["Zeit"].values.tolist() == SECONDS


@pytest.mark.parametrize("unit", ["ms", "us", "ns"])
@pytest.mark.parametrize("name", ["zeitpunkt", "time"])
def test_the_only_column_of_stamps_is_the_time(name, unit, tmp_path):
    stamps = np.datetime64("2026-10-25T01:59:59.99") + np.arange(4) * np.timedelta64(10, "ms")
    found = columns(tmp_path, pl.DataFrame({"p [bar]": P, name: pl.Series(stamps.astype(f"datetime64[{unit}]"))}))
    assert list(found) == ["p", "time"] and found["time"].values.tolist() == SECONDS


def test_one_column_of_stamps_beside_a_time_is_a_signal(tmp_path):
    stamps = [datetime.datetime(2026, 1, 1, microsecond=10_000 * k) for k in range(4)]
    found = columns(tmp_path, pl.DataFrame({"Zeit [s]": SECONDS, "written": stamps}))
    assert list(found) == ["Zeit", "written"] and found["written"].values.tolist() == SECONDS


@pytest.mark.parametrize("name", ["Zeit [ns]", "timestamp", "clock [us]"])
def test_a_count_of_time_since_1970_keeps_every_digit(name, tmp_path):
    count = 1_700_000_000_000_000_001 + np.arange(4) * 10_000_000
    (found,) = columns(tmp_path, pl.DataFrame({name: count})).values()
    assert found.values.tolist() == [0, 1e7, 2e7, 3e7]


def test_columns_without_numbers_say_so_and_cost_nothing_else(tmp_path):
    others = {
        "mode": (["auto", "hand", None, "auto"], "string.*got 'auto'"),
        "gear": (pl.Series(["one", "two", "one", "two"], dtype=pl.Categorical), "got 'one'"),
        "spectrum": ([[1.0, 2.0]] * 4, "list"),
        "raw": ([b"a"] * 4, "binary"),
        "point": ([{"x": 1.0}] * 4, "struct"),
    }
    frame = pl.DataFrame({"time [s]": SECONDS, "p [bar]": P} | {name: values for name, (values, _) in others.items()})
    found = columns(tmp_path, frame)
    assert found["p"].values.tolist() == P.tolist() and not found["p"].unusable
    for name, (_, says) in others.items():
        assert re.search(rf"a.parquet: column '{name}': it holds no numbers but .*{says}", found[name].unusable)
        assert len(found[name].values) == 4 and np.isnan(found[name].values).all()


def test_decimals_truth_values_and_what_is_absent_are_numbers(tmp_path):
    frame = pl.DataFrame(
        {
            "valve": [True, False, None, True],
            "price": pl.Series(["1.25", None, "3.5", "0"]).cast(pl.Decimal(10, 2)),
            "count": pl.Series([1, None, 3, 4], dtype=pl.UInt8),
            "large": pl.Series([2**63 + 4096] * 4, dtype=pl.UInt64),
            "empty": pl.Series([None] * 4, dtype=pl.Null),
        }
    )
    found = {name: c.values for name, c in columns(tmp_path, frame).items()}
    np.testing.assert_array_equal(found["valve"], [1, 0, np.nan, 1])
    np.testing.assert_array_equal(found["price"], [1.25, np.nan, 3.5, 0])
    np.testing.assert_array_equal(found["count"], [1, np.nan, 3, 4])
    np.testing.assert_array_equal(found["large"], [float(2**63 + 4096)] * 4)
    assert np.isnan(found["empty"]).all()


@pytest.mark.parametrize("how", ["feather", "stream"])
def test_arrow_files_read_alike(how, tmp_path):
    import pyarrow as pa
    import pyarrow.feather

    frame = pd.DataFrame({"p [bar]": P, "mode": list("abab")}, index=pd.to_timedelta(SECONDS, unit="s"))
    table = pa.Table.from_pandas(frame)
    path = tmp_path / "a.arrow"
    if how == "stream":
        with pa.ipc.new_stream(path, table.schema) as writer:
            writer.write_table(table)
    else:
        pyarrow.feather.write_feather(table, path)
    record = read_record(path)
    assert record.time.tolist() == SECONDS and record.names == ("p",)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(DataError, match="not a whole Arrow file"):
        read_record(path)


def test_dates_as_text_are_the_time(tmp_path):
    path = tmp_path / "a.parquet"
    stamps = [f"2026-05-04T10:00:00.{k:02d}Z" for k in range(4)]
    pl.DataFrame({"timestamp": stamps, "p [bar]": P}).write_parquet(path)
    record = read_record(path)
    np.testing.assert_allclose(record.time, SECONDS, atol=1e-12)
    np.testing.assert_allclose(record["p"], P * 1e5)
