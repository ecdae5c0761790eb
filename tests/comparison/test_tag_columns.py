"""Conditions that columns of the recordings tell."""

from __future__ import annotations

import pytest

from hydrotwin.comparison import Tags, read_scenario
from hydrotwin.models.language.errors import DataError, DeclarationError, UnitError
from hydrotwin.records import read_record

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


def test_a_text_that_changes_is_no_word(tmp_path):
    (tmp_path / "run.csv").write_text("time [s],u [V],rig\n0,1,A\n0.1,1,B\n0.2,1,A\n")
    record = read_record(tmp_path / "run.csv")
    assert dict(record.words) == {}
    with pytest.raises(DataError, match="text, not numbers"):
        Tags(columns={"rig": "rig"}).put(record, tmp_path / "run.csv")


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
