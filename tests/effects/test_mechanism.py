"""Masses, lengths, loads, stops and joints against trigonometry and Newton's laws."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.identification import identify
from hydrotwin.models import cehA
from hydrotwin.models.effects import add_effect, candidates
from hydrotwin.models.effects.mechanism import Backlash, ConstantLoad, EndStop, StructuralCompliance
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from tests.components.bench import at, bench, observed, run
from tests.effects import benches


def sites(effect, model):
    return {c.site.name for c in candidates(model, [effect])}


def test_lengths_of_the_linkage_are_found_and_positions_are_not():
    assert sites("linkage_error", cehA.model()) == {
        "arm.length",
        "arm.pin_length",
        "arm.retracted_length",
        "arm.base_length",
    }
    assert not candidates(benches.pump_bench(), ["linkage_error"])


def test_masses_and_areas_become_free_where_they_stand():
    assert sites("payload_error", cehA.model()) == {"arm.extra_mass", "arm.arm_mass"}
    assert sites("area_error", benches.pump_bench()) == {"cylinder.cap_area", "cylinder.rod_area"}
    (found,) = candidates(benches.axis(), ["payload_error"])
    freed = benches.axis().plus([found.addition]).flat
    assert [(p.name, p.value) for p in freed.parameters if p.free] == [("carriage.mass", 500.0)]
    assert [p["carriage.mass"] for p in found.probes] == pytest.approx([600.0, 400.0])


def test_a_constant_load_pushes_towards_smaller_positions_at_any_speed():
    for v in (-0.1, 0.0, 0.1):
        y = at(bench(ConstantLoad(force=70.0), flange="potential"), {"flange_end.place": 0.0, "flange_end.speed": v})
        assert y["flange_f"] == 70.0
    time = np.linspace(0, 1, 11)
    y = run(add_effect(benches.axis(), "constant_load", values={"force": 50.0}), time, force=50.0)
    assert np.allclose(y["position"], 0.0, atol=1e-12)


@pytest.mark.parametrize("theta", (-0.4, 0.1, 0.6))
def test_a_tilted_base_turns_gravity(theta):
    model, tilt = cehA.model(), 0.01
    p = {q.name: q.value for q in model.flat.parameters}
    weight = (p["arm.extra_mass"] + p["arm.arm_mass"] / 2) * p["arm.gravity"] * p["arm.length"]
    inertia = (p["arm.extra_mass"] + p["arm.arm_mass"] / 3) * p["arm.length"] ** 2
    tilted = add_effect(model, "gravity_tilt", values={"rate": weight / inertia * tilt})
    states = {"arm.angle": theta, "cylinder.cap_pressure": 2e6}
    straight, turned = (at(m, states)["der(arm.angular_velocity)"] for m in (model, tilted))
    expected = weight / inertia * (np.cos(theta) - np.cos(theta + tilt))
    assert turned - straight == pytest.approx(expected, rel=0.06)  # the tilt is small, not zero


def test_a_slide_has_no_angle_to_tilt():
    assert not candidates(benches.axis(), ["gravity_tilt"])


def test_a_pushed_mass_comes_to_rest_at_the_stop():
    model = add_effect(benches.axis(), "end_stop", values={"high": 0.05})
    y = run(model, np.linspace(0, 10, 1001), force=100.0)
    assert y["position"][-1] == pytest.approx(0.05 + 100.0 / 2e7, abs=1e-7)
    assert y["position"].max() < 0.0505
    y = run(add_effect(benches.axis(), "end_stop", values={"low": -0.05}), np.linspace(0, 10, 1001), force=-100.0)
    assert y["position"][-1] == pytest.approx(-0.05 - 100.0 / 2e7, abs=1e-7)


def test_a_stop_returns_less_speed_than_it_was_given():
    model = add_effect(benches.axis(), "end_stop", values={"high": 0.02}).with_parameters(
        {"carriage.friction.viscous": 0.0}
    )
    y = run(model, np.linspace(0, 0.5, 501), start={"carriage.velocity": 0.1})
    assert -0.1 < y["velocity"][-1] < 0.0
    assert np.max(np.abs(y["velocity"])) <= 0.1 + 1e-9


def test_how_hard_a_stop_is_comes_out_of_a_fit():
    truth = {"end_stop.high": 0.008, "end_stop.stiffness": 4e5, "end_stop.damping": 3.0}
    (stop,) = candidates(benches.axis(), ["end_stop"])
    assert truth.keys() <= set(stop.free)
    model, time = benches.axis().plus([stop.addition]), np.linspace(0, 1.0, 501)
    force = 60.0 * np.sign(np.sin(7 * time))
    truly = simulate(model.with_parameters(truth), Record(time, {"force": force}, {"force": "N"}))
    record = Record(time, {"force": force, "position": truly["position"]}, {"force": "N", "position": "m"})
    assert record["position"].max() > 0.0081
    fit = identify(model, [record], free=list(truth), start={"end_stop.high": 0.0081}, noise={"position": 1e-7})
    assert {p.name: p.value for p in fit.parameters} == pytest.approx(truth, rel=0.01)


@pytest.mark.parametrize("v", (-1.0, -0.05, 0.0, 0.05, 1.0))
@pytest.mark.parametrize("s", (-0.11, 0.0, 0.21))
def test_a_stop_never_pulls(s, v):
    y = at(bench(EndStop(low=-0.1, high=0.2), flange="potential"), {"flange_end.place": s, "flange_end.speed": v})
    assert y["flange_f"] * (1 if s > 0.1 else -1) >= 0
    assert (y["flange_f"] == 0) == (s == 0.0 or (s > 0.1 and v <= -0.1) or (s < -0.1 and v >= 0.1))


def test_stops_are_looked_for_inside_the_positions_seen_and_no_end_where_nothing_reaches_it():
    probes = EndStop.probes_for({"flange.s": np.linspace(0.1, 0.5, 1001)})
    assert all(0.1 < probe["low"] < probe["high"] < 0.5 for probe in probes)
    deepest = 0.5 - min(probe["high"] for probe in probes), max(probe["low"] for probe in probes) - 0.1
    assert deepest == pytest.approx((0.04, 0.04))


@pytest.mark.parametrize("force", (-500.0, 300.0, 2000.0))
def test_a_compliant_joint_gives_in_proportion_to_force(force):
    model = bench(StructuralCompliance(compliance=1e-6), a="flow", b="potential")
    y = run(model, np.linspace(0, 0.1, 101), a=force)
    assert y["a_s"][-1] - y["b_s"][-1] == pytest.approx(1e-6 * force, rel=1e-6)
    assert y["b_f"][-1] == pytest.approx(-force)


def test_a_damped_joint_creeps_to_where_its_spring_ends():
    """A spring of 1e6 N/m beside a damper of 2e4 N.s/m, 20 ms; the step of force takes one sample."""
    model = bench(StructuralCompliance(compliance=1e-6, relaxation=0.02), a="flow", b="potential")
    time = np.linspace(0, 0.2, 2001)
    y = run(model, time, a=np.where(time < 0.05, 0.0, 1000.0))
    expected = 1e-3 * (1 - np.exp(-np.maximum(time - 0.05, 0) / 0.02))
    np.testing.assert_allclose(y["a_s"] - y["b_s"], expected, atol=0.04e-3)  # while the lags of 0.5 ms begin


@pytest.mark.parametrize("relaxation", [0.0, 2e-4, 7.5e-4, 1e-3, 3e-3])
def test_a_joint_loses_no_more_at_twenty_hertz_than_its_damper(relaxation):
    """Steel loses little: the lags that keep a loop away, one millisecond together, are not to damp it."""
    model = bench(StructuralCompliance(compliance=1e-6, relaxation=relaxation), a="flow", b="potential")
    period, turn = 1e-4, 2 * np.pi * 20.0
    time = period * np.arange(2501)
    y = run(model, time, a=1000.0 * np.sin(turn * time))
    wave = np.exp(-1j * turn * time[500:2500])  # four periods, after what began
    force = np.sum(1000.0 * np.sin(turn * (time[500:2500] - period / 2)) * wave)  # held: half a sample late
    ratio = np.sum((y["a_s"] - y["b_s"])[500:2500] * wave) / force
    assert ratio == pytest.approx(1e-6 / (1 + 1j * turn * relaxation), rel=0.025)


@pytest.mark.parametrize("relaxation", np.linspace(0.0, 1.2e-3, 7))
def test_what_takes_back_the_lags_of_a_joint_never_drives_it(relaxation):
    """Work is lost in every cycle at every frequency: the deflection lags the force, Im x/F < 0."""
    flat = bench(StructuralCompliance(compliance=1e-6, relaxation=relaxation), a="flow", b="potential").flat
    unit, p = np.eye(len(flat.states)), flat.parameter_vector()
    pushed = [float(i.name == "a") for i in flat.inputs]
    columns = [flat.ode(0.0, x, np.zeros(len(pushed)), p) for x in unit]
    rates, outputs = (np.column_stack([np.array(c[k]).ravel() for c in columns]) for k in (0, 1))
    forced = np.array(flat.ode(0.0, np.zeros(len(unit)), pushed, p)[0]).ravel()
    names = [o.name for o in flat.outputs]
    stretch = outputs[names.index("a_s")] - outputs[names.index("b_s")]
    for turn in np.logspace(1, 5, 60):
        assert (stretch @ np.linalg.solve(1j * turn * unit - rates, forced)).imag < 0


def test_a_joint_with_play_jumps_where_the_force_changes_sign():
    model = bench(Backlash(gap=1e-3), a="flow", b="potential")
    time = np.linspace(0, 2, 401)
    y = run(model, time, a=2000 * np.cos(np.pi * time))
    offset = y["a_s"] - y["b_s"]
    assert offset[0] == pytest.approx(5e-4, rel=1e-6)  # it starts on the side the force says
    assert offset[200] == pytest.approx(-5e-4, rel=1e-3)
    assert np.all(np.abs(offset) <= 5e-4 + 1e-12)


def test_a_stiff_joint_is_no_joint():
    time = np.linspace(0, 2, 201)
    command = 3 * np.sin(2 * np.pi * time)
    plain = run(benches.pump_bench(), time, command=command)
    for effect, value in (("structural_compliance", {"compliance": 1e-13}), ("backlash", {"gap": 1e-9})):
        stiff = run(add_effect(benches.pump_bench(), effect, values=value), time, command=command)
        assert np.allclose(stiff["position"], plain["position"], atol=1e-8)


@pytest.mark.parametrize(
    ("effect", "value"), [("structural_compliance", {"compliance": 2e-7}), ("backlash", {"gap": 1e-3})]
)
def test_a_soft_joint_starts_at_rest_and_lets_the_rod_run_ahead_of_the_load(effect, value):
    model = add_effect(benches.pump_bench(), effect, values=value)
    paths = ["cylinder.rod.s", "load.flange.s", f"{effect}.a.f", "der(load.velocity)"]
    states = {"cylinder.cap_pressure": 4e6, "cylinder.rod_pressure": 1e6}
    rod, load, force, _ = observed(model, paths, states)
    expected = 2e-7 * force if effect == "structural_compliance" else 5e-4 * np.tanh(force / 200.0)
    assert force > 1000.0 and rod - load == pytest.approx(expected)
    y = run(model, np.linspace(0, 0.05, 51), start=states)
    assert np.all(np.isfinite(y["position"]))


def test_a_bar_longer_than_stated_leaves_the_foot_where_it_is():
    """The foot's distance follows from two lengths only until one of them is found to be another."""
    model = cehA.model()
    foot = np.sqrt(0.3055**2 - 0.225**2)
    assert "arm.base_length" not in {p.name for p in model.flat.parameters}
    longer = add_effect(model, "linkage_error", "arm.pin_length", {"arm.pin_length": 0.23})
    values = {p.name: p.value for p in longer.flat.parameters}
    assert values["arm.base_length"] == pytest.approx(foot, rel=1e-12)
    stroke = float(longer.observe(["arm.pin.s"])(0.0, *_at_rest(longer)))
    assert stroke == pytest.approx(np.hypot(0.23, foot) - 0.3055, rel=1e-9)  # the arm level: a right angle at the joint
    moved = add_effect(model, "linkage_error", "arm.base_length", {"arm.base_length": 0.2})
    assert {p.name for p in moved.flat.parameters if p.free} - {p.name for p in model.flat.parameters if p.free} == {
        "arm.base_length"
    }


def test_a_length_that_follows_one_the_user_fits_goes_on_following():
    fitted = cehA.model().with_settings({"arm.pin_length": {"free": True}})
    more = add_effect(fitted, "linkage_error", "arm.retracted_length")
    assert "arm.base_length" not in {p.name for p in more.flat.parameters}


def _at_rest(model):
    flat = model.flat
    x = np.array(flat.start_given()([s.default for s in flat.inputs], flat.parameter_vector(), [])).ravel()
    x[[s.name for s in flat.states].index("arm.angle")] = 0.0
    return x, [s.default for s in flat.inputs], flat.parameter_vector()
