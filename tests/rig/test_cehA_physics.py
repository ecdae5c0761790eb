"""Closed forms the C-EHA of the rig must obey."""

from __future__ import annotations

import numpy as np
import pytest

from tests import rig

P = rig.MACHINES["cehA"].parameters
BETA, A1, A2 = P["cylinder.oil.bulk_modulus"], P["cylinder.cap_area"], P["cylinder.rod_area"]
PIN, BASE, X0 = P["arm.pin_length"], P["arm.base_length"], P["arm.retracted_length"]
LENGTH, M1, M2, GRAVITY = P["arm.length"], P["arm.extra_mass"], P["arm.arm_mass"], 9.80665
FRICTIONLESS = {f"cylinder.friction.{name}": 0.0 for name in ("kinetic", "static", "viscous")}

KICK = {"external_push": {"force": 50.0, "start": 0.0, "end": 0.1}}


def geometry(theta):
    s = np.sqrt(PIN**2 + BASE**2 + 2 * PIN * BASE * np.sin(theta))
    return s - X0, PIN * BASE * np.cos(theta) / s


def stiffness(x, beta=BETA):
    v1, v2 = P["cylinder.cap_dead_volume"] + A1 * x, P["cylinder.rod_dead_volume"] - A2 * x
    return beta * (A1**2 / v1 + A2**2 / v2)


def ticks(duration, rate=1000):
    return np.arange(round(duration * rate) + 1) / rate


def still(duration, rate=1000, **options):
    time = ticks(duration, rate)
    return rig.record("cehA", np.zeros(len(time)), time, **options)


def ringing_frequency(run, after):
    """From the rising zero crossings of the piston force about its mean, interpolated."""
    keep = run["time"] > after
    t, f = run["time"][keep], run["piston_force"][keep]
    f = f - 0.5 * (f.max() + f.min())
    up = np.flatnonzero((f[:-1] < 0) & (f[1:] >= 0))
    crossings = t[up] - f[up] * (t[up + 1] - t[up]) / (f[up + 1] - f[up])
    return (len(crossings) - 1) / (crossings[-1] - crossings[0])


@pytest.mark.parametrize("start", [-0.25, 0.0, 0.5])
def test_the_arm_at_rest_stays_and_the_piston_carries_its_weight(start):
    run = still(1.0, start=start)
    _, lever = geometry(start)
    weight = (M1 + M2 / 2) * GRAVITY * LENGTH * np.cos(start) / lever
    assert np.ptp(run["arm_angle"]) < 1e-10
    assert run["piston_force"] == pytest.approx(np.full(1001, weight), rel=1e-9)
    assert run["pressure_rod"][0] == P["precharge"]


@pytest.mark.parametrize("start", [-0.2, 0.12, 0.5])
def test_the_pushed_arm_rings_at_the_hydraulic_frequency(start):
    run = still(1.5, 4000, start=start, parameters=FRICTIONLESS, effects=KICK)
    x, lever = geometry(start)
    mass = (M1 + M2 / 3) * LENGTH**2 / lever**2
    assert ringing_frequency(run, 0.1) == pytest.approx(np.sqrt(stiffness(x) / mass) / (2 * np.pi), rel=2e-3)


def test_the_frictionless_arm_rings_without_decay():
    run = still(4.0, 4000, parameters=FRICTIONLESS, effects=KICK)
    force = run["piston_force"][401:].reshape(4, -1)
    swings = np.ptp(force, axis=1)
    assert swings[-1] == pytest.approx(swings[0], rel=1e-3)
    assert swings[0] > 20


def test_the_motor_answers_a_step_as_a_first_order_lag_from_its_very_sample_on():
    time = ticks(0.4, 100)
    run = rig.record("cehA", np.where(time >= 0.1 - 1e-12, 2.0, 0.0), time)
    expected = np.where(time < 0.1, 0, 240 * -np.expm1(-np.maximum(time - 0.1, 0) / 0.03))
    assert run["motor_speed"] == pytest.approx(expected, abs=1e-8)


def test_the_rod_settles_at_pump_flow_over_area():
    time = ticks(1.2)
    run = rig.record("cehA", np.full(len(time), 1.5), time, parameters={"cylinder.friction.viscous": 2e4})
    v = np.gradient(run["rod_position"], time)[-200:-2].mean()
    assert v == pytest.approx(1.5 * 120 * 1.05e-7 / A1, rel=3e-4)


def test_work_in_is_energy_stored_plus_friction_heat():
    time, command = rig.drive("cehA", 6.0, 2000, seed=4)
    run = rig.record("cehA", command, time)
    theta, x, force = run["arm_angle"], run["rod_position"], run["piston_force"]
    v = np.gradient(x, time, edge_order=2)
    omega = np.gradient(theta, time, edge_order=2)
    work = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(x))
    kinetic = 0.5 * (M1 + M2 / 3) * LENGTH**2 * (omega[-1] ** 2 - omega[0] ** 2)
    potential = (M1 + M2 / 2) * GRAVITY * LENGTH * (np.sin(theta[-1]) - np.sin(theta[0]))
    dry = 1.87 + (13.15 - 1.87) * np.exp(-((v / 0.0028) ** 2))
    heat = np.trapezoid((dry * np.tanh(v / 1e-3) + 741.36 * v) * v, time)
    assert heat > 1.0
    assert work == pytest.approx(kinetic + potential + heat, abs=0.002 * heat + 1e-3)


def test_an_internal_leak_creeps_at_the_rate_of_the_closed_form():
    conductance = 1e-14
    run = still(2.0, 100, effects={"internal_leakage": {"conductance": conductance}})
    x, _ = geometry(run["arm_angle"][0])
    a, b = P["cylinder.cap_dead_volume"] + A1 * x, P["cylinder.rod_dead_volume"] - A2 * x
    drop = run["pressure_cap"][0] - run["pressure_rod"][0]
    expected = -conductance * drop * (A1 / a + A2 / b) / (A1**2 / a + A2**2 / b)
    creep = (run["rod_position"][-1] - run["rod_position"][100]) / 1.0
    assert creep == pytest.approx(expected, rel=0.02)


def test_droop_slows_the_loaded_motor_by_its_torque():
    time = ticks(1.0)
    run = rig.record("cehA", np.full(len(time), 1.0), time, effects={"motor_droop": {"resistance": 40.0}})
    torque = 1.05e-7 * (run["pressure_cap"] - A2 / A1 * run["pressure_rod"])
    assert run["motor_speed"][-300:].mean() == pytest.approx(120 - 40 * torque[-300:].mean(), rel=1e-3)


def test_the_pin_stretches_by_force_over_stiffness():
    run = still(0.5, effects={"structural_compliance": {"stiffness": 5e6}})
    x, _ = geometry(run["arm_angle"])
    assert run["rod_position"] - x == pytest.approx(run["piston_force"] / 5e6, rel=1e-6)


def test_behind_a_pin_that_gives_all_that_moves_weighs_what_is_stated():
    pin = {"structural_compliance": {"stiffness": 1e9, "damping": 0.0}}
    run = still(1.5, 4000, parameters=FRICTIONLESS, effects={**KICK, **pin})
    _, lever = geometry(run["arm_angle"][0])
    mass = (M1 + M2 / 3) * LENGTH**2 / lever**2
    in_series = 1 / (1 / stiffness(run["rod_position"][0]) + 1 / 1e9)
    assert ringing_frequency(run, 0.1) == pytest.approx(np.sqrt(in_series / mass) / (2 * np.pi), rel=1.5e-3)


def test_the_end_stop_carries_what_the_pump_pushes():
    time = ticks(2.0)
    stop = {"end_stop": {"low": -0.03, "high": 0.03, "stiffness": 5e7, "damping": 20.0}}
    run = rig.record("cehA", np.where(time < 0.6, 1.5, 0.0), time, effects=stop)
    x, lever = geometry(run["arm_angle"][-1])
    weight = (M1 + M2 / 2) * GRAVITY * LENGTH * np.cos(run["arm_angle"][-1]) / lever
    assert x > 0.03
    assert run["piston_force"][-1] - weight == pytest.approx(5e7 * (x - 0.03), rel=2e-2)


def test_entrained_air_lowers_the_frequency_as_the_mixture_does():
    share, n, p0 = 0.01, 1.3, 101325.0
    air = {"entrained_air": {"fraction": share, "exponent": n}}
    run = still(1.5, 4000, parameters=FRICTIONLESS, effects={**KICK, **air})
    x, lever = geometry(run["arm_angle"][0])

    def beta(p):
        gas = share * (p0 / p) ** (1 / n)
        liquid = (1 - share) * np.exp(-(p - p0) / BETA)
        return (gas + liquid) / (liquid / BETA + gas / (n * p))

    v1, v2 = P["cylinder.cap_dead_volume"] + A1 * x, P["cylinder.rod_dead_volume"] - A2 * x
    k = beta(run["pressure_cap"][0]) * A1**2 / v1 + beta(run["pressure_rod"][0]) * A2**2 / v2
    mass = (M1 + M2 / 3) * LENGTH**2 / lever**2
    assert beta(run["pressure_rod"][0]) < 0.6 * BETA
    assert ringing_frequency(run, 0.1) == pytest.approx(np.sqrt(k / mass) / (2 * np.pi), rel=1e-2)
