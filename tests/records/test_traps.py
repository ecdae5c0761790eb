"""Files that could be read in two ways: read in the only right one, or asked for. Nothing is lost without a word."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import read_record


def written(tmp_path, text):
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_columns_parted_by_blanks_have_decimals_and_no_groups(tmp_path):
    """Three decimals everywhere: a program writes so, and groups nothing."""
    path = written(tmp_path, "time[ms] force[N] position[mm]\n0 20.000 80.500\n10 20.500 81.002\n")
    np.testing.assert_allclose(read_record(path)["force"], [20.0, 20.5])
    path = written(tmp_path, "time[s] p[bar] F[N]\n0 35,491 12,531\n1 35,491 12,5\n")
    np.testing.assert_allclose(read_record(path)["F"], [12.531, 12.5])
    path = written(tmp_path, "time[s] p[bar]\n" + "".join(f"{k / 100:.4f} {k / 7:.4f}\n" for k in range(50)))
    np.testing.assert_allclose(read_record(path)["p"], 1e5 * np.round(np.arange(50) / 7, 4))


@pytest.mark.parametrize("first", ["ev{},", "2021-03-12 10:00:00.{:02d},", ","])
def test_the_place_of_a_column_counts_columns_without_a_name(first, tmp_path):
    rows = "".join(f"{first.format(k)}{k},{k},{2 * k}\n" for k in range(5))
    path = written(tmp_path, ",time [s],a [V],b [V]\n" + rows)
    np.testing.assert_array_equal(read_record(path, columns="command=#3")["command"], range(5))


@pytest.mark.parametrize(
    ("times", "words"),
    [
        (["00:00", "00:01", "00:02"], "hours and minutes, or minutes and seconds.*--unit 'time=mm:ss'"),
        (["1234567000", "1234568000", "1234569000"], "its numbers do not tell it"),
        (["1234567890123", "1234577890123", "1234587890123"], "its numbers do not tell it"),
        (["25000.000", "25000.005", "25000.010"], "its numbers do not tell it"),
    ],
)
def test_times_that_may_count_two_things_are_asked_for(times, words, tmp_path):
    path = written(tmp_path, "time,p [bar]\n" + "".join(f"{t},1\n" for t in times))
    with pytest.raises(DataError, match=words):
        read_record(path)
    if ":" in times[0]:
        np.testing.assert_allclose(read_record(path, units="time=mm:ss").time, [0, 1, 2])
        np.testing.assert_allclose(read_record(path, units="time=hh:mm").time, [0, 60, 120])


@pytest.mark.parametrize(
    ("head", "units"),
    [
        ("time,Druck (A),Weg (m)\ns,bar,mm\n", {"Druck (A)": "Pa", "Weg (m)": "m"}),
        ("pump (A),valve (V),time (s)\n", {"pump (A)": None, "valve (V)": None}),
        ("Time (s),I (A),U (V)\n", {"I": "A", "U": "V"}),
        ("time_s,speed_rad_s,flow_l_min\n", {"speed": "rad/s", "flow": "m3/s"}),
        ("time_s,torque_N_m,p_bar\n", {"torque": None, "p": "Pa"}),
        ("time_s,p_A_bar,p_T_bar\n", {"p_A": "Pa", "p_T": "Pa"}),
        ("time [s],Druck [bar],x [m]\ns,mbar,m\n", {"Druck": None, "x": "m"}),
        ("time [s],temperature in C,q / A\n", {"temperature in C": None, "q / A": None}),
    ],
)
def test_a_letter_behind_a_name_is_a_unit_only_where_it_can_be_nothing_else(head, units, tmp_path):
    record = read_record(written(tmp_path, head + "0,1,2\n1,2,3\n2,3,4\n"))
    for name, unit in units.items():
        assert record.units.get(name) == unit, record.refused
        assert (name in record.refused) == (unit is None)


def test_a_labelled_row_above_the_numbers_is_no_sample(tmp_path):
    path = written(tmp_path, "Name,time,p\nUnit,s,bar\nScale,0,0.1\n" + "".join(f",{k},{k}\n" for k in range(9)))
    np.testing.assert_allclose(read_record(path)["p"], 1e5 * np.arange(9))


def test_no_sample_is_lost_where_a_remark_stands_between_the_rows(tmp_path):
    path = written(tmp_path, "time [s],p [bar]\n0,1\n# valve opened\n1,2\n2,3\n")
    np.testing.assert_allclose(read_record(path).time, [0, 1, 2])
    path = written(tmp_path, "time [s],p [bar]\n0,1\nvalve opened\n1,2\n2,3\n3,4\n")
    with pytest.raises(DataError, match="row 3, column 'p': the row is too short"):
        read_record(path)


def test_channels_with_times_of_their_own_are_not_put_on_one_clock(tmp_path):
    path = written(tmp_path, "Time [ms];a [V];Time [ms];b [bar]\n0;0;5;35\n10;0;15;35\n")
    with pytest.raises(DataError, match=r"columns 1 and 3 are both named 'Time'.*files of their own"):
        read_record(path)


def test_a_clock_goes_on_as_it_is_told_and_keeps_its_pauses(tmp_path):
    stamps = ["23:59:50.0", "23:59:51.0", "00:00:10.0", "00:00:11.0"]
    path = written(tmp_path, "time,x [1]\n" + "".join(f"{s},1\n" for s in stamps))
    np.testing.assert_allclose(read_record(path, clock="unwrap").time, [0, 1, 20, 21])
    stamps = [7] * 3 + [8] * 10 + [9] * 10  # 10 Hz from 7.7 s on, in whole seconds
    path = written(tmp_path, "time [s],x [1]\n" + "".join(f"{s},1\n" for s in stamps))
    np.testing.assert_allclose(read_record(path, clock="spread").time, 7.7 + np.arange(23) / 10)


def test_what_was_said_is_told(tmp_path):
    path = written(tmp_path, "time [s],a [V],b [V]\n0,1,2\n1,2,3\n2,3,4\n")
    told = read_record(path, rate=1000, columns="a=b", units="b=mV").understood
    words = "a is 'b', the column 'a' of the file is not used, b in mV, sampled at 1000 Hz in place of time"
    assert told.endswith(words)
    with pytest.raises(DataError, match="contradict each other"):
        read_record(path, rate=1000, time="time")


def test_labview_files_say_their_own_step_whatever_parts_their_cells(tmp_path):
    head = "LabVIEW Measurement\nSeparator,Comma\nX_Columns,No\n***End_of_Header***\n\n"
    head += "Channels,2\nY_Unit_Label,bar,bar\n"
    tail = "***End_of_Header***\nX_Value,p,q,Comment\n" + "".join(f",{k},{k}\n" for k in range(5))
    path = tmp_path / "run.lvm"
    path.write_text(head + "X0,0.5,0.5\nDelta_X,0.01,0.01\n" + tail)
    np.testing.assert_allclose(read_record(path).time, 0.5 + np.arange(5) / 100)
    for wrong in ("Delta_X,0.01,0.02\n", "", "X0,0,0.5\nDelta_X,0.01,0.01\n"):
        path.write_text(head + wrong + tail)
        with pytest.raises(DataError, match="--rate 1000"):
            read_record(path)


@pytest.mark.parametrize("text", ["files = 3\n", "time = true\n", "encoding = 3\n"])
def test_an_import_file_of_wrong_kinds_is_refused(text, tmp_path):
    path = written(tmp_path, "time [s],a [V]\n0,1\n1,2\n")
    (tmp_path / "import.toml").write_text(text)
    with pytest.raises(DataError, match=r"import.toml: \w+: "):
        read_record(path)
    (tmp_path / "import.toml").write_bytes("time = 'time'\n".encode("utf-8-sig"))
    assert len(read_record(path)) == 2
