"""Every hidden effect, on every machine it fits: it shows, halving the step changes nothing, names are checked."""

from __future__ import annotations

import numpy as np
import pytest

from tests import rig

FITTING = [(machine, name) for machine in rig.MACHINES for name, e in rig.EFFECTS.items() if machine in e.machines]
LATE = {"payload_change": {"time": 2.0}, "external_push": {"start": 2.0, "end": 3.0}}
SENSOR = {"value": 1e-3, "width": 1e-3, "rate": 1e-3, "step": 1e-3, "amplitude": 1e-3, "period": 1e-2}
HARD = {"end_stop": 5e-3}  # a stiff contact: the only effect whose step error is above a thousandth of the noise


def options_of(machine, name):
    effect = rig.EFFECTS[name]
    if effect.kind != "sensor":
        return LATE.get(name, {})
    sized = {key: size for key, size in SENSOR.items() if key in effect.defaults}
    return {"output": rig.MACHINES[machine].outputs[0], **sized}


@pytest.fixture(scope="module", params=sorted(rig.MACHINES))
def machine(request):
    time, command = rig.drive(request.param, 6.0, seed=5)
    return request.param, time, command, rig.record(request.param, command, time)


@pytest.mark.parametrize("name", sorted(rig.EFFECTS))
def test_an_effect_shows_and_halving_the_step_changes_nothing_visible(machine, name):
    which, time, command, plain = machine
    if (which, name) not in FITTING:
        with pytest.raises(KeyError, match="no effect"):
            rig.record(which, command, time, effects={name: {}})
        return
    hidden = {name: options_of(which, name)}
    coarse = rig.record(which, command, time, effects=hidden)
    fine = rig.record(which, command, time, effects=hidden, step=2.5e-5)
    noise = rig.sensor_noise(which)
    error = max(np.max(np.abs(coarse[n] - fine[n])) / s for n, s in noise.items())
    shown = max(np.max(np.abs(coarse[n] - plain[n])) / s for n, s in noise.items())
    assert error < HARD.get(name, 1e-3)
    assert shown > 0.1
    assert np.array_equal(coarse[rig.MACHINES[which].input], command)


def test_a_dead_time_of_whole_samples_is_exactly_the_shifted_command():
    time, command = rig.drive("cehA", 4.0, seed=2)
    late = rig.record("cehA", command, time, effects={"dead_time": {"seconds": 0.07}})
    shifted = rig.record("cehA", np.concatenate([np.zeros(7), command[:-7]]), time)
    for name in rig.MACHINES["cehA"].outputs:
        assert late[name] == pytest.approx(shifted[name], rel=1e-9, abs=1e-9)


def test_a_dead_time_of_a_fraction_of_a_sample_moves_the_step_by_that_fraction():
    time = np.arange(41) / 100
    run = rig.record("cehA", np.where(time >= 0.1 - 1e-12, 1.0, 0.0), time, effects={"dead_time": {"seconds": 0.0137}})
    expected = 120 * -np.expm1(-np.maximum(time - 0.1137, 0) / 0.03)
    assert run["motor_speed"] == pytest.approx(expected, abs=1e-8)


def test_a_delayed_sensor_reports_what_was_true_then():
    time, command = rig.drive("spool_valve", 4.0, seed=2)
    plain = rig.record("spool_valve", command, time)
    late = rig.record("spool_valve", command, time, effects={"sensor_delay": {"output": "position", "seconds": 0.05}})
    assert late["position"][5:] == pytest.approx(plain["position"][:-5], abs=1e-12)
    assert late["velocity"] == pytest.approx(plain["velocity"], abs=1e-10)


def test_a_lagging_sensor_follows_the_closed_form():
    time = np.arange(41) / 100
    run = rig.record(
        "cehA",
        np.where(time >= 0.1 - 1e-12, 1.0, 0.0),
        time,
        effects={"sensor_lag": {"output": "motor_speed", "time_constant": 0.05}},
    )
    t = np.maximum(time - 0.1, 0)
    expected = 120 * (1 - (0.05 * np.exp(-t / 0.05) - 0.03 * np.exp(-t / 0.03)) / 0.02)
    assert run["motor_speed"] == pytest.approx(expected, abs=2e-3)


def test_a_rippled_sensor_is_off_by_a_sine_of_what_it_measures():
    time, command = rig.drive("spool_valve", 4.0, seed=2)
    plain = rig.record("spool_valve", command, time)["position"]
    uneven = {"sensor_ripple": {"output": "position", "amplitude": 1e-4, "period": 0.01}}
    seen = rig.record("spool_valve", command, time, effects=uneven)["position"]
    assert seen - plain == pytest.approx(1e-4 * np.sin(2 * np.pi * plain / 0.01), abs=1e-15)


def test_several_effects_of_one_kind_are_pairs():
    time = np.arange(11) / 100
    biased = [("sensor_bias", {"output": name, "value": 1.0}) for name in ("motor_speed", "piston_force")]
    run, plain = (rig.record("cehA", np.zeros(11), time, effects=e) for e in (biased, None))
    assert run["motor_speed"] - plain["motor_speed"] == pytest.approx(np.ones(11))
    assert run["piston_force"] - plain["piston_force"] == pytest.approx(np.ones(11))


@pytest.mark.parametrize(
    ("effects", "complaint"),
    [
        ({"internal_leackage": {}}, "no effect"),
        ({"internal_leakage": {"conductanse": 1}}, "no option"),
        ({"sensor_bias": {"output": "angle", "value": 1}}, "needs output"),
        ({"valve_overlap": {}}, "no effect"),
    ],
)
def test_a_wrong_name_is_refused(effects, complaint):
    with pytest.raises(KeyError, match=complaint):
        rig.record("cehA", np.zeros(3), np.arange(3) / 10, effects=effects)
