"""Responses to first order: of linear effects what a machine does; from a bent base they put effects in order."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.discovery.fits.response import Responses, stretch_of
from hydrotwin.discovery.structures.foreseen import foreseen
from hydrotwin.identification.problem import Recording
from hydrotwin.models.effects import candidates
from hydrotwin.models.language import Model
from hydrotwin.simulation import prepare
from tests.discovery.slides import Drive, begun, records

TIME = np.arange(0.0, 20.0, 0.02)
COMMAND = np.sign(np.sin(1.3 * TIME))[:, None] + 0.5 * np.sin(5 * TIME)[:, None]
EFFECTS = ("null_bias", "actuator_lag", "dead_time", "sensor_lag", "command_deadband", "sensor_drift")


def run(model, p):
    return prepare(model.flat, step=1e-3).run(TIME, COMMAND, p, np.zeros(len(model.flat.states)))


def drive_with(effect, size):
    """The drive with an effect of a size: its model, its parameters with and without it, what it measures."""
    one = next(c for c in candidates(Model(Drive()), [effect]))
    model = Model(Drive()).plus([one.addition])
    name = one.free[0]
    p, without = (model.flat.parameter_vector({**one.neutral, name: v}) for v in (size, one.neutral[name]))
    return model, p, without, run(model, p)[0]


def along(y, free=()):
    """Responses of the plain drive along its runs, where something else was measured, and where."""
    flat = Model(Drive()).flat
    p, propagator, whole = flat.parameter_vector(), prepare(flat, step=1e-3), Recording("whole", None, TIME, COMMAND, y)
    states = run(Model(Drive()), p)[1]
    size = np.sqrt(np.mean((y - states) ** 2, axis=0))

    def part_of(part, x0):
        return propagator.run(TIME[part], COMMAND[part], p, x0)

    return Responses(flat, p, free, [stretch_of(whole, states, part_of, size, 20.0, 1500)], size)


@pytest.mark.parametrize(
    ("effect", "size", "share"),
    [("null_bias", 0.3, 1e-6), ("sensor_lag", 0.05, 1e-2), ("actuator_lag", 0.05, 1e-2), ("dead_time", 0.05, 1e-2)],
)
def test_what_an_effect_does_is_left_by_none_but_its_own_response(effect, size, share):
    measured = drive_with(effect, size)[3]
    responses = along(measured)
    shares = {}
    for other, value in (("null_bias", 0.3), ("command_deadband", 0.1), ("dead_time", 0.05), (effect, size)):
        model, p, _, _ = drive_with(other, value)
        shares[other] = responses.promises([responses.of(model.flat, p[None])])[0].left
    assert shares[effect] < share
    assert min(shares, key=shares.get) == effect


def test_base_parameters_explain_their_part_first():
    """A wrong gain and a bias: what the bias leaves is the gain's, until that is free."""
    model, *_ = drive_with("null_bias", 0.3)
    both = model.flat.parameter_vector({"gain": 8.8, model.flat.parameters[-1].name: 0.03})
    measured, with_bias = run(model, both)[0], drive_with("null_bias", 0.03)[1]
    shares = []
    for free in ((), ("gain",)):
        responses = along(measured, free)
        shares.append(responses.promises([responses.of(model.flat, with_bias[None])])[0].left)
    assert shares[1] < 1e-3 < 0.3 < shares[0]


def test_the_stretch_is_where_most_is_left_and_no_longer_than_told():
    left = np.where((TIME > 12) & (TIME < 13), 1.0, 1e-3)[:, None]
    whole = Recording("whole", None, TIME, COMMAND, left)

    def still(part, x0):
        return np.zeros((len(TIME[part]), 1)), np.zeros((len(TIME[part]), 1))

    part = stretch_of(whole, np.zeros((len(TIME), 1)), still, np.ones(1), 0.0, 200)
    assert part.time[0, 0] < 12.1 and part.time[-1, -1] > 12.9 and part.left.size <= 200
    coarse = stretch_of(whole, np.zeros((len(TIME), 1)), still, np.ones(1), 15.0, 200)
    assert coarse.left.size <= 200 and coarse.time[-1, -1] - coarse.time[0, 0] > 14.0


def test_from_a_bent_base_dry_friction_stands_before_what_it_is_not():
    search = begun(records(3, dry=60.0), ("coulomb_friction", "null_bias", "dead_time", "sensor_scale"))
    base = search.identify()
    shares = foreseen(search.table, search.jobs, base)
    assert len(shares) == len(search.table.candidates)
    assert min(shares, key=lambda label: shares[label].left).startswith("coulomb_friction")
