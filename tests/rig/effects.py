"""The hidden effects by name. Ids are those of the catalogue where it has one; the equations here are the rig's own.

An effect is one of four kinds: fields of the C core, a change of base parameters, a stage of the command path, or a
property of a sensor. Options not given take the defaults listed here (a visible size on the default machine).
"""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass

from . import command_path, sensors
from .further import FURTHER
from .machines import machine_of, parameter_values

BOTH = ("cehA", "spool_valve")
ALL = (*BOTH, *FURTHER)
VALVES = ("spool_valve", "lift_boom", "test_cylinder")
COMMANDED = (*BOTH, "winch", "lift_boom")  # the others are given a wanted position, and command themselves


@dataclass(frozen=True)
class RigEffect:
    """How one effect enters the truth."""

    kind: str  # "field" | "parameter" | "command" | "sensor"
    defaults: Mapping[str, object]
    fields: Mapping[str, str] | None = None  # option -> C field, or parameter path by machine
    machines: tuple[str, ...] = BOTH


def _field(machines=BOTH, /, **options):
    """Option=(C field, default)."""
    defaults = {option: default for option, (_, default) in options.items()}
    return RigEffect("field", defaults, {option: field for option, (field, _) in options.items()}, machines)


def _factor(value, /, **paths):
    """A base parameter that differs from its value by a factor."""
    return RigEffect("parameter", {"factor": value}, paths, tuple(paths))


FIELDS = {
    "coulomb_friction": _field(ALL, force=("coulomb", 150.0)),
    "stribeck_friction": _field(
        ALL, kinetic=("coulomb", 100.0), extra=("breakaway", 80.0), velocity=("stribeck_velocity", 0.01)
    ),
    "asymmetric_friction": _field(ALL, force=("coulomb", 150.0), asymmetry=("asymmetry", 0.4)),
    "position_dependent_friction": _field(
        ALL, force=("coulomb", 150.0), share=("ripple", 0.5), length=("ripple_length", 0.05)
    ),
    "pressure_dependent_friction": _field(ALL, area=("per_pressure", 3e-5)),
    "presliding_friction": _field(
        stiffness=("bristle_stiffness", 2e6),
        damping=("bristle_damping", 1e3),
        kinetic=("bristle_kinetic", 120.0),
        static=("bristle_static", 160.0),
        velocity=("bristle_velocity", 0.005),
    ),
    "exact_friction": _field(("cehA",), on=("exact", 1.0)),
    "internal_leakage": _field(ALL, conductance=("leak", 1e-14)),
    "turbulent_leakage": _field(ALL, coefficient=("leak_turbulent", 1e-11)),
    "external_leakage": _field(ALL, cap=("leak_a", 3e-15), rod=("leak_b", 0.0)),
    "pump_slip": _field(("cehA",), conductance=("slip", 2e-14), speed=("slip_speed", 100.0)),
    "speed_dependent_efficiency": _field(("cehA",), share=("lost_share", 0.1), speed=("lost_speed", 50.0)),
    "entrained_air": _field(ALL, fraction=("air", 0.02), exponent=("air_exponent", 1.3)),
    "line_compliance": _field(ALL, cap=("hose_a", 3e-14), rod=("hose_b", 0.0)),
    "cavitation": _field(pressure=("lowest_pressure", 1.9e6)),
    "line_friction": _field(("spool_valve",), laminar=("line_laminar", 0.0), turbulent=("line_turbulent", 3e13)),
    "relief_saturation": _field(ALL, pressure=("relief_pressure", 3.6e6), conductance=("relief_conductance", 1e-11)),
    "check_valve_cracking": _field(ALL, pressure=("refill_pressure", 1.9e6), conductance=("refill_conductance", 1e-13)),
    "end_stop": _field(
        (*BOTH, "lift_boom", "test_cylinder"),
        low=("stop_low", -0.03),
        high=("stop_high", 0.06),
        stiffness=("stop_stiffness", 2e7),
        damping=("stop_damping", 2.0),
    ),
    "structural_compliance": _field(
        stiffness=("coupling_stiffness", 1e7), damping=("coupling_damping", 3e3), rod_mass=("rod_mass", 2.0)
    ),
    "backlash": _field(
        gap=("coupling_gap", 5e-4),
        stiffness=("coupling_stiffness", 3e7),
        damping=("coupling_damping", 5e3),
        rod_mass=("rod_mass", 2.0),
    ),
    "constant_load": _field(ALL, force=("constant_force", 200.0)),
    "external_push": _field(ALL, force=("push_force", 300.0), start=("push_start", 15.0), end=("push_end", 18.0)),
    "payload_change": _field(ALL, mass=("payload_step", 10.0), time=("payload_time", 20.0)),
    "gravity_tilt": _field(("cehA",), angle=("tilt", 0.1)),
    "actuator_lag": _field(time_constant=("command_lag", 0.03)),
    "motor_droop": _field(("cehA", "winch"), resistance=("droop", 50.0)),
    "drift": _field(COMMANDED, rate=("drift", 2e-3)),
    "viscosity_warming": _field(ALL, share=("warming", 0.5), time_constant=("warming_time", 60.0)),
    "pump_ripple": _field(("cehA",), share=("ripple_flow", 0.05), pistons=("pistons", 7.0)),
    "cogging": _field(("cehA",), speed=("cogging", 10.0), poles=("poles", 8.0)),
    "valve_overlap": RigEffect("field", {"share": 0.03}, None, VALVES),
    "asymmetric_overlap": _field(
        VALVES,
        pressure_a=("overlap_pa", 0.03),
        tank_a=("overlap_at", 0.01),
        pressure_b=("overlap_pb", 0.01),
        tank_b=("overlap_bt", 0.03),
    ),
    "flow_saturation": _field(("spool_valve",), knee=("flow_knee", 0.4), limit=("flow_limit", 0.8)),
    "supply_droop": _field(VALVES, resistance=("supply_resistance", 1e10), volume=("supply_volume", 1e-3)),
    "load_dependent_flow": _field(("spool_valve",), share=("load_sensitivity", 0.2)),
    "load_spring": _field(("spool_valve",), stiffness=("spring", 3e3)),
    "displacement_error": _factor(1.05, cehA="pump.displacement", spool_valve="valve.orifice.flow_coefficient"),
    "area_error": _factor(1.05, cehA="cylinder.cap_area", spool_valve="cylinder.cap_area"),
    "linkage_error": _factor(1.02, cehA="arm.pin_length"),
    "payload_error": _factor(
        1.2,
        cehA="arm.extra_mass",
        spool_valve="load.mass",
        winch="load.mass",
        lift_boom="boom.extra_mass",
        test_cylinder="load.mass",
    ),
    "viscous_friction": _factor(3.0, cehA="cylinder.friction.viscous", spool_valve="cylinder.friction.viscous"),
    "spool_lag": _factor(0.5, spool_valve="slide.natural_frequency"),
}
_SPOOL = {  # where the bigger machine needs another size to show the effect
    "coulomb_friction": {"force": 500.0},
    "asymmetric_friction": {"force": 500.0},
    "position_dependent_friction": {"force": 500.0},
    "stribeck_friction": {"kinetic": 300.0, "extra": 300.0},
    "presliding_friction": {"kinetic": 400.0, "static": 550.0},
    "internal_leakage": {"conductance": 1e-12},
    "turbulent_leakage": {"coefficient": 1e-9},
    "external_leakage": {"cap": 1e-12},
    "line_compliance": {"cap": 5e-13},
    "cavitation": {"pressure": 6.1e6},
    "relief_saturation": {"pressure": 10e6},
    "check_valve_cracking": {"pressure": 6.2e6, "conductance": 1e-11},
    "end_stop": {"low": 0.42, "high": 0.48},
    "structural_compliance": {"stiffness": 2e6},
    "backlash": {"gap": 2e-3},
    "constant_load": {"force": 500.0},
    "external_push": {"force": 1000.0},
    "payload_change": {"mass": 150.0},
    "viscosity_warming": {"share": 0.8},
    "command_saturation": {"limit": 0.5},
}
DEFAULTS = {
    "spool_valve": _SPOOL,
    "winch": {
        **_SPOOL,
        "line_compliance": {"cap": 2e-13},
        "check_valve_cracking": {"pressure": 9e6},
        "motor_droop": {"resistance": 0.1},
    },
    "lift_boom": {**_SPOOL, "line_compliance": {"cap": 1e-13}, "end_stop": {"low": 0.2, "high": 0.24}},
    "test_cylinder": {
        **_SPOOL,
        "relief_saturation": {"pressure": 5.5e6},
        "end_stop": {"low": 0.44, "high": 0.455},
        "viscosity_warming": {"share": 0.8, "time_constant": 30.0},
    },
}
EFFECTS: dict[str, RigEffect] = {
    **FIELDS,
    **{stage.__name__: RigEffect("command", defaults, None, COMMANDED) for stage, defaults in command_path.STAGES},
    "dead_time": RigEffect("command", {"seconds": 0.03}, None, ALL),
    **{name: RigEffect("sensor", defaults, None, ALL) for name, defaults in sensors.DEFAULTS.items()},
}
OWN = {("test_cylinder", "spool_hysteresis"): _field(("test_cylinder",), width=("play", 0.04))}  # behind its controller


def effect_of(machine: str, name: str) -> RigEffect | None:
    """The effect of that name as this machine has it; None where it cannot have it."""
    own = OWN.get((machine, name)) or EFFECTS.get(name)
    return own if own and machine in own.machines else None


def default_options(machine: str, name: str) -> dict:
    """The options of an effect where none are given."""
    return {**effect_of(machine, name).defaults, **DEFAULTS.get(machine, {}).get(name, {})}


def named_effects(machine: str, effects) -> list[tuple[str, dict]]:
    """Effects with all their options, from a mapping or a sequence of (name, options) pairs."""
    pairs = list(effects.items()) if isinstance(effects, Mapping) else list(effects or ())
    answer = []
    for name, options in pairs:
        effect = effect_of(machine, name)
        if effect is None:
            able = [key for key in EFFECTS if effect_of(machine, key)]
            raise KeyError(f"rig: no effect {name!r} for {machine} (there are {', '.join(able)}).")
        wrong = set(options or {}) - set(effect.defaults)
        if wrong:
            raise KeyError(f"rig: {name} has no option {sorted(wrong)} (it has {', '.join(effect.defaults)}).")
        full = {**default_options(machine, name), **(options or {})}
        if effect.kind == "sensor" and full["output"] not in machine_of(machine).outputs:
            raise KeyError(f"rig: {name} needs output=one of {', '.join(machine_of(machine).outputs)}.")
        answer.append((name, full))
    return answer


def true_values(machine: str, changes: Mapping[str, float], effects) -> tuple[dict, dict]:
    """Base parameters and C fields after every effect that lives in them."""
    parameters = parameter_values(machine, changes)
    fields = {}
    for name, options in effects:
        effect = effect_of(machine, name)
        if effect.kind == "parameter":
            path = effect.fields[machine]
            parameters[path] *= options["factor"]
        elif name == "valve_overlap":
            fields |= dict.fromkeys(("overlap_pa", "overlap_at", "overlap_pb", "overlap_bt"), options["share"])
        elif effect.kind == "field":
            fields |= {effect.fields[option]: float(value) for option, value in options.items()}
        if name == "cavitation":
            fields["separates"] = 1.0
    _oil_is_one_kind(machine, fields)
    return parameters, fields


def _oil_is_one_kind(machine, fields):
    """Column separation follows the amount of oil, which free air or a hose that yields would have to be part of."""
    if fields.get("separates") and any(fields.get(name) for name in ("air", "hose_a", "hose_b")):
        raise ValueError(f"rig: {machine} cannot have cavitation beside entrained_air or line_compliance.")


def command_stages(machine: str, effects) -> list:
    """What happens to a command before it reaches the machine, in physical order: functions of a signal."""
    wanted = {name: options for name, options in effects if effect_of(machine, name).kind == "command"}
    stages = [stage for stage, _ in command_path.STAGES if stage.__name__ in wanted]
    return [functools.partial(stage, **wanted[stage.__name__]) for stage in stages]


def changed_command(machine: str, signal, effects):
    """The command as it reaches the machine."""
    for stage in command_stages(machine, effects):
        signal = stage(signal)
    return signal
