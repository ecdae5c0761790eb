"""One recording in the layouts that loggers and spreadsheets write: each is read to the same numbers, with no edit."""

from __future__ import annotations

import gzip

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import read_record
from tests.records.whole import whole

COUNT = 60
TIME = np.arange(COUNT) / 100
COMMAND = np.where(TIME > 0.1, 2.5, 0.0)
ANGLE = np.round(7 + 3 * np.sin(9 * TIME), 4)  # deg
PRESSURE = np.round(35 + 1000 * TIME**2, 3)  # bar, beyond a thousand at the end of nothing: 35 to 383
NAMES = ("command", "arm_angle", "pressure_cap")


def rows(decimal=".", delimiter=",", time=None, end="", blank=""):
    """The block of numbers as text."""
    times = [f"{t:.2f}" for t in TIME] if time is None else time
    lines = []
    for t, *values in zip(times, COMMAND, ANGLE, PRESSURE, strict=True):
        cells = [f"{v:g}" if v == round(v) else f"{v:.4f}" for v in values]
        cells = [t if time else t.replace(".", decimal), *(c.replace(".", decimal) for c in cells)]
        lines.append(blank + delimiter.join(cells) + end)
    return "\n".join(lines) + "\n"


def german(**more):
    return rows(",", ";", **more)


PLAIN = "time [s],command [V],arm_angle [deg],pressure_cap [bar]\n"
BAR = "time [s];command [V];arm_angle [°];pressure_cap [bar]\n"
TAB = PLAIN.replace(",", "\t")
LABVIEW = """LabVIEW Measurement\t
Writer_Version\t2
Reader_Version\t2
Separator\tTab
Decimal_Separator\t{decimal}
Multi_Headings\tNo
X_Columns\t{columns}
Time_Pref\tRelative
Date\t2021/05/04
***End_of_Header***\t
\t
Channels\t3
Samples\t60\t60\t60
Y_Unit_Label\tVolts\tdeg\tbar
X_Dimension\tTime\tTime\tTime
X0\t0{decimal}0E+0\t0{decimal}0E+0\t0{decimal}0E+0
Delta_X\t0{decimal}010000\t0{decimal}010000\t0{decimal}010000
***End_of_Header***\t\t\t
X_Value\tcommand\tarm_angle\tpressure_cap\tComment
"""

COUNTED = "".join(f"{k},{row}\n" for k, row in enumerate(rows().splitlines()))
MIDNIGHT = ("2021-05-04 23:59:59.{:02.0f}", "2021-05-05 00:00:00.{:02.0f}")

LAYOUTS = {
    "plain": PLAIN + rows(),
    "semicolons and points": BAR + rows(delimiter=";"),
    "German Excel": BAR + german(),
    "German Excel in Latin-1": (BAR + german()).encode("latin-1"),
    "German Excel in UTF-16": (BAR + german()).encode("utf-16"),
    "UTF-16 without a mark": (BAR + german()).encode("utf-16-le"),
    "UTF-32": (BAR + german()).encode("utf-32"),
    "UTF-8 with a mark": ("sep=;\n" + BAR + german()).encode("utf-8-sig"),
    "sep= in quotes": '"sep=;"\n' + BAR + german(),
    "old Macintosh line ends": (PLAIN + rows()).replace("\n", "\r"),
    "tabs": TAB + rows(delimiter="\t"),
    "tabs and commas": TAB + rows(",", "\t"),
    "bars": PLAIN.replace(",", "|") + rows(delimiter="|"),
    "blanks": "time[s] command[V] arm_angle[deg] pressure_cap[bar]\n" + rows(delimiter="   ", blank="  "),
    "blanks, units apart": "time [s]  command [V]  arm_angle [deg] pressure_cap [bar]\n" + rows(delimiter="  "),
    "blanks and decimal commas": "time[s] command[V] arm_angle[deg] pressure_cap[bar]\n" + rows(",", "  "),
    "round brackets": PLAIN.replace("[", "(").replace("]", ")") + rows(),
    "a slash": "time / s;command / V;arm_angle / °;pressure_cap / bar\n" + german(),
    "in words": "time in s;command in V;arm_angle in °;pressure_cap in bar\n" + german(),
    "units behind names": "time_s,command_V,arm_angle_deg,pressure_cap_bar\n" + rows(),
    "a row of units": "time,command,arm_angle,pressure_cap\ns,V,deg,bar\n" + rows(),
    "a row of units in brackets": "time;command;arm_angle;pressure_cap\n[s];[V];[°];[bar]\n" + german(),
    "units in words": "time (sec),command (Volts),arm_angle (Degrees),pressure_cap (Bar)\n" + rows(),
    "names, comments and units": "Zeit;command;arm_angle;pressure_cap\nChannel 1;soll;ist;p1\ns;V;°;bar\n" + german(),
    "units above names": "s,V,deg,bar\ntime,command,arm_angle,pressure_cap\n" + rows(),
    "catman, Windows": (
        "HBM_CATMAN_DATAFILE_40\nKommentar: Öl\nZeit  1 - Rate\tcommand\tarm_angle\tpressure_cap\n"
        "s\tV\t°\tbar\n" + rows(",", "\t")
    ).replace("\n", "\r\n").encode("cp1252"),
    "catman": "HBM_CATMAN_DATAFILE_40\nDatum: 04.05.2021 10:12:33\nKommentar: Zylinder, 40 °C\nKanäle: 4\n"
    "Zeit  1 - Standardmessrate\tcommand\tarm_angle\tpressure_cap\ns\tV\t°\tbar\n" + rows(",", "\t"),
    "a preamble with commas": "Bench 3, run 12, 2021\nOperator, M. Muster\nRate, 100, Hz\n\n" + PLAIN + rows(),
    "a preamble of pairs": "Start;04.05.2021\nRate;100\n\n" + BAR + german(),
    "comments above": "# bench 3\n% run 12\n// cold\n" + PLAIN + rows(),
    "names in a comment": "# bench 3\n# time [s] command [V] arm_angle [deg] pressure_cap [bar]\n"
    + rows(delimiter=" "),
    "names in a comment, commas": "% " + PLAIN + rows(),
    "trailing delimiters": BAR.replace("\n", ";\n") + german(end=";"),
    "trailing delimiters below": BAR + german(end=";"),
    "a footer": PLAIN + rows() + "End of data\nchecksum,9af3\n",
    "a summary below": BAR + german() + "\nMittelwert;2,1;7,5;120,4\nMaximum;2,5;10;383\n",
    "quoted": PLAIN.replace("time [s]", '"time [s]"') + rows(),
    "every cell quoted": "".join(
        ",".join(f'"{c}"' for c in line.split(",")) + "\n" for line in (PLAIN + rows()).splitlines()
    ),
    "quoted decimal commas": PLAIN
    + "".join(",".join(f'"{c}"' for c in line.split(";")) + "\n" for line in german().splitlines()),
    "a text column": PLAIN.replace("\n", ",state\n") + rows(end=",running"),
    "a text column first": "state," + PLAIN + rows(blank="on,"),
    "an unknown unit": PLAIN.replace("\n", ",x [furlong]\n") + rows(end=",1"),
    "an empty column": PLAIN.replace("\n", ",spare [V]\n") + rows(end=","),
    "a column without a unit": PLAIN.replace("\n", ",counter\n") + rows(end=",7"),
    "a named time": PLAIN.replace("time", "Zeitstempel") + rows(),
    "t": PLAIN.replace("time", "t") + rows(),
    "milliseconds": PLAIN.replace("[s]", "[ms]") + rows(time=[f"{1000 * t:.0f}" for t in TIME]),
    "time of day": PLAIN.replace(" [s]", "") + rows(time=[f"10:59:59.{100 * t:02.0f}" for t in TIME]),
    "German time of day": "Uhrzeit;command [V];arm_angle [°];pressure_cap [bar]\n"
    + german(time=[f"10:59:59,{100 * t:02.0f}" for t in TIME]),
    "date and time": PLAIN.replace(" [s]", "") + rows(time=[f"2021-05-04 10:12:33.{100 * t:02.0f}" for t in TIME]),
    "ISO 8601": PLAIN.replace("time [s]", "timestamp")
    + rows(time=[f"2021-05-04T10:12:33.{100 * t:02.0f}Z" for t in TIME]),
    "German date and time": "Zeit;command [V];arm_angle [°];pressure_cap [bar]\n"
    + german(time=[f"04.05.2021 10:12:33,{100 * t:02.0f}" for t in TIME]),
    "date and time apart": "Datum;Uhrzeit;command [V];arm_angle [°];pressure_cap [bar]\n"
    + german(time=[f"04.05.2021;10:12:33,{100 * t:02.0f}" for t in TIME]),
    "American": PLAIN.replace(" [s]", "") + rows(time=[f"5/4/2021 10:12:33.{100 * t:02.0f} PM" for t in TIME]),
    "over midnight": PLAIN.replace(" [s]", "")
    + rows(time=[MIDNIGHT[int(t >= 0.295)].format(100 * t + (70 if t < 0.295 else -30)) for t in TIME]),
    "since 1970": PLAIN.replace("[s]", "[ms]") + rows(time=[f"{1.7e12 + 1000 * t:.0f}" for t in TIME]),
    "since 1970, no unit": PLAIN.replace(" [s]", "") + rows(time=[f"{1.7e9 + t:.2f}" for t in TIME]),
    "since 1970 in ns, no unit": PLAIN.replace(" [s]", "")
    + rows(time=[f"{1_700_000_000_000_000_000 + round(t * 100) * 10_000_000}" for t in TIME]),
    "days of Excel": PLAIN.replace(" [s]", "") + rows(time=[f"{45000.5 + t / 86400:.12f}" for t in TIME]),
    "PicoScope": "Time,command,arm_angle,pressure_cap\n(ms),(V),(deg),(bar)\n\n"
    + rows(time=[f"{1000 * t:.0f}" for t in TIME]),
    "Keysight": "x-axis,command,arm_angle,pressure_cap\nsecond,Volt,deg,bar\n" + rows(time=[f"{t:+.4E}" for t in TIME]),
    "LeCroy": "LECROY9354,935412345\nSegments,1,SegmentSize,60\nSegment,TrigTime,TimeSinceFirstSegment\n"
    "#1,21 Mar 1990 9:37:08,0.0\n" + PLAIN + rows(),
    "MTS": 'MTS793|MPT|ENU|1|2|.|/|:|1|0|0|A\n\nData Header:\tTime:\t0.59\tSec\n"Time"\t"command"\t"arm_angle"\t'
    '"pressure_cap"\n"Sec"\t"V"\t"deg"\t"bar"\n' + rows(delimiter="\t"),
    "INCA": "ETASAsciiItemFile\trecord\nsampleCount\t60\ntime\tcommand\tarm_angle\tpressure_cap\n"
    "f8\tf8\tf8\tf8\ns\tV\tdeg\tbar\n" + rows(delimiter="\t"),
    "a data frame with its index": "," + PLAIN + COUNTED,
    "an index with a name": "no [1]," + PLAIN + COUNTED,
    "a registering instrument": "Vendor,GRAPH\nSampling interval,10ms\nTotal data points,60\n\n"
    "Number,Date&Time,command,arm_angle,pressure_cap\nNO.,Time,V,deg,bar\n"
    + "\n".join(f"{k},2021/05/04 10:12:33.{100 * TIME[k]:02.0f},{r.split(',', 1)[1]}"
                for k, r in enumerate(rows().splitlines())) + "\n",
    "numbers in the names": "time [s],command [V],arm_angle [deg],pressure_cap [bar],2 [bar]\n" + rows(end=",1"),
    "one recorder, several clocks": "Time abs,Time [s],command [V],arm_angle [deg],pressure_cap [bar]\n"
    + "\n".join(f"10:12:33.{100 * TIME[k]:02.0f},{r}" for k, r in enumerate(rows().splitlines())) + "\n",
    "exponents": PLAIN + rows(time=[f"{t:.6e}" for t in TIME]),
    "plus signs": PLAIN + rows(time=[f"+{t:.2f}" for t in TIME]),
    "row names, one name less": '"time[s]" "command[V]" "arm_angle[deg]" "pressure_cap[bar]"\n'
    + "".join(f'"{k}" {row}\n' for k, row in enumerate(rows(delimiter=" ").splitlines())),
    "the index of a data frame is its time": PLAIN.replace("time [s]", "")
    + rows(time=[f"2021-05-04 10:12:33.{100 * t:02.0f}0000" for t in TIME]),
    "time since the start of a data frame": PLAIN.replace("time [s]", "")
    + rows(time=[f"0 days 00:00:00.{100 * t:02.0f}0000" for t in TIME]),
    "Fortran": PLAIN + rows(time=[f"{t:.6E}".replace("E", "D") for t in TIME]),
    "a name over two lines": PLAIN.replace("time [s]", '"time\n[s]"') + rows(),
    "milliseconds of their own": "Datum;Uhrzeit;Millisekunden;command [V];arm_angle [°];pressure_cap [bar]\n"
    + german(time=[f"04.05.2021;10:12:33;{1000 * t:.0f}" for t in TIME]),
    "an oscilloscope": "Vertical Units,V,deg,bar\nModel,X,Y,Z\n\n" + PLAIN + rows(),
    "LabVIEW": LABVIEW.format(decimal=",", columns="One") + rows(",", "\t"),
    "LabVIEW with comments": LABVIEW.format(decimal=".", columns="One") + rows(delimiter="\t", end="\tok"),
    "LabVIEW without time": LABVIEW.format(decimal=".", columns="No")
    + "".join("\t" + line.split("\t", 1)[1] + "\n" for line in rows(delimiter="\t").splitlines()),
}  # fmt: skip


@pytest.mark.parametrize("name", LAYOUTS)
def test_a_layout_is_read_right_with_no_edit(name, tmp_path):
    content = LAYOUTS[name]
    path = tmp_path / ("run.lvm" if name.startswith("LabVIEW") else "run.dat")
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    record = read_record(path)
    rounded = name.startswith(("since", "days"))  # by the size of the numbers in the file
    np.testing.assert_allclose(record.time - record.time[0], TIME, atol=2e-6 if rounded else 1e-9)
    for signal, values in zip(NAMES, (COMMAND, np.radians(ANGLE), 1e5 * PRESSURE), strict=True):
        np.testing.assert_allclose(record[signal], values, rtol=1e-12, err_msg=record.understood)
    assert set(record.names) - {"no", "2"} == set(NAMES)


def test_a_packed_file_is_read_as_what_it_holds(tmp_path):
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress((BAR + german()).encode("latin-1")))
    record = whole(tmp_path / "run.csv.gz")
    assert record.name == "run"
    assert record.understood == "cp1252 (or --encoding), semicolon, names in row 1, decimal comma"
    (tmp_path / "run.csv.gz").write_bytes(gzip.compress((BAR + german()).encode())[:-30])
    with pytest.raises(DataError, match="packed file ends too early"):
        whole(tmp_path / "run.csv.gz")


# -- what a person must say --------------------------------------------------------------------------------------------
def written(tmp_path, text):
    path = tmp_path / "run.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_a_file_without_names_is_read_by_the_places_of_its_columns(tmp_path):
    path = written(tmp_path, rows())
    with pytest.raises(DataError, match=r"no column is called a time \(got 1, 2, 3, 4\).*--rate 1000"):
        read_record(path)
    with pytest.raises(DataError, match=r"column '1' has no unit, and its numbers do not tell it.*--unit '1=s'"):
        read_record(path, time="1")
    record = read_record(path, time="1", units={"1": "s", "p": "bar"}, columns="p=4")
    np.testing.assert_allclose(record["p"], 1e5 * PRESSURE)
    with pytest.raises(DataError, match="column '2' has no unit"):
        record["2"]
    sampled = read_record(path, rate=100, units={"p": "bar"}, columns={"p": "#4"})
    np.testing.assert_allclose(sampled.time, TIME)
    np.testing.assert_allclose(sampled["p"], 1e5 * PRESSURE)


def test_columns_units_scales_and_constants_are_said_once(tmp_path):
    path = written(tmp_path, "Zeit [s];Ventil_Soll;Druck A;Druck A\n" + german().replace(";35;", ";35,0;"))
    record = read_record(
        path, columns=["command=Ventil_Soll", "p=#4"], units={"p": "bar"}, scale="command=0.5 V",
        constants={"supply": "200 bar"},
    )  # fmt: skip
    np.testing.assert_allclose(record["command"], 0.5 * COMMAND)
    np.testing.assert_allclose(record["p"], 1e5 * PRESSURE)
    assert (record["supply"] == 200e5).all() and "set supply = 200 bar" in record.understood
    with pytest.raises(DataError, match=r"columns 3 and 4 are both named 'Druck A'.*--column 'Druck A=#3'"):
        read_record(path)["Druck A"]
    with pytest.raises(DataError, match=r"no column 'Ventil_Sol' for 'command'. Did you mean 'Ventil_Soll'"):
        read_record(path, columns="command=Ventil_Sol")
    with pytest.raises(DataError, match="set: 'supply' is no finite number with a unit"):
        read_record(path, constants={"supply": "high"})


def test_a_file_beside_the_recordings_says_it_for_all_of_them(tmp_path):
    path = written(tmp_path, "Zeit;Ventil_Soll;Winkel;Druck\n" + german())
    (tmp_path / "import.toml").write_text(
        'files = ["run*.csv"]\ntime = "Zeit"\n[columns]\ncommand = "Ventil_Soll"\npressure_cap = "Druck"\n'
        '[units]\nZeit = "s"\ncommand = "V"\nDruck = "bar"\n'
    )
    record = read_record(path)
    np.testing.assert_allclose(record["pressure_cap"], 1e5 * PRESSURE)
    assert record.understood.endswith("by import.toml")
    mega = read_record(path, units={"pressure_cap": "MPa"})
    np.testing.assert_allclose(mega["pressure_cap"], 1e6 * PRESSURE, err_msg="what is said now beats the file")
    path.rename(tmp_path / "other.csv")
    with pytest.raises(DataError, match="column 'Zeit' has no unit"):
        read_record(tmp_path / "other.csv")
    (tmp_path / "import.toml").write_text("[colums]\na = 'b'\n")
    with pytest.raises(DataError, match=r"import.toml: unknown key 'colums'. Did you mean 'columns'\?"):
        read_record(tmp_path / "other.csv")


@pytest.mark.parametrize(
    ("clock", "stamps", "times"),
    [
        ("spread", [0, 0, 0.02, 0.02, 0.04, 0.04], [0, 0.01, 0.02, 0.03, 0.04, 0.05]),
        ("first", [0, 0, 0.02, 0.03, 0.04, 0.04], [0, 0.02, 0.03, 0.04]),
        ("last", [0, 0, 0.02, 0.03, 0.04, 0.04], [0, 0.02, 0.03, 0.04]),
        ("unwrap", [0.97, 0.98, 0.99, 0, 0.01, 0.02], [0.97, 0.98, 0.99, 1.0, 1.01, 1.02]),
        ("sort", [0, 0.02, 0.01, 0.03, 0.05, 0.04], [0, 0.01, 0.02, 0.03, 0.04, 0.05]),
    ],
)
def test_a_clock_is_repaired_only_when_told_how(clock, stamps, times, tmp_path):
    path = written(tmp_path, "time [s],x [1]\n" + "".join(f"{t},{k}\n" for k, t in enumerate(stamps)))
    with pytest.raises(DataError, match=r"--clock spread|--clock sort"):
        read_record(path)
    record = read_record(path, clock=clock)
    np.testing.assert_allclose(record.time, times, atol=1e-12)
    kept = {"first": [0, 2, 3, 4], "last": [1, 2, 3, 5], "sort": [0, 2, 1, 3, 5, 4]}.get(clock, range(6))
    np.testing.assert_array_equal(record["x"], list(kept))
    assert f"clock: {clock}" in record.understood


def test_a_time_of_day_goes_on_after_midnight_when_told(tmp_path):
    stamps = ["23:59:59.98", "23:59:59.99", "00:00:00.00", "00:00:00.01"]
    path = written(tmp_path, "time,x [1]\n" + "".join(f"{s},{k}\n" for k, s in enumerate(stamps)))
    with pytest.raises(DataError, match=r"runs backward.*--clock unwrap"):
        read_record(path)
    np.testing.assert_allclose(read_record(path, clock="unwrap").time, [0, 0.01, 0.02, 0.03], atol=1e-9)


@pytest.mark.parametrize(
    ("said", "words"),
    [
        ({"clock": "mend"}, "clock: not a choice .*Known: spread"),
        ({"rate": "fast"}, "rate: no sampling rate"),
        ({"rate": -3}, "rate: no sampling rate"),
        ({"delimiter": "::"}, "delimiter: not one sign"),
        ({"columns": "command"}, "columns: no 'name=value'.*--column command=Ventil_Soll"),
        ({"units": {"x": "barr"}}, "units: 'x': unit 'barr': not known"),
        ({"units": {"y": "bar"}}, "no column 'y', named in units"),
        ({"time": "Zeit"}, "no column 'Zeit', named as its time"),
        ({"encoding": "utf-9"}, "not a text file in utf-9"),
        ({"colums": "a=b"}, "unknown option 'colums'. Did you mean 'columns'"),
    ],
)
def test_what_is_said_wrongly_is_refused_with_the_right_word(said, words, tmp_path):
    from hydrotwin.models.language.errors import HydrotwinError

    path = written(tmp_path, "time [s],x [1]\n0,1\n1,2\n")
    with pytest.raises(HydrotwinError, match=words):
        read_record(path, **said)


def test_a_column_that_cannot_be_used_is_never_taken_for_one_that_is_absent(tmp_path):
    record = read_record(written(tmp_path, "time [s],x [1],p [bar]\n0,1,2\n1,2,\n"))
    assert record.names == ("x",)
    asks = [
        lambda: "p" in record,
        lambda: "p" in record.signals,
        lambda: record["p"],
        lambda: record.signals["p"],
        lambda: "p" in record.window(0, 1),
    ]
    for ask in asks:
        with pytest.raises(DataError, match="row 3, column 'p': no value"):
            ask()
    assert "q" not in record and "p" in record.with_signals({"p": np.zeros(2)}, {"p": "Pa"})


ODD = {
    "units in the cells": "time,p,n\n" + "".join(f"{k / 100} sec,{k}.5 bar,{k}\n" for k in range(9)),
    "German units in the cells": "Zeit;p [bar]\n" + "".join(f"{10 * k},000 ms;{k},5\n" for k in range(9)),
    "whole lines in quotes": '"time [s];p [bar]"\n' + "".join(f'"0,{k:02d};{k},5"\n' for k in range(9)),
    "stamps of a program with a comma": "time,p [bar]\n"
    + "".join(f"2021-05-04 10:12:33,{10 * k:03d},{k}.5\n" for k in range(9)),
    "compact stamps": "time;p [bar]\n" + "".join(f"20211231_235959.{k:02d};{k}.5\n" for k in range(9)),
    "German dates with a day of the week": "Zeit;p [bar]\n"
    + "".join(f"Fr 31. Dez 2021 10:00:00,{k:02d};{k},5\n" for k in range(9)),
    "zones that change": "Zeit;p [bar]\n"
    + "".join(f"2021-10-31 0{'2' if k else '3'}:00:00.{k:02d} {'CET' if k else 'CEST'};{k}.5\n" for k in range(9)),
    "room at the end that was never filled": "time [s],p [bar]\n"
    + "".join(f"{k / 100},{k}.5\n" for k in range(9)) + "\0" * 40,
    "a comment in the middle": "time [s],p [bar]\n" + "".join(f"{k / 100},{k}.5\n# a, b\n" for k in range(9)),
    "a unit and no name for the time": ";p\ns;bar\n" + "".join(f"{k / 100};{k}.5\n" for k in range(9)),
    "a small table above": "Channel,Gain\np,1.0\nq,2.0\n\ntime [s],p [bar]\n"
    + "".join(f"{k / 100},{k % 9}.5\n" for k in range(30)),
}  # fmt: skip


@pytest.mark.parametrize("name", ODD)
def test_an_odd_layout_is_read_right_with_no_edit(name, tmp_path):
    (tmp_path / "run.csv").write_text(ODD[name])
    record = read_record(tmp_path / "run.csv")
    np.testing.assert_allclose(record.time[:9], np.arange(9) / 100, atol=1e-9)
    np.testing.assert_allclose(record["p"][:9], 1e5 * (np.arange(9) + 0.5))
