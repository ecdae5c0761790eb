"""The gate table says pass, fail or why not, and `make fmus` builds for the platforms that are named."""

from __future__ import annotations

import dataclasses
import zipfile

import pytest

from fmus import gates, make
from fmus.machines import Machine
from fmus.shipped import all_shipped
from hydrotwin.export import CheckRow
from hydrotwin.records import write_record
from tests.export.test_shipped import SMALL, copy_of_small


@pytest.fixture
def alone(monkeypatch):
    """No other machines: they have tests of their own."""
    monkeypatch.setattr(gates, "THERE", {})
    monkeypatch.setattr(gates, "COLUMNS", gates.COLUMNS[:9])


def test_a_row_has_a_mark_for_every_gate(alone):
    [block] = all_shipped(names=[SMALL])
    row = gates.row_of(block, 2, "cs")
    assert len(row) == len(gates.COLUMNS)
    assert row[:4] == [SMALL, "2.0", "cs", "pass"]
    assert row[4].startswith("pass ") and float(row[4].split()[1]) < 1e-6
    assert row[5].startswith("pass ") and row[6] == "-"
    assert row[7] == "pass 11 of 11"  # with its record: what it was trained on


def test_what_has_no_such_kind_says_why_and_fails_only_where_it_was_promised(alone):
    [block] = all_shipped(names=[SMALL])
    row = gates.row_of(block, 3, "me")
    assert row[3].startswith("- (") and "sampled block cannot be Model Exchange" in row[3]
    assert gates.row_of(dataclasses.replace(block, kind="both"), 3, "me")[3].startswith("FAIL (")


def test_a_gate_that_is_not_passed_fails_the_table(alone, tmp_path, capsys):
    folder = copy_of_small(tmp_path)
    assert gates.main([SMALL], tmp_path) == 0
    [block] = all_shipped(tmp_path)
    record = block.reference_run()
    wrong = record.with_signals({"position": record["position"] * 1.01}, {"position": record.units["position"]})
    write_record(wrong, folder / "reference.csv")
    assert gates.main([SMALL], tmp_path) == 1
    table = capsys.readouterr().out
    assert "FAIL 0.0" in table and "fmpy " in table
    assert str(tmp_path) not in table
    assert gates.main(["nobody"], tmp_path) == 2


def test_a_machine_that_fails_or_differs_fails(monkeypatch, tmp_path):
    def broken(fmu, platform, kind):
        raise RuntimeError("win64: the replay ended with 2. more")

    monkeypatch.setattr(gates, "replayed", broken)
    monkeypatch.setattr(gates, "machine_for", _there)
    assert gates._elsewhere(tmp_path, "win64", "cs") == "FAIL (win64: the replay ended with 2. more)"


def _there(platform: str) -> Machine:
    return Machine(platform, missing="no wine" if platform == "aarch64-linux" else "")


def test_a_machine_that_cannot_be_imitated_says_why(monkeypatch, tmp_path):
    monkeypatch.setattr(gates, "machine_for", _there)
    assert gates._elsewhere(tmp_path, "aarch64-linux", "cs") == "- (no wine)"


def test_the_figure_of_a_detail_is_the_largest_difference():
    assert gates._figure("3 outputs, largest difference 2.2e-07 of the range at x") == "2.2e-07"
    assert gates._figure("20 steps, largest difference to our master 3.5e-15") == "3.5e-15"
    assert gates._figure("largest difference to finite differences 0 of nominal") == "0"
    assert gates._other(CheckRow("x", "not tried", "not installed")) == "- (not installed)"
    assert gates._other(None) == "-"


def test_make_builds_for_the_platforms_that_are_named(tmp_path):
    pytest.importorskip("ziglang")
    copy_of_small(tmp_path)
    assert make.main([SMALL, "--platform", "linux64", "--platform", "aarch64-linux"], tmp_path) == 0
    with zipfile.ZipFile(tmp_path / SMALL / f"{SMALL}_fmi2.fmu") as archive:
        folders = {name.split("/")[1] for name in archive.namelist() if name.startswith("binaries/")}
    assert folders == {"linux64", "aarch64-linux"}
    assert make.main([SMALL, "--platform", "linux46"], tmp_path) == 2
