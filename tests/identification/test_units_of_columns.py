"""The columns of a recording reach a model in the units that it declares, or are refused."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification.problem import recordings
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der
from hydrotwin.models.language.errors import UnitError
from hydrotwin.records import read_record, write_record
from hydrotwin.simulation import simulate


class Pumping(Component):
    """A piston pump: every stroke moves a volume; a counter of strokes lags behind."""

    strokes = Input("1/s", "strokes", nominal=1.0, interpolation="hold")
    counted = Output("1/s", "strokes counted", nominal=1.0)
    lag = Parameter(0.1, "s", "lag of the counter", bounds=(1e-3, 1.0))
    rate = State(0.0, "1/s", "counted", nominal=1.0)

    def equations(self):
        yield self.lag * der(self.rate) == self.strokes - self.rate
        yield self.counted == self.rate


@pytest.fixture
def recorded(tmp_path):
    path = tmp_path / "strokes.csv"
    path.write_text("time [s],strokes [1/min],counted [min-1]\n" + "".join(f"{k / 10},120,60\n" for k in range(30)))
    return read_record(path)


def test_strokes_per_minute_reach_a_model_as_strokes_and_not_as_radians(recorded, tmp_path):
    flat = Model(Pumping()).flat
    (found,) = recordings(flat, [recorded], None, "run")
    assert found.u[:, 0] == pytest.approx(2.0) and found.y[:, 0] == pytest.approx(1.0)
    run = simulate(Model(Pumping()), recorded)
    write_record(run, tmp_path / "run.csv")
    y = read_record(tmp_path / "run.csv")["counted"]
    assert y == pytest.approx(2.0 - np.exp(-recorded.time / 0.1), rel=1e-6)  # from the first count, 1/s


def test_a_column_of_another_dimension_is_refused_by_identification_itself(recorded):
    record = recorded.with_signals({"counted": recorded["counted"]}, {"counted": "m"}, {"counted": "mm"})
    with pytest.raises(UnitError, match="column 'counted' is in mm, the model needs 1/s"):
        recordings(Model(Pumping()).flat, [record], None, "run")
