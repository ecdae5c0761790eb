"""Criteria on the command line: files, conditions from columns, and what a server reads where nothing ran."""

from __future__ import annotations

from xml.etree import ElementTree

from tests.face.command_line import hydrotwin

TOO_TIGHT = "arm_angle.rmse < 0.0001 deg"
FREE = ("--mode", "free run", "--output", "arm_angle")


def test_a_server_does_not_read_an_old_pass_where_no_model_could_run(recordings, tmp_path):
    """A command a million times too large: nothing is scored, and every criterion is missed."""
    words = ("compare", "--model", "cehA", "--validate", recordings / "validate_1.csv", *FREE, "--accept", TOO_TIGHT)
    file = tmp_path / "criteria.xml"
    answer = hydrotwin(*words, "--out", tmp_path / "out", "--junit", file, "--scale", "command=1e6")
    assert answer.code == 1 and "no model could be scored" in answer.said
    (case,) = ElementTree.parse(file).getroot()[0].iter("testcase")
    assert case.get("name") == TOO_TIGHT and "could not be integrated" in case.find("failure").text
    assert "is of an earlier run" not in answer.said
    assert hydrotwin(*words[:-2], "--out", tmp_path / "out").code == 0
    answer = hydrotwin(*words, "--out", tmp_path / "out", "--scale", "command=1e6")
    assert answer.code == 1 and "out is of an earlier run" in answer.said.replace("\n", " ")


def test_a_file_of_a_criterion_is_looked_for_where_the_command_is_given(recordings, tmp_path, monkeypatch):
    (tmp_path / "there").mkdir()
    scenario = tmp_path / "there" / "s.toml"
    path = (recordings / "validate_1.csv").as_posix()
    scenario.write_text(
        f'models = ["cehA"]\nvalidate = ["{path}"]\nmodes = ["free run"]\noutputs = ["arm_angle"]\n'
        'accept = ["arm_angle.rmse < 90 deg"]\n'
    )
    monkeypatch.chdir(tmp_path)
    assert hydrotwin("compare", scenario, "--out", "first").code == 0
    answer = hydrotwin(
        "compare", scenario, "--out", "second", "--accept", "arm_angle not worse than first/compare.json"
    )
    assert answer.code == 0 and "all 2 criteria" in answer.said


def test_conditions_come_from_columns(recordings, tmp_path):
    words = ("compare", "--model", "cehA", "--validate", recordings / "validate_1.csv", *FREE, "--out", tmp_path)
    how = ("--tag-column", "cap=pressure_cap by 100 bar", "--accept", "cap=0 bar: arm_angle.rmse < 90 deg")
    assert hydrotwin(*words, *how).code == 0
    answer = hydrotwin(*words, "--tag-column", "cap")
    assert answer.code == 2 and "no 'TAG=COLUMN'" in answer.said


def test_a_reference_that_the_run_replaces_is_told(recordings, tmp_path):
    """Else a model that became worse fails once, and passes the night after."""
    words = (
        "compare",
        "--model",
        "cehA",
        "--validate",
        recordings / "validate_1.csv",
        *FREE,
        "--out",
        tmp_path / "out",
    )
    assert "replaces it" not in hydrotwin(*words).said
    file = tmp_path / "out" / "compare.json"
    elsewhere = tmp_path / "reference.json"
    elsewhere.write_bytes(file.read_bytes())
    for how in (("--against", file), ("--accept", f"not worse than {file} by 5 %")):
        answer = hydrotwin(*words, *how)
        assert answer.code == 0 and "the next one is held against this one" in " ".join(answer.said.split())
    assert "replaces it" not in " ".join(hydrotwin(*words, "--against", elsewhere).said.split())
