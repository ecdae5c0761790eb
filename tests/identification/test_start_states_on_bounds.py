"""A start state that rests on its bound takes no step, and the others step as if it were a constant."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.optimize import least_squares

from hydrotwin.identification import identify
from hydrotwin.models.language.flat import FlatModel, ParameterValue, Signal, StateVariable, fixed_start
from hydrotwin.records.record import Record


def loaded_slide() -> FlatModel:
    """b x' = u - F, F' = 0: each recording has a load F >= 0 of its own."""
    t, x, u, p = ca.SX.sym("t"), ca.SX.sym("x", 2), ca.SX.sym("u"), ca.SX.sym("p")
    rate = ca.vertcat((u - x[1]) / p, 0)
    return FlatModel(
        name="slide",
        inputs=(Signal("force", "N"),),
        outputs=(Signal("position", "m"),),
        states=(
            StateVariable("position", "m", measured_by="position"),
            StateVariable("load", "N", bounds=(0.0, 100.0)),
        ),
        parameters=(ParameterValue("viscous", 5.0, "N.s/m", (0.1, 100.0), free=True),),
        ode=ca.Function("ode", [t, x, u, p], [rate, x[0]], ["t", "x", "u", "p"], ["xdot", "y"]),
        initialisation=fixed_start([0.0, 1.0], ["position", "load"], 1, 1),
        step=0.01,
    )


def recorded(load: float, name: str) -> Record:
    """The exact motion under b = 2 N.s/m and a load [N]."""
    time = np.arange(0.0, 4.0, 0.01)
    force = np.where(time < 2.0, 3.0, -1.0)
    travelled = np.concatenate([[0.0], np.cumsum((force[:-1] - load) / 2.0 * 0.01)])
    return Record(time, {"force": force, "position": travelled}, {"force": "N", "position": "m"}, name)


def lowest(records: list[Record]) -> np.ndarray:
    """b, F of the second recording and both first positions, by SciPy, with F = 0 in the first."""

    def residual(z):
        b, F, *first = z
        pushed = [np.concatenate([[0.0], np.cumsum(r["force"][:-1] * 0.01)]) for r in records]
        rows = [x + (U - load * r.time) / b - r["position"]
                for r, U, load, x in zip(records, pushed, (0.0, F), first, strict=True)]  # fmt: skip
        return np.concatenate(rows)

    return least_squares(residual, [2.0, 1.0, 0.0, 0.0], xtol=1e-12, ftol=1e-12).x


def test_a_load_on_its_bound_does_not_hold_up_the_other_recordings():
    records = [recorded(-0.5, "pulled"), recorded(2.0, "pushed")]
    fit = identify(
        loaded_slide(), records, initial_states="free", noise={"position": 0.01}, starts=1, windows=(), iterations=30
    )
    viscous, load, *_ = lowest(records)
    starts = {r.name: r.start for r in fit.records}
    assert fit.converged
    assert starts["pulled"]["load"] == 0.0
    assert starts["pushed"]["load"] == pytest.approx(load, rel=1e-3)
    assert fit.values["viscous"] == pytest.approx(viscous, rel=1e-3)
