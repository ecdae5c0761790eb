"""Empty cells of a slower sensor: `--missing keep` wherever recordings are read."""

from __future__ import annotations

import json

import pytest

from tests.face.command_line import SHIPPED, hydrotwin, short

TOLD = "pressure_cap has no value in 360 of 400 samples"


@pytest.fixture
def slow(tmp_path, monkeypatch):
    """The first four seconds of a shipped recording, with a pressure every tenth sample."""
    source = short(SHIPPED / "cehA" / "recordings" / "validate_1.csv", tmp_path / "whole.csv")
    head, *rows = source.read_text(encoding="utf-8").splitlines()[:401]
    k = [name.split(" ")[0] for name in head.split(",")].index("pressure_cap")
    cells = [row.split(",") for row in rows]
    kept = [",".join("" if j == k and i % 10 else cell for j, cell in enumerate(row)) for i, row in enumerate(cells)]
    (tmp_path / "slow.csv").write_text("\n".join([head, *kept]) + "\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_compare_scores_a_slow_sensor_where_it_was_read(slow):
    words = ("compare", "--model", "cehA", "--validate", "slow.csv", "--mode", "free run", "--out", "report")
    refused = hydrotwin(*words)
    assert refused.code == 2 and 'missing="keep"' in refused.said
    answer = hydrotwin(*words, "--missing", "keep")
    assert answer.code == 0 and TOLD in answer.said
    by_option = json.loads((slow / "report" / "compare.json").read_text())["scores"]
    assert any(score["output"] == "pressure_cap" for score in by_option)
    scenario = 'models = ["cehA"]\nvalidate = ["slow.csv"]\nmodes = ["free run"]\nmissing = "keep"\n'
    (slow / "all.toml").write_text(scenario)
    assert hydrotwin("compare", "all.toml", "--out", "again").code == 0
    by_file = json.loads((slow / "again" / "compare.json").read_text())["scores"]
    assert [s["rmse"] for s in by_file] == [s["rmse"] for s in by_option]
    doubled = hydrotwin("compare", "all.toml", "--missing", "keep", "--out", "again")
    assert doubled.code == 2 and "--missing would be ignored" in doubled.said
    (slow / "all.toml").write_text(scenario.replace('"keep"', '"sometimes"'))
    wrong = hydrotwin("compare", "all.toml", "--out", "again")
    assert wrong.code == 2 and "sometimes" in wrong.said and "drop rows" in wrong.said


def test_simulate_needs_the_inputs_alone(slow):
    words = ("simulate", "cehA", "--input", "slow.csv", "--out", "simulated.csv")
    assert hydrotwin(*words).code == 2
    answer = hydrotwin(*words, "--missing", "keep")
    assert answer.code == 0 and (slow / "simulated.csv").exists()


def test_learn_needs_every_sample_of_what_it_learns_and_of_nothing_else(slow):
    words = ("learn", "piecewise", "slow.csv", "--input", "command", "--missing", "keep", "--out", "block.toml")
    assert hydrotwin(*words, "--output", "rod_position").code == 0
    refused = hydrotwin(*words, "--output", "pressure_cap")
    assert refused.code == 2 and "column 'pressure_cap' has 360 values that are not numbers" in refused.said


def test_simulate_tells_no_error_of_an_output_that_no_sample_knows(slow):
    head, *rows = (slow / "slow.csv").read_text(encoding="utf-8").splitlines()
    k = [name.split(" ")[0] for name in head.split(",")].index("pressure_cap")
    cells = [["" if j == k else cell for j, cell in enumerate(row.split(","))] for row in rows]
    (slow / "empty.csv").write_text("\n".join([head, *map(",".join, cells)]) + "\n", encoding="utf-8")
    words = ("simulate", "cehA", "--input", "empty.csv", "--missing", "keep")
    answer = hydrotwin(*words, "--out", "simulated.csv", "--json")
    rmse = {one["output"]: one["rmse"] for one in json.loads(answer.out)["outputs"]}
    assert answer.code == 0 and (slow / "simulated.csv").exists()
    assert rmse["pressure_cap"] is None and rmse["pressure_rod"] > 0
