"""What a third hostile look found read wrong without a word: each kind is right now, or refused by name."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import read_record


def written(tmp_path, text):
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_stamps_before_a_trailing_comma_keep_their_numbers(tmp_path):
    for end, names in ((",", "time,p [kPa],q [mm]"), (",OK", "time,p [kPa],q [mm],state")):
        rows = "".join(f"10:00:0{k},{100 + k},{k}{end}\n" for k in range(6))
        record = read_record(written(tmp_path, f"{names}\n{rows}"))
        assert record.time.tolist() == list(range(6)) and record["p"][0] == 1e5 and record["q"][5] == 5e-3


def test_values_without_a_column_are_refused_in_large_files_too(tmp_path):
    rows = "".join(f"{k},3.5,\n" for k in range(250_000)) + "250000,3,5\n250001,3.5,\n"
    with pytest.raises(DataError, match="value without a column"):
        read_record(written(tmp_path, "time [s],p [bar],\n" + rows))


def test_a_time_takes_no_scale(tmp_path):
    with pytest.raises(DataError, match="is the time, which takes no scale"):
        read_record(written(tmp_path, "Zeit [ms];p [bar]\n0;1\n1;2\n"), scale="Zeit=0.5")


@pytest.mark.parametrize(
    ("stamps", "times"),
    [
        ([0, 1, 10, 11, 20, 21], [0, 1, 10, 11, 20, 21]),
        ([0, 1, 5, 6], [0, 1, 5, 6]),
    ],
)
def test_a_coarse_clock_with_gaps_is_spread_at_its_own_rate(stamps, times, tmp_path):
    rows = "".join(f"{s},{k}\n" for s in stamps for k in range(4))
    time = read_record(written(tmp_path, "t [s],p [bar]\n" + rows), clock="spread").time
    np.testing.assert_allclose(time, (np.array(times)[:, None] + np.arange(4) / 4).ravel())


def test_rows_are_dropped_after_the_clock_is_spread(tmp_path):
    rows = "".join(f"{k // 10},{'' if k == 57 else k}\n" for k in range(100))
    record = read_record(written(tmp_path, "t [s],p [bar]\n" + rows), clock="spread", missing="drop rows")
    np.testing.assert_allclose(record.time, np.delete(np.arange(100) / 10, 57))


@pytest.mark.parametrize("sign", "-/.")
def test_a_year_of_two_digits_may_come_first(sign, tmp_path):
    clock = ("23:59:59.0", "23:59:59.5", "00:00:00.0", "00:00:00.5")
    rows = "".join(f"21{sign}05{sign}{4 + k // 2:02d} {stamp};1\n" for k, stamp in enumerate(clock))
    time = read_record(written(tmp_path, "Zeit;p [bar]\n" + rows)).time
    np.testing.assert_allclose(time, np.arange(4) / 2)


def test_a_place_means_its_column_whatever_takes_the_name(tmp_path):
    path = written(tmp_path, "time [s];p [bar];p [bar];x [mm]\n0;1;10;5\n1;2;20;6\n")
    record = read_record(path, columns={"p": "#3"}, scale={"#2": "2"})
    assert record["p"].tolist() == [10e5, 20e5] and record["#2"].tolist() == [2e5, 4e5]


def test_what_an_import_says_of_a_column_stays_with_it(tmp_path):
    path = written(tmp_path, "time [s];p [bar];q [bar]\n0;1;10\n1;2;20\n")
    (tmp_path / "import.toml").write_text('[columns]\ncmd = "p"\n[units]\np = "kPa"\n')
    record = read_record(path, columns={"p": "q"})
    assert record["cmd"].tolist() == [1e3, 2e3] and record["p"].tolist() == [10e5, 20e5]


def test_ports_with_a_number_and_letters_behind_numbers_are_no_units(tmp_path):
    record = read_record(written(tmp_path, "time [s];p (A1);x;y;z [bar]\n0;1;1A;1.5d2;0\n1;2;1A;1.5d2;0\n"))
    assert set(record.refused) == {"p (A1)", "x", "y"} and record.names == ("z",)
    assert "has no unit" in record.refused["p (A1)"] and "text" in record.refused["x"]


def test_what_instruments_write_for_an_overflow_is_no_value(tmp_path):
    path = written(tmp_path, "time [s];p [bar]\n0;1\n1;+9.9E37\n2;3\n")
    with pytest.raises(DataError, match="row 3, column 'p': no value"):
        read_record(path)["p"]
    assert np.isnan(read_record(path, missing="keep")["p"][1])
