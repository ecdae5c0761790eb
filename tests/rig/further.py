"""Further machines, of which hydrotwin ships no model: a winch, a boom, a test cylinder under a controller."""

from __future__ import annotations

import numpy as np

from .machine import GRAVITY, RigMachine, table

_WINCH, _WINCH_FIELDS = table("""
    motor.gain                        30      gain
    motor.time_constant               0.05    time_constant
    pump.displacement                 4e-6    displacement
    hydraulic_motor.displacement      1.6e-5  motor_displacement
    hose_a.volume                     1e-3    volume_a
    hose_b.volume                     1e-3    volume_b
    hose_a.oil.bulk_modulus           8e8     beta_a
    hose_b.oil.bulk_modulus           8e8     beta_b
    boost.pressure                    2e6     boost
    feed.law.conductance              2e-10   boost_conductance
    drum.radius                       0.01    radius
    drum.inertia                      0.05    inertia
    load.mass                         1200    mass
    load.friction.viscous             4000    viscous
""")
_BOOM, _BOOM_FIELDS = table("""
    slide.natural_frequency           90      frequency
    slide.damping                     0.7     damping
    valve.orifice.flow_coefficient    3.5e-8  flow_gain
    supply.pressure                   180e5   supply
    tank.pressure                     5e5     tank
    cylinder.cap_area                 1.96e-3 area_a
    cylinder.rod_area                 1.37e-3 area_b
    cylinder.cap_dead_volume          3e-4    dead_a
    cylinder.rod_dead_volume          3e-4    dead_b
    cylinder.rod_reference            0.5     stroke
    cylinder.oil.bulk_modulus         1e9     beta
    cylinder.friction.viscous         15000   viscous
    boom.extra_mass                   100     payload
    boom.arm_mass                     80      boom_mass
    boom.length                       2.5     length
    boom.pin_length                   0.6     pin
    boom.base_length                  0.8     foot
    boom.retracted_length             0.82    retracted
    start_pressure_b                  50e5    -
""")
_CYLINDER, _CYLINDER_FIELDS = table("""
    controller.gain                   40      control_gain
    slide.natural_frequency           150     frequency
    slide.damping                     0.8     damping
    valve.orifice.flow_coefficient    6e-8    flow_gain
    supply.pressure                   160e5   supply
    tank.pressure                     5e5     tank
    hose_a.volume                     5e-4    hose_volume_a
    hose_b.volume                     5e-4    hose_volume_b
    hose_a.oil.bulk_modulus           8e8     hose_beta_a
    hose_b.oil.bulk_modulus           8e8     hose_beta_b
    line_a.law.conductance            2e-10   hose_conductance_a
    line_b.law.conductance            2e-10   hose_conductance_b
    cylinder.cap_area                 1.96e-3 area_a
    cylinder.rod_area                 1.37e-3 area_b
    cylinder.cap_dead_volume          2e-4    dead_a
    cylinder.rod_dead_volume          2e-4    dead_b
    cylinder.rod_reference            0.9     stroke
    cylinder.oil.bulk_modulus         1e9     beta
    cylinder.friction.viscous         4000    viscous
    load.mass                         350     mass
    load.load_force                   2000    load
    start_pressure_b                  60e5    -
""")


def _winch_start(p, fields, s, command):
    """The load hangs on the rope, the return hose stands at boost pressure."""
    low = p["boost.pressure"]
    weight = p["load.mass"] * GRAVITY * p["drum.radius"]
    return [0.0, low + weight / p["hydraulic_motor.displacement"], low, s, 0.0]


def _boom_start(p, fields, theta, command):
    """At rest; the cap side carries the boom."""
    pin, foot = p["boom.pin_length"], p["boom.base_length"]
    lever = pin * foot * np.cos(theta) / np.sqrt(pin**2 + foot**2 + 2 * pin * foot * np.sin(theta))
    moment = (p["boom.extra_mass"] + p["boom.arm_mass"] / 2) * p["boom.length"] * GRAVITY * np.cos(theta)
    b = p["start_pressure_b"]
    a = (moment / lever + b * p["cylinder.rod_area"]) / p["cylinder.cap_area"]
    return [0.0, 0.0, a, b, theta, 0.0, p["supply.pressure"]]


def _cylinder_start(p, fields, x, command):
    """At rest, the hoses at the pressures of their chambers, the spool in its centre."""
    b = p["start_pressure_b"]
    a = (p["load.load_force"] + b * p["cylinder.rod_area"]) / p["cylinder.cap_area"]
    return [0.0, 0.0, a, b, a, b, x, 0.0, p["controller.gain"] * (command - x), p["supply.pressure"]]


FURTHER = {
    "winch": RigMachine(
        name="winch",
        input="command",
        input_unit="V",
        outputs=("rope_position", "motor_speed", "pressure_a", "pressure_b"),
        units=("m", "rad/s", "Pa", "Pa"),
        file_units=("mm", "rad/s", "bar", "bar"),
        noise=(2e-4, 0.2, 2e4, 1e4),
        parameters=_WINCH,
        fields=_WINCH_FIELDS,
        start_output="rope_position",
        start_value=1.5,
        command_limit=5.0,
        position="rope_position",
        span=(0.2, 2.8),
        path_band=(0.02, 0.3),
        fastest=0.37,
        speed_per_command=(30 * 4e-6 / 1.6e-5 * 0.01,) * 2,
        start_state=_winch_start,
        start_pressure="boost.pressure",
        full_scale=(5.0, 400.0, 2.5e7, 6e6),
    ),
    "lift_boom": RigMachine(
        name="lift_boom",
        input="current",
        input_unit="1",
        outputs=("boom_angle", "spool", "pressure_a", "pressure_b", "rod_position"),
        units=("rad", "1", "Pa", "Pa", "m"),
        file_units=("deg", "1", "bar", "bar", "mm"),
        noise=(2e-4, 1e-3, 2e4, 2e4, 1e-4),
        parameters=_BOOM,
        fields=_BOOM_FIELDS,
        start_output="boom_angle",
        start_value=0.2,
        command_limit=1.0,
        position="rod_position",
        span=(0.08, 0.42),
        path_band=(0.02, 0.25),
        fastest=0.05,
        speed_per_command=(0.054, 0.06),
        start_state=_boom_start,
        start_pressure="start_pressure_b",
        full_scale=(3.0, 2.5, 2.5e7, 2.5e7, 0.6),
    ),
    "test_cylinder": RigMachine(
        name="test_cylinder",
        input="reference",
        input_unit="m",
        outputs=("position", "spool", "pressure_a", "pressure_b"),
        units=("m", "1", "Pa", "Pa"),
        file_units=("mm", "1", "bar", "bar"),
        noise=(1e-4, 1e-3, 2e4, 2e4),
        parameters=_CYLINDER,
        fields=_CYLINDER_FIELDS,
        start_output="position",
        start_value=0.45,
        command_limit=0.09,
        position="position",
        span=(0.2, 0.7),
        path_band=(0.02, 0.3),
        fastest=0.09,
        speed_per_command=(1.0, 1.0),
        start_state=_cylinder_start,
        start_pressure="start_pressure_b",
        full_scale=(1.0, 2.5, 2.5e7, 2.5e7),
        positioned=True,
    ),
}
