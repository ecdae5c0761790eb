"""Whether an input is held or linear between its samples: by what the recording shows, its name and its unit."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.records.between import sentences, shown, shown_otherwise

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


def as_taken(interpolation: str | None, chosen_by: str | None) -> Signal:
    return Signal("force", "N", interpolation=interpolation, chosen_by=chosen_by, why="so it was in the fit")


def runs(**columns) -> list[Record]:
    return [Record(TIME, {"force": values}, {"force": "N"}, name) for name, values in columns.items()]


@pytest.mark.parametrize(
    ("signal", "columns", "apart"),
    [
        (as_taken("hold", "recording"), {"smooth": SINE}, "smooth"),
        (as_taken("hold", "recording"), {"steps": STEPS}, ""),
        (as_taken("hold", "recording"), {"steps": STEPS, "smooth": SINE, "more": SINE}, "smooth (and 1 more)"),
        (as_taken("linear", "recording"), {"steps": STEPS}, "steps"),
        (as_taken("smooth", "fit"), {"steps": STEPS, "smooth": SINE}, "steps"),
        (as_taken("hold", "fit"), {"smooth": SINE}, ""),  # the fit held what looked linear, and saw why
        (as_taken(None, None), {"steps": STEPS, "slower": SLOWER, "smooth": SINE}, "steps (and 1 more)"),
        (as_taken("hold", "recording"), {"still": 0 * TIME}, ""),  # it shows nothing
        (as_taken("hold", "model"), {"smooth": SINE}, ""),
        (as_taken("hold", "user"), {"smooth": SINE}, ""),
    ],
)
def test_a_choice_by_recordings_is_told_where_others_show_it_otherwise(signal, columns, apart):
    """A file of a fit to held forces ran with held ones on a smooth force, 20 times as wrong, and gave their reason."""
    told = shown_otherwise([signal], runs(**columns))
    assert bool(told) == bool(apart)
    if told:
        other = "linear" if signal.interpolation == "hold" else "hold"
        assert f"{apart} shows it otherwise" in told[0] and f"--interpolation force={other}" in told[0]
