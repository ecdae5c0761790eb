"""Places that no recording tells apart are one candidate, and only those."""

from __future__ import annotations

from collections import Counter
from functools import cache

import numpy as np
import pytest

from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.components import (
    AttachedMass,
    FirstOrderLag,
    FlowSensor,
    ForceSensor,
    ForceSource,
    Gain,
    LinearLoad,
    Mass,
    Pump,
    Saturation,
    SpringDamper,
)
from hydrotwin.models.effects import CATALOGUE, add_effect, candidates
from hydrotwin.models.effects.law import law_of
from hydrotwin.models.language import Component, Input, Model, Output, connect
from hydrotwin.models.laws import ConstantVolumetricEfficiency, Viscous
from hydrotwin.simulation import prepare
from tests.effects import hoses
from tests.effects.benches import Axis, PumpBench, ValveBench

MACHINES = {"winch": hoses.winch, "cylinder": hoses.cylinder_bench}


@cache
def listed(name: str, pieces: int):
    return candidates(MACHINES[name](pieces))


def sites(model, effect):
    """Places of an effect, each with its twins."""
    known = candidates(model, [effect])
    return {c.site.name: tuple(t.removeprefix(f"{effect} at ") for t in c.twins) for c in known}


@pytest.mark.parametrize("name", MACHINES)
def test_a_hose_in_four_pieces_or_eight_lacks_what_a_hose_in_one_lacks(name):
    for pieces in (4, 8):
        assert Counter(c.id for c in listed(name, pieces)) == Counter(c.id for c in listed(name, 1))
    assert len(listed(name, 4)) <= 150
    assert len(candidates(MACHINES[name](4), merged=False)) > 400


@pytest.mark.parametrize("name", MACHINES)
def test_every_place_is_a_candidate_the_twin_of_one_or_moves_nothing(name):
    model = MACHINES[name](4)
    told = [label for c in listed(name, 4) for label in (c.label, *c.twins)]
    assert len(told) == len(set(told))
    rest = {c.label for c in candidates(model, merged=False)} - set(told)
    assert rest and all("leakage" in label for label in rest)  # leaks between two pieces of one hose


def test_fittings_that_throttle_make_places_of_the_pieces_of_a_hose():
    wide, narrow = (candidates(hoses.winch(4, g), ["external_leakage"]) for g in (1e-7, 2e-11))
    assert len(wide) == 2 < len(narrow)


def stiffly(model, time, opening):
    """Outputs (n, ny) by an L-stable method: fittings of a few millibars settle within microseconds."""
    flat = model.flat
    p, u = flat.parameter_vector(), opening[:, None]
    x = np.asarray(flat.start_given()(u[0], p, [])).ravel()
    return np.asarray(prepare(flat, method="implicit").run(time, u, p, x)[0])


def test_a_twin_is_added_and_excluded_by_its_own_name():
    model = hoses.winch(4)
    one = next(c for c in listed("winch", 4) if c.id == "external_leakage" and len(c.twins) >= 3)
    again = candidates(model, [one.twins[-1]])
    assert [c.label for c in again] == [one.label]
    assert not candidates(model, ["external_leakage at *hose_a*"], [one.twins[-1]])
    elsewhere = add_effect(model, "external_leakage", one.twins[-1].partition(" at ")[2])
    assert one.label not in {c.label for c in candidates(elsewhere)}


@pytest.mark.parametrize("effect", ["external_leakage", "relief_saturation", "line_compliance"])
def test_twins_run_alike_where_others_do_not(effect):
    """What the equations say of small disturbances holds for effects as large as they start, in a run."""
    values = {
        "external_leakage": {"conductance": 2e-12},
        "relief_saturation": {"pressure": 4e6, "conductance": 1e-11},
        "line_compliance": {"compliance": 2e-12},
    }[effect]
    model, time = hoses.winch(4), np.arange(0, 1.0, 0.01)
    opening = 0.3 * np.sin(2 * np.pi * 2 * time) + 0.2
    known = [c for c in candidates(model, [effect]) if "hose" in c.site.name]
    one = next(c for c in known if c.twins)
    twin, other = one.twins[-1].partition(" at ")[2], next(c.site.name for c in known if c is not one)
    added = [add_effect(model, effect, site, values) for site in (one.site.name, twin, other)]
    base, here, there, away = (stiffly(m, time, opening) for m in (model, *added))
    size = np.abs(here - base).max(axis=0)
    assert np.all(np.abs(here - there).max(axis=0) < 0.03 * size)
    assert np.any(np.abs(here - away).max(axis=0) > 0.3 * size)


class Sensed(Axis):
    """The carriage pushed through a force sensor."""

    sensor = ForceSensor()

    def equations(self):
        yield connect(self.force, self.motor.force)
        yield connect(self.motor.flange, self.sensor.a)
        yield connect(self.sensor.b, self.carriage.flange)
        yield self.position == self.carriage.position
        yield self.velocity == self.carriage.velocity


def test_both_sides_of_a_sensor_that_gives_nothing_are_one():
    places = sites(Model(Sensed(), "sensed"), "coulomb_friction")
    assert [len(twins) for twins in places.values()] == [1]


class Weighed(ValveBench):
    """The valve bench with a force sensor on the rod."""

    sensor = ForceSensor()

    def equations(self):
        *others, _, position = super().equations()
        yield from others
        yield connect(self.cylinder.rod, self.sensor.a)
        yield connect(self.sensor.b, self.load.flange)
        yield position


def test_seals_refine_the_friction_that_is_called_after_the_other_side_of_a_sensor():
    model = Model(Weighed(), "weighed", step=5e-4)
    (seals,), (dry,) = (candidates(model, [f"{name}_friction"]) for name in ("pressure_dependent", "coulomb"))
    assert len(dry.twins) == 1 and seals.refines(dry) and not dry.refines(seals)


class Metered(ValveBench):
    """The valve bench with a flow sensor in a line."""

    meter = FlowSensor()

    def equations(self):
        yield connect(self.spool, self.valve.spool)
        yield connect(self.supply.port, self.valve.supply)
        yield connect(self.tank.port, self.valve.tank)
        yield connect(self.valve.a, self.meter.a)
        yield connect(self.meter.b, self.cylinder.cap)
        yield connect(self.valve.b, self.cylinder.annulus)
        yield connect(self.cylinder.rod, self.load.flange)
        yield self.position == self.load.position


def test_a_flow_sensor_makes_no_places_of_its_own():
    plain, metered = (candidates(Model(kind(), "bench", step=5e-4)) for kind in (ValveBench, Metered))
    assert Counter(c.id for c in plain) == Counter(c.id for c in metered)


class Balance(Component):
    """A carriage between two side masses on springs; only the carriage is seen."""

    force = Input("N", "force", nominal=100.0)
    position = Output("m", "position", nominal=0.1)
    motor = ForceSource()
    carriage = LinearLoad(mass=50.0, load_force=0.0, friction=Viscous(viscous=200.0))
    left, right = Mass(mass=10.0), Mass(mass=10.0)
    left_spring, right_spring = SpringDamper(stiffness=1e4, damping=30.0), SpringDamper(stiffness=1e4, damping=30.0)

    def equations(self):
        yield connect(self.force, self.motor.force)
        yield connect(self.motor.flange, self.carriage.flange)
        yield connect(self.left_spring.a, self.left.flange)
        yield connect(self.left_spring.b, self.carriage.flange)
        yield connect(self.right_spring.a, self.right.flange)
        yield connect(self.right_spring.b, self.carriage.flange)
        yield self.position == self.carriage.position


def test_mirror_equal_places_are_one_and_unequal_ones_are_not():
    equal, unequal = Model(Balance(), "balance"), Model(Balance(right=Mass(mass=13.0)), "balance")
    assert sites(equal, "coulomb_friction") == {"carriage.flange": (), "left.flange": ("right.flange",)}
    assert set(sites(unequal, "coulomb_friction")) == {"carriage.flange", "left.flange", "right.flange"}


class Amplified(Component):
    """A command through a gain, a lag and a limit."""

    command = Input("1", "command", nominal=1.0)
    reading = Output("1", "what comes out", nominal=1.0)
    gain = Gain(k=2.0)
    lag = FirstOrderLag(time_constant=0.05)
    limit = Saturation(lower=-1.5, upper=1.5)
    last = FirstOrderLag(time_constant=0.02)

    def equations(self):
        yield connect(self.command, self.gain.u)
        yield connect(self.gain.y, self.lag.u)
        yield connect(self.lag.y, self.limit.u)
        yield connect(self.limit.y, self.last.u)
        yield self.reading == self.last.y


def test_a_delay_is_the_same_all_along_what_is_linear_and_a_deadband_along_a_gain():
    model = Model(Amplified(), "amplified")
    assert sites(model, "dead_time") == {"command": ("lag.u", "limit.u"), "last.u": ()}
    assert sites(model, "command_deadband") == {"command": ("lag.u",), "limit.u": (), "last.u": ()}


def test_what_is_said_of_laws_holds_for_them():
    """A delay and a lag are linear, play takes an offset along, a deadband does neither."""
    laws = {name: law_of(CATALOGUE[name], True) for name in ("dead_time", "spool_hysteresis", "command_deadband")}
    assert (laws["dead_time"].linear, laws["spool_hysteresis"].linear, laws["command_deadband"].linear) == (1, 0, 0)
    assert (laws["spool_hysteresis"].shifts, laws["command_deadband"].shifts) == (True, False)
    assert law_of(CATALOGUE["command_gain"], False).linear and not law_of(CATALOGUE["drift"], False).linear


class Loaded(Axis):
    """The carriage with a mass on it."""

    payload = AttachedMass(mass=20.0)

    def equations(self):
        yield from super().equations()
        yield connect(self.payload.flange, self.carriage.flange)


def test_two_masses_on_one_flange_are_one_payload_and_those_of_an_arm_are_two():
    assert sites(Model(Loaded(), "loaded"), "payload_error") == {"carriage.mass": ("payload.mass",)}
    assert set(sites(cehA.model(), "payload_error")) == {"arm.extra_mass", "arm.arm_mass"}


def test_a_mass_is_no_payload_to_look_for_beside_one_that_is_free_already():
    fixed = Model(Loaded(), "loaded")
    assert sites(fixed.with_settings({"carriage.mass": {"free": True}}), "payload_error") == {}
    assert sites(add_effect(fixed, "payload_error", "carriage.mass"), "payload_error") == {}
    small = fixed.with_settings({"payload.mass": {"free": True}})  # 20 kg cannot be a carriage 105 kg lighter
    assert sites(small, "payload_error") == {"carriage.mass": ()}
    assert set(sites(cehA.model().with_settings({"arm.arm_mass": {"free": True}}), "payload_error")) == {
        "arm.extra_mass"
    }


def test_a_displacement_is_none_beside_a_free_efficiency_that_scales_the_same_flow():
    pump = Pump(displacement=2e-7, return_ratio=0.8, loss=ConstantVolumetricEfficiency(efficiency=0.9))
    known = Model(PumpBench(pump=pump), "pump_bench")
    free = known.with_settings({"pump.loss.efficiency": {"free": True, "value": 0.8}})
    assert set(sites(known, "displacement_error")) == {"pump.displacement"} and not sites(free, "displacement_error")
    assert sites(free, "area_error") == sites(known, "area_error") != {}
    narrow = free.with_settings({"pump.loss.efficiency": {"bounds": (0.75, 0.85), "unit": "1"}})
    assert set(sites(narrow, "displacement_error")) == {"pump.displacement"}  # 15 % more does not fit in there


def test_the_own_machines_keep_lists_that_can_be_searched():
    assert len(candidates(cehA.model())) <= 125 and len(candidates(spool_valve.model())) <= 125


def test_what_moves_nothing_is_no_candidate():
    """The shaft of a drive that holds its speed, and lines that a pump at a given speed does not feel."""
    places = {c.label for c in candidates(cehA.model())}
    assert not {"coulomb_friction at motor.shaft", "line_friction at cylinder.cap"} & places
