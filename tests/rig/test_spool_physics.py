"""Closed forms the valve-driven cylinder of the rig must obey."""

from __future__ import annotations

import numpy as np
import pytest

from tests import rig

P = rig.MACHINES["spool_valve"].parameters
BETA, AA, AB = P["cylinder.oil.bulk_modulus"], P["cylinder.cap_area"], P["cylinder.rod_area"]
KQ, PS, PT, LOAD = P["valve.orifice.flow_coefficient"], P["supply.pressure"], P["tank.pressure"], P["load.load_force"]
KICK = {"external_push": {"force": 300.0, "start": 0.0, "end": 0.05}}


def spring(x):
    return BETA * (AA**2 / (4e-4 + AA * x) + AB**2 / (4e-4 + AB * (0.9 - x)))


def run_of(command, time, **options):
    return rig.record("spool_valve", np.broadcast_to(command, time.shape), time, **options)


def ticks(duration, rate=1000):
    return np.arange(round(duration * rate) + 1) / rate


def test_the_closed_valve_holds_the_load():
    run = run_of(0.0, ticks(1.0))
    assert np.ptp(run["position"]) < 1e-12
    assert run["pressure_a"] * AA - run["pressure_b"] * AB == pytest.approx(np.full(1001, LOAD), rel=1e-9)


@pytest.mark.parametrize("joint", [np.inf, 1e9])
@pytest.mark.parametrize("start", [0.2, 0.45, 0.7])
def test_behind_the_closed_valve_the_mass_rings_on_the_oil_spring(start, joint):
    gives = {} if np.isinf(joint) else {"structural_compliance": {"stiffness": joint, "damping": 0.0}}
    frictionless = {"cylinder.friction.viscous": 0.0}
    run = run_of(0.0, ticks(4.0), start=start, parameters=frictionless, effects={**KICK, **gives})
    v, t = run["velocity"][100:], run["time"][100:]
    up = np.flatnonzero((v[:-1] < 0) & (v[1:] >= 0))
    crossings = t[up] - v[up] * 1e-3 / (v[up + 1] - v[up])
    frequency = (len(crossings) - 1) / (crossings[-1] - crossings[0])
    in_series = 1 / (1 / spring(start) + 1 / joint)
    assert frequency == pytest.approx(np.sqrt(in_series / 350) / (2 * np.pi), rel=2e-3)
    assert np.ptp(v[-300:]) == pytest.approx(np.ptp(v[:300]), rel=1e-3)


def test_coulomb_friction_takes_the_same_bite_from_every_swing():
    force = 10.0
    run = run_of(
        0.0,
        ticks(6.0, 4000),
        parameters={"cylinder.friction.viscous": 0.0},
        effects={**KICK, "coulomb_friction": {"force": force}},
    )
    x = run["position"][np.flatnonzero(run["time"] > 0.06)]
    turns = np.flatnonzero(np.diff(np.sign(np.diff(x))) != 0) + 1
    swings = np.abs(np.diff(x[turns]))
    bites = -np.diff(swings[:5])
    assert bites == pytest.approx(np.full(4, 4 * force / spring(0.45)), rel=0.03)


def test_after_its_last_swing_the_mass_is_stuck_exactly():
    run = run_of(0.0, ticks(6.0), effects={**KICK, "coulomb_friction": {"force": 60.0}})
    assert np.all(run["velocity"][-1000:] == 0)
    assert np.ptp(run["position"][-1000:]) == 0
    assert np.max(np.abs(run["velocity"])) > 1e-3


def test_a_push_below_friction_moves_nothing_and_one_above_it_does():
    def pushed(force):
        push = {"force": force, "start": 0.1, "end": 1.0}
        return run_of(0.0, ticks(1.0), effects={"external_push": push, "coulomb_friction": {"force": 100.0}})

    still, moved = pushed(99.0), pushed(101.0)
    assert np.ptp(still["position"]) == 0
    assert np.ptp(moved["position"]) > 1e-7


@pytest.mark.parametrize("current", [0.5, -0.5])
def test_steady_speed_is_the_metered_flow_over_the_area(current):
    run = run_of(current, ticks(1.5), parameters={"cylinder.friction.viscous": 2e4})
    v, a, b = (run[name][-100:].mean() for name in ("velocity", "pressure_a", "pressure_b"))
    into_a = KQ * current * np.sqrt(PS - a if current > 0 else a - PT)
    out_of_b = KQ * current * np.sqrt(b - PT if current > 0 else PS - b)
    assert AA * v == pytest.approx(into_a, rel=5e-3)
    assert AB * v == pytest.approx(out_of_b, rel=5e-3)
    assert a * AA - b * AB == pytest.approx(LOAD + 2e4 * v, rel=5e-3)


def test_the_spool_answers_a_step_as_a_second_order_lag_from_its_very_sample_on():
    time = ticks(0.3, 100)
    run = run_of(np.where(time >= 0.05 - 1e-12, 0.3, 0.0), time)
    t, wn, zeta = np.maximum(time - 0.05, 0), 120.0, 0.8
    wd = wn * np.sqrt(1 - zeta**2)
    answer = 1 - np.exp(-zeta * wn * t) * (np.cos(wd * t) + zeta * wn / wd * np.sin(wd * t))
    assert run["spool"] == pytest.approx(0.3 * answer, abs=1e-8)


def test_within_the_overlap_nothing_moves_and_beyond_it_the_flow_starts():
    time = ticks(0.5)
    inside = run_of(0.03, time, effects={"valve_overlap": {"share": 0.05}})
    beyond = run_of(0.15, time, effects={"valve_overlap": {"share": 0.05}})
    plain = run_of(0.10, time)
    assert np.ptp(inside["position"]) < 1e-12
    assert beyond["velocity"][-50:].mean() == pytest.approx(plain["velocity"][-50:].mean(), rel=1e-3)


def test_supply_droop_lowers_the_supply_by_resistance_times_flow():
    resistance, time = 2e10, ticks(1.5)
    droop = {"supply_droop": {"resistance": resistance}}
    run = run_of(0.8, time, parameters={"cylinder.friction.viscous": 2e4}, effects=droop)
    flow = AA * run["velocity"][-100:].mean()
    expected = KQ * 0.8 * np.sqrt(PS - resistance * flow - run["pressure_a"][-100:].mean())
    assert flow == pytest.approx(expected, rel=5e-3)


def test_bristles_hold_elastically_before_they_slide():
    push = {"external_push": {"force": 40.0, "start": 0.0, "end": 9.0}}
    bristle = {"presliding_friction": {"stiffness": 5e6, "damping": 2e4, "kinetic": 4e4, "static": 5e4}}
    run = run_of(0.0, ticks(3.0), effects={**push, **bristle})
    moved = run["position"][0] - run["position"][-1]
    assert moved == pytest.approx(40.0 / (5e6 + spring(0.45)), rel=0.01)
