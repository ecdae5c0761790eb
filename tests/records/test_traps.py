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
        ("time_s,torque_N_m,p_bar\n", {"torque_N_m": None, "p": "Pa"}),
        ("time_s,p_A_bar,p_T_bar\n", {"p_A": "Pa", "p_T": "Pa"}),
        ("time [s],Druck [bar],x [m]\ns,mbar,m\n", {"Druck": None, "x": "m"}),
        ("Zeit (s),Druck (min),Druck (max)\n", {"Druck (min)": None, "Druck (max)": None}),
        ("time (s),flow (in),flow (out)\n", {"flow (in)": None, "flow (out)": None}),
        ("time (s),p (1),p (2)\n", {"p (1)": None, "p (2)": None}),
        ("time [s],pressure_in,position_in\n", {"pressure_in": None, "position_in": None}),
        ("time_s,stiffness_Nm_rad,viscosity_Pa_s\n", {"stiffness_Nm_rad": None, "viscosity_Pa_s": None}),
        ("time_s,delay_1_s,p_in_bar\n", {"delay_1": "s", "p_in": "Pa"}),
        ("time_min,jerk_m_s3,speed_m_s\n", {"jerk_m_s3": None, "speed": "m/s"}),
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
    words = "a is 'b', the column 'a' of the file is not used, a in mV, sampled at 1000 Hz in place of time"
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
        with pytest.raises(DataError, match=r"--rate 1000|times of their own"):
            read_record(path)


@pytest.mark.parametrize("text", ["files = 3\n", "time = true\n", "encoding = 3\n"])
def test_an_import_file_of_wrong_kinds_is_refused(text, tmp_path):
    path = written(tmp_path, "time [s],a [V]\n0,1\n1,2\n")
    (tmp_path / "import.toml").write_text(text)
    with pytest.raises(DataError, match=r"import.toml: \w+: "):
        read_record(path)
    (tmp_path / "import.toml").write_bytes("time = 'time'\n".encode("utf-8-sig"))
    assert len(read_record(path)) == 2


def test_names_are_not_shifted_where_a_row_has_a_value_too_many(tmp_path):
    """A decimal comma in a comma file: one name less than values."""
    for text in ("t [ms],command [V]\n0,1,5\n1,2,5\n2,3,5\n", "time [s],p [bar]\n0.0,1.5,7\n0.1,2.5,8\n"):
        with pytest.raises(DataError):
            read_record(written(tmp_path, text))


def test_rows_with_words_right_below_the_names_are_not_lost(tmp_path):
    path = written(tmp_path, "time [s];p;q;r [bar]\n0;init;init;init\n1;init;init;init\n" + "".join(
        f"{k};0;0;{k}\n" for k in range(2, 9)))  # fmt: skip
    with pytest.raises(DataError, match="row 2, column 'r': not a number"):
        read_record(path)["r"]
    path = written(tmp_path, "time [s];p [bar]\n0;18\n#1;20\n2;22\n3;22\n")
    with pytest.raises(DataError, match="row 3, column 'time': not a number"):
        read_record(path)


def test_a_title_as_wide_as_the_table_names_nothing(tmp_path):
    path = written(tmp_path, "Cylinder test run\ntime pA pB\ns bar bar\n0.0 1.5 1\n0.1 2.5 2\n0.2 3.5 3\n")
    assert read_record(path).names == ("pA", "pB")
    path = written(tmp_path, "Halle 3;Meier;Rig 7\nt [s];p [bar];x [mm]\n0.0;1.5;1\n0.1;2.5;2\n")
    assert read_record(path).names == ("p", "x")
    path = written(tmp_path, "time;1;2\ns;bar;mm\n0.0;1.5;1\n0.1;2.5;2\n")
    assert read_record(path).names == ("1", "2")


def test_what_is_said_now_beats_the_file_whichever_name_of_a_column_is_used(tmp_path):
    path = written(tmp_path, "Zeit;Ventil\n0;1\n1;2\n")
    (tmp_path / "import.toml").write_text('[units]\nZeit = "s"\ncommand = "%"\n[columns]\ncommand = "Ventil"\n')
    np.testing.assert_allclose(read_record(path, units="Ventil=V")["command"], [1, 2])
    np.testing.assert_allclose(read_record(path, units="command=V")["command"], [1, 2])
    path = written(tmp_path, "time [s];p [bar];x [mm]\n0;1;2\n1;2;3\n")
    (tmp_path / "import.toml").unlink()
    swapped = read_record(path, columns=["p=x", "x=p"], units="p=m")
    assert swapped["p"].tolist() == [2, 3] and swapped["x"].tolist() == [1e5, 2e5]


@pytest.mark.parametrize(
    ("stamps", "options", "times"),
    [
        (["59:58", "59:59", "00:00"], {"units": "time=mm:ss", "clock": "unwrap"}, [0, 1, 2]),
        (["00:01.5", "00:02.0", "00:02.5"], {}, [0, 0.5, 1.0]),
        (["10:00:00.1", "09:59:59.9", "10:00:00.3"], {"clock": "unwrap"}, None),
        (["10:12:33:10", "10:12:33:20", "10:12:33:30"], {}, None),
        (["1300000000", "1300000000", "1300000001", "1300000001"], {"clock": "spread"}, None),
    ],
)
def test_clocks_wrap_where_they_do_and_nowhere_else(stamps, options, times, tmp_path):
    path = written(tmp_path, "time,p [bar]\n" + "".join(f"{s},{k}\n" for k, s in enumerate(stamps)))
    if times is None:
        with pytest.raises(DataError):
            read_record(path, **options)
    else:
        np.testing.assert_allclose(read_record(path, **options).time, times)


def test_a_temperature_with_a_zero_of_its_own_takes_no_scale(tmp_path):
    with pytest.raises(DataError, match="a scale of it means nothing"):
        read_record(written(tmp_path, "time [s],T [degC]\n0,1\n1,2\n"), scale="T=2 mm/K")


def test_repairs_of_a_clock_may_follow_each_other(tmp_path):
    stamps = ["23:59:59", "23:59:59", "00:00:00", "00:00:00", "00:00:01", "00:00:01"]
    path = written(tmp_path, "time,x [1]\n" + "".join(f"{s},1\n" for s in stamps))
    np.testing.assert_allclose(read_record(path, clock="unwrap,spread").time, [0, 0.5, 1, 1.5, 2, 2.5])
    with pytest.raises(DataError, match="clock: not a choice"):
        read_record(path, clock="unwrap,mend")


def test_a_column_may_be_meant_by_its_place_wherever_one_is_named(tmp_path):
    path = written(tmp_path, "time,p,p\n0,1,3\n1,2,4\n")
    record = read_record(path, columns="q=#3", units=["#1=ms", "q=bar", "#2=mbar"])
    assert record.time.tolist() == [0, 1e-3]
    assert record["q"].tolist() == [3e5, 4e5] and record["p"].tolist() == [100, 200]
    path = written(tmp_path, ",x [V]\n0,1\n1,2\n")
    np.testing.assert_allclose(read_record(path, time="#1", units="#1=ms").time, [0, 1e-3])


def test_remarks_of_labview_files_are_a_column_of_their_own(tmp_path):
    head = "LabVIEW Measurement\nSeparator\tTab\nX_Columns\tOne\n***End_of_Header***\n\nChannels\t1\n"
    head += "Y_Unit_Label\tbar\n***End_of_Header***\nX_Value\tp\tComment\n"
    path = tmp_path / "run.lvm"
    path.write_text(head + "0\t1\tnote 7\n1\t2\n2\t3\n")
    assert read_record(path)["p"].tolist() == [1e5, 2e5, 3e5]


def test_dates_and_versions_do_not_tell_a_decimal_sign(tmp_path):
    rows = "".join(f"04.05.2021;10:11:12.{10 * k:03d};{{}}\n" for k in range(4))
    head = "Datum;Zeit;p [bar]\n"
    for numbers in ((1.5, 2.5, 3, 4), ("1,5", "2,5", 3, 4)):
        record = read_record(written(tmp_path, head + rows.format(*numbers)))
        assert record["p"].tolist() == [1.5e5, 2.5e5, 3e5, 4e5]
    with pytest.raises(DataError, match=r"'1\.345' may be 1345"):
        read_record(written(tmp_path, head + rows.format("1.345", "2.345", "3.345", "4.345")))
    with pytest.raises(DataError, match=r"'1\.345' may be 1345"):
        read_record(written(tmp_path, "v;t [s];p [bar]\n1.2.3;0;1.345\n1.2.3;1;2.345\n"))


def test_a_sample_with_a_remark_in_front_is_a_sample(tmp_path):
    rows = "".join(f"{'Start' if k < 2 else ''};{0.1 * k:.1f};{k}\n" for k in range(50))
    record = read_record(written(tmp_path, "Kommentar;Zeit [s];p [bar]\n" + rows))
    assert len(record) == 50 and record["p"][:2].tolist() == [0, 1e5]
    stamped = "".join(f"{'Start' if k < 2 else ''};10:00:{k:02d};{k}\n" for k in range(50))
    assert len(read_record(written(tmp_path, "Kommentar;Zeit;p [bar]\n" + stamped))) == 50
    record = read_record(written(tmp_path, "Name;Zeit;p\nEinheit;s;bar\nKanal;1;2\n" + rows.replace("Start", "")))
    assert len(record) == 50 and "1 line above the numbers left out, the first: 'Kanal;1;2'" in record.understood


def test_samples_before_a_gap_are_not_spread_into_it(tmp_path):
    rows = "".join(f"{k // 5 + (3 if k >= 30 else 0)},{k}\n" for k in range(60))
    time = read_record(written(tmp_path, "t [s],p [bar]\n" + rows), clock="spread").time
    np.testing.assert_allclose(time[25:31], [5, 5.2, 5.4, 5.6, 5.8, 9])


def test_a_factor_gives_no_temperature(tmp_path):
    path = written(tmp_path, "t [s],T [V]\n0,1\n1,2\n")
    for unit in ("degC/V", "°C/V", "degC", "degF/V"):
        with pytest.raises(DataError, match="has a zero of its own"):
            read_record(path, scale=f"T=10 {unit}")
    assert read_record(path, scale="T=10 K/V")["T"].tolist() == [10, 20]


def test_a_blank_line_in_one_column_is_a_missing_value(tmp_path):
    path = written(tmp_path, "p [bar]\n1\n2\n\n4\n")
    with pytest.raises(DataError, match="row 4, column 'p': no value"):
        read_record(path, rate=10)["p"]
    record = read_record(path, rate=10, missing="keep")
    assert len(record) == 4 and np.isnan(record["p"][2]) and record["p"][3] == 4e5


def test_elements_of_arrays_keep_their_numbers(tmp_path):
    path = written(tmp_path, 'time [s],T[1],T[2],"b[1,2]",x [1]\n0,1,2,3,4\n1,1,2,3,4\n')
    record = read_record(path, units=["T[1]=K", "T[2]=K"])
    assert record["T[1]"].tolist() == [1, 1] and record["T[2]"].tolist() == [2, 2] and record["x"].tolist() == [4, 4]
    with pytest.raises(DataError, match=r"--unit 'b\[1,2\]=UNIT'"):
        record["b[1,2]"]


def test_a_column_that_fills_late_is_one_of_numbers(tmp_path):
    rows = (f"{0.01 * k:.2f};{'' if k < 600 else k / 2};{k / 3:.17f};{'on' if k % 7 else ''}\n" for k in range(60_000))
    path = written(tmp_path, "time [s];s [bar];q [bar];state\n" + "".join(rows))
    record = read_record(path, missing="keep")
    assert np.isnan(record["s"][599]) and record["s"][600] == 300e5


def test_a_constant_may_be_scaled_and_be_true(tmp_path):
    path = written(tmp_path, "time [s],p [bar]\n0,1\n1,2\n")
    record = read_record(path, constants=["current=5mA", "on=true"], scale="current=0.1 1/mA")
    assert record["current"].tolist() == [0.5, 0.5] and record["on"].tolist() == [1, 1]


def test_a_constant_without_a_unit_is_refused_as_a_column_without_one(tmp_path):
    """50 of a valve in % had been 5000 %."""
    path = written(tmp_path, "time [s],p [bar]\n0,1\n1,2\n")
    record = read_record(path, constants=["valve=50", "other=50 %", "gear=3 1", "off=0", "q=2"], scale="q=5 L/min")
    with pytest.raises(DataError, match=r"'valve = 50' has no unit. Write it behind the number"):
        record["valve"]
    assert [record[n][0] for n in ("other", "gear", "off")] == [0.5, 3.0, 0.0]
    assert record["q"][0] == pytest.approx(10e-3 / 60)


def test_a_scale_belongs_to_one_column_however_names_are_turned(tmp_path):
    path = written(tmp_path, "time [s],a [V],b [V],c [V]\n0,1,10,100\n1,2,20,200\n")
    swapped = read_record(path, columns=["a=b", "b=a"], scale="a=2 1")
    assert swapped["a"].tolist() == [20, 40] and swapped["b"].tolist() == [1, 2]
    chained = read_record(path, columns=["a=b", "b=c"], scale="b=2 1")
    assert chained["a"].tolist() == [10, 20] and chained["b"].tolist() == [200, 400]
    alike = read_record(path, columns=["x=b", "y=b"], scale="b=2 1")
    assert alike["x"].tolist() == alike["y"].tolist() == [20, 40]


def test_pairs_of_times_and_values_with_one_name_are_meant_by_their_places(tmp_path):
    path = written(tmp_path, "Name\tp [bar]\tName\tq [bar]\n0\t1\t0\t5\n10\t2\t10\t6\n")
    record = read_record(path, time="#1", units="#1=ms")
    assert record.time.tolist() == [0, 0.01] and record["q"].tolist() == [5e5, 6e5]


def test_blanks_in_stamps_part_no_cells_where_commas_do(tmp_path):
    forms = (("time, p [bar]", "2020-01-01 12:00:0{}.500"), ("Date Time,p A [bar]", "1/2/2020 11:59:5{} PM"))
    for head, stamp in forms:
        record = read_record(written(tmp_path, head + "\n" + "".join(f"{stamp.format(k)}, {k}.5\n" for k in range(6))))
        assert record.time.tolist() == list(range(6)) and record[record.names[0]][1] == 1.5e5


def test_footers_of_several_rows_are_left_out_of_a_short_file(tmp_path):
    rows = "".join(f"{k},{k}\n" for k in range(12))
    for footer in ("Min,0\nMax,11\n", "Min,0\nMax,11\nMean,5.5\n"):
        record = read_record(written(tmp_path, "time [s],p [bar]\n" + rows + footer))
        assert len(record) == 12 and "below the numbers left out" in record.understood


def test_milliseconds_that_count_from_the_start_are_no_fraction_of_a_second(tmp_path):
    rows = "".join(f"10:00:0{(k + 5) // 10},{100 * k},{k}\n" for k in range(10))
    with pytest.raises(DataError, match="the same time as in row"):
        read_record(written(tmp_path, "time,ms,p [bar]\n" + rows))
    rows = "".join(f"10:00:0{(k + 5) // 10},{(100 * k + 500) % 1000},{k}\n" for k in range(10))
    np.testing.assert_allclose(read_record(written(tmp_path, "time,ms,p [bar]\n" + rows)).time, np.arange(10) / 10)


def test_marks_before_later_gaps_cost_no_sample(tmp_path):
    rows = "".join(f"{'Start' if k % 20 == 0 else ''};{0.1 * k:.1f};{k}\n" for k in range(200))
    assert len(read_record(written(tmp_path, "Marker;time [s];p [bar]\n" + rows))) == 200


def test_gauge_pressure_is_refused_however_it_is_parted(tmp_path):
    for unit in ("bar g", "barg", "psi g", "kPa a"):
        with pytest.raises(DataError):
            read_record(written(tmp_path, f"time [s],p [{unit}]\n0,1\n1,2\n"))["p"]


def test_numbers_behind_stamps_with_a_point_are_read_quickly_too(tmp_path):
    stamps = (f"01.05.2021 12:{k // 60000:02d}:{k // 1000 % 60:02d}.{k % 1000:03d}" for k in range(80_000))
    rows = "".join(f"{stamp};{k},5;{k},25\n" for k, stamp in enumerate(stamps))
    record = read_record(written(tmp_path, "Zeit;p [bar];q [bar]\n" + rows))
    assert len(record) == 80_000 and record["q"][-1] == pytest.approx(79999.25e5)
    np.testing.assert_allclose(np.diff(record.time), 1e-3, atol=1e-9)


def test_an_option_says_one_thing_of_a_name(tmp_path):
    path = written(tmp_path, "time [s],p\n0,1\n1,2\n")
    with pytest.raises(DataError, match="'p' is given twice"):
        read_record(path, units=["p=bar", "p=mbar"])
    with pytest.raises(DataError, match="no finite number"):
        read_record(path, constants="q=1e400")
