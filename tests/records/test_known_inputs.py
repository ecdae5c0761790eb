"""An input of a slower raster is known between its samples; one with a gap is not."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, known_inputs
from hydrotwin.simulation import simulate
from tests.simulation.small_models import integrator

TIME = np.arange(101) * 0.01
SLOW = np.where(np.arange(101) % 10 == 0, np.sin(3 * TIME), np.nan)


def record(u, time=TIME):
    return Record(time, {"u": u}, {"u": "1"}, "run")


@pytest.mark.parametrize("interpolation", ["hold", "linear"])
def test_a_slower_input_drives_a_model_as_on_its_own_raster(interpolation):
    model = integrator(interpolation)
    alone = simulate(model, record(SLOW[::10], TIME[::10]))
    among = simulate(model, record(SLOW))
    np.testing.assert_allclose(among["x_seen"][::10], alone["x_seen"], atol=1e-12)


def test_it_may_begin_within_a_step_after_the_others():
    late = np.where(np.arange(101) % 10 == 5, TIME, np.nan)
    filled = known_inputs(record(late), [Signal("u", "1", interpolation="linear")], "model")["u"]
    np.testing.assert_allclose(filled[5:96], TIME[5:96], atol=1e-12)
    assert filled[:5] == pytest.approx(0.05) and filled[96:] == pytest.approx(0.95)


@pytest.mark.parametrize("lost", [slice(40, 41), slice(0, 30), slice(70, 101), slice(0, 101), slice(20, 60)])
def test_a_gap_in_an_input_is_refused(lost):
    for column in (TIME.copy(), SLOW.copy()):
        column[lost] = np.nan
        with pytest.raises(DataError, match=r"run: input column 'u' has gaps .* the first at t = "):
            known_inputs(record(column), [Signal("u", "1")], "model")
