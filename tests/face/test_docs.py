"""The documentation keeps its word: its commands parse, its Python runs, its files are read."""

from __future__ import annotations

import re
import shlex
import shutil
import sys
import tomllib
from types import SimpleNamespace
from unittest import mock

import pytest
import typer

import hydrotwin as ht
from hydrotwin.cli import app, spread
from hydrotwin.models import cehA
from hydrotwin.models.effects import add_effect
from hydrotwin.models.language.modelica import modelica_text
from tests.face.command_line import ROOT
from tests.report import gap_discoveries

TEXT = (ROOT / "docs/gap.md").read_text(encoding="utf-8")
VALIDATION = (ROOT / "docs/validation.md").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^ {4,6}(hydrotwin .*)$", TEXT + README + VALIDATION, re.MULTILINE)
PYTHON = [block.partition("```")[0] for block in TEXT.split("```python\n")[1:]]


@pytest.mark.parametrize("line", [c for c in dict.fromkeys(COMMANDS) if not c.endswith("\\")])
def test_a_command_line_of_the_documentation_is_one(line):
    command, *words = spread(shlex.split(line)[1:])
    typer.main.get_command(app).commands[command].make_context(command, words)


def test_the_documentation_shows_each_option_of_gap_that_changes_what_is_tried_or_where_it_runs():
    for option in (
        "--free",
        "--effects",
        "--exclude",
        "--max-effects",
        "--initial-states",
        "--executor",
        "--fresh",
        "--validate",
        "--json",
    ):
        assert option in TEXT, option


def test_the_variants_of_the_documentation_are_read():
    from hydrotwin.comparison.variants import KEYS, read_variants

    blocks = [block.partition("```")[0] for block in VALIDATION.split("```toml\n")[1:]]
    table = tomllib.loads(next(block for block in blocks if "[matrix]" in block))
    found = read_variants(table["variants"], table["matrix"], "validation.md")
    assert len(found) == 1 + len(table["variants"]) + 6
    rows = re.findall(r"^\| (`.+?`) \|", VALIDATION.partition("## Variants")[2], re.MULTILINE)
    assert set(re.findall("`(.+?)`", " ".join(rows))) == set(KEYS)


def test_make_knows_every_target_that_is_named():
    known = set(re.findall(r"^([a-z-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE))
    named = re.findall(r"\bmake ([a-z-]+)(?=`|  | #)", README + (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8"))
    assert {"demo", "test", "bench-gap"} <= set(named) <= known


def test_the_snippet_that_discovers_writes_a_report(recordings, tmp_path, monkeypatch, capsys):
    for path in recordings.glob("*.csv"):
        shutil.copy(path, tmp_path)
    monkeypatch.chdir(tmp_path)
    asked = mock.Mock(return_value=gap_discoveries.named())
    monkeypatch.setitem(sys.modules, "hydrotwin.discovery.discover", SimpleNamespace(discover=asked))
    exec(compile(next(s for s in PYTHON if "ht.discover" in s), "gap.md", "exec"), {})
    assert len(asked.call_args.args[1]) == 3 and len(asked.call_args.kwargs["validate"]) == 2
    assert capsys.readouterr().out.startswith("named")
    assert (tmp_path / "gap/report.html").exists()


def test_the_snippet_that_adds_an_effect_by_hand_writes_the_file_that_is_shown(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    exec(compile(next(s for s in PYTHON if "ht.add_effect" in s), "gap.md", "exec"), {})
    said = capsys.readouterr().out
    assert "internal_leakage at cylinder.annulus-cylinder.cap" in said and "extends CehA;" in said
    (tmp_path / "shown.toml").write_text(TEXT.split("```toml\n")[1].partition("```")[0])
    written, shown = ht.load("leaking.toml"), ht.load("shown.toml")
    assert [(a.effect, a.site, a.name) for a in written.additions] == [
        (a.effect, a.site, a.name) for a in shown.additions
    ]
    values = [{p.name: p.value for p in m.flat.parameters}["internal_leakage.conductance"] for m in (written, shown)]
    assert values == [2e-14, 2e-14]


def test_the_modelica_that_is_shown_is_what_is_written():
    shown = TEXT.split("```modelica\n")[1].partition("```")[0]
    written = modelica_text(add_effect(cehA.model(), "coulomb_friction"))
    assert "\n".join(f"  {line}" for line in shown.strip().splitlines()) in written.replace(
        "    extends", "    extends"
    )


def test_every_criterion_of_the_documentation_is_one():
    from hydrotwin.comparison import criteria_of
    from hydrotwin.comparison.metric import METRICS

    angle = next(s for s in ht.load("cehA").flat.outputs if s.name == "arm_angle")
    rows = re.findall(r"^\| `(.+?)` \|", VALIDATION.partition("## Bands")[0], re.MULTILINE)
    assert len(rows) >= 6 and all(criteria_of(row, [angle])[0].output == "arm_angle" for row in rows)
    assert all(f"`{metric}`" in VALIDATION for metric in METRICS)
