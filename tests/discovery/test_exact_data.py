"""Recordings without noise of the very same equations show no gap, however few digits they have."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.simulation import simulate

from .slides import DAMPING, MASS, found, records, slide

TRUTH = {"mass.mass": MASS, "mass.damping": DAMPING}


def exact(effect=(), **settings):
    """The slide's own runs, without noise."""
    model = slide().plus([c.addition for c in effect])
    runs = []
    for r in records(3):
        speed = simulate(model, r, parameters={**TRUTH, **settings}, step=5e-3)["speed"]
        runs.append(r.with_signals({"speed": speed}))
    return runs


def digits(number):
    return lambda v: np.array([float(f"{x:.{number - 1}e}") for x in v])


@pytest.mark.parametrize(
    "how", [lambda v: v, digits(3), digits(6), lambda v: np.float32(v).astype(float)],
    ids=["double precision", "three digits", "six digits", "single precision"],
)  # fmt: skip
def test_data_without_noise_of_the_same_equations_lacks_nothing(how):
    runs = [r.with_signals({"speed": how(r["speed"])}) for r in exact()]
    assert found(runs, ["coulomb_friction", "dead_time"]).verdict == "none"
