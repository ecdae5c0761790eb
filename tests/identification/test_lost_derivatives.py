"""What a fit says where derivatives are lost at its minimum: an answer without them, or a sentence."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification import identify
from hydrotwin.identification.shooting import Shooting
from hydrotwin.models.language.errors import SolveError

from .drive import drive, recorded

OFF = {"motor.gain": 13.0}
NOISE = {"position": 0.01, "motor_speed": 0.1}


def fitted(monkeypatch, lost):
    """A fit of two recordings; ``lost(method, i)``: whether the derivatives of a training run are."""
    known = Shooting.sensitivities

    def sensitivities(self, i, q, z):
        return None if lost(self.propagator.method, i) else known(self, i, q, z)

    monkeypatch.setattr(Shooting, "sensitivities", sensitivities)
    return identify(drive(), [recorded(drive(), k, noise=NOISE) for k in (1, 2)], start=OFF, starts=1)


def test_a_recording_whose_derivatives_are_lost_is_told_and_the_sigmas_come_from_the_others(monkeypatch):
    both = fitted(monkeypatch, lambda method, i: False)
    one = fitted(monkeypatch, lambda method, i: i == 0)
    assert one.values == pytest.approx(both.values)
    (told,) = [str(f) for f in one.findings if f.kind == "diverged"]
    assert "run_1" in told and "do not count" in told
    wider = [p.sigma / q.sigma for p, q in zip(one.parameters, both.parameters, strict=True)]
    assert np.isfinite(wider).all() and np.median(wider) > 1.1
    assert one.degrees_of_freedom < both.degrees_of_freedom


def test_derivatives_that_explicit_steps_lose_are_those_of_the_implicit_method(monkeypatch):
    both = fitted(monkeypatch, lambda method, i: False)
    kept = fitted(monkeypatch, lambda method, i: method == "explicit")
    assert not [f for f in kept.findings if f.kind == "diverged"]
    assert [p.sigma for p in kept.parameters] == pytest.approx([p.sigma for p in both.parameters], rel=1e-3)


def test_where_all_are_lost_it_ends_in_a_sentence(monkeypatch):
    with pytest.raises(SolveError, match=r"every training run of .* Start elsewhere"):
        fitted(monkeypatch, lambda method, i: True)
