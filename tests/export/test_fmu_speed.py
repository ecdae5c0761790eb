"""The benchmark of FMUs on a short run: its figures belong to runs that compute the same."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.export import fmu_speed


@pytest.fixture
def short(monkeypatch):
    for name, value in {"STEPS": 400, "FMPY_STEPS": 200, "ROUNDS": 1, "FMPY_ROUNDS": 1}.items():
        monkeypatch.setattr(fmu_speed, name, value)
    monkeypatch.setattr(fmu_speed, "python_fmu", lambda folder: None)  # it aborts now and then when it is unloaded


@pytest.mark.proof
def test_every_contender_is_measured_and_judged(short, tmp_path, capsys):
    pytest.importorskip("ziglang")
    fmu_speed.speed(tmp_path)
    told = capsys.readouterr().out
    for contender in ("bare compiled loop", "FMU from C", "FMU through FMPy's calls", "FMU that does nothing"):
        (line,) = (line for line in told.splitlines() if line.startswith(f"  {contender}") and "/" not in line
                   and " - " not in line)  # fmt: skip
        assert float(line.split()[-1]) > 0, line
    assert "FMU from C / bare loop" in told and "<= 1.5 x" in told


def test_a_run_with_other_outputs_is_no_measurement():
    expected = np.linspace(0.0, 1.0, 12).reshape(-1, 2)
    fmu_speed.same(expected + 1e-9, expected, "near")
    with pytest.raises(SystemExit, match=r"far: its outputs are 1\.1e-03 of their range off the bare loop"):
        fmu_speed.same(expected + 1e-3, expected, "far")


def test_a_missed_target_is_told():
    assert fmu_speed.at_most("a", 1.6, 1.5, "x")[-1] == fmu_speed.at_least("b", 49.0, 50.0, "x")[-1] == "MISSED"
    assert fmu_speed.at_most("a", 1.4, 1.5, "x")[-1] == fmu_speed.at_least("b", 51.0, 50.0, "x")[-1] == "met"
