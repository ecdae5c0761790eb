"""The C-EHA: data sheet, statics, hydraulic frequency, energy, and the third-order form."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models import cehA
from hydrotwin.simulation import simulate
from tests.components.bench import jacobian
from tests.machines.recordings import held, rig_record

G = 9.80665
A_CAP, A_ROD, BETA, C_P, V0 = 8.042e-4, 6.319e-4, 1.747e9, 1.05e-7, 8e-5
PIN, FOOT = 0.225, np.sqrt(0.3055**2 - 0.225**2)
INERTIA, MOMENT = (46.7 + 1.64 / 3) * 0.488**2, (46.7 + 1.64 / 2) * G * 0.488
FREE = {"motor.gain", "motor.time_constant", "cylinder.friction.viscous", "cylinder.oil.bulk_modulus",
        "cylinder.cap_dead_volume", "cylinder.rod_dead_volume"}  # fmt: skip
TABLE_1 = {
    "arm.extra_mass": 46.7, "arm.arm_mass": 1.64, "arm.length": 0.488, "arm.pin_length": 0.225,
    "cylinder.rod_area": 6.319e-4, "cylinder.cap_area": 8.042e-4, "arm.retracted_length": 0.3055,
    "pump.displacement": 1.05e-7, "cylinder.oil.bulk_modulus": 1.747e9, "cylinder.friction.kinetic": 1.87,
    "cylinder.friction.static": 13.15, "cylinder.friction.viscous": 741.36,
    "cylinder.friction.stribeck_velocity": 0.0028,
}  # fmt: skip
MODEL = cehA.model()


def lever(theta):
    return PIN * FOOT * np.cos(theta) / np.sqrt(PIN**2 + FOOT**2 + 2 * PIN * FOOT * np.sin(theta))


def poles(model, **states):
    x = model.equilibrium(states={"arm.angle": 0.0} | states)
    return np.linalg.eigvals(jacobian(model)(0, x, [0], model.flat.parameter_vector()).full())


def test_the_model_has_the_signals_of_the_machine_and_its_six_free_parameters():
    flat = MODEL.flat
    assert [(i.name, i.unit) for i in flat.inputs] == [("command", "V")]
    names = ["arm_angle", "motor_speed", "rod_position", "pressure_cap", "pressure_rod", "piston_force"]
    assert [o.name for o in flat.outputs] == names
    assert {p.name for p in flat.parameters if p.free} == FREE


def test_the_values_are_those_of_table_1():
    values = {p.name: p.value for p in MODEL.flat.parameters}
    assert {name: values[name] for name in TABLE_1} == TABLE_1


@pytest.mark.parametrize(("command", "angle"), [(5.0, -0.2), (-5.0, 0.5)])
def test_five_volts_move_the_rod_with_the_eight_centimetres_per_second_of_the_data_sheet(command, angle):
    y = simulate(MODEL, held("cehA", 1.0, command), start={"arm.angle": angle})
    speed = np.polyfit(y.time[100:], y["rod_position"][100:], 1)[0]
    assert speed == pytest.approx(command * 120 * C_P / A_CAP, rel=2e-3)
    assert abs(speed) == pytest.approx(0.08, rel=0.03)
    assert y["motor_speed"][-1] == pytest.approx(600 * np.sign(command))


@pytest.mark.parametrize("theta", [-0.2, 0.0, 0.12, 0.5])
@pytest.mark.parametrize("precharge", [1e6, 2e6])
def test_it_stands_still_where_it_starts(theta, precharge):
    """The cap pressure carries arm and weight; for ten seconds nothing moves."""
    model = MODEL.with_parameters({"precharge": precharge})
    cap = (MOMENT * np.cos(theta) / lever(theta) + precharge * A_ROD) / A_CAP
    assert model.equilibrium(states={"arm.angle": theta}) == pytest.approx([0, cap, precharge, theta, 0], rel=1e-12)
    y = simulate(model, held("cehA", 10.0, 0.0), start={"arm.angle": theta})
    assert np.ptp(y["arm_angle"]) < 1e-12
    assert y["piston_force"] == pytest.approx(np.full(len(y.time), MOMENT * np.cos(theta) / lever(theta)), rel=1e-9)


def test_the_hydraulic_frequency_at_zero_angle_is_34_to_36_hertz_and_lightly_damped():
    model = MODEL.with_parameters({"cylinder.friction.static": 0.0, "cylinder.friction.kinetic": 0.0})
    pair = max(poles(model), key=lambda z: z.imag)
    stiffness, mass = BETA * (A_CAP**2 + A_ROD**2) / V0, INERTIA / lever(0.0) ** 2
    assert stiffness == pytest.approx(2.3e7, rel=0.02) and mass == pytest.approx(486, rel=0.01)
    assert 34 < abs(pair) / (2 * np.pi) < 36
    assert abs(pair) == pytest.approx(np.sqrt(stiffness / mass), rel=1e-3)
    assert -pair.real / abs(pair) == pytest.approx(741.36 / (2 * np.sqrt(stiffness * mass)), rel=1e-3)


def test_the_frequency_falls_from_42_to_27_hertz_as_the_arm_rises_because_the_lever_shortens():
    found = [poles(MODEL, **{"arm.angle": theta}).imag.max() / (2 * np.pi) for theta in (-0.2, 0.0, 0.12, 0.5)]
    assert found == pytest.approx([41.5, 34.4, 31.8, 26.9], abs=0.1)


def test_stiffer_oil_raises_the_hydraulic_frequency_by_the_root():
    stiff = MODEL.with_parameters({"cylinder.oil.bulk_modulus": 2 * BETA})
    assert poles(stiff).imag.max() / poles(MODEL).imag.max() == pytest.approx(np.sqrt(2), rel=5e-3)


def test_angle_and_mean_pressure_are_neutral_in_the_area_matched_circuit():
    """Two zero poles: the pump holds any angle, and any precharge; so the start pressures need a precharge."""
    assert np.sum(np.abs(poles(MODEL)) < 1e-6) == 2


def test_shaft_work_is_stored_or_rubbed_away_at_every_moment():
    """tau w = d/dt (oil, motion, height) + friction heat, at random states."""
    paths = ["pump.shaft.tau", "cylinder.rod.s", "der(cylinder.cap_pressure)", "der(cylinder.rod_pressure)",
             "der(arm.angular_velocity)", "cylinder.rod.f"]  # fmt: skip
    look, p = MODEL.observe(paths), MODEL.flat.parameter_vector()
    random = np.random.default_rng(0)
    for _ in range(20):
        w, p1, p2 = random.uniform(-600, 600), random.uniform(1e6, 9e6), random.uniform(1e6, 9e6)
        theta, rate = random.uniform(-0.2, 0.5), random.uniform(-0.5, 0.5)
        tau, s, dp1, dp2, acceleration, f = np.array(look(0, [w, p1, p2, theta, rate], [0], p)).ravel()
        oil = (V0 + A_CAP * s) / BETA * p1 * dp1 + (V0 - A_ROD * s) / BETA * p2 * dp2
        motion = INERTIA * rate * acceleration + MOMENT * np.cos(theta) * rate
        friction = (p1 * A_CAP - p2 * A_ROD + f) * lever(theta) * rate
        assert tau * w == pytest.approx(oil + motion + friction, rel=1e-9, abs=1e-6)
        assert friction >= 0


def test_the_third_order_form_runs_like_the_full_model():
    """Corrected Eq. 16 against pump, two chambers and arm, on a drive command and on hard steps."""
    for command in ("drive", "steps"):
        record = rig_record("cehA", command).select(["command"])
        start = {"arm.angle": 0.12}
        fine = {"start": start, "step": 2.5e-4}  # each form refines its own states' kinks: below the errors of both
        full, third = simulate(MODEL, record, **fine), simulate(cehA.third_order(), record, **fine)
        for name in ("arm_angle", "motor_speed", "rod_position", "piston_force"):
            assert np.abs(third[name] - full[name]).max() < 1e-6 * np.ptp(full[name]), name


def test_the_third_order_form_takes_the_torque_of_the_full_pump():
    third, p1, p2 = cehA.third_order(), 5e6, 3e6
    full = MODEL.observe(["pump.shaft.tau"])(0, [300, p1, p2, 0.1, 0.2], [0], MODEL.flat.parameter_vector())
    state = [300, p1 * A_CAP - p2 * A_ROD, 0.1, 0.2]
    short = third.observe(["actuator.shaft.tau"])(0, state, [0], third.flat.parameter_vector())
    assert float(short) == pytest.approx(float(full), rel=1e-12)
    assert float(full) == pytest.approx(C_P * (p1 - A_ROD / A_CAP * p2), rel=1e-12)


def test_the_third_order_form_has_the_same_values_but_no_pressures():
    full = {p.name: p.value for p in MODEL.flat.parameters}
    renamed = {"displacement": "pump.", "default": "cylinder."}
    for p in cehA.third_order().flat.parameters:
        owner, _, leaf = p.name.partition(".")
        name = p.name if owner != "actuator" else renamed.get(leaf, renamed["default"]) + leaf
        assert full[name] == p.value
    assert not any("pressure" in o.name for o in cehA.third_order().flat.outputs)
