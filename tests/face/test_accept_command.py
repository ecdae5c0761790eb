"""Criteria on the command line: files, conditions from columns, and what a server reads where nothing ran."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

import hydrotwin as ht
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
    assert "of an earlier run" not in answer.said
    assert hydrotwin(*words[:-2], "--out", tmp_path / "out").code == 0
    answer = hydrotwin(*words, "--out", tmp_path / "out", "--scale", "command=1e6")
    assert answer.code == 1 and "The report of an earlier run is in" in answer.said


def test_a_run_that_ends_without_a_verdict_leaves_none_of_an_earlier_one(recordings, tmp_path):
    """A column that is lost tonight is exit code 2; the server had read last night's PASS."""
    file = tmp_path / "criteria.xml"
    words = ("compare", "--model", "cehA", *FREE, "--accept", "arm_angle.rmse < 90 deg", "--out", tmp_path / "out")
    assert hydrotwin(*words, "--validate", recordings / "validate_1.csv", "--junit", file).code == 0 and file.exists()
    lost = tmp_path / "lost.csv"
    text = (recordings / "validate_1.csv").read_text(encoding="utf-8")
    lost.write_text(text.replace("command", "valve", 1), encoding="utf-8")
    before = {p.name: p.read_bytes() for p in (tmp_path / "out").iterdir() if p.suffix in (".json", ".md", ".html")}
    for way in (
        ("--validate", lost),
        ("--validate", lost, "--output", "nothing"),
        ("--validate", tmp_path / "gone.csv"),
        ("--validate", recordings / "validate_1.csv", "--rate", "fast"),  # options that are understood before files
        ("--validate", recordings / "validate_1.csv", "--ssp", tmp_path / "models.zip"),
    ):
        answer = hydrotwin(*words, *way, "--junit", file)
        assert answer.code == 2 and not file.exists()
        assert not (tmp_path / "out" / "compare.json").exists() and "The report of an earlier run is in" in answer.said
        aside = tmp_path / "out" / "earlier_answer"
        assert {p.name: p.read_bytes() for p in aside.iterdir() if p.name in before} == before  # nothing is lost
    against = ("--against", tmp_path / "out" / "compare.json")  # what was put aside is still the reference
    answer = hydrotwin(*words, "--validate", recordings / "validate_1.csv", *against)
    assert answer.code == 0 and "As before" in answer.said and (tmp_path / "out" / "compare.json").exists()
    assert not aside.exists()


def test_pages_of_variants_and_criteria_in_the_folder_are_put_aside_with_their_report(recordings, tmp_path):
    file, out = tmp_path / "s.toml", tmp_path / "out"
    text = (
        f'models = ["cehA"]\nvalidate = ["{(recordings / "validate_1.csv").as_posix()}"]\nmodes = ["free run"]\n'
        'outputs = ["arm_angle"]\naccept = ["arm_angle.rmse < 90 deg"]\n[variants.fine]\nstep = 0.0005\n'
    )
    file.write_text(text, encoding="utf-8")
    words = ("compare", file, "--out", out, "--junit", out / "criteria.xml")
    assert hydrotwin(*words).code == 0
    (out / "own.txt").write_text("mine", encoding="utf-8")
    made = {p.relative_to(out) for p in out.rglob("*") if p.suffix in (".json", ".html", ".xml", ".md")}
    file.write_text(text.replace("arm_angle.rmse", "arm_angel.rmse"), encoding="utf-8")
    assert hydrotwin(*words).code == 2
    left = {p.relative_to(out) for p in out.rglob("*") if p.suffix in (".json", ".html", ".xml", ".md", ".txt")}
    aside = {p.relative_to("earlier_answer") for p in left if p.parts[0] == "earlier_answer"}
    assert made <= aside | {Path(".written.json")} and (out / "own.txt").exists()
    assert not {p for p in left if p.parts[0] != "earlier_answer"} - {Path("own.txt"), Path(".written.json")}


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


def test_a_report_that_another_run_wrote_meanwhile_is_told(recordings, tmp_path):
    """Two runs into one folder: the report of the first to end is gone, and its words on the screen are of another."""
    out = tmp_path / "out"
    code = "from pathlib import Path\nimport hydrotwin as ht\n\n\ndef meanwhile():\n"
    code += f"    out = Path({str(out)!r})\n    out.mkdir(exist_ok=True)\n"
    code += "    (out / 'compare.json').write_text('other')\n"
    (tmp_path / "other.py").write_text(code + "    return ht.load('cehA')\n")
    words = ("compare", "--validate", recordings / "validate_1.csv", *FREE, "--out", out, "--model")
    answer = hydrotwin(*words, f"{tmp_path / 'other.py'}:meanwhile")
    assert answer.code == 0 and "another run has written its report there" in " ".join(answer.said.split())
    assert "another run" not in hydrotwin(*words, "cehA").said


def test_what_recordings_lack_is_told_everywhere_and_once(recordings, tmp_path):
    """Of a scenario file and of --validate alike: on the screen, on the page, in Markdown, JSON and JUnit."""
    record = ht.read_record(recordings / "validate_1.csv").window(0.0, 4.0)
    wrapped, holed = np.angle(np.exp(3j * record.time)), record["rod_position"].copy()
    holed[50:80] = np.nan
    signals = {"command": record["command"], "arm_angle": wrapped, "rod_position": holed}
    units = {name: record.units[name] for name in signals}
    path = ht.write_record(ht.Record(record.time, signals, units, "turning"), tmp_path / "turning.csv")
    asked = 'accept = ["rod_position.rmse < 900 m"]\nmodes = ["free run"]\nmissing = "keep"\n'
    (tmp_path / "s.toml").write_text(f'models = ["cehA"]\nvalidate = ["turning.csv"]\n{asked}')
    by_words = ("--model", "cehA", "--validate", path, "--mode", "free run", "--missing", "keep", "--accept",
                "rod_position.rmse < 900 m")  # fmt: skip
    for k, words in enumerate([(tmp_path / "s.toml",), by_words]):
        folder = tmp_path / f"out{k}"
        answer = hydrotwin("compare", *words, "--out", folder, "--junit", folder / "criteria.xml")
        assert answer.code == 0, answer.said
        assert answer.said.count("seems to begin anew at every turn") == 1 and "rod_position" in answer.err
        for file in ("report.html", "report.md", "compare.json", "criteria.xml"):
            text = (folder / file).read_text(encoding="utf-8")
            assert "seems to begin anew at every turn" in text and "no value of rod_position in 30" in text
