"""Weights from what is left: the same answer on a right model, a sane one where an effect is missing."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification import identify
from hydrotwin.models.language.errors import DeclarationError
from tests.identification.drive import drive, recorded

FINE = {"position": 1e-4, "motor_speed": 0.1}


def with_slow_drift(record, size: float, seconds: float = 3.0):
    """A position that wanders: what no parameter of the drive can explain."""
    return record.with_signals({"position": record["position"] + size * np.sin(record.time / seconds)})


def test_a_right_model_is_weighed_by_its_noise():
    records = [recorded(drive(), k, noise={"position": 0.01, "motor_speed": 0.1}) for k in (1, 2)]
    plain, auto = (identify(drive(), records, weights=kind) for kind in ("noise", "auto"))
    assert auto.values == plain.values
    assert auto.sigma == plain.sigma
    assert auto.allowed == pytest.approx(auto.noise)


def test_an_unexplained_position_does_not_spoil_what_the_speed_tells():
    records = [with_slow_drift(recorded(drive(), k, noise=FINE), 0.05) for k in (1, 2)]
    by_noise, auto = (identify(drive(), records, weights=kind) for kind in ("noise", "auto"))
    away = {fit: abs(fit.values["motor.gain"] - 10.0) for fit in (by_noise, auto)}
    assert away[auto] < 0.5 * away[by_noise]
    assert away[auto] < 4 * auto.sigma["motor.gain"]
    assert auto.allowed["position"] > 30 * auto.noise["position"]
    assert auto.allowed["motor_speed"] == pytest.approx(auto.noise["motor_speed"])


def test_the_weights_that_were_used_are_told():
    records = [with_slow_drift(recorded(drive(), 1, noise=FINE), 0.05)]
    auto = next(f for f in identify(drive(), records).findings if f.kind == "weights")
    assert auto.sentence.startswith("identify: weighed by what is left of each output, not by its noise (position ")
    plain = next(f for f in identify(drive(), records, weights="noise").findings if f.kind == "weights")
    assert plain.sentence.endswith("or take weights='residual'.")


def test_a_noise_that_was_given_is_kept_unless_residual_weights_are_asked_for():
    records = [with_slow_drift(recorded(drive(), 1, noise=FINE), 0.05)]
    given = identify(drive(), records, noise={"position": 1e-3}, starts=1)
    assert given.allowed["position"] == pytest.approx(1e-3)
    asked = identify(drive(), records, noise={"position": 1e-3}, starts=1, weights="residual")
    assert asked.allowed["position"] == pytest.approx(asked.rmse["train"]["position"], rel=0.05)


def test_chi_square_stays_in_units_of_the_noise():
    fit = identify(drive(), [with_slow_drift(recorded(drive(), 1, noise=FINE), 0.05)])
    assert fit.chi2_per_dof > 100
    left = next(r for r in fit.residuals if r.output == "position")
    assert left.chi2_per_sample == pytest.approx((left.rmse / fit.noise["position"]) ** 2)
    assert 0.01 < left.rmse < 0.05


def test_unknown_weights_are_refused():
    with pytest.raises(DeclarationError, match=r"no weights 'residuals'. Did you mean 'residual'"):
        identify(drive(), [recorded(drive(), 1)], weights="residuals")
