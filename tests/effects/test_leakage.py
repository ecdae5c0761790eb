"""Leaks and losses of pumps, held against what their equations say."""

from __future__ import annotations

import math

import numpy as np
import pytest

from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.components import PressureSource
from hydrotwin.models.effects import add_effect, candidates
from hydrotwin.models.effects.leakage import FillingLoss
from hydrotwin.models.effects.sites import low_pressure_node, open_tank_node
from hydrotwin.models.language import Model
from hydrotwin.models.language.places import Places
from tests.effects.benches import ValveBench, pump_bench, seen, valve_bench

PRESSURES = {"cylinder__cap_pressure": 5e6, "cylinder__rod_pressure": 1e6}


def change(model, effect, paths, speed=0.0, site=None, /, **values):
    """What an effect adds to variables of a model (SI), at 50 and 10 bar."""
    inputs = [0.0] * len(model.flat.inputs)
    state = dict(PRESSURES, **({"motor__speed": speed} if "motor.speed" in {s.name for s in model.flat.states} else {}))
    more = add_effect(model, effect, site, values)
    return seen(more, paths, inputs, **state) - seen(model, paths, inputs, **state)


CHAMBERS = ["cylinder.cap.q", "cylinder.annulus.q"]


def test_an_internal_leak_takes_from_the_high_pressure_what_it_gives_to_the_low_one():
    out, into = change(pump_bench(), "internal_leakage", CHAMBERS, conductance=1e-12)
    assert out == pytest.approx(-4e-6) and into == pytest.approx(4e-6)


def test_an_external_leak_takes_from_one_chamber_alone():
    model = pump_bench()
    out, into = change(model, "external_leakage", CHAMBERS, 0.0, "cylinder.cap", conductance=1e-12)
    assert out == pytest.approx(-5e-6) and into == 0


def with_tank(pressure):
    return valve_bench().with_parameters({"tank.pressure": pressure})


def test_an_external_leak_runs_to_an_open_tank():
    out, _ = change(with_tank(1e5), "external_leakage", CHAMBERS, 0.0, "cylinder.cap", conductance=1e-12)
    assert out == pytest.approx(-(5e6 - 1e5) * 1e-12)


def test_oil_leaves_the_machine_to_the_surroundings_and_gets_into_a_tank_under_pressure_within_it():
    for effect, site, against in (("external", "cylinder.cap", 0.0), ("internal", "cylinder.cap-tank.port", 5e5)):
        out, _ = change(with_tank(5e5), f"{effect}_leakage", CHAMBERS, 0.0, site, conductance=1e-12)
        assert out == pytest.approx(-(5e6 - against) * 1e-12)


def test_a_turbulent_leak_grows_with_the_root_of_the_pressure():
    out, into = change(pump_bench(), "turbulent_leakage", CHAMBERS, coefficient=1e-9)
    assert out == pytest.approx(-1e-9 * np.sqrt(4e6), rel=1e-3) and into == -out


def test_no_two_nodes_leak_under_two_names():
    for model in (cehA.model(), spool_valve.model(), pump_bench(), with_tank(0.0), with_tank(5e5)):
        inside = {frozenset(c.site.ties.values()) for c in candidates(model, ["internal_leakage"])}
        tank = open_tank_node(Places(model))
        outside = candidates(model, ["external_leakage"])
        assert len(inside) == len(candidates(model, ["internal_leakage"]))
        assert outside
        assert not any(tank and frozenset((c.site.ties["port"], tank.name)) in inside for c in outside)


def test_the_tank_is_the_lowest_prescribed_pressure_and_a_supply_alone_is_none():
    assert low_pressure_node(Places(valve_bench())).name in ("tank.port", "valve.tank")
    two_supplies = Model(ValveBench(tank=PressureSource(pressure=5e6)))
    assert low_pressure_node(Places(two_supplies)) is None
    assert low_pressure_node(Places(pump_bench())) is None


@pytest.mark.parametrize(("speed", "share"), [(0.0, 1.0), (100.0, 0.5), (-300.0, 0.25)])
def test_a_pump_slips_less_the_faster_it_turns(speed, share):
    out, into = change(pump_bench(), "pump_slip", CHAMBERS, speed, conductance=1e-12, reference_speed=100.0)
    assert out == pytest.approx(-4e-6 * share, rel=1e-6) and into == pytest.approx(-out)


@pytest.mark.parametrize("speed", [-200.0, 50.0, 200.0])
@pytest.mark.parametrize(("shape", "falls"), [(1.0, lambda s: 1 / (1 + s)), (2.0, lambda s: 4 / (2 + s) ** 2)])
def test_a_share_of_the_flow_is_lost_on_both_sides_of_the_pump_more_at_low_speed(speed, shape, falls):
    flows = change(pump_bench(), "speed_dependent_efficiency", CHAMBERS, speed, loss=0.2, shape=shape)
    share = 0.2 * falls(abs(speed) / 50.0)
    assert flows[0] == pytest.approx(-share * 2e-7 * speed, rel=1e-6)
    assert flows[1] == pytest.approx(share * 0.8 * 2e-7 * speed, rel=1e-6)


def test_a_steep_loss_is_nearly_an_exponential_of_the_speed():
    lost, _ = change(pump_bench(), "speed_dependent_efficiency", CHAMBERS, 50.0, loss=0.2, shape=20.0)
    assert -lost / (2e-7 * 50.0) == pytest.approx(0.2 * math.exp(-1), rel=0.03)


@pytest.mark.parametrize(("speed", "sign"), [(200.0, 1), (-200.0, -1)])
def test_a_pump_may_deliver_more_in_one_direction(speed, sign):
    flows = change(pump_bench(), "displacement_asymmetry", CHAMBERS, speed, asymmetry=0.1)
    assert flows[0] == pytest.approx(sign * 0.1 * 2e-7 * speed, rel=1e-6)
    assert flows[1] == pytest.approx(-sign * 0.1 * 0.8 * 2e-7 * speed, rel=1e-6)


@pytest.mark.parametrize(("speed", "n", "kept"), [(50, 1.0, 1 / 1.2), (200, 1.0, 1 / 1.8), (-200, 1.0, 1 / 1.8)])
def test_a_pump_that_fills_badly_delivers_the_less_of_its_flow_the_faster_it_turns(speed, n, kept):
    lost = change(pump_bench(), "filling_loss", CHAMBERS, speed, ratio=0.4, sharpness=n)
    assert lost == pytest.approx(np.array([-2e-7, 0.8 * 2e-7]) * speed * (1 - kept), rel=1e-9)


def test_chambers_that_fill_up_to_a_speed_deliver_no_more_beyond_it():
    def delivered(speed):
        return 2e-7 * speed + change(pump_bench(), "filling_loss", CHAMBERS, speed, ratio=0.5, sharpness=20.0)[0]

    assert delivered(100.0) == pytest.approx(2e-7 * 100.0, rel=1e-3)  # 200 rad/s is where it ends
    assert delivered(400.0) == pytest.approx(2e-7 * 200.0, rel=1e-3)
    assert delivered(800.0) == pytest.approx(2e-7 * 200.0, rel=1e-3)


def test_speeds_at_which_filling_may_end_are_among_the_highest_seen():
    probes = FillingLoss.probes_for({"w": np.linspace(-300.0, 300.0, 601)})
    assert all(200.0 < 100.0 / probe["ratio"] < 300.0 for probe in probes if probe["sharpness"] > 1)
    assert not FillingLoss.probes_for({"w": np.zeros(9)})


def test_a_displacement_is_freed_where_it_is_fixed_and_volumes_are_none():
    freed = [c.site.frees for c in candidates(pump_bench(), ["displacement_error"])]
    assert freed == ["pump.displacement"]
    assert [c.site.frees for c in candidates(valve_bench(), ["displacement_error"])] == [
        "valve.orifice.flow_coefficient"
    ]
    free = pump_bench().with_settings({"pump.displacement": {"free": True}})
    assert not candidates(free, ["displacement_error"])


def test_starts_of_a_freed_parameter_lie_around_what_is_stated():
    (found,) = candidates(pump_bench(), ["displacement_error"])
    assert [probe["pump.displacement"] for probe in found.probes] == pytest.approx([2.1e-7, 1.9e-7])
    assert found.typical["pump.displacement"] == pytest.approx((1.7e-7, 2.3e-7))
