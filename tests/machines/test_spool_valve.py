"""The spool valve: statics, speeds, frequency, and the quasi-static variant against the full model."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models import spool_valve
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests.components.bench import jacobian
from tests.machines.recordings import held

A_A, A_B, P_S, P_T, K, B, LOAD, MASS = 1.96e-3, 1.37e-3, 180e5, 5e5, 6e-8, 4000.0, 4000.0, 350.0
FREE = {"slide.natural_frequency", "slide.damping", "valve.orifice.flow_coefficient", "cylinder.oil.bulk_modulus",
        "cylinder.friction.viscous", "load.load_force"}  # fmt: skip
MODEL, QUASI = spool_valve.model(), spool_valve.quasi_static()


def steady_speed(x, load=LOAD):
    """Root of the force balance with the orifice pressures of both edges, by bisection; the load drives or holds."""

    def surplus(v):
        root = np.sign(v) * v**2 / (K * x) ** 2
        if x > 0:
            return (P_S - A_A**2 * root) * A_A - (P_T + A_B**2 * root) * A_B - load - B * v
        return (P_T - A_A**2 * root) * A_A - (P_S + A_B**2 * root) * A_B - load - B * v

    low, high = -2.0, 2.0
    for _ in range(80):
        middle = (low + high) / 2
        low, high = (middle, high) if surplus(middle) > 0 else (low, middle)
    return low


def end_speeds(current, load=LOAD):
    """Velocity of full and quasi-static model after four seconds of constant current."""
    at = 0.2 if current > 0 else 0.7
    record = held("spool_valve", 4.0, current)
    full = simulate(MODEL, record, start={"load.position": at}, parameters={"load.load_force": load})
    quasi = simulate(QUASI, record, start={"curve.stroke": at}, parameters={"curve.load_force": load})
    return full["velocity"][-1], quasi["velocity"][-1]


def test_the_model_has_the_signals_of_the_machine_and_its_six_free_parameters():
    flat = MODEL.flat
    assert [(i.name, i.unit) for i in flat.inputs] == [("current", "1")]
    assert [o.name for o in flat.outputs] == ["position", "spool", "pressure_a", "pressure_b", "velocity"]
    assert {p.name for p in flat.parameters if p.free} == FREE


def test_it_starts_at_rest_with_the_load_carried_by_chamber_a():
    x = dict(zip((s.name for s in MODEL.flat.states), MODEL.equilibrium(), strict=True))
    assert x["cylinder.rod_pressure"] == 60e5
    assert x["cylinder.cap_pressure"] == pytest.approx((LOAD + 60e5 * A_B) / A_A, rel=1e-12)
    y = simulate(MODEL, held("spool_valve", 5.0, 0.0))
    assert np.ptp(y["position"]) < 1e-12


def test_the_quasi_static_variant_has_the_same_values():
    full = {p.name: p.value for p in MODEL.flat.parameters}
    leaves = {"flow_coefficient": "valve.orifice.", "supply_pressure": "supply.pressure",
              "tank_pressure": "tank.pressure", "load_force": "load.", "viscous": "cylinder.friction.",
              "cap_area": "cylinder.", "rod_area": "cylinder."}  # fmt: skip
    for p in QUASI.flat.parameters:
        leaf = p.name.removeprefix("curve.")
        name = leaves[leaf] + leaf if leaf in leaves and leaves[leaf].endswith(".") else leaves.get(leaf, p.name)
        assert full[name] == p.value


@pytest.mark.parametrize("x", [1.0, 0.5, 0.2, -0.2, -0.5, -1.0])
def test_both_models_reach_the_speed_at_which_edges_and_load_balance(x):
    full, quasi = end_speeds(x)
    assert quasi == pytest.approx(steady_speed(x), rel=1e-9)
    assert full == pytest.approx(steady_speed(x), rel=1e-3)
    assert np.sign(full) == np.sign(x)


def test_the_speeds_out_and_in_differ_because_areas_and_load_do():
    assert steady_speed(1.0) == pytest.approx(0.1037, abs=1e-4)
    assert steady_speed(-1.0) == pytest.approx(-0.0986, abs=1e-4)


@pytest.mark.parametrize("x", [0.2, 0.05])
def test_a_load_beyond_the_supply_sinks_through_the_open_valve(x):
    """40 kN is more than 180 bar on the cap side carry: the oil goes back to the supply."""
    full, quasi = end_speeds(x, 40000.0)
    assert quasi == pytest.approx(steady_speed(x, 40000.0), rel=1e-9)
    assert full == pytest.approx(quasi, rel=2e-3)
    assert full < 0


def test_at_ten_hertz_a_slow_run_of_both_is_the_same_but_for_the_chambers_start():
    time = np.arange(601) / 10
    current = 0.5 * np.sin(2 * np.pi * 0.07 * time) + 0.25 * np.sin(2 * np.pi * 0.19 * time)
    record = Record(time, {"current": current}, {"current": "1"}, "slow")
    full, quasi = simulate(MODEL, record, start={"load.position": 0.45}), simulate(QUASI, record)
    assert np.ptp(full["position"]) > 0.2
    assert np.abs(full["position"] - quasi["position"]).max() < 0.02 * np.ptp(full["position"])
    assert np.sqrt(np.mean((full["velocity"] - quasi["velocity"]) ** 2)) < 0.03 * np.ptp(full["velocity"])


def test_the_load_rings_on_both_oil_columns_at_the_root_of_k_over_m():
    x, p = MODEL.equilibrium(), MODEL.flat.parameter_vector()
    poles = np.linalg.eigvals(jacobian(MODEL)(0, x, [0], p).full())
    V_a, V_b = 4e-4 + A_A * 0.45, 4e-4 + A_B * 0.45
    stiffness = 1e9 * (A_A**2 / V_a + A_B**2 / V_b)
    oil = [z for z in poles if z.imag > 0 and abs(abs(z) - 120) > 1e-6]
    assert len(oil) == 1
    assert abs(oil[0]) == pytest.approx(np.sqrt(stiffness / MASS), rel=1e-6)
    assert -2 * oil[0].real == pytest.approx(B / MASS, rel=1e-6)


def test_the_spool_is_a_second_order_lag_of_the_current():
    y = simulate(MODEL, held("spool_valve", 0.3, 0.6, rate=1000))
    t, D, w0 = y.time, 0.8, 120.0
    wd = w0 * np.sqrt(1 - D**2)
    step = 1 - np.exp(-D * w0 * t) * (np.cos(wd * t) + D * w0 / wd * np.sin(wd * t))
    assert y["spool"] == pytest.approx(0.6 * step, abs=1e-6)


def test_a_dead_time_delays_the_whole_machine():
    record = held("spool_valve", 1.0, 0.0)
    record = record.with_signals({"current": np.where(record.time >= 0.1 - 1e-9, 0.5, 0.0)})
    late = simulate(MODEL, record, parameters={"solenoid.dead_time": 0.1})
    prompt = simulate(MODEL, record)
    assert late["position"][20:] == pytest.approx(prompt["position"][:-20], abs=1e-9)
