"""MDF: every group keeps its own samples, and what is marked as invalid is unknown."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from hydrotwin.records import read_record
from hydrotwin.records.mdf_file import read_mdf

mdf = pytest.importorskip("asammdf")


def channel(name, time, values, unit="bar", **options):
    return mdf.Signal(samples=np.asarray(values), timestamps=np.asarray(time, float), name=name, unit=unit, **options)


def written(tmp_path, *groups):
    path = tmp_path / "a.mf4"
    with mdf.MDF(version="4.10") as file:
        for group in groups:
            file.append(list(group))
        file.save(path, overwrite=True)
    return path


def test_samples_with_the_invalidation_bit_are_unknown(tmp_path):
    time, values = np.arange(10) * 0.01, np.arange(10.0)
    values[3:6] = -9999
    invalid = (values < 0).astype(bool)
    path = written(tmp_path, [channel("p", time, values, invalidation_bits=invalid), channel("q", time, np.arange(10))])
    record = read_record(path)
    np.testing.assert_array_equal(np.isnan(record["p"]), invalid)
    np.testing.assert_allclose(record["p"][~invalid], values[~invalid] * 1e5)
    assert np.isfinite(record["q"]).all()
    np.testing.assert_array_equal(read_record(path, missing="keep")["p"], record["p"])
    np.testing.assert_allclose(read_record(path, missing="drop rows").time, time[~invalid])


def test_groups_of_several_rasters_are_on_the_union_of_their_times(tmp_path):
    fast, slow, late = np.arange(101) * 0.01, 0.005 + np.arange(10) * 0.1, 0.4 + np.arange(100) * 1e-3
    path = written(
        tmp_path,
        [channel("fast", fast, fast)],
        [channel("slow", slow, slow)],
        [channel("triggered", late, late), channel("flag", late, (late > 0.45).astype("u1"), "1")],
    )
    record = read_record(path)
    np.testing.assert_allclose(record.time, np.union1d(np.union1d(fast, slow).round(6), late.round(6)), atol=1e-9)
    for name, axis in (("fast", fast), ("slow", slow), ("triggered", late)):
        known = np.isfinite(record[name])
        np.testing.assert_allclose(record.time[known], axis, atol=1e-9)
        np.testing.assert_allclose(record[name][known], axis * 1e5)
    assert np.isfinite(record["flag"]).sum() == 100


def test_one_instant_of_two_groups_is_one_sample_however_it_was_rounded(tmp_path):
    one, two = np.arange(1001) * 0.01, np.arange(101) * 0.1 * (1 + 1e-12)
    record = read_record(written(tmp_path, [channel("a", one, one)], [channel("b", two, two)]))
    assert len(record) == 1001
    assert np.isfinite(record["b"]).sum() == 101


def test_text_and_angles_say_why_they_cannot_be_used_and_empty_groups_are_left_out(tmp_path):
    time = np.arange(5) * 0.1
    path = tmp_path / "a.mf4"
    with mdf.MDF(version="4.10") as file:
        file.append([channel("p", time, time), channel("gear", time, np.array([b"one"] * 5), "", encoding="utf-8")])
        file.append([channel("cylinder", np.arange(9.0), np.arange(9.0))])
        file.groups[1].channels[0].sync_type = 2  # over an angle
        file.save(path, overwrite=True)
    columns = {c.name: c for c in read_mdf(path).columns}
    assert set(columns) == {"time", "p", "gear", "cylinder"}
    np.testing.assert_array_equal(columns["p"].values, time)
    for name, says in (("gear", "no numbers .got .*one"), ("cylinder", "not sampled over time")):
        assert re.search(rf"a.mf4: column '{name}': .*{says}", columns[name].unusable)
        assert len(columns[name].values) == 5 and np.isnan(columns[name].values).all()


def test_a_conversion_of_the_file_is_applied(tmp_path):
    raw = channel("p", np.arange(3) * 0.1, np.array([0, 100, 200], "u2"), "bar", conversion={"a": 0.1, "b": -1.0})
    np.testing.assert_allclose(read_record(written(tmp_path, [raw]))["p"], [-1e5, 9e5, 19e5])


def test_a_group_whose_time_does_not_grow_costs_only_its_channels(tmp_path):
    path = written(tmp_path, [channel("a", [0, 1, 2], [0, 1, 2])], [channel("b", [0, 0.5, 0.5], [0, 1, 2])])
    time, a, b = read_mdf(path).columns
    np.testing.assert_array_equal(time.values, [0, 1, 2])
    np.testing.assert_array_equal(a.values, [0, 1, 2])
    assert "column 'b': time must grow (got 0.5 s after 0.5 s in row 3" in b.unusable


@pytest.mark.parametrize("version", ["2.14", "3.30", "4.20"])
def test_every_version_keeps_the_raster_of_each_group(version, tmp_path):
    fast, slow = np.arange(6) * 0.1, 0.05 + np.arange(3) * 0.2
    with mdf.MDF(version=version) as file:
        file.append([channel("p", fast, fast * 2), channel("T", fast, fast, "degC")])
        file.append([channel("p", slow, slow), channel("level [mm]", slow, slow.astype("f4"), "")])
        path = Path(file.save(tmp_path / "a.mdf", overwrite=True))
    columns = {c.name: c for c in read_mdf(path).columns}
    assert set(columns) == {"time", "group 1.p", "T", "group 2.p", "level"}
    assert columns["level"].unit == "mm"
    np.testing.assert_allclose(columns["time"].values, np.union1d(fast, slow))
    known = np.isfinite(columns["group 2.p"].values)
    np.testing.assert_allclose(columns["time"].values[known], slow)
    np.testing.assert_allclose(columns["group 1.p"].values[~known], fast * 2)


@pytest.mark.parametrize("shape", [(3,), (2, 2)])
def test_a_channel_of_arrays_is_one_column_per_element(shape, tmp_path):
    time = np.arange(10) * 0.01
    many = np.zeros(10, dtype=[("p", "<f8", shape)])
    many["p"] = np.arange(10 * np.prod(shape), dtype=float).reshape(10, *shape)
    record = read_record(written(tmp_path, [channel("p", time, many), channel("q", time, np.arange(10.0))]))
    columns = {f"p{''.join(f'[{i}]' for i in at)}": many["p"][:, *at] for at in np.ndindex(shape)}
    assert set(record.names) == {*columns, "q"}
    assert record.units[next(iter(columns))] == "Pa"
    for name, values in columns.items():
        np.testing.assert_allclose(record[name], values * 1e5)


def test_a_file_that_is_mdf_and_called_dat_is_read_as_mdf(tmp_path):
    with mdf.MDF(version="3.30") as file:
        file.append([channel("p", [0, 0.1, 0.2], [1, 2, 3])])
        path = Path(file.save(tmp_path / "a.mdf", overwrite=True)).rename(tmp_path / "a.dat")
    np.testing.assert_allclose(read_record(path)["p"], [1e5, 2e5, 3e5])
