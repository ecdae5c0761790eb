"""Both machines against a simulator that shares no code with them."""

from __future__ import annotations

import pytest

from hydrotwin.models.effects import candidates
from hydrotwin.records import read_record
from tests.machines.make_references import REFERENCES
from tests.machines.recordings import MODELS, relative_error, rig_record

FINE = {"cehA": {}, "spool_valve": {"valve.orifice.transition_pressure": 1e3}}  # the rig's own value


@pytest.mark.parametrize("machine", MODELS)
@pytest.mark.parametrize("command", ["drive", "steps"])
def test_with_fine_steps_model_and_rig_are_the_same_machine(machine, command):
    model = MODELS[machine]().with_parameters(FINE[machine])
    error = relative_error(model, rig_record(machine, command), step=1e-4)
    assert max(error.values()) < 1e-7, error


@pytest.mark.parametrize("machine", MODELS)
@pytest.mark.parametrize(("command", "worst"), [("drive", 5e-5), ("steps", 1e-3)])
def test_with_its_usual_step_a_model_stays_far_below_sensor_noise(machine, command, worst):
    error = relative_error(MODELS[machine](), rig_record(machine, command))
    assert max(error.values()) < worst, error


CHANGES = {
    "cehA": {
        "motor.gain": 104.0, "motor.time_constant": 0.05, "pump.displacement": 1.2e-7, "cylinder.cap_area": 9e-4,
        "cylinder.rod_area": 5e-4, "cylinder.cap_dead_volume": 1.1e-4, "cylinder.rod_dead_volume": 9e-5,
        "cylinder.oil.bulk_modulus": 1.1e9, "cylinder.friction.kinetic": 20.0, "cylinder.friction.static": 45.0,
        "cylinder.friction.viscous": 1200.0, "cylinder.friction.stribeck_velocity": 0.006,
        "cylinder.friction.smoothing_velocity": 3e-3, "arm.extra_mass": 30.0, "arm.arm_mass": 4.0, "arm.length": 0.6,
        "arm.pin_length": 0.21, "arm.retracted_length": 0.29, "precharge": 3e6,
    },
    "spool_valve": {
        "slide.natural_frequency": 90.0, "slide.damping": 0.6, "solenoid.gain": 0.9, "solenoid.offset": 0.01,
        "valve.orifice.flow_coefficient": 5e-8, "supply.pressure": 150e5, "tank.pressure": 8e5,
        "cylinder.cap_area": 1.7e-3, "cylinder.rod_area": 1.1e-3, "cylinder.cap_dead_volume": 3e-4,
        "cylinder.rod_dead_volume": 5e-4, "cylinder.rod_reference": 1.0, "cylinder.oil.bulk_modulus": 1.3e9,
        "cylinder.friction.viscous": 6000.0, "load.mass": 200.0, "load.load_force": 2500.0, "start_pressure_b": 40e5,
    },
}  # fmt: skip


@pytest.mark.parametrize("machine", MODELS)
def test_every_parameter_means_the_same_in_model_and_rig(machine):
    """Every one changed at once: a parameter that acts elsewhere, or not at all, would show."""
    record = rig_record(machine, "drive", duration=10.0, parameters=CHANGES[machine])
    model = MODELS[machine]().with_parameters(CHANGES[machine] | FINE[machine])
    error = relative_error(model, record, step=1e-4)
    assert max(error.values()) < 1e-7, error
    assert max(relative_error(MODELS[machine](), record).values()) > 0.05


@pytest.mark.parametrize(
    ("machine", "site", "force", "worst"),
    [("cehA", "arm.pin", 55.0, 1e-2), ("cehA", "arm.pin", 500.0, 1.5e-2), ("spool_valve", "cylinder.rod", 250.0, 2e-4)],
)
def test_what_dry_friction_holds_does_not_move_on_its_oil(machine, site, force, worst):
    """The rig sticks exactly. What gives half a micrometre leaves 1.8 times the noise of the force on the piston."""
    record = rig_record(machine, duration=10.0, effects={"coulomb_friction": {"force": force}})
    (found,) = (c for c in candidates(MODELS[machine](), ["coulomb_friction"]) if c.site.name == site)
    model = MODELS[machine]().plus([found.addition]).with_parameters({"coulomb_friction.force": force})
    error = relative_error(model, record)
    assert max(error.values()) < worst < 0.1 * max(relative_error(MODELS[machine](), record).values()), error


def test_play_with_the_contact_of_the_rig_is_the_play_of_the_rig():
    """The rig's rod is light here: the model's weighs nothing."""
    play = {"gap": 5e-4, "stiffness": 3e7, "damping": 5e3, "rod_mass": 0.5}
    record = rig_record("cehA", duration=10.0, effects={"backlash": play})
    (found,) = candidates(MODELS["cehA"](), ["backlash"])
    values = {"gap": 5e-4, "compliance": 1 / 3e7, "relaxation": 5e3 / 3e7}
    loose = MODELS["cehA"]().plus([found.addition]).with_parameters({f"backlash.{k}": v for k, v in values.items()})
    error = relative_error(loose, record)
    assert max(error.values()) < 3.5e-3 < 0.3 * max(relative_error(MODELS["cehA"](), record).values()), error


@pytest.mark.parametrize("machine", MODELS)
def test_a_model_reproduces_the_reference_that_lies_beside_it(machine):
    path = REFERENCES[machine]
    assert path.stat().st_size < 100_000
    error = relative_error(MODELS[machine](), read_record(path))
    assert max(error.values()) < 2e-4, error
