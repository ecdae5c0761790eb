"""A time axis that nobody would see the end of is refused with its numbers."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.records import Record
from hydrotwin.simulation import lower, simulate
from tests.simulation.small_models import lag

IN_NANOSECONDS = Record(np.arange(11) * 1e9, {"u": np.ones(11)}, {"u": "1"}, "run")  # read as seconds
SAID = r"1e\+10 s in steps of 0.001 s would be 1e\+13 steps, at most 1e\+08"


@pytest.mark.parametrize("method", ["auto", "explicit", "vm"])
@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_a_run_of_1e13_steps_is_refused(method, interpolation):
    with pytest.raises(DataError, match=SAID):
        simulate(lag(interpolation), IN_NANOSECONDS, method=method)


def test_so_is_a_block_and_a_finer_time_axis():
    with pytest.raises(DataError, match=SAID):
        simulate(lower(lag(), period=1e-3), IN_NANOSECONDS)
    with pytest.raises(DataError, match=SAID):
        IN_NANOSECONDS.resample(period=1e-3)
    hole = Record([0.0, 1e-3, 2e-3, 1e7], {"u": np.ones(4)}, {"u": "1"}, "hole")
    with pytest.raises(DataError, match=r"anti-alias filter: 1e\+07 s in steps of 0.001 s would be 1e\+10 steps"):
        hole.resample(times=[0.0, 5e6], anti_alias=True)


def test_steps_as_long_as_the_recording_asks_for_are_taken():
    slow = dataclasses.replace(lag(time_constant=1e9), step=1e8)
    assert simulate(slow, IN_NANOSECONDS)["x_seen"][-1] == pytest.approx(2 * (1 - np.exp(-10)), rel=1e-3)
