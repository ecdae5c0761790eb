"""TDMS: time from waveforms, stamps or a channel; groups keep their instants; damaged files are refused."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import Record, read_record, write_record

nptdms = pytest.importorskip("nptdms")
from hydrotwin.records.tdms_file import read_tdms  # noqa: E402

STEP = 0.01


def channel(name, values, group="Messung", **properties):
    return nptdms.ChannelObject(group, name, np.asarray(values), properties=properties)


def waveform(name, values, group="Messung", unit="bar", **properties):
    return channel(
        name, values, group, **{"unit_string": unit, "wf_increment": STEP, "wf_start_offset": 0.0} | properties
    )


def written(tmp_path, *channels, times=1):
    path = tmp_path / "a.tdms"
    with nptdms.TdmsWriter(path) as writer:
        for _ in range(times):
            writer.write_segment(list(channels))
    return path


def columns(path):
    return {c.name: c for c in read_tdms(path).columns}


def test_a_waveform_tells_the_time_and_the_unit_of_a_channel(tmp_path):
    path = written(
        tmp_path, waveform("pressure_cap", np.arange(4.0)), waveform("x [mm]", np.arange(4, dtype="i2"), unit="")
    )
    record = read_record(path)
    np.testing.assert_allclose(record.time, np.arange(4) * STEP, rtol=1e-15)
    np.testing.assert_allclose(record["pressure_cap"], np.arange(4) * 1e5)
    np.testing.assert_allclose(record["x"], np.arange(4) * 1e-3)


def test_a_waveform_written_in_segments_with_an_offset_is_one_signal(tmp_path):
    path = written(tmp_path, waveform("p", np.arange(5.0), wf_start_offset=-0.02), times=3)
    time, p = read_tdms(path).columns
    np.testing.assert_allclose(time.values, -0.02 + np.arange(15) * STEP, atol=1e-15)
    np.testing.assert_array_equal(p.values, np.tile(np.arange(5.0), 3))


def test_groups_of_other_increments_and_starts_meet_on_the_union_of_their_times(tmp_path):
    start = np.datetime64("2026-05-04T10:00:00.123456", "us")
    fast = waveform("p", np.arange(101.0), "fast", wf_start_time=start)
    slow = waveform("p", np.arange(6.0), "slow", wf_start_time=start + np.timedelta64(5, "ms"), wf_increment=0.2)
    table = read_tdms(written(tmp_path, fast, slow))
    assert table.marks_unknown
    time, p, late = table.columns
    assert (p.name, late.name) == ("fast.p", "slow.p")
    known = np.isfinite(late.values)
    np.testing.assert_allclose(time.values[known], 0.005 + np.arange(6) * 0.2, atol=1e-9)
    np.testing.assert_allclose(time.values[np.isfinite(p.values)], np.arange(101) * STEP, atol=1e-12)
    np.testing.assert_array_equal(late.values[known], np.arange(6))


@pytest.mark.parametrize("name", ["Zeit [ms]", "time [ms]", "Time"])
def test_a_channel_that_is_called_time_is_the_time_of_its_group(name, tmp_path):
    path = written(tmp_path, channel("p", [1.0, 2, 3]), channel(name, [0.0, 10, 30]))
    found = columns(path)
    assert list(found) == ["time", "p"]
    assert found["time"].unit == ("ms" if "ms" in name else None)
    np.testing.assert_array_equal(found["time"].values, [0, 10, 30])


def test_stamps_are_seconds_from_the_first_to_the_digit(tmp_path):
    stamps = np.datetime64("2026-10-25T01:59:59.999990", "us") + np.arange(5) * np.timedelta64(10, "us")
    found = columns(written(tmp_path, channel("Stempel", stamps), channel("p", np.arange(5.0))))
    assert list(found) == ["time", "p"] and found["time"].unit == "s"
    assert found["time"].values.tolist() == [0, 1e-5, 2e-5, 3e-5, 4e-5]


def test_one_time_in_a_group_of_its_own_is_that_of_the_file(tmp_path):
    path = written(
        tmp_path, channel("Zeit [s]", [0.0, 1, 2], "Achse"), channel("p", [4.0, 5, 6]), channel("q", [7.0, 8])
    )
    found = columns(path)
    np.testing.assert_array_equal(found["time"].values, [0, 1, 2])
    np.testing.assert_array_equal(found["p"].values, [4, 5, 6])
    assert "has 2 values, time has 3" in found["q"].unusable


def test_columns_without_any_time_stay_as_they_are(tmp_path):
    found = columns(written(tmp_path, channel("Weg", [3.0, 1]), channel("p", [1.0, 2])))
    assert list(found) == ["Weg", "p"]


def test_text_and_spectra_say_why_they_cannot_be_used(tmp_path):
    text = nptdms.ChannelObject("Messung", "mode", ["auto", "hand", "auto"])
    spectrum = waveform("S", np.arange(3.0), wf_xunit_string="Hz")
    found = columns(written(tmp_path, waveform("p", np.arange(3.0)), text, spectrum))
    for name, says in (("mode", "no numbers .got 'auto'"), ("S", "over Hz, not over time")):
        assert re.search(rf"a.tdms: column '{name}': .*{says}", found[name].unusable)
        assert np.isnan(found[name].values).all() and len(found[name].values) == 3
    np.testing.assert_array_equal(found["p"].values, np.arange(3))


def test_a_linear_scaling_of_the_file_is_applied(tmp_path):
    scaled = {"NI_Number_Of_Scales": 1, "NI_Scale[0]_Scale_Type": "Linear", "NI_Scale[0]_Linear_Slope": 0.5}
    scaled |= {"NI_Scale[0]_Linear_Y_Intercept": 1.0, "NI_Scale[0]_Linear_Input_Source": 0xFFFFFFFF}
    found = columns(written(tmp_path, waveform("p", np.arange(3, dtype="i2"), **scaled)))
    np.testing.assert_array_equal(found["p"].values, [1, 1.5, 2])


@pytest.mark.parametrize("part", [0.0, 0.01, 0.4, 0.95])
def test_a_truncated_file_is_refused(part, tmp_path):
    path = written(tmp_path, waveform("p", np.arange(1000.0)), waveform("q", np.arange(1000.0)), times=2)
    path.write_bytes(path.read_bytes()[: int(part * path.stat().st_size)])
    with pytest.raises(DataError, match=r"a.tdms: .*[Cc]opy") as error:
        read_tdms(path)
    assert len(str(error.value)) < 500


def test_other_bytes_and_a_missing_package_are_told(tmp_path, monkeypatch):
    path = tmp_path / "a.tdms"
    path.write_bytes(b"no tdms at all" * 10)
    with pytest.raises(DataError, match="not a whole TDMS file"):
        read_tdms(path)
    monkeypatch.setitem(sys.modules, "nptdms", None)
    with pytest.raises(DataError, match=r"npTDMS.*hydrotwin\[tdms\]"):
        read_tdms(path)


def test_it_is_read_and_not_written(tmp_path):
    record = Record([0.0, 1.0], {"p": [1.0, 2.0]}, {"p": "Pa"})
    with pytest.raises(DataError, match=r"not a format that is written \(got '.tdms'\)"):
        write_record(record, tmp_path / "a.tdms")


def test_dates_as_text_are_the_time(tmp_path):
    stamps = nptdms.ChannelObject("Messung", "Zeitstempel", [f"04.05.2026 10:00:00,{k:02d}" for k in range(3)])
    path = written(tmp_path, stamps, channel("p [bar]", np.arange(3.0)))
    np.testing.assert_allclose(read_record(path).time, [0, 0.01, 0.02], atol=1e-12)
