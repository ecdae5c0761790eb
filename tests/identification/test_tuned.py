"""Starts at other frequencies of a lightly damped mode, on a mass that hangs on a spring."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification import tuned
from hydrotwin.identification.horizon import fastest_oscillation
from hydrotwin.identification.problem import free_parameters, recordings
from hydrotwin.identification.tuned import CLOSE, EACH_WAY, SPACING, tuned_starts
from hydrotwin.models.language.errors import SolveError
from tests.identification.drive import drive, recorded
from tests.identification.hanging import FREE, hanging, swinging
from tests.identification.pulled import FREE as PULLED
from tests.identification.pulled import pulled, pulling

WAYS = [k for k in range(-EACH_WAY, EACH_WAY + 1) if k]


def asked(model, bounds=None):
    flat = model.flat
    return flat, recordings(flat, [swinging(0)], None, "record"), free_parameters(flat, FREE, bounds=bounds)


def test_tuned_starts_have_the_frequencies_of_a_mass_on_a_spring():
    flat, measured, free = asked(hanging())
    present, *starts = tuned_starts(flat, measured, free)
    first = dict(zip(free.names, free.start, strict=True))
    assert present == pytest.approx(first)
    hertz = [np.sqrt(s["body.stiffness"] / s["body.mass"]) / (2 * np.pi) for s in (first, *starts)]
    assert fastest_oscillation(flat, measured, flat.parameter_vector()) == pytest.approx(hertz[0], rel=1e-6)
    off = np.log(np.array(hertz[1:]) / hertz[0]) / np.log(SPACING) - WAYS
    assert len(starts) == len(WAYS) and np.abs(off).max() < CLOSE
    for s in starts:  # as little as can be: mass and stiffness by the same factor, the damping not at all
        assert s["body.damping"] == pytest.approx(first["body.damping"], rel=1e-4)
        moved = np.log([s[n] / first[n] for n in ("body.stiffness", "body.mass")])
        assert moved[0] == pytest.approx(-moved[1], rel=1e-3)


def test_a_bound_gives_way_to_another_parameter_or_to_no_start():
    flat, measured, free = asked(hanging(), {"body.mass": (49.0, 51.0)})
    _, *starts = tuned_starts(flat, measured, free)
    assert len(starts) == len(WAYS) and all(49.0 <= s["body.mass"] <= 51.0 for s in starts)
    off = [np.log(s["body.stiffness"] / s["body.mass"] / (hanging().flat.parameter_vector()[1] / 50.0)) for s in starts]
    assert np.abs(0.5 * np.array(off) / np.log(SPACING) - WAYS).max() < CLOSE
    flat, measured, free = asked(hanging(), {"body.mass": (49.0, 51.0), "body.stiffness": (1.9e6, 2.1e6)})
    assert tuned_starts(flat, measured, free) == []


def test_a_damped_model_has_no_other_frequencies():
    measured = recordings(drive(), [recorded(drive(), 1)], None, "record")
    assert tuned_starts(drive(), measured, free_parameters(drive(), None)) == []
    flat, measured, _ = asked(hanging(damping=2e4))
    assert tuned_starts(flat, measured, free_parameters(flat, FREE)) == []


def test_nothing_that_is_free_moves_the_mode():
    flat, measured, _ = asked(hanging())
    assert tuned_starts(flat, measured, free_parameters(flat, ["body.damping"])) == []


def test_a_frequency_at_which_the_machine_finds_no_rest_is_no_start(monkeypatch):
    flat, measured, free = asked(hanging())
    known = tuned.lightly_damped(flat, measured)

    def restless_above(p):
        if abs(mode := known(p)) > 2 * np.pi * 35.0:
            raise SolveError("hanging: no static equilibrium found.")
        return mode

    monkeypatch.setattr(tuned, "lightly_damped", lambda *_: restless_above)
    assert len(tuned_starts(flat, measured, free)) == 1 + EACH_WAY  # 22 and 27 Hz of 32, not 38 and 46


def test_tuned_starts_say_nothing_of_what_the_mode_does_not_depend_on():
    """A command's gain and lag before the spring; damping moves the mode's decay alone, not its frequency."""
    flat = pulled().flat
    measured = recordings(flat, [pulling(0)], None, "record")
    starts = tuned_starts(flat, measured, free_parameters(flat, PULLED))
    assert len(starts) == 1 + len(WAYS)
    assert all(set(s) == {"stiffness", "damping"} for s in starts)
