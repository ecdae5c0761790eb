"""Solenoid, spool and four metering edges."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.components import FourEdgeValve, ProportionalSolenoid, Spool
from hydrotwin.models.laws import OverlappedEdge
from tests.components.bench import at, bench, run

P = dict(supply=180e5, tank=5e5, a=80e5, b=60e5)
TIME = np.linspace(0, 0.3, 301)


def valve_bench(**changes):
    return bench(FourEdgeValve(**changes), supply="potential", tank="potential", a="potential", b="potential")


def test_the_solenoid_scales_shifts_and_delays_its_current():
    model = bench(ProportionalSolenoid(gain=0.9, offset=0.05, dead_time=0.05))
    y = run(model, TIME, current=np.where(TIME >= 0.1 - 1e-12, 1.0, 0.0))["target"]
    assert y == pytest.approx(np.where(TIME >= 0.15 - 1e-9, 0.95, 0.05), abs=1e-12)


def test_a_spool_overshoots_by_exp_of_minus_pi_d_over_root_1_minus_d_squared():
    model = bench(Spool(natural_frequency=120.0, damping=0.3))
    x = run(model, TIME, target=0.5)["displacement"]
    assert x.max() / 0.5 - 1 == pytest.approx(np.exp(-np.pi * 0.3 / np.sqrt(1 - 0.09)), abs=1e-3)
    assert x[-1] == pytest.approx(0.5, abs=1e-4)


def test_a_spool_follows_the_second_order_step_response():
    w0, D = 120.0, 0.8
    wd = w0 * np.sqrt(1 - D**2)
    x = run(bench(Spool()), TIME, target=1.0)["displacement"]
    step = 1 - np.exp(-D * w0 * TIME) * (np.cos(wd * TIME) + D * w0 / wd * np.sin(wd * TIME))
    assert x == pytest.approx(step, abs=1e-5)


@pytest.mark.parametrize("x", [0.3, -0.3])
@pytest.mark.parametrize(("a", "b"), [(80e5, 60e5), (200e5, 60e5), (80e5, 1e5), (200e5, 200e5)])
def test_oil_flows_from_high_to_low_pressure_through_the_open_edges(x, a, b):
    """All four quadrants: spool both ways, work ports above the supply and below the tank."""

    def q(dp):
        return 6e-8 * abs(x) * np.sqrt(abs(dp)) * np.sign(dp)

    y = at(valve_bench(), spool=x, **P | {"a": a, "b": b})
    p_s, p_t = P["supply"], P["tank"]
    to_a, from_b = (q(p_s - a), q(b - p_t)) if x > 0 else (-q(a - p_t), -q(p_s - b))
    assert y["a_q"] == pytest.approx(-to_a, rel=1e-3)
    assert y["b_q"] == pytest.approx(from_b, rel=1e-3)
    assert y["supply_q"] == pytest.approx(to_a if x > 0 else -from_b, rel=1e-3)


@pytest.mark.parametrize("x", [-1.0, -0.2, 0.0, 0.02, 0.7])
def test_a_valve_keeps_its_oil_and_only_throttles(x):
    y = at(valve_bench(supply_to_a=OverlappedEdge(overlap=-0.1)), spool=x, **P)
    flows = np.array([y[f"{port}_q"] for port in P])
    assert flows.sum() == pytest.approx(0, abs=1e-18)
    assert np.dot(flows, list(P.values())) >= 0


def test_a_centred_critical_valve_is_shut_and_an_overlapped_one_stays_shut_to_its_overlap():
    edges = {name: OverlappedEdge(overlap=0.1) for name in ("supply_to_a", "supply_to_b", "a_to_tank", "b_to_tank")}
    for model, x in ((valve_bench(), 0.0), (valve_bench(**edges), 0.09), (valve_bench(**edges), -0.09)):
        y = at(model, spool=x, **P)
        assert all(y[f"{port}_q"] == 0 for port in P)
    opened = at(valve_bench(**edges), spool=0.3, **P)["a_q"]
    assert opened == pytest.approx(at(valve_bench(), spool=0.2, **P)["a_q"], rel=1e-12)


def test_an_open_centre_leaks_from_supply_through_both_work_ports():
    edges = {name: OverlappedEdge(overlap=-0.1) for name in ("supply_to_a", "supply_to_b", "a_to_tank", "b_to_tank")}
    y = at(valve_bench(**edges), spool=0.0, **P)
    assert y["supply_q"] == pytest.approx(6e-9 * (np.sqrt(100e5) + np.sqrt(120e5)), rel=1e-5)
    assert y["tank_q"] == pytest.approx(-6e-9 * (np.sqrt(75e5) + np.sqrt(55e5)), rel=1e-5)
