"""Winch, boom and test cylinder: they rest, move and leak as hand calculation says, and their effects show."""

from __future__ import annotations

import numpy as np
import pytest

from tests import rig

FITTING = [(m, name) for m in rig.FURTHER for name in rig.EFFECTS if rig.effect_of(m, name)]
LATE = {"payload_change": {"time": 1.0}, "external_push": {"start": 1.0, "end": 2.0}}
SENSOR = {"value": 1e-3, "width": 1e-3, "rate": 1e-3, "step": 1e-3, "amplitude": 1e-3, "period": 1e-2}
HARD = {"end_stop": 5e-3, "spool_hysteresis": 0.05}  # a stiff contact; play inside a loop follows from step to step
G = 9.80665


def still(machine, seconds=4.0, **options):
    m = rig.FURTHER[machine]
    time = np.arange(round(seconds * 100) + 1) / 100
    return rig.record(machine, np.full(len(time), m.start_value if m.positioned else 0.0), time, **options)


def parameters(machine):
    return rig.FURTHER[machine].parameters


@pytest.mark.parametrize("machine", rig.FURTHER)
def test_a_machine_that_nobody_moves_rests(machine):
    run, noise = still(machine), rig.sensor_noise(machine)
    assert all(np.ptp(run[name]) < 1e-4 * sigma for name, sigma in noise.items())


def test_the_winch_lifts_what_its_pump_delivers():
    p, time = parameters("winch"), np.arange(801) / 100
    run = rig.record("winch", np.full(801, 2.0), time)
    speed = p["motor.gain"] * 2.0 * p["pump.displacement"] / p["hydraulic_motor.displacement"] * p["drum.radius"]
    assert np.gradient(run["rope_position"], time)[-100:] == pytest.approx(np.full(100, speed), rel=1e-3)
    force = p["load.mass"] * G + p["load.friction.viscous"] * speed
    torque = force * p["drum.radius"]
    difference = np.mean((run["pressure_a"] - run["pressure_b"])[-100:])
    assert difference == pytest.approx(torque / p["hydraulic_motor.displacement"], rel=1e-3)


def test_a_load_sinks_on_a_winch_whose_motor_leaks_outwards():
    p, leak = parameters("winch"), 1e-12
    run = still("winch", effects={"external_leakage": {"cap": leak}})
    speed = leak * run["pressure_a"][-1] / p["hydraulic_motor.displacement"] * p["drum.radius"]
    assert np.gradient(run["rope_position"], run["time"])[-50:] == pytest.approx(np.full(50, -speed), rel=1e-2)


def test_the_boom_gains_as_much_height_as_its_cylinder_works_for():
    """Slow: work of the pressures at the rod less friction is the gain in potential energy."""
    p, time = parameters("lift_boom"), np.arange(601) / 100
    run = rig.record("lift_boom", 0.3 * np.clip(np.minimum(time - 0.5, 5.0 - time), 0, 1), time)
    x, theta = run["rod_position"], run["boom_angle"]
    force = run["pressure_a"] * p["cylinder.cap_area"] - run["pressure_b"] * p["cylinder.rod_area"]
    force -= p["cylinder.friction.viscous"] * np.gradient(x, time)
    moment = (p["boom.extra_mass"] + p["boom.arm_mass"] / 2) * p["boom.length"] * G
    assert np.trapezoid(force, x) == pytest.approx(moment * (np.sin(theta[-1]) - np.sin(theta[0])), rel=5e-3)
    assert theta[-1] - theta[0] > 0.05


def test_the_controlled_cylinder_runs_past_its_target_by_the_play_of_its_valve():
    p, play = parameters("test_cylinder"), 0.08
    time = np.arange(801) / 100
    reference = 0.45 + 0.1 * np.clip(time - 0.5, 0, 1)
    exact, loose = (
        rig.record("test_cylinder", reference, time, effects=effects)["position"]
        for effects in (None, {"spool_hysteresis": {"width": play}})
    )
    assert exact[-1] == pytest.approx(0.55, abs=1e-5)
    assert loose[-1] - 0.55 == pytest.approx(0.5 * play / p["controller.gain"], rel=1e-3)


@pytest.fixture(scope="module", params=rig.FURTHER)
def machine(request):
    time, command = rig.drive(request.param, 4.0, kind="chirp", seed=5)
    return request.param, time, command, rig.record(request.param, command, time)


@pytest.mark.parametrize("name", rig.EFFECTS)
def test_an_effect_shows_and_halving_the_step_changes_nothing_visible(machine, name):
    which, time, command, plain = machine
    if (which, name) not in FITTING:
        with pytest.raises(KeyError, match="no effect"):
            rig.record(which, command, time, effects={name: {}})
        return
    sized = {key: size for key, size in SENSOR.items() if key in rig.EFFECTS[name].defaults}
    sensor = {"output": rig.FURTHER[which].outputs[0], **sized}
    hidden = {name: sensor if rig.EFFECTS[name].kind == "sensor" else LATE.get(name, {})}
    coarse, fine = (rig.record(which, command, time, effects=hidden, step=step) for step in (5e-5, 2.5e-5))
    noise = rig.sensor_noise(which)
    shown = max(np.max(np.abs(coarse[n] - plain[n])) / s for n, s in noise.items())
    error = max(np.max(np.abs(coarse[n] - fine[n])) / s for n, s in noise.items())
    assert error < HARD.get(name, 1e-3)
    assert shown > 0.1
