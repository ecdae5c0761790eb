"""Held inputs that come late and act together, beside the closed form: runs, their derivatives, lanes, blocks, FMUs."""

import itertools

import casadi as ca
import numpy as np
import pytest

from hydrotwin.export import export_fmu, read_fmu
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import lower, prepare, simulate
from hydrotwin.simulation.many import run_many

from .small_models import small_model

RATE = 3.0  # 1/s
TIME = np.arange(0.0, 1.0, 0.02)
U = np.random.default_rng(1).normal(size=(len(TIME), 3))
DEAD = {"Td": 0.0137, "Tv": 0.0306}


def mixed(step):
    """x' = rate (u w + v^2 - x); u and w come late by Td, v by Tv."""

    def equations(t, x, u, p):
        return p[2] * (u[0] * u[1] + u[2] ** 2 - x[0]), x

    late = {"u": "Td", "w": "Td", "v": "Tv"}
    inputs = tuple(Signal(name, "1", interpolation="hold", dead_time=dead) for name, dead in late.items())
    return small_model("mixed", ["x"], DEAD | {"rate": RATE}, equations, inputs=inputs, step=step)


def closed(Td, Tv):
    """x (n,) at the samples: exponentials from one jump to the next."""
    corners = np.unique(np.concatenate([TIME, TIME + Td, TIME + Tv]))
    x, found = 0.0, [0.0]
    for a, b in itertools.pairwise(corners[corners <= TIME[-1]]):
        now, then = (U[np.searchsorted(TIME, 0.5 * (a + b) - dead, side="right").clip(1) - 1] for dead in (Td, Tv))
        target = now[0] * now[1] + then[2] ** 2
        x = target + (x - target) * np.exp(-RATE * (b - a))
        if b in TIME:
            found.append(x)
    return np.array(found)


def record():
    return Record(TIME, dict(zip("uwv", U.T, strict=True)), dict.fromkeys("uwv", "1"))


@pytest.mark.parametrize("method", ["explicit", "implicit", "vm"])
@pytest.mark.parametrize("step", [5e-4, 5e-3, 2e-2])
def test_runs_and_their_derivatives_are_those_of_the_closed_form_whatever_the_step(method, step):
    model = mixed(step)
    propagator, p = prepare(model, free_parameters=("Td", "Tv"), method=method), model.parameter_vector()
    x, dx, _, _ = propagator.sensitivity(TIME, U, p, np.zeros(1), np.zeros((1, 2)))
    assert x[:, 0] == pytest.approx(closed(**DEAD), abs=1e-6)
    assert propagator.run(TIME, U, p, np.zeros(1))[0][:, 0] == pytest.approx(closed(**DEAD), abs=1e-6)
    for column, name in enumerate(DEAD):
        later, sooner = (closed(**DEAD | {name: DEAD[name] + d}) for d in (1e-6, -1e-6))
        assert dx[:, 0, column] == pytest.approx((later - sooner) / 2e-6, abs=1e-5 * np.abs(dx[:, 0, column]).max())


def test_lanes_with_dead_times_of_their_own_are_those_of_the_closed_form():
    model = mixed(5e-3)
    Td = np.linspace(0.0, 0.05, 19)
    p = np.column_stack([Td, Td[::-1], np.full(19, RATE)])
    y, stops = run_many(prepare(model, method="explicit"), TIME, U, p, np.zeros((19, 1)))
    assert stops == [None] * 19
    for found, one in zip(y, p, strict=True):
        assert found[:, 0] == pytest.approx(closed(one[0], one[1]), abs=1e-6)


@pytest.mark.parametrize("method", ["explicit", "implicit"])
def test_a_block_and_its_derivative_to_a_dead_time(method):
    block = lower(mixed(5e-3), period=0.02, method=method)
    assert simulate(block, record())["x_seen"] == pytest.approx(closed(**DEAD), abs=1e-6)
    p, z, u = ca.MX.sym("p", 3), ca.MX.sym("z", len(block.states)), ca.MX.sym("u", 3)
    slope = ca.Function("slope", [z, u, p], [ca.jacobian(block.step(z, u, p)[0][0], p)])
    after = ca.Function("after", [z, u, p], [block.step(z, u, p)[0][0]])
    now, past, late = U[7], np.random.default_rng(2).normal(size=len(block.states)), np.array([*DEAD.values(), RATE])
    for k in range(2):
        moved = 1e-6 * np.eye(3)[k]
        difference = (float(after(past, now, late + moved)) - float(after(past, now, late - moved))) / 2e-6
        assert float(slope(past, now, late)[k]) == pytest.approx(difference, rel=1e-5, abs=1e-8)


def test_an_fmu_is_that_of_the_closed_form(tmp_path):
    block = read_fmu(export_fmu(mixed(5e-3), tmp_path / "mixed.fmu"))
    assert block.free_run(record())["x_seen"] == pytest.approx(closed(**DEAD), abs=1e-6)
