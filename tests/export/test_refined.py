"""Steps of an exported model are cut around contacts as those of `simulate` are: the same numbers, and right ones."""

from __future__ import annotations

import fmpy
import numpy as np
import pytest

from hydrotwin.export import check_fmu, export_fmu, read_fmu, reference_run
from hydrotwin.export.method import choose_method
from hydrotwin.records import Record
from hydrotwin.simulation import InaccurateWarning, simulate
from tests.simulation.test_accuracy import ball, dropped

TIME = np.arange(0.0, 5.0, 0.01)


@pytest.fixture(scope="module")
def fallen(tmp_path_factory):
    """An FMU of a ball above a stop of 1e8 N/m, whose contacts of 0.3 ms lie between its steps of 1 ms."""
    flat = ball()
    return export_fmu(flat, tmp_path_factory.mktemp("ball") / "ball.fmu", reference=reference_run(flat))


@pytest.mark.parametrize("stiffness", [1e4, 1e6, 1e8, 1e10])
def test_an_exported_ball_rebounds_to_the_height_it_fell_from(fallen, stiffness):
    found = read_fmu(fallen, values={"k": stiffness}).free_run(Record(TIME, {}, {}, "drop"))
    simulated = simulate(ball(stiffness), Record(TIME, {}, {}, "drop"))
    for name in ("height_seen", "speed_seen"):
        assert np.abs(found[name] - simulated[name]).max() < 1e-12 * np.ptp(simulated[name])
    assert found["height_seen"] == pytest.approx(dropped(stiffness, TIME), abs=1e-4)


@pytest.mark.parametrize("communication", [1e-3, 0.05, 0.5])
def test_another_master_meets_the_rebound_at_any_communication_step(fallen, communication):
    found = fmpy.simulate_fmu(str(fallen), stop_time=5.0, step_size=communication, output_interval=communication)
    assert found["height_seen"] == pytest.approx(dropped(1e8, found["time"]), abs=1e-4)


def test_the_run_inside_is_that_of_simulate(fallen):
    row = check_fmu(fallen)["reference"]
    assert row.passed, row.detail
    assert float(row.detail.split("difference ")[1].split()[0]) < 1e-12


def test_the_method_and_its_accuracy_are_told():
    method, step, reason = choose_method(ball(), "auto", 1e-3)
    assert (method, step) == ("refined", 1e-3)
    assert "accurate to" in reason


def test_whole_steps_are_for_who_asks_for_them_and_the_run_inside_says_that_they_miss():
    with pytest.warns(InaccurateWarning, match="explicit, step 0.001 s"):
        record = reference_run(ball(), method="explicit")
    assert record["height_seen"].max() > 2.0
