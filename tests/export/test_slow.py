"""FMUs of what moves slowly: a block that steps every few seconds, a model of long steps."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.export import check_fmu, export_fmu, read_fmu, reference_run
from hydrotwin.export.method import DURATION, FEWEST, excitation
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests.export.systems import lag_block


@pytest.fixture(scope="module")
def slow():
    return dataclasses.replace(lag_block(), period=4.0)


@pytest.fixture(scope="module")
def fmu(slow, tmp_path_factory):
    run = reference_run(slow)
    return export_fmu(slow, tmp_path_factory.mktemp("slow") / "slow.fmu", reference=run)


def test_the_run_that_goes_along_lasts_as_long_as_what_it_shows(slow, fmu):
    """Two seconds had been one sample of it, and half a hertz every four seconds would be no movement."""
    run = reference_run(slow)
    assert len(run) == FEWEST + 1 and run.period == pytest.approx(4.0)
    assert np.ptp(run["command"]) > 0.5 and np.ptp(run["angle"]) > 0.1
    assert check_fmu(fmu, replay=True).replays[0].passed
    assert float(read_fmu(fmu).description.source.defaultExperiment.stopTime) == pytest.approx(5 * FEWEST * 4.0)


def test_what_moves_fast_is_tried_for_two_seconds_as_ever(systems):
    assert excitation(systems["cehA"]).duration == pytest.approx(DURATION)
    long = excitation(dataclasses.replace(systems["cehA"], step=1.0))
    assert long.duration == pytest.approx(FEWEST) and len(long) == len(excitation(systems["cehA"]))


def test_the_last_part_of_a_period_lies_on_the_line_as_in_simulate(slow, fmu):
    time = np.arange(0.0, 22.0, 0.5)  # ends between the samples of the block
    record = Record(time, {"command": np.sin(time), "angle": np.full(len(time), 0.2)}, {"command": "V", "angle": "rad"})
    found, expected = read_fmu(fmu, interpolation="hold").free_run(record), simulate(slow, record)
    np.testing.assert_allclose(found["angle"], expected["angle"], rtol=0, atol=1e-12)
    assert np.ptp(expected["angle"][-3:]) > 1e-3
