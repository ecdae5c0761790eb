"""The page of a characteristic: its figures are of the points, and what it says of errors is right."""

from __future__ import annotations

import base64
import json

import casadi as ca
import numpy as np
import pytest

from hydrotwin.learned import Characteristic, learn_compensator, learn_inverse
from hydrotwin.learned.inverse.compensator import desired_curve
from hydrotwin.models.language.flat import Signal
from hydrotwin.report.characteristic import write_characteristic
from hydrotwin.simulation.block import Block
from tests.report.page_figures import unpacked

COMMAND, RATE = Signal("current", "1"), Signal("wanted_position_rate", "m/s")
LEVELS = np.linspace(-1, 1, 81)
WAYPOINTS = [(0.5, 0.03), (1.0, 0.09)]


@pytest.fixture(scope="module")
def forward():
    """0.1 m/s at full command, with a deadband of 0.05 on either side."""
    return Characteristic(COMMAND, RATE, LEVELS, 0.1 * np.sign(LEVELS) * np.maximum(np.abs(LEVELS) - 0.05, 0))


def errors(files) -> dict[str, float]:
    """The only row of the first table, SI."""
    row = json.loads(files["json"].read_text(encoding="utf-8"))["tables"]["errors"]["rows"][0]
    return {name: row[name]["value"] for name in ("rms", "largest")}


def test_the_page_of_an_inverse_says_how_far_it_misses(forward, tmp_path):
    block = learn_inverse(forward)
    files = write_characteristic(forward, tmp_path, inverse=block)
    text = files["markdown"].read_text(encoding="utf-8")
    assert "position rate: characteristic" in text and "behind the inverse it misses" in text
    row = errors(files)
    assert 0 < row["rms"] < 1e-3 and row["rms"] <= row["largest"]


def test_the_page_of_a_compensator_shows_the_machine_behind_it(forward, tmp_path):
    block = learn_compensator(forward, None, None, WAYPOINTS)
    files = write_characteristic(forward, tmp_path, compensator=block, desired=desired_curve(WAYPOINTS))
    row = errors(files)
    assert row["rms"] < 2e-3, "with it the deadband is gone"
    wrong = write_characteristic(forward, tmp_path / "w", compensator=block, desired=desired_curve([(1.0, 0.05)]))
    assert errors(wrong)["rms"] > 5 * row["rms"]


def test_a_process_is_shown_with_its_band(forward, tmp_path):
    u = ca.SX.sym("u")
    none = ca.SX.sym("x", 0), ca.SX.sym("p", 0)
    answers = ca.vertcat(0, 0.1 * u, 0.02)
    step = ca.Function("step", [none[0], u, none[1]], [none[0], answers], ["x", "u", "p"], ["x_next", "y"])
    start = ca.Function("start", [u, ca.SX.sym("y", 3), none[1]], [none[0]], ["u", "y", "p"], ["x"])
    outputs = (Signal("position", "m"), Signal("position.slope", "m/s"), Signal("position.slope.sd", "m/s"))
    process = Block("process", (COMMAND,), outputs, (), (), step, start, 0.1)
    plain = write_characteristic(forward, tmp_path / "plain")["html"].read_text(encoding="utf-8")
    page = write_characteristic(forward, tmp_path, machine=process)["html"].read_text(encoding="utf-8")
    assert "95 % band" in page and "95 % band" not in plain
    edge = 1e3 * (0.1 * np.linspace(-1, 1, 801) + 1.96 * 0.02)  # shown in mm/s
    assert base64.b64encode(edge.astype("<f4").tobytes()).decode() in "".join(unpacked(page, "spec"))
