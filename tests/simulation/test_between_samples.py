"""What a model's inputs do between samples: declared, shown by the recording, or told, and the same in the file."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, der
from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.model_file import read_model_file, write_model_file
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.simulation.inputs import as_seen

TIME = np.arange(0, 2.001, 0.1)


def integrator(interpolation=None) -> Model:
    """x' = gain q."""

    class Tank(Component):
        """A tank."""

        flow = Input("m3/s", "flow in", interpolation=interpolation)
        level = Output("m", "level")
        gain = Parameter(1.0, "1/m2", "one over the area")
        height = State(0.0, "m", "level")

        def equations(self):
            yield der(self.height) == self.gain * self.flow
            yield self.level == self.height

    return Model(Tank(), "tank")


RECORD = Record(TIME, {"flow": np.sin(3 * TIME)}, {"flow": "m3/s"}, "run")
HELD = np.concatenate([[0], np.cumsum(0.1 * np.sin(3 * TIME))[:-1]])
LINEAR = HELD + 0.05 * (np.sin(3 * TIME) - np.sin(0))


@pytest.mark.parametrize(
    ("declared", "told", "expected"),
    [
        (None, None, LINEAR),
        ("hold", None, HELD),
        ("linear", None, LINEAR),
        (None, "hold", HELD),
        ("hold", "linear", LINEAR),
    ],
)
def test_the_user_wins_over_the_model_and_the_model_over_the_recording(declared, told, expected):
    run = simulate(integrator(declared), RECORD, interpolation=told and {"flow": told})
    assert run["level"] == pytest.approx(expected, abs=1e-9)


def test_settings_and_further_parts_keep_what_was_chosen():
    model = integrator().with_inputs({"flow": {"interpolation": "linear", "chosen_by": "fit", "shift": 0.05}})
    for other in (model.with_settings({"gain": 2.0}), model.plus(()), model.but(gain=Parameter(2.0, "1/m2", "area"))):
        (flow,) = other.flat.inputs
        assert (flow.interpolation, flow.chosen_by, flow.shift) == ("linear", "fit", 0.05)


def test_a_model_file_keeps_what_was_chosen_by_whom_and_why(tmp_path):
    change = {"interpolation": "linear", "chosen_by": "recording", "shift": -0.05, "why": "it moves"}
    path = write_model_file(tmp_path / "m.toml", "tank.py:tank", integrator().with_inputs({"flow": change}))
    assert read_model_file(path).inputs == {"flow": change}


@pytest.mark.parametrize(
    ("row", "message"),
    [
        ('flow = "linear"', "no table"),
        ('flow = {interpolatoin = "linear"}', "interpolation"),
        ('flow = {shift = "late"}', "no number of seconds"),
        ("flow = {interpolation = 1}", "no text"),
    ],
)
def test_a_row_that_is_none_is_refused_by_name(tmp_path, row, message):
    path = tmp_path / "m.toml"
    path.write_text(f'model = "cehA"\n[inputs]\n{row}\n', encoding="utf-8")
    with pytest.raises(DataError, match=message):
        read_model_file(path)


def test_an_unknown_kind_and_an_unknown_input_are_refused():
    with pytest.raises(DeclarationError, match="cubic"):
        integrator().with_inputs({"flow": {"interpolation": "cubic"}})
    with pytest.raises(DeclarationError, match="flow"):
        integrator().with_inputs({"flaw": {"interpolation": "hold"}})


def test_a_shift_keeps_the_integral_of_a_held_input_and_the_line_of_a_linear_one():
    held = Signal("q", "1", shift=0.05)
    column = np.sin(3 * TIME)
    expected = np.r_[column[0], 0.5 * (column[1:] + column[:-1])]
    assert as_seen(held, TIME, column) == pytest.approx(expected, abs=1e-12)
    linear = dataclasses.replace(held, interpolation="linear", shift=-0.1)
    assert as_seen(linear, TIME, column) == pytest.approx(np.r_[column[1:], column[-1]], abs=1e-12)
