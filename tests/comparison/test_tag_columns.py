"""Conditions that columns of the recordings tell."""

from __future__ import annotations

import datetime
from dataclasses import replace

import numpy as np
import pytest

from hydrotwin.comparison import Tags, Wanted, acceptance, compare, read_scenario
from hydrotwin.comparison.running import read_all
from hydrotwin.comparison.tags import check_tags, of_group
from hydrotwin.models.language.errors import DataError, DeclarationError, UnitError
from hydrotwin.records import read_record
from tests.comparison.toys import Toy
from tests.comparison.toys import recording as toy

LINES = ["time [s],load_mass [kg],oil [°C],rig,shift,noise [V]", "0,20.5,38.9,A 1,2,0.1", "0.1,20.5,41.2,A 1,2,-0.2",
         "0.2,20.5,40.3,A 1,2,0.0"]  # fmt: skip


@pytest.fixture(params=[",", ";"])
def recording(tmp_path, request):
    """The same with commas, and as German programs write it."""
    lines = LINES if request.param == "," else [line.replace(",", ";").replace(".", ",") for line in LINES]
    path = tmp_path / "run.csv"
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    return read_record(path), path


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("load_mass", "20.5 kg"),
        ("load_mass by 10 kg", "20 kg"),
        ("oil by 10 degC", "40 degC"),
        ("oil by 5 K", "315 K"),
        ("rig", "A 1"),
        ("shift", "2"),
        ("noise by 1 V", "0 V"),
    ],
)
def test_a_column_tells_a_tag(recording, column, value):
    assert Tags(columns={"tag": column}).put(*recording).tags == {"tag": value}


@pytest.mark.parametrize(
    ("column", "says"),
    [
        ("oil", "oil of run changes from 38.9 to 41.2.*oil by 2"),
        ("oil by 10 bar", "oil is in .*C. Write"),
        ("oil by 0 K", "step above 0"),
        ("lod_mass", "Did you mean 'load_mass'"),
        ("rig by 2", "text, not numbers"),
    ],
)
def test_a_column_that_tells_none_is_refused(recording, column, says):
    with pytest.raises((DataError, DeclarationError, UnitError), match=says):
        Tags(columns={"tag": column}).put(*recording)


@pytest.mark.parametrize("zeros", ["0012", '"0012"', "007", "00"])
def test_zeros_before_a_number_are_part_of_a_name(tmp_path, zeros):
    """0012 and 12 were one condition: a column of digits was a number. Now somebody is asked."""
    records = []
    for k, cell in enumerate((zeros, str(int(zeros.strip('"'))))):
        path = tmp_path / f"run_{k}.csv"
        path.write_text("time [s],u [V],serial [1]\n" + "".join(f"{t},1,{cell}\n" for t in (0, 0.1, 0.2)))
        records.append(Tags(columns={"serial": "serial"}).put(read_record(path), path))
    assert records[0].tags == {"serial": zeros.strip('"')} and records[0]["serial"][0] == int(zeros.strip('"'))
    check_tags(records[:1])
    with pytest.raises(DeclarationError, match="one condition, or two"):
        check_tags(records)


def test_a_text_that_changes_is_no_word(tmp_path):
    (tmp_path / "run.csv").write_text("time [s],u [V],rig\n0,1,A\n0.1,1,B\n0.2,1,A\n")
    record = read_record(tmp_path / "run.csv")
    assert dict(record.words) == {"rig": ("A", "B")}
    with pytest.raises(DataError, match="rig of run changes from 'A' to 'B' within the recording"):
        Tags(columns={"rig": "rig"}).put(record, tmp_path / "run.csv")


@pytest.mark.parametrize("head", ["serial", "serial [1]", "serial [kg]"])
@pytest.mark.parametrize("numbers", [(12345671, 12345672), (20261128, 20261129), (0.1234567, 0.1234568)])
def test_numbers_that_differ_in_their_last_digit_are_two_conditions(tmp_path, head, numbers):
    """Serial numbers and days have more than six digits: cut to those, two machines had been one."""
    found = []
    for number in numbers:
        (tmp_path / "run.csv").write_text(f"time [s],u [V],{head}\n0,1,{number}\n0.1,1,{number}\n0.2,1,{number}\n")
        record = Tags(columns={"serial": "serial"}).put(read_record(tmp_path / "run.csv"), tmp_path / "run.csv")
        found.append(record.tags["serial"].removesuffix(" kg"))
    assert [float(text) for text in found] == list(numbers) and "e" not in found[0]


def test_a_scenario_says_columns_and_what_it_says_of_a_file_stands(recording, tmp_path):
    (tmp_path / "scenario.toml").write_text(
        'models = ["cehA"]\nvalidate = ["run.csv", {file = "run.csv", tags = {rig = "B"}}]\n'
        'tag_columns = {rig = "rig", load = "load_mass"}\n'
    )
    tags = read_scenario(tmp_path / "scenario.toml").tags
    assert tags.put(recording[0], tmp_path / "run.csv").tags == {"rig": "B", "load": "20.5 kg"}


def test_the_same_condition_is_one_however_it_is_written(recording):
    """A number of a scenario, a file name, a text with blanks: else a criterion would leave some of them out."""
    record, path = recording
    said = [Tags(by_file={path: {"load": value}}) for value in (2, 2.0, " 2 ", "2")] + [Tags("run{load}")]
    named = path.with_name("run2.csv")
    found = {one.put(record, named if one.pattern else path).tags["load"] for one in said}
    assert found == {"2"} and Tags(by_file={path: {"load": 2.5}}).put(record, path).tags == {"load": "2.5"}
    assert Tags(by_file={path: {"oil": "very\ncold"}}).put(record, path).tags == {"oil": "very cold"}


def test_what_is_said_of_a_file_counts_before_a_column_and_a_column_before_its_name(recording):
    record, path = recording
    columns, named = {"rig": "rig"}, path.with_name("run2.csv")
    assert Tags("run{rig}", columns=columns).put(record, named).tags == {"rig": "A 1"}
    assert Tags("run{rig}", {named: {"rig": "B"}}, columns).put(record, named).tags == {"rig": "B"}


@pytest.mark.parametrize("value", ["", "  ", "\n"])
def test_an_empty_tag_is_refused(recording, value):
    with pytest.raises(DeclarationError, match="oil of run is empty"):
        Tags(by_file={recording[1]: {"oil": value}}).put(*recording)


@pytest.mark.parametrize(
    ("said", "told", "named"),
    [
        ("40", "40", ["load=40", "load = 40.0", "load=4e1", "load='40'"]),
        ("40.0", "40", ["load=40", "load=40.0"]),
        ("2.5", "2.5", ["load=2.5", "load=2.50"]),
        ("1e-6", "1e-06", ["load=1e-6", "load=0.000001"]),
        ("true", "true", ["load=true"]),
        ("2026-11-28", "2026-11-28", ["load=2026-11-28", "load = 2026-11-28"]),
        ("2026-11-28 10:12:00", "2026-11-28T10:12:00", ["load=2026-11-28 10:12", "load=2026-11-28T10:12:00"]),
        ("10:12:00", "10:12:00", ["load=10:12"]),
        ("'40 degC'", "40 degC", ["load=40degC", "load=40.0 degC"]),
        ("'no. 7'", "no. 7", ["load=no. 7"]),
    ],
)
def test_what_a_scenario_says_is_what_a_criterion_names(recording, said, told, named):
    record, path = recording
    file = path.with_name("scenario.toml")
    file.write_text(f'models = ["cehA"]\nvalidate = [{{file = "run.csv", tags = {{load = {said}}}}}]\n')
    tagged = read_scenario(file).tags.put(record, path)
    assert tagged.tags == {"load": told}
    assert all(of_group([tagged], group) == ("run",) for group in named)
    assert not any(of_group([tagged], f"load={other}") for other in ("41", "false", "2026-11-29", "11:12", "41 degC"))


@pytest.mark.parametrize("said", ["[1, 2]", "{low = 1}", "nan", "-inf"])
def test_what_is_no_one_condition_is_refused(recording, said):
    record, path = recording
    file = path.with_name("scenario.toml")
    file.write_text(f'models = ["cehA"]\nvalidate = [{{file = "run.csv", tags = {{load = {said}}}}}]\n')
    with pytest.raises(DeclarationError, match=r"load of run is no one condition.*load = 2.*tags of its own"):
        read_scenario(file).tags.put(record, path)


def test_numbers_and_dates_of_python_are_tags(recording):
    record, path = recording
    values = {"a": np.int64(2), "b": np.float64(2.0), "c": np.bool_(True), "d": datetime.date(2026, 11, 28)}
    found = Tags(by_file={path: values}).put(record, path).tags
    assert found == {"a": "2", "b": "2", "c": "true", "d": "2026-11-28"}


def test_one_value_in_two_writings_is_asked_about(recording):
    """Tables would show two conditions, and `load=7` would be about one of them, or about both."""
    _, path = recording
    other = path.with_name("other.csv")
    other.write_bytes(path.read_bytes().replace(b"38", b"37"))  # no recording twice
    file = path.with_name("scenario.toml")
    text = 'models = ["cehA"]\nvalidate = [{file="run.csv", tags={load=7}}, {file="other.csv", tags={load="%s"}}]\n'
    from hydrotwin.work.executor import Here

    file.write_text(text % "007")
    with pytest.raises(DeclarationError, match="load is 7 of run and 007 of other: one condition, or two"):
        read_all(read_scenario(file), Here())
    file.write_text(text.replace("load=7}", 'load="2 t"}') % "2000 kg")  # half of a condition had met a criterion of it
    with pytest.raises(DeclarationError, match="load is 2 t of run and 2000 kg of other: one condition, or two"):
        read_all(read_scenario(file), Here())
    file.write_text(text % "7.5")
    records, _ = read_all(read_scenario(file), Here())
    assert of_group(records, "load=7.50") == ("other",)
    hot = [replace(records[0], tags={"oil": "40 degC"})]
    assert of_group(hot, "oil=313.15 K") == of_group(hot, "oil=104 degF") == ("run",) and of_group(hot, "oil=40") == ()
    assert of_group([replace(records[0], tags={})], "load=7") == ()


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("50 %", "0.5"),
        ("10 kPa", "10 kN/m2"),
        ("5 W", "5 J/s"),
        ("60 1/min", "60 rpm"),  # as columns are told
        ("2,5 t", "2500 kg"),
        ("kühl", "ku\u0308hl"),  # as macOS writes names of files
    ],
)
def test_one_condition_in_two_spellings_is_asked_about_and_found_by_either(recording, one, other):
    record, _ = recording
    told = [replace(record, name="a", tags={"load": one}), replace(record, name="b", tags={"load": other})]
    with pytest.raises(DeclarationError, match="one condition, or two"):
        check_tags(told)
    assert of_group(told, f"load={one}") == of_group(told, f"load={other}") == ("a", "b")


@pytest.mark.parametrize(
    ("one", "other"), [("60 1/s", "60 rad/s"), ("1/2", "1"), ("11/2026", "1 1/2026"), ("5 K", "5 degC")]
)
def test_conditions_that_look_alike_are_two(recording, one, other):
    told = [replace(recording[0], name=value, tags={"load": value}) for value in (one, other)]
    check_tags(told)
    assert of_group(told, f"load={one}") == (one,)


def test_a_column_in_percent_is_rounded_in_percent(tmp_path):
    """By 10 had been by 1000 %: every recording was of one condition, 0."""
    (tmp_path / "run.csv").write_text("time [s],valve [%]\n0,61\n0.1,62\n0.2,63\n")
    record = read_record(tmp_path / "run.csv")
    with pytest.raises(UnitError, match=r"valve is in %. Write for example 'valve by 10 %'"):
        Tags(columns={"valve": "valve by 10"}).put(record, tmp_path / "run.csv")
    assert Tags(columns={"valve": "valve by 10 %"}).put(record, tmp_path / "run.csv").tags == {"valve": "60 %"}


def test_a_serial_number_of_more_digits_than_a_number_keeps_is_no_tag(tmp_path):
    """12345678901234567 and ...568 are one number: two machines had been one condition."""
    (tmp_path / "run.csv").write_text("time [s],serial [1]\n" + "".join(f"{k},12345678901234567\n" for k in range(3)))
    record = read_record(tmp_path / "run.csv")
    with pytest.raises(DataError, match="more digits than a number keeps"):
        Tags(columns={"serial": "serial"}).put(record, tmp_path / "run.csv")


def test_serial_numbers_that_differ_late_are_two_conditions(recording):
    told = [replace(recording[0], name=v, tags={"serial": v}) for v in ("123456789012345", "123456789012346")]
    check_tags(told)
    assert of_group(told, "serial=123456789012345") == ("123456789012345",)


def test_a_recording_that_is_called_like_a_tag_of_others_does_not_join_them():
    """``load=2`` had been judged on load=2.csv, too, whose load is 3; so had every table of the tag."""
    named, other = replace(toy(1, name="load=2"), tags={"load": "3"}), replace(toy(2), tags={"load": "2"})
    assert of_group([named, other], "load=2") == of_group([named, other], "load=2.0") == (other.name,)
    assert of_group([named], "load=2") == ("load=2",)
    found = compare([Toy("good")], [named, other], repeats=0, modes=("free run",))
    with pytest.raises(DeclarationError, match="load=2 is the name of one recording and a tag of validation_2"):
        acceptance(found, Wanted(("load=2: arm_angle.rmse < 9 deg",)))
    alike = compare([Toy("good")], [replace(named, tags={"load": "2"}), other], repeats=0, modes=("free run",))
    (one,) = acceptance(alike, Wanted(("load=2: arm_angle.rmse < 9 deg",))).judged
    assert one.samples == len(named) + len(other)  # the condition, of which it is


def test_a_name_that_does_not_fit_is_no_matter_where_its_tags_are_told(tmp_path):
    """The refusal says to tell them beside the file, and had refused that, too."""
    path = tmp_path / "other.csv"
    both, pattern = {"load": 2, "stroke": 3}, "load{load}_stroke{stroke}"
    assert Tags(pattern, {path: both}).put(toy(1), path).tags == {"load": "2", "stroke": "3"}
    with pytest.raises(DeclarationError, match=r"does not fit 'other.csv'.*tags = \{load = \.\.\.\}"):
        Tags(pattern, {path: {"stroke": 3}}).put(toy(1), path)


def test_one_condition_in_two_writings_is_refused_from_python_too():
    """A criterion on load=2 was of both recordings, and the table of conditions parted them."""
    records = [replace(toy(k), tags={"load": load}) for k, load in ((1, "2"), (2, "2.0"))]
    with pytest.raises(DeclarationError, match=r"load is 2 of validation_1 and 2\.0 of validation_2"):
        compare([Toy("good")], records, repeats=0)
