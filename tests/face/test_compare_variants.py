"""`hydrotwin compare` with variants: exit codes, pages, what is refused, and where the runs are made."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path
from xml.etree import ElementTree

import jsonschema
import pytest

from tests.face.command_line import hydrotwin
from tests.report.test_schema import SCHEMA, unnamed

SCENARIO = """
models = [{model = "cehA", name = "full"}, "eq17"]
validate = ["validate_1.csv", "validate_2.csv"]
tags = "validate_{day}"
modes = ["free run"]
outputs = ["arm_angle"]
accept = ["arm_angle.rmse < 20 deg", "variant=slow*: arm_angle.rmse < 0.001 deg"]

[variants."slow motor"]
parameters = {"motor.gain" = 100.0}
"""


@pytest.fixture(scope="module")
def folder(recordings, tmp_path_factory):
    path = tmp_path_factory.mktemp("variants")
    for name in ("validate_1.csv", "validate_2.csv"):
        (path / name).write_bytes((recordings / name).read_bytes())
    (path / "scenario.toml").write_text(SCENARIO)
    return path


@pytest.fixture(scope="module")
def written(folder):
    """The answer of one run, and its folder."""
    words = ("--out", folder / "out", "--junit", folder / "criteria.xml", "--executor", "here")
    return hydrotwin("compare", folder / "scenario.toml", *words), folder / "out"


def test_a_missed_criterion_of_a_variant_is_said_first_and_is_exit_code_1(written, folder):
    answer, _ = written
    assert answer.code == 1
    assert "FAIL: full misses 1 of 3 criteria: “variant=slow motor: arm_angle.rmse < 0.001 deg”" in answer.said
    suite = ElementTree.parse(folder / "criteria.xml").getroot().find("testsuite")
    assert (suite.get("tests"), suite.get("failures")) == ("3", "1")


def test_compare_json_is_as_published_and_leads_to_the_file_of_each_variant(written):
    data = json.loads((written[1] / "compare.json").read_text(encoding="utf-8"))
    jsonschema.Draft202012Validator(SCHEMA).validate(data)
    assert unnamed(data, SCHEMA) == []
    base, slow = data["variants"]
    assert (base["name"], slow["name"], slow["changes"]) == (
        "base",
        "slow motor",
        {"parameters": {"motor.gain": 100.0}},
    )
    assert base["means"] == data["means"] and slow["as_base"] == ["eq17"]
    assert (base["acceptance"]["passed"], slow["acceptance"]["passed"]) == (True, False)
    assert not data["acceptance"]["passed"]
    for one in (base, slow):
        own = json.loads((written[1] / one["page"]).with_name("compare.json").read_text(encoding="utf-8"))
        assert own["means"] == one["means"] and own["scores"]


def test_the_overview_links_the_pages_and_puts_the_worst_first(written):
    page = (written[1] / "report.html").read_text(encoding="utf-8")
    links = [f'href="{name}/report.html"' for name in ("slow_motor", "base")]
    assert 0 < page.index(links[0]) < page.index(links[1])
    assert all((written[1] / name / "report.html").is_file() for name in ("slow_motor", "base"))
    assert "[slow motor](slow_motor/report.html)" in (written[1] / "report.md").read_text(encoding="utf-8")


def test_a_second_call_makes_no_run_and_gives_the_same_numbers(written, folder, monkeypatch, tmp_path):
    before = json.loads((written[1] / "compare.json").read_text(encoding="utf-8"))

    def never(*_):
        raise AssertionError("a finished run is made again")

    monkeypatch.setattr("hydrotwin.comparison.job._predict", never)
    answer = hydrotwin("compare", folder / "scenario.toml", "--out", folder / "out", "--executor", "here", "--json")
    assert "an earlier call" not in answer.out
    after = json.loads(answer.out)
    for key in ("scores", "means", "residuals", "variants", "acceptance"):
        assert after[key] == before[key]
    shutil.copytree(written[1], tmp_path / "out")
    with pytest.raises(AssertionError, match="made again"):
        hydrotwin("compare", folder / "scenario.toml", "--out", tmp_path / "out", "--executor", "here", "--fresh")


NO_DASK = "'distributed' is missing. Install it: pip install 'hydrotwin[cluster]'"


@pytest.mark.parametrize(
    ("words", "text", "says"),
    [
        (("--executor", "proceses"), "", "no 'proceses'. Did you mean 'processes'"),
        (("--executor", "dask://127.0.0.1:1"), "", NO_DASK),
        (("--executor", "dask"), "", NO_DASK),
        (("--executor", "here", "--workers", "2"), "", "--workers says how many processes"),
        (("--ssp", "a.ssp"), "", "--ssp packs the models of a scenario without variants"),
        ((), "[variants.x]\nstp = 1", "[variants.x] has an unknown key 'stp'. Did you mean 'step'"),
        ((), "[variants.x]\nparameters = {'motor.gian' = 1}", "Did you mean 'motor.gain'"),
        ((), "[variants.x]\nparameters = {'motor.gain' = 1e9}", "value outside its bounds"),
        ((), "[matrix]\nstep = []", "step is no list of values"),
        ((), f"[matrix]\nstep = {[k / 1000 for k in range(1, 400)]}", "399 variants, more than 200"),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused_in_a_sentence_with_nothing_written(folder, tmp_path, monkeypatch, words, text, says):
    monkeypatch.setitem(sys.modules, "distributed", None)
    path = folder / "bad.toml"
    path.write_text(f"{SCENARIO}\n{text}")
    answer = hydrotwin("compare", path, "--out", tmp_path / "out", *words)
    assert (answer.code, says in answer.said) == (2, True), answer.said
    assert not (tmp_path / "out").exists() and not Path("a.ssp").exists()


def test_runs_are_kept_where_they_are_many(folder, monkeypatch, tmp_path):
    line = ("compare", "--model", "eq17", "--validate", folder / "validate_1.csv", "--mode", "free run", "--out")
    assert hydrotwin(*line, tmp_path / "few", "--executor", "here").code == 0
    monkeypatch.setattr("hydrotwin.commands.comparing_many.MANY", 1)
    assert hydrotwin(*line, tmp_path / "many", "--executor", "here").code == 0
    assert not (tmp_path / "few" / ".runs").exists() and (tmp_path / "many" / ".runs").is_dir()


def test_no_page_of_an_earlier_run_passes_for_one_of_this(written, folder, tmp_path):
    """The variant is called otherwise, then there is none: pages of before go, what is not hydrotwin's stays."""
    out = tmp_path / "out"
    shutil.copytree(written[1], out)
    (out / "slow_motor" / "notes.txt").write_text("mine", encoding="utf-8")
    renamed = folder / "renamed.toml"
    renamed.write_text(SCENARIO.replace('variants."slow motor"', "variants.late").replace("slow*", "late"))
    words = ("--out", out, "--executor", "here", "--junit", out / "criteria.xml")
    assert hydrotwin("compare", renamed, *words).code == 1
    assert [p.name for p in (out / "slow_motor").iterdir()] == ["notes.txt"]
    assert (out / "late" / "report.html").is_file() and (out / "criteria.xml").is_file()
    alone = folder / "alone.toml"
    alone.write_text(SCENARIO.partition("[variants")[0].replace(', "variant=slow*: arm_angle.rmse < 0.001 deg"', ""))
    assert hydrotwin("compare", alone, "--out", out, "--executor", "here").code == 0
    assert {p.name for p in out.iterdir()} == {".runs", "report.html", "report.md", "compare.json", "slow_motor"}
