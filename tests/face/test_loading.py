"""What a user may write for a model."""

from __future__ import annotations

import sys

import hydrotwin as ht
from hydrotwin.loading import load

MODEL = """
from hydrotwin.models.language import Component, Input, Model, Output, State, der
from beside import RATE


class Tank(Component):
    inflow = Input("m3/s", "inflow")
    volume_out = Output("m3", "volume")
    volume = State(1.0, "m3", "volume")

    def equations(self):
        yield der(self.volume) == RATE * self.inflow
        yield self.volume_out == self.volume


def tank():
    return Model(Tank(), "tank")
"""


def test_the_catalogue_and_the_gap_workflow_are_found_at_the_face():
    assert set(ht.effects) >= {"coulomb_friction", "dead_time", "internal_leakage"}
    friction = ht.add_effect(load("cehA"), "coulomb_friction")
    assert "coulomb_friction at arm.pin" not in {c.label for c in ht.candidates(friction)}
    assert {"discover", "Discovery", "write_gap_report", "effects"} <= set(dir(ht))
    assert all(hasattr(ht, name) for name in ht.__all__)


def test_a_users_file_may_import_what_lies_beside_it_and_leaves_no_trace(tmp_path):
    (tmp_path / "tank.py").write_text(MODEL)
    (tmp_path / "beside.py").write_text("RATE = 2.0\n")
    before = list(sys.path)
    model = load(f"{tmp_path}/tank.py:tank")
    assert float(model.flat.ode(0, [1.0], [3.0], [])[0]) == 6.0
    assert sys.path == before
    assert "beside" not in sys.modules
