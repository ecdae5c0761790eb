"""Samples that stand alone far from all others are left out and told; what is motion is not."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification import identify

from .drive import TRUTH, drive, recorded

NOISE = {"position": 0.01, "motor_speed": 0.1}
OFF = {"motor.gain": 12.0, "motor.time_constant": 0.08}


def spoiled(record, output: str, samples, by: float):
    """The recording with something added to some samples."""
    values = record[output].copy()
    values[list(samples)] += by
    return record.with_signals({output: values})


@pytest.mark.parametrize(
    ("output", "samples", "by"),
    [
        ("position", range(20, 500, 25), 5.0),
        ("motor_speed", range(20, 500, 50), -40.0),
        ("position", [250], 1e4),
        ("position", [100, 101, 102, 300, 301], 3.0),
    ],
)
def test_samples_that_stand_alone_are_left_out_and_told(output, samples, by):
    fit = identify(drive(), [spoiled(recorded(drive(), 1, noise=NOISE), output, samples, by)], start=OFF)
    (told,) = [str(f) for f in fit.findings]
    assert f"{len(list(samples))} in run_1" in told and output in told and "left out" in told
    assert fit.converged and all(r.explained for r in fit.residuals)
    for p in fit.parameters:
        assert abs(p.value - TRUTH[p.name]) < 4 * p.sigma and p.sigma < 0.02 * p.value


def test_who_asks_for_squares_gets_them():
    record = spoiled(recorded(drive(), 1, noise=NOISE), "position", range(20, 500, 25), 5.0)
    fit = identify(drive(), [record], start=OFF, loss="linear", starts=1)
    assert not [f for f in fit.findings if f.kind == "outliers"]
    assert [f for f in fit.findings if f.kind == "unexplained"]


def test_where_more_than_such_samples_is_left_they_are_told_and_kept():
    record = recorded(drive(), 1, noise=NOISE)
    drifting = record.with_signals({"position": record["position"] + 0.2 * np.sin(record.time / 3.0)})
    fit = identify(drive(), [spoiled(drifting, "position", range(20, 500, 50), 20.0)], start=OFF, starts=2)
    kinds = {f.kind: str(f) for f in fit.findings}
    assert "unexplained" in kinds and "soft_l1" in kinds["outliers"]


def test_a_bump_that_lasts_is_no_outlier():
    record = spoiled(recorded(drive(), 1, noise=NOISE), "position", range(200, 230), 5.0)
    fit = identify(drive(), [record], start=OFF, starts=2)
    assert not [f for f in fit.findings if f.kind == "outliers"]
    assert [f for f in fit.findings if f.kind == "unexplained"]
