"""Whether an input is held or linear between its samples: by what the recording shows, its name and its unit."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.language.flat import Signal
from hydrotwin.records.between import sentences, shown

TIME = np.arange(0, 10, 0.01)
RANDOM = np.random.default_rng(0)
SINE = 30 * np.sin(2 * TIME)
STEPS = RANDOM.uniform(-30, 30, 40)[(TIME / 0.25).astype(int)]
SLOWER = np.repeat(np.sin(np.arange(0, 10, 0.05)), 5)  # a command of 20 Hz in a recording of 100 Hz
RESTS = np.where((TIME > 3) & (TIME < 6), 0.0, SINE)


@pytest.mark.parametrize(
    ("name", "unit", "column", "expected"),
    [
        ("force", "N", SINE, "linear"),
        ("force", "N", SINE + RANDOM.normal(0, 0.5, len(TIME)), "linear"),
        ("force", "N", np.round(SINE, 1), "linear"),
        ("force", "N", np.round(0.3 * SINE), "linear"),  # an ADC of few levels stays as well, but never jumps
        ("force", "N", RESTS, "linear"),
        ("force", "N", STEPS, "hold"),
        ("force", "N", np.round(STEPS), "hold"),
        ("flow", "m3/s", SLOWER, "hold"),
        ("pressure", "Pa", 1e5 * SINE, "linear"),
        ("motor_speed", "rad/s", SINE, "linear"),
        ("speed_setpoint", "rad/s", SINE, "hold"),
        ("direction", "1", np.sign(SINE), "hold"),
        ("u", "V", SINE, "hold"),
        ("u", "V", SINE + RANDOM.normal(0, 0.5, len(TIME)), "hold"),
        ("current", "A", SINE, "hold"),
        ("measured_current", "A", SINE, "linear"),
        ("angle", "rad", SINE, "linear"),
        ("force", "N", np.zeros(10), "linear"),
        ("force", "N", np.full(10, np.nan), "linear"),
    ],
)
def test_a_command_is_held_and_a_measured_quantity_linear(name, unit, column, expected):
    kind, why = shown(Signal(name, unit), [column])
    assert kind == expected and why


def test_all_recordings_decide_together():
    assert shown(Signal("force", "N"), [STEPS, STEPS, SINE[:50]])[0] == "hold"
    assert shown(Signal("force", "N"), [])[0] == "linear"


def test_what_a_model_declares_needs_no_words_and_everything_else_has_its_reason():
    assert sentences([Signal("command", "V", chosen_by="model")]) == []
    (told,) = sentences([Signal("force", "N", interpolation="linear", chosen_by="fit", shift=-0.01, why="because")])
    assert "linear" in told and "0.01 s earlier" in told and "the fit: because" in told
