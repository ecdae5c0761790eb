"""The C-EHA from starts 30 % off: recordings of the truth rig, which shares no code with the model."""

from __future__ import annotations

from functools import cache

import pytest

from hydrotwin.identification import identify
from hydrotwin.records.record import Record
from tests import rig
from tests.simulation.flat_cehA import flat_cehA

TRUTH = {p.name: p.value for p in flat_cehA().parameters if p.free}
MODEL = flat_cehA()


@cache
def recordings(role: str) -> tuple[Record, ...]:
    units = {s.name: s.unit for s in (*MODEL.inputs, *MODEL.outputs)}
    made = []
    for k, columns in enumerate(rig.clean_recordings("cehA", role, seed=1, duration=15.0)):
        time = columns.pop("time")
        made.append(Record(time, columns, units, name=f"{role}_{k + 1}"))
    return tuple(made)


@cache
def cost_at_truth() -> float:
    return identify(MODEL, recordings("train"), windows=(), starts=1).cost


@pytest.mark.parametrize(
    "signs",
    [
        pytest.param((1, 0, 0, 0, 0, 0), id="gain high: drives into the end stop"),
        pytest.param((0, 0, -1, -1, 0, 0), id="volumes low: runs out of oil"),
        pytest.param((1, -1, 1, 1, -1, 1), id="soft oil", marks=pytest.mark.proof),
        pytest.param((-1, 1, -1, -1, 1, -1), id="stiff oil", marks=pytest.mark.proof),
    ],
)
def test_thirty_percent_off_still_ends_at_the_truth(signs):
    start = {name: value * (1 + 0.3 * sign) for (name, value), sign in zip(TRUTH.items(), signs, strict=True)}
    fit = identify(MODEL, recordings("train"), start=start, validate=recordings("validate"))
    assert fit.cost < 1.01 * cost_at_truth()
    for p in fit.parameters:
        assert abs(p.value - TRUTH[p.name]) < 4 * p.sigma, p
    noise = rig.sensor_noise("cehA")["arm_angle"]
    assert fit.rmse["validate"]["arm_angle"] < 1.05 * noise
    assert fit.chi2_per_dof == pytest.approx(1.0, abs=0.1)
