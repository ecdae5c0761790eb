"""How large an effect is: its options at a level between 0 (absent) and 1 (the largest that is plausible).

Most options grow in proportion; limits that cut something off move from where nothing reaches them inward.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

BODY = 0.7  # of the way from the outermost value to the usual one: as far in as a limit moves


@dataclass(frozen=True)
class Facts:
    """What the machine does without the effect, over the fit recordings, SI.

    command, slew: largest magnitude and rate of change between samples; pressure: (least, median, largest);
    travel: (least, largest) of the rod [m]; rest: the same of where recordings begin; spread: largest less least of the
    output that a sensor effect sits on. sign: of effects that may go either way. seconds: length of a recording.
    second: index into pairs of limits, those of the actuator and those of the larger machines.
    """

    machine: str
    command: float
    slew: float
    pressure: tuple[float, float, float]
    travel: tuple[float, float]
    rest: tuple[float, float]
    output: str
    spread: float
    sign: float
    seed: int
    seconds: float

    @property
    def second(self) -> int:
        return int(self.machine != "cehA")


Options = Callable[[float, Facts], dict]


def grown(**largest) -> Options:
    """Each option in proportion to the level; a pair of limits is one for each machine."""
    return lambda level, f: {name: level * _own(limit, f) for name, limit in largest.items()}


def signed(**largest) -> Options:
    """As `grown`, up or down."""
    return lambda level, f: {name: f.sign * level * _own(limit, f) for name, limit in largest.items()}


def factor(largest, option="factor") -> Options:
    """1 +- level times the largest share."""
    return lambda level, f: {option: 1 + f.sign * level * _own(largest, f)}


def commanded(option, share, *, sign=False) -> Options:
    """A share of the largest command."""
    return lambda level, f: {option: (f.sign if sign else 1.0) * level * share * f.command}


def _own(limit, f):
    return limit[f.second] if isinstance(limit, tuple) else limit


def _within(outer, inner, level):
    return outer + level * (inner - outer)


def _presliding(level, f):
    kinetic = level * (600.0, 2000.0)[f.second]
    stiffness = kinetic / 6e-5  # bristles bend by as much whatever the force
    return {"kinetic": kinetic, "static": 1.35 * kinetic, "stiffness": stiffness, "damping": 5e-4 * stiffness}


def _along(level, f):
    """Friction that changes slowly along the stroke, as a rod out of line gives it."""
    force, travel = level * (1000.0, 3500.0)[f.second], f.travel[1] - f.travel[0]
    return {"force": force, "share": 0.8, "length": 3 * travel}


def _push(level, f):
    force = f.sign * level * (3000.0, 10000.0)[f.second]
    return {"force": force, "start": 0.375 * f.seconds, "end": 0.45 * f.seconds}


def _relief(level, f):
    _, middle, high = f.pressure
    return {"pressure": _within(high, high - BODY * (high - middle), level), "conductance": (1e-11, 1e-10)[f.second]}


def _refill(level, f):
    low, middle, _ = f.pressure
    full = (1e-12, 1e-11)[f.second]
    if low < 0:  # a valve opens towards a tank, not towards a vacuum: here it is its size that grows
        return {"pressure": 0.0, "conductance": level * full}
    return {"pressure": _within(low, low + BODY * (middle - low), level), "conductance": full}


def _cavitation(level, f):
    return {"pressure": _within(max(f.pressure[0], -1e5), 1e5, level)}  # a vacuum, if pressures are gauge: -1 bar


def _end_stop(level, f):
    """From the ends of the travel inward, but not past where the machine rests: it would begin pressed into a stop."""
    low, high = f.travel
    room = level * 0.35 * (high - low)
    return {"low": min(low + room, f.rest[0]), "high": max(high - room, f.rest[1]), "stiffness": 2e7}


def _stiff(softest) -> Options:
    """From 3e8 N/m down: softer by the same factor per level."""
    return lambda level, f: {"stiffness": 3e8 * (_own(softest, f) / 3e8) ** level}


def _saturation(level, f):
    return {"limit": _within(f.command, 0.3 * f.command, level)}


def _flow_saturation(level, f):
    knee = _within(f.command, 0.25 * f.command, level)
    return {"knee": knee, "limit": knee + 0.3 * f.command}


def _rate_limit(level, f):
    return {"rate": 100 * f.slew * (2e-4) ** level}


def _sensor(**shares) -> Options:
    """On the output drawn for the case; shares of its spread."""
    return lambda level, f: {"output": f.output, **{n: level * share * f.spread for n, share in shares.items()}}


def _sensor_signed(**shares) -> Options:
    return lambda level, f: {"output": f.output, **{n: f.sign * level * s * f.spread for n, s in shares.items()}}


def _ripple(level, f):
    """Seven periods over the span of the output, as a scale with a coarse pitch has them."""
    return {"output": f.output, "amplitude": 0.1 * level * f.spread, "period": f.spread / 7}


AMPLITUDES: dict[str, Options] = {
    "coulomb_friction": grown(force=(1000.0, 3500.0)),
    "stribeck_friction": grown(kinetic=(600.0, 2000.0), extra=(480.0, 1600.0)),
    "asymmetric_friction": grown(force=(1000.0, 3500.0)),
    "position_dependent_friction": _along,
    "pressure_dependent_friction": grown(area=(2e-4, 3e-4)),
    "presliding_friction": _presliding,
    "viscous_friction": lambda level, f: {"factor": 1 + 4 * level},
    "internal_leakage": grown(conductance=1e-11),
    "turbulent_leakage": grown(coefficient=(5e-9, 2e-8)),
    "external_leakage": grown(cap=1e-11),
    "pump_slip": grown(conductance=1e-11),
    "speed_dependent_efficiency": grown(share=0.3),
    "displacement_error": factor(0.15),
    "entrained_air": grown(fraction=0.1),
    "line_compliance": grown(cap=(2e-12, 8e-12)),
    "line_friction": grown(turbulent=1e15),
    "cavitation": _cavitation,
    "check_valve_cracking": _refill,
    "relief_saturation": _relief,
    "area_error": factor(0.1),
    "end_stop": _end_stop,
    "backlash": grown(gap=5e-3),
    "structural_compliance": _stiff((1e6, 5e5)),
    "payload_error": factor(0.5),
    "gravity_tilt": signed(angle=0.2),
    "constant_load": signed(force=(1000.0, 4000.0)),
    "linkage_error": factor(0.05),
    "valve_overlap": grown(share=0.22),
    "asymmetric_overlap": grown(pressure_a=0.2, tank_a=0.07, pressure_b=0.07, tank_b=0.2),
    "null_bias": commanded("value", 0.1, sign=True),
    "spool_hysteresis": commanded("width", 0.2),
    "flow_saturation": _flow_saturation,
    "supply_droop": lambda level, f: {"resistance": max(level * 5e10, 2e8)},
    "load_dependent_flow": grown(share=0.5),
    "spool_lag": lambda level, f: {"factor": 1 - 0.8 * level},
    "dead_time": grown(seconds=0.24),
    "actuator_lag": lambda level, f: {"time_constant": max(0.15 * level, 2e-4)},
    "command_deadband": commanded("width", 0.2),
    "command_saturation": _saturation,
    "rate_limit": _rate_limit,
    "direction_asymmetry": factor(0.4, "ratio"),
    "motor_droop": grown(resistance=300.0),
    "drift": signed(rate=5e-3),
    "sensor_bias": _sensor_signed(value=0.1),
    "sensor_scale": lambda level, f: {"output": f.output, "factor": 1 + 0.2 * f.sign * level},
    "sensor_delay": lambda level, f: {"output": f.output, "seconds": 0.2 * level},
    "sensor_lag": lambda level, f: {"output": f.output, "time_constant": 0.2 * level},
    "sensor_hysteresis": _sensor(width=0.3),
    "quantisation": _sensor(step=0.3),
    "pump_ripple": grown(share=0.5),
    "cogging": grown(speed=100.0),
    "packet_loss": lambda level, f: {"share": 0.6 * level, "seed": f.seed},
    "viscosity_warming": grown(share=0.9),
    "external_push": _push,
    "payload_change": lambda level, f: {"mass": level * (40.0, 350.0)[f.second], "time": 0.5 * f.seconds},
    "load_spring": grown(stiffness=5e4),
    "sensor_ripple": _ripple,
    "sensor_drift": _sensor_signed(rate=0.005),
}
STIFF = {"structural_compliance", "backlash", "end_stop", "presliding_friction", "actuator_lag", "supply_droop"}
