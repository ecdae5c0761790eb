"""Names of files that are no text: letters of an old code page, line ends, control signs. No traceback ends a run."""

from __future__ import annotations

import json
import os
from xml.etree import ElementTree

import pytest

from hydrotwin.comparison import Acceptance, Judged, criterion, junit
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.writing import printable, write_whole
from hydrotwin.records import read_record, write_record
from tests.comparison.toys import recording
from tests.face.command_line import hydrotwin

OLD = os.fsdecode(b"rig_\xd6l.csv")


@pytest.fixture
def folder(tmp_path):
    try:
        write_record(recording(1), tmp_path / OLD)
    except (OSError, UnicodeEncodeError):
        pytest.skip("this file system has names in UTF-8 only")
    return tmp_path


def test_a_name_in_an_old_code_page_is_read_and_written_everywhere(folder):
    assert read_record(folder / OLD).name == "rig_Öl"
    asked = ["--validate", folder / OLD, "--mode", "free run", "--tags", "rig_{oil}"]
    asked += ["--accept", "oil=Öl: arm_angle.rmse < 90000 deg", "--junit", folder / "criteria.xml"]
    answer = hydrotwin("compare", "--model", "eq17", *asked, "--out", folder / "page")
    assert answer.code == 0, answer.said
    told = json.loads((folder / "page" / "compare.json").read_text(encoding="utf-8"))
    (row,) = told["recordings"]
    assert (row["file"], row["tags"]) == ("rig_Öl.csv", {"oil": "Öl"}) and "rig_Öl" in told["command"]
    assert hydrotwin("inspect", folder / OLD, "--report", folder / "inspection").code == 0


def test_a_sentence_with_such_a_path_is_written(tmp_path):
    write_whole(tmp_path / "a.json", json.dumps(f"{OLD}: no value\n", ensure_ascii=False))
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == "rig_Öl.csv: no value\n"


def test_a_line_end_in_a_name_is_a_space(tmp_path):
    write_record(recording(1), tmp_path / "new\nline\x01.csv")
    assert read_record(tmp_path / "new\nline\x01.csv").name == "new line " == printable("new\nline\x01")


def test_servers_can_read_control_signs_that_a_name_or_a_vendor_brings():
    odd = "\x1b[31mred\x00\x0b"
    one = criterion("x.rmse < 1 m", [Signal("x", "m")])
    failed = Judged(one, float("inf"), one.low, one.high, reason=f"fmu: {odd}", doubt=odd)
    root = ElementTree.fromstring(junit(Acceptance(odd, "free run", (failed,)), odd, [odd, odd]).partition("?>")[2])
    (case,) = root.iter("testcase")
    assert case.find("failure").text == "fmu:  [31mred  " and case.get("classname") == " [31mred  "
    assert root.find("testsuite/system-out").text.count("\n") == 1
