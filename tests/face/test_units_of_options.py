"""Times, forces and shares of options take units, through the one way in that all numbers have."""

from __future__ import annotations

import pytest

from hydrotwin.commands.fitting import force_of
from hydrotwin.commands.shared import duration_of
from hydrotwin.commands.training import options_of
from hydrotwin.learned import characteristic, learn_arx, learn_inverse
from hydrotwin.models.language.errors import HydrotwinError


def test_times_and_forces_of_options_take_their_units():
    budget, load = duration_of("--budget", 0.1), [force_of(text) for text in ("2.5kN", "2500", "2500 N")]
    assert [budget(text) for text in ("90", "1.5min", "1min 30s", "90000 ms")] == [90.0] * 4 and load == [2500.0] * 3
    for text, said in (("3 kg", "no duration of 0.1 s or more"), ("50ms", "no duration"), ("0", "no duration")):
        with pytest.raises(HydrotwinError, match=rf"--budget {text}: {said}"):
            budget(text)
    with pytest.raises(HydrotwinError, match="--load"):
        force_of("2 bar")


def test_options_of_kinds_take_their_units():
    def options(*settings):
        return options_of("invert", learn_inverse, settings, {}, characteristic)

    assert options("settle=200ms", "window=0.5", "steady=5 %") == {"settle": 0.2, "window": 0.5, "steady": 0.05}
    assert options_of("learn arx", learn_arx, ["period=10 ms", "delay=3"], {}) == {"period": 0.01, "delay": 3}
    with pytest.raises(HydrotwinError, match="settle"):
        options("settle=2 bar")
    with pytest.raises(HydrotwinError, match=r"delay cannot be '30ms'\. It takes a whole number"):
        options_of("learn arx", learn_arx, ["delay=30ms"], {})
