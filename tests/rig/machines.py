"""The shipped machines and those beside them, by name. Values: Table 1 of the C-EHA paper, else ours."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from .further import FURTHER
from .machine import GRAVITY, RigMachine, table


def _cehA_start(p, fields, theta, command):
    """At rest on the rod-side precharge; the cap pressure carries arm and load."""
    pin, base = p["arm.pin_length"], p["arm.base_length"]
    s = np.sqrt(pin**2 + base**2 + 2 * pin * base * np.sin(theta))
    lever = pin * base * np.cos(theta) / s
    mass = p["arm.extra_mass"] + p["arm.arm_mass"] / 2
    force = mass * GRAVITY * p["arm.length"] * np.cos(theta) / lever
    rod, x = p["precharge"], s - p["arm.retracted_length"]
    cap = (force + rod * p["cylinder.rod_area"]) / p["cylinder.cap_area"]
    xr = x + _preload(fields, force)
    volumes = (
        p["cylinder.cap_dead_volume"] + p["cylinder.cap_area"] * xr,
        p["cylinder.rod_dead_volume"] - p["cylinder.rod_area"] * xr,
    )
    oil = _oil(fields, (cap, rod), volumes, p["cylinder.oil.bulk_modulus"])
    return [0.0, cap, rod, theta, 0.0, xr, 0.0, 0.0, command, 0.0, *oil]


def _spool_start(p, fields, x, command):
    """At rest, spool where the command holds it; chamber A carries the load."""
    b = p["start_pressure_b"]
    a = (p["load.load_force"] + b * p["cylinder.rod_area"]) / p["cylinder.cap_area"]
    s = p["solenoid.gain"] * command + p["solenoid.offset"]
    rod = x + _preload(fields, p["load.load_force"])
    volumes = (
        p["cylinder.cap_dead_volume"] + p["cylinder.cap_area"] * rod,
        p["cylinder.rod_dead_volume"] + p["cylinder.rod_area"] * (p["cylinder.rod_reference"] - rod),
    )
    oil = _oil(fields, (a, b), volumes, p["cylinder.oil.bulk_modulus"])
    return [s, 0.0, a, b, x, 0.0, rod, 0.0, 0.0, command, p["supply.pressure"], *oil]


def _oil(fields, pressures, volumes, beta):
    """Oil in each chamber as a volume at the lowest pressure it bears [m3]; below it, only the volume itself."""
    above = [max(p - fields["lowest_pressure"], 0.0) for p in pressures]
    return [V * np.exp(p / beta) for p, V in zip(above, volumes, strict=True)]


def _preload(fields, force):
    if fields["coupling_stiffness"] <= 0:
        return 0.0
    return force / fields["coupling_stiffness"] + np.sign(force) * fields["coupling_gap"] / 2


_CEHA, _CEHA_FIELDS = table("""
    motor.gain                            120        gain
    motor.time_constant                   0.03       time_constant
    pump.displacement                     1.05e-7    displacement
    cylinder.cap_area                     8.042e-4   area_a
    cylinder.rod_area                     6.319e-4   area_b
    cylinder.cap_dead_volume              8e-5       dead_a
    cylinder.rod_dead_volume              8e-5       dead_b
    cylinder.oil.bulk_modulus             1.747e9    beta
    cylinder.friction.kinetic             1.87       kinetic
    cylinder.friction.static              13.15      static_force
    cylinder.friction.viscous             741.36     viscous
    cylinder.friction.stribeck_velocity   0.0028     stribeck
    cylinder.friction.smoothing_velocity  1e-3       smoothing
    arm.extra_mass                        46.7       extra_mass
    arm.arm_mass                          1.64       arm_mass
    arm.length                            0.488      length
    arm.pin_length                        0.225      pin
    arm.base_length                       nan        base
    arm.retracted_length                  0.3055     retracted
    precharge                             2e6        -
""")
_CEHA["arm.base_length"] = float(np.sqrt(_CEHA["arm.retracted_length"] ** 2 - _CEHA["arm.pin_length"] ** 2))

_SPOOL, _SPOOL_FIELDS = table("""
    slide.natural_frequency         120      frequency
    slide.damping                   0.8      damping
    solenoid.gain                   1        command_gain
    solenoid.offset                 0        offset
    valve.orifice.flow_coefficient  6e-8     flow_gain
    supply.pressure                 180e5    supply
    tank.pressure                   5e5      tank
    cylinder.cap_area               1.96e-3  area_a
    cylinder.rod_area               1.37e-3  area_b
    cylinder.cap_dead_volume        4e-4     dead_a
    cylinder.rod_dead_volume        4e-4     dead_b
    cylinder.rod_reference          0.9      stroke
    cylinder.oil.bulk_modulus       1e9      beta
    cylinder.friction.viscous       4000     viscous
    load.mass                       350      mass
    load.load_force                 4000     load
    start_pressure_b                60e5     -
""")

MACHINES = {
    "cehA": RigMachine(
        name="cehA",
        input="command",
        input_unit="V",
        outputs=("arm_angle", "motor_speed", "rod_position", "pressure_cap", "pressure_rod", "piston_force"),
        units=("rad", "rad/s", "m", "Pa", "Pa", "N"),
        file_units=("deg", "rad/s", "mm", "bar", "bar", "N"),
        noise=(1e-4, 0.3, 2e-5, 2e4, 2e4, 10.0),
        parameters=_CEHA,
        fields=_CEHA_FIELDS,
        start_output="arm_angle",
        start_value=0.12,
        command_limit=5.0,
        position="rod_position",
        span=(-0.032, 0.072),
        path_band=(0.05, 0.45),
        fastest=0.078,
        speed_per_command=(120 * 1.05e-7 / 8.042e-4,) * 2,
        start_state=_cehA_start,
        start_pressure="precharge",
        full_scale=(3.0, 1200.0, 0.15, 1e7, 1e7, 2e4),
    ),
    "spool_valve": RigMachine(
        name="spool_valve",
        input="current",
        input_unit="1",
        outputs=("position", "spool", "pressure_a", "pressure_b", "velocity"),
        units=("m", "1", "Pa", "Pa", "m/s"),
        file_units=("mm", "1", "bar", "bar", "m/s"),
        noise=(1e-4, 1e-3, 2e4, 2e4, 5e-4),
        parameters=_SPOOL,
        fields=_SPOOL_FIELDS,
        start_output="position",
        start_value=0.45,
        command_limit=1.0,
        position="position",
        span=(0.2, 0.7),
        path_band=(0.02, 0.25),
        fastest=0.1,
        speed_per_command=(0.104, 0.099),
        start_state=_spool_start,
        start_pressure="start_pressure_b",
        full_scale=(0.8, 2.5, 2.5e7, 2.5e7, 0.5),
    ),
}


def machine_of(name: str) -> RigMachine:
    """A machine, shipped or further, by name."""
    every = {**MACHINES, **FURTHER}
    if name not in every:
        raise KeyError(f"rig: no machine {name!r} (there are {', '.join(every)}).")
    return every[name]


def sensor_noise(machine: str, scale: float = 1.0) -> dict[str, float]:
    """Realistic standard deviations of the sensors [SI], times ``scale``."""
    m = machine_of(machine)
    return {name: scale * sigma for name, sigma in zip(m.outputs, m.noise, strict=True)}


def parameter_values(machine: str, changes: Mapping[str, float]) -> dict[str, float]:
    """The defaults with some changed by name; the base length follows pin and retracted length unless given."""
    defaults = machine_of(machine).parameters
    unknown = set(changes) - set(defaults)
    if unknown:
        raise KeyError(f"rig: {machine} has no parameter {sorted(unknown)} (there are {', '.join(defaults)}).")
    values = {**defaults, **changes}
    if machine == "cehA" and "arm.base_length" not in changes:
        values["arm.base_length"] = float(np.sqrt(values["arm.retracted_length"] ** 2 - values["arm.pin_length"] ** 2))
    return values
