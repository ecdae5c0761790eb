"""Effects on commands and drives, held against what their equations say."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.components import Cylinder, LinearLoad, Pump
from hydrotwin.models.components.mechanical import SpeedSource
from hydrotwin.models.effects import add_effect, candidates
from hydrotwin.models.effects.command import CommandSaturation, RateLimit
from hydrotwin.models.language import Component, Input, Model, Output, State, connect, der
from hydrotwin.records import Record
from hydrotwin.simulation import prepare, simulate
from tests.effects.benches import axis, pass_on, passed, pump_bench, run, seen, valve_bench

TIME = np.arange(0.0, 1.0, 1e-3)
STEP = np.where(TIME < 0.1, 0.0, 3.0)
SINE = 3.0 * np.sin(2 * np.pi * 2 * TIME)


def test_a_dead_time_shows_the_command_as_it_was():
    late = passed("dead_time", "command", TIME, SINE, time=0.05)
    np.testing.assert_allclose(late[60:], SINE[10:-50], atol=1e-9)


def test_a_dead_time_that_the_model_has_already_is_freed_and_not_put_in_twice():
    (found, behind) = candidates(spool_valve.model(), ["dead_time"])
    assert found.site.frees == "solenoid.dead_time" and found.addition.part is None
    assert found.twins == ("dead_time at slide.target",) and behind.label == "dead_time at valve.spool"
    assert all(0 < probe["solenoid.dead_time"] < 0.3 for probe in found.probes)
    late = spool_valve.model().plus([found.addition])
    assert next(p for p in late.flat.parameters if p.name == "solenoid.dead_time").free
    assert [c.label for c in candidates(late, ["dead_time"])] == ["dead_time at valve.spool"]


def test_a_lag_follows_a_step_exponentially():
    lagging = passed("actuator_lag", "command", TIME, STEP, time_constant=0.05)
    expected = 3.0 * (1 - np.exp(-np.maximum(TIME - 0.0995, 0) / 0.05))  # the step takes one sample
    np.testing.assert_allclose(lagging, expected, atol=0.01 * 3.0)


@pytest.mark.parametrize("lag", [0.0005, 0.003, 0.1])
def test_a_lag_of_any_length_is_behind_a_ramp_by_itself(lag):
    lagging = passed("actuator_lag", "command", TIME, TIME, time_constant=lag)
    uneven = 5e-4**2 / (12 * lag)  # what a lag makes of a ramp of steps, each the mean over a step of the model
    assert (TIME - lagging)[-1] == pytest.approx(lag + uneven, abs=1e-5)


@pytest.mark.parametrize("lag", [0.0005, 0.001, 0.003])
@pytest.mark.parametrize(("effect", "site"), [("actuator_lag", "command"), ("sensor_lag", "reading")])
def test_a_lag_down_to_one_step_of_the_model_follows_a_held_command_exponentially(effect, site, lag):
    late = add_effect(pass_on(), effect, site, {"time_constant": lag})
    since = np.maximum(TIME - 0.1, 0)
    np.testing.assert_allclose(run(late, TIME, STEP)[:, 0], 3.0 * (1 - np.exp(-since / lag)), atol=0.02 * 3.0)


def test_a_limited_rate_turns_a_step_into_a_ramp():
    limited = passed("rate_limit", "command", TIME, STEP, rate=10.0)
    ramp = np.clip(10.0 * (TIME - 0.099), 0.0, 3.0)  # the step takes one sample
    np.testing.assert_allclose(limited, ramp, atol=0.0025)  # R T_0, where it arrives
    assert np.sum(np.abs(limited - ramp) > 1e-9) <= 3


@pytest.mark.parametrize("milliseconds", [2.5, 5.0, 20.0])
def test_a_ramp_that_lasts_a_few_steps_of_the_model_holds_back_as_much_as_the_exact_one(milliseconds):
    lasts = 1e-3 * milliseconds
    late = add_effect(pass_on(), "rate_limit", "command", {"rate": 3.0 / lasts}).flat
    start = np.asarray(late.start_given()([0.0], late.parameter_vector(), [])).ravel()
    _, states, *_ = prepare(late, method="vm").run(TIME, STEP[:, None], late.parameter_vector(), start)
    memory = np.asarray(states)[:, [s.name for s in late.states].index("memory")]
    held_back = 3.0 * (TIME[-1] - 0.1) - memory[-1]
    assert held_back == pytest.approx(3.0 * lasts / 2, rel=0.02)


def test_a_limited_rate_leaves_what_is_slower_alone():
    np.testing.assert_allclose(passed("rate_limit", "command", TIME, SINE, rate=600.0), SINE, atol=1e-9)
    nearly = passed("rate_limit", "command", TIME, SINE, rate=38.0)
    np.testing.assert_allclose(nearly, SINE, atol=38.0 * 5e-4)  # T_0 late, and half a step of the model


def test_a_rate_without_a_limit_leaves_steps_of_a_thousand_nominals_alone():
    free = add_effect(pass_on(), "rate_limit", "command", {})
    np.testing.assert_array_equal(run(free, TIME, 1e3 * STEP)[:, 0], 1e3 * STEP)


def test_commands_beyond_a_limit_do_no_more_than_the_limit():
    limited = passed("command_saturation", "command", TIME, SINE, limit=1.0)
    np.testing.assert_allclose(limited, np.clip(SINE, -1, 1), atol=1e-12)


def test_a_deadband_swallows_small_commands_and_shortens_large_ones():
    left = passed("command_deadband", "command", TIME, SINE, width=0.5)
    np.testing.assert_allclose(left, np.sign(SINE) * np.maximum(np.abs(SINE) - 0.5, 0), atol=1e-12)


def test_a_drive_may_give_more_in_one_direction_than_in_the_other():
    given = passed("direction_asymmetry", "command", TIME, SINE, asymmetry=0.1)
    np.testing.assert_allclose(given, np.where(SINE > 0, 1.1, 0.9) * SINE, atol=1e-12)


def test_and_the_mean_of_both_may_be_off_as_well():
    given = passed("direction_asymmetry", "command", TIME, SINE, asymmetry=0.1, gain=-0.2)
    np.testing.assert_allclose(given, 0.8 * np.where(SINE > 0, 1.1, 0.9) * SINE, atol=1e-12)
    np.testing.assert_allclose(passed("command_gain", "command", TIME, SINE, error=0.3), 1.3 * SINE, atol=1e-12)


@pytest.mark.parametrize(
    ("model", "free", "already"),
    [
        (cehA.model, (), True),  # its motor's gain is free
        (spool_valve.model, (), False),  # its flow coefficient is, and the spool itself is measured
        (pump_bench, ("motor.gain",), True),
        (pump_bench, ("pump.displacement",), False),
        (valve_bench, ("valve.orifice.flow_coefficient",), True),  # the input is the spool
        (axis, ("carriage.mass", "carriage.load_force"), False),
        (axis, ("carriage.mass", "carriage.load_force", "carriage.friction.viscous"), True),  # m v' = F - L - b v
    ],
)
def test_a_gain_is_looked_for_where_no_free_parameters_are_that_gain(model, free, already):
    model = model().with_settings({name: {"free": True} for name in free})
    found = {c.id: c for c in candidates(model, ["command_gain", "direction_asymmetry"])[::-1]}
    assert ("command_gain" in found) == (not already)
    own = ("asymmetry",) if already else ("asymmetry", "gain")
    assert found["direction_asymmetry"].free == tuple(f"direction_asymmetry.{name}" for name in own)


def test_a_null_offset_is_added_to_the_command():
    np.testing.assert_allclose(passed("null_bias", "command", TIME, SINE, offset=0.2), SINE + 0.2, atol=1e-12)


def test_a_drift_grows_with_time():
    np.testing.assert_allclose(passed("drift", "command", TIME, SINE, rate=0.01), SINE * (1 + 0.01 * TIME), atol=1e-12)


def test_more_flows_through_a_valve_while_its_oil_warms_and_the_spool_stands_where_it_stood():
    known = {c.site.name: c for c in candidates(spool_valve.model(), ["drift"])}
    assert list(known) == ["current", "valve.spool"]
    assert [c.site.name for c in candidates(cehA.model(), ["drift"])] == ["command"]
    time = np.arange(0.0, 2.0, 0.01)
    record = Record(time, {"current": np.full(len(time), 0.1)}, {"current": "1"}, "held")
    steady, warm, driven = (
        simulate(model, record)
        for model in (spool_valve.model(), *(added(site, rate=0.05) for site in ("valve.spool", "current")))
    )
    np.testing.assert_allclose(warm["spool"], steady["spool"], rtol=1e-9, atol=1e-12)
    assert driven["spool"][-1] == pytest.approx(1.1 * steady["spool"][-1], rel=5e-3)
    faster = [r["velocity"][-1] / steady["velocity"][-1] for r in (warm, driven)]
    assert faster == pytest.approx([1.1, 1.1], rel=5e-3)


def added(site: str, **values: float):
    """The valve with a drift somewhere."""
    (drift,) = (c for c in candidates(spool_valve.model(), ["drift"]) if c.site.name == site)
    model = spool_valve.model().plus([drift.addition])
    return model.with_parameters({f"{drift.name}.{name}": value for name, value in values.items()})


def test_a_null_offset_sits_where_the_command_enters_and_nowhere_else_on_the_way_to_the_valve():
    assert [c.site.name for c in candidates(spool_valve.model(), ["null_bias"])] == ["current"]


def test_a_drive_under_load_turns_slower_by_its_droop_times_the_torque():
    model = add_effect(pump_bench(), "motor_droop", values={"slope": 20.0})
    pressures = {"cylinder__cap_pressure": 5e6, "cylinder__rod_pressure": 1e6}
    torque = 2e-7 * (5e6 - 0.8 * 1e6)
    turning = {"motor__speed": 200.0, "motor_droop__torque": torque}
    drive, pump, taken = seen(model, ["motor.shaft.w", "pump.shaft.w", "pump.shaft.tau"], [2.0], **turning, **pressures)
    assert drive == 200.0
    assert taken == pytest.approx(torque)
    assert pump == pytest.approx(200.0 - 20.0 * torque)


def test_the_sensor_of_a_drive_sees_what_the_load_takes_through_the_lag_of_the_drive():
    """T w' + w = k u - R M, integrated here from the torque M that the pressures make."""
    model = add_effect(cehA.model(), "motor_droop", values={"slope": 20.0})
    value = {p.name: p.value for p in model.flat.parameters}
    time_constant, gain = value["motor.time_constant"], value["motor.gain"]
    assert value["motor_droop.lag"] == time_constant
    run = simulate(model, Record(TIME, {"command": SINE}, {"command": "V"}))
    ratio = value["cylinder.rod_area"] / value["cylinder.cap_area"]
    torque = value["pump.displacement"] * (run["pressure_cap"] - ratio * run["pressure_rod"])
    decay, speed = np.exp(-1e-3 / time_constant), [run["motor_speed"][0]]
    for u, M in zip(SINE[:-1], (torque[1:] + torque[:-1]) / 2, strict=True):
        speed.append(decay * speed[-1] + (1 - decay) * (gain * u - 20.0 * M))
    assert np.ptp(20.0 * torque) > 1.0
    np.testing.assert_allclose(run["motor_speed"], speed, atol=2e-3)


class MeasuredDrive(Component):
    """A pump and a cylinder, driven by the measured speed of the pump."""

    speed = Input("rad/s", "measured speed", nominal=100.0, interpolation="linear")
    position = Output("m", "position")
    drive = SpeedSource()
    pump = Pump()
    cylinder = Cylinder()
    load = LinearLoad()

    def equations(self):
        yield connect(self.speed, self.drive.speed)
        yield connect(self.drive.shaft, self.pump.shaft)
        yield connect(self.pump.cap, self.cylinder.cap)
        yield connect(self.pump.rod, self.cylinder.annulus)
        yield connect(self.cylinder.rod, self.load.flange)
        yield self.position == self.load.position


def test_a_drive_whose_speed_was_measured_has_no_droop():
    measured = Model(MeasuredDrive())
    told = Model(MeasuredDrive(speed=Input("rad/s", "wanted speed", nominal=100.0)))
    assert not candidates(measured, ["motor_droop"])
    assert [c.site.name for c in candidates(told, ["motor_droop"])] == ["drive.shaft"]
    assert not candidates(axis(), ["motor_droop"])


def test_limits_are_tried_where_the_command_is_large():
    starts = [probe["limit"] for probe in CommandSaturation.probes_for({"u": SINE})]
    assert len(starts) > 2 and 3.0 > starts[0] > starts[-1] > 1.0
    assert CommandSaturation.probes_for({"u": np.zeros(5)}) == []


def test_rates_are_tried_that_the_command_exceeds_now_and_then():
    starts = [probe["rate"] for probe in RateLimit.probes_for({"u": SINE, "time": TIME})]
    steepest = 3.0 * 2 * np.pi * 2
    assert starts == sorted(starts, reverse=True)
    assert all(0 < rate < steepest for rate in starts)
    assert RateLimit.probes_for({"u": np.ones(5), "time": np.arange(5.0)}) == []
    (step,) = {max(p["rate"] for p in RateLimit.probes_for({"u": STEP, "time": TIME}))}
    assert step <= 3.0 / 0.02


def test_what_a_sensor_reports_is_no_command_that_saturates_or_lags():
    class Measured(Component):
        speed = Input("rad/s", "measured speed", nominal=100.0, interpolation="linear")
        turned = Output("rad", "way")
        way = State(0.0, "rad", "way")

        def equations(self):
            yield der(self.way) == self.speed
            yield self.turned == self.way

    ids = {c.id for c in candidates(Model(Measured(), "measured"))}
    assert not ids & {"command_saturation", "command_deadband", "rate_limit", "actuator_lag"}
    assert {"direction_asymmetry", "null_bias", "dead_time"} <= ids


def test_a_drive_may_feel_the_whole_difference_of_pressures_where_its_pump_takes_a_part_of_it():
    """w = w_0 - R M, T M' = c_p (p_a - p_b) - M: the return ratio of 0.8 is then one of flows alone."""
    usual, whole = candidates(pump_bench(), ["motor_droop"])
    assert (usual.label, whole.label) == ("motor_droop at motor.shaft", "motor_droop at motor.shaft-pump")
    model = pump_bench().plus([whole.addition]).with_parameters({f"{whole.name}.slope": 20.0})
    states = {"cylinder__cap_pressure": 5e6, "cylinder__rod_pressure": 1e6, "motor__speed": 200.0}
    torque = 2e-7 * (5e6 - 1e6)
    names = ["pump.shaft.w", f"der({whole.name}.torque)"]
    speed, rate = seen(model, names, [2.0], **states, **{f"{whole.name}__torque": 0.5 * torque})
    assert speed == pytest.approx(200.0 - 20.0 * 0.5 * torque)
    assert rate == pytest.approx(0.5 * torque / 0.03, rel=1e-9)  # c_p is found from the model's equations
    closed = pump_bench().but(pump=Pump(displacement=2e-7, return_ratio=1.0))
    assert [c.site.name for c in candidates(closed, ["motor_droop"])] == ["motor.shaft"]
