"""Hand-made answers of the gap workflow with realistic numbers, one for each verdict."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime
from functools import cache
from types import SimpleNamespace

import numpy as np

from hydrotwin.discovery.answer.discovery import (
    Discovery,
    EffectParameter,
    Experiment,
    Location,
    OutputGap,
    Overlay,
    Ranked,
    RecordingGap,
    Region,
    Rung,
    Shift,
    Step,
    Unknown,
)
from hydrotwin.models.language import Component, Input, Model, Output, Parameter
from hydrotwin.report import gap_page, write_gap_report

DATE = datetime(2026, 3, 4, 5, 6, 7, tzinfo=UTC)
NAN = float("nan")
UNITS = {"arm_angle": "rad", "pressure_cap": "Pa", "motor_speed": "rad/s"}
NOISE = {"arm_angle": 1.1e-4, "pressure_cap": 8.0e3, "motor_speed": 0.8}
GAP = {"arm_angle": 1.1e-2, "pressure_cap": 2.4e5, "motor_speed": 0.0}  # size of the gap where the arm sinks
ROLES = {"run_1": "fit", "run_2": "fit", "run_3": "fit", "run_4": "report", "slow_5": "report"}


class Motor(Component):
    """The smallest model with a command."""

    command = Input("V", "command of the drive")
    motor_speed = Output("rad/s", "speed of the motor")
    gain = Parameter(120.0, "rad/(s.V)", "speed per volt", bounds=(0, 1e3))

    def equations(self):
        yield self.motor_speed == self.gain * self.command


def parameter(name, value, unit, sigma, description="", typical=None):
    reach = 1.96 * sigma
    return EffectParameter(name, value, unit, sigma, value - reach, value + reach, description, typical)


FORCE = parameter("rod_friction.force", 1234.0, "N", 15.0, "kinetic friction", (100.0, 5000.0))
CONDUCTANCE = parameter("leak.conductance", 1.2e-12, "m3/(s.Pa)", 3e-14, "leakage conductance", (1e-14, 1e-11))
SLIP = parameter("slip.conductance", 1.25e-12, "m3/(s.Pa)", 5e-14, "pump slip", (1e-14, 1e-11))
DELAY = parameter("delay.time", 0.031, "s", 0.002, "dead time", (2e-3, 0.24))

FRICTION = Ranked(
    *("coulomb_friction", "cylinder.rod", "Coulomb friction", "F = Fc sign(v)"),
    *(0.83, 12.4, 0.9873, 0.981, "named", "", (FORCE,)),
)
STRIBECK = Ranked(
    *("stribeck_friction", "cylinder.rod", "Stribeck friction", "F = (Fs - Fc) exp(-(v/vs)^2) sign(v)"),
    *(0.84, 12.1, 0.9874, 0.0, "rejected", "leaves more than what is told, or no less for more parameters"),
)
LEAK = Ranked(
    *("internal_leakage", "cylinder.cap-cylinder.annulus", "internal leakage", "q = G (p_A - p_B)"),
    *(0.41, 5410.0, 0.46, 0.62, "rejected", "leaves more than what is told", (CONDUCTANCE,)),
)
PUMP_SLIP = Ranked(
    *(
        "pump_slip",
        "pump",
        "slip of the pump",
        "q = G dp / (1 + w/w0)",
        0.4,
        5416.0,
        0.455,
        0.36,
        "in class",
        "",
        (SLIP,),
    ),
)
DEAD_TIME = Ranked(
    *(
        "dead_time",
        "command",
        "dead time",
        "y(t) = u(t - T)",
        0.12,
        9150.0,
        0.11,
        0.0,
        "rejected",
        "leaves more than what is told",
    ),
    parameters=(DELAY,),
)
LOOKED_AT = tuple(
    Ranked(e, s, t, "", share, NAN, NAN, 0.0, "not fitted", "in short windows it promises less than what was fitted")
    for e, s, t, share in (
        ("command_deadband", "command", "deadband", 0.031),
        ("sensor_bias", "arm_angle", "Bias of a sensor", 0.004),
        ("backlash", "cylinder.rod", "Play", NAN),
    )
)
AIR = Ranked(
    *("entrained_air", "cylinder.cap", "entrained air", "", 0.0, NAN, NAN, 0.0, "not testable"),
    "it would not show in these recordings, whatever its size",
)


def step(ranked, first, *, members=(), source="Armstrong-Hélouvry, Dupont, Canudas de Wit 1994, Eq. 2", sentence=""):
    members = tuple((r.effect, r.site) for r in (first, *members))
    return Step(
        *(first.effect, first.site, first.title, first.equation, source, members, first.probability),
        *(first.parameters, first.gap_closed, ranked),
        sentence=sentence,
    )


def output_gaps(before=1.0, after=0.0, jitter=0.0):
    """OutputGap of every output when ``before`` and ``after`` of the gap are there."""
    rows = []
    for name, unit in UNITS.items():
        noise = NOISE[name] * (1.0 + jitter)
        first, last = np.hypot(noise, before * GAP[name]), np.hypot(noise, after * GAP[name])
        closed = 1.0 - (last**2 - noise**2) / (first**2 - noise**2) if first > 1.01 * noise else NAN
        rows.append(OutputGap(name, unit, NOISE[name], float(first), float(last), float(closed)))
    return tuple(rows)


def signals(seed, seconds=40.0, period=0.01):
    """Time, command and the three outputs of an arm that is lifted and lowered."""
    random = np.random.default_rng(seed)
    time = np.arange(0.0, seconds, period)
    waves = zip(random.uniform(0.05, 0.4, 4), random.uniform(0.0, 6.28, 4), strict=True)
    command = sum(np.sin(2 * np.pi * f * time + p) for f, p in waves)
    angle = 0.4 + period * np.cumsum(0.05 * command)
    pressure = 2.4e6 + 4e5 * np.cos(angle) + 1e5 * command
    return time, command, {"arm_angle": angle, "pressure_cap": pressure, "motor_speed": 120.0 * command}


def overlay(record, role, seed, after=0.0, seconds=40.0):
    """Measured, before and after: the gap is there where the arm sinks."""
    time, command, true = signals(seed, seconds)
    random = np.random.default_rng(seed + 100)
    measured = {n: v + NOISE[n] * random.standard_normal(len(time)) for n, v in true.items()}
    shape = np.where(command < 0.0, -1.4 - 0.2 * command, 0.1)
    before = {n: v + GAP[n] * shape for n, v in true.items()}
    done = {n: v + after * GAP[n] * shape for n, v in true.items()}
    return Overlay(record, role, time, measured, before, done, {"command": command})


def region(output, over, over_unit, low, high, after=0.0, bins=12):
    edges = np.linspace(low, high, bins + 1)
    centres = (edges[:-1] + edges[1:]) / 2
    below = centres < (low + high) / 2
    mean = np.where(below, -1.4, 0.1) * (GAP[output] or NOISE[output] * 0.1)
    error = np.full(bins, 0.3 * NOISE[output]) * (1 + np.linspace(0, 1, bins))
    rest = after * mean + 0.5 * error * np.sin(np.arange(bins))
    sure = np.abs(mean) > 3 * error
    return Region(
        *(output, UNITS[output], over, over_unit, edges, mean, error, sure),
        *(rest, error, np.abs(rest) > 3 * error),
    )


def regions(after=0.0):
    return tuple(
        region(output, *over, after)
        for output in ("arm_angle", "pressure_cap")
        for over in (("cylinder.rod.v", "m/s", -0.05, 0.05), ("command", "V", -3.0, 3.0), ("time", "s", 0.0, 40.0))
    )


def discovery(verdict, steps=(), *, after=0.0, **more):
    """A Discovery with everything that does not depend on the verdict."""
    gap = 1.0 if steps or verdict == "unknown" else 0.0
    left = after if steps else gap
    recordings = tuple(
        RecordingGap(name, role, output_gaps(gap * (1.0 + 0.1 * k), left, 0.004 * k))
        for k, (name, role) in enumerate(ROLES.items())
    )
    fit = SimpleNamespace(
        name="cehA",
        parameters=(),
        records=[SimpleNamespace(name=n, role="train", samples=4000, digest=f"{k:064x}") for k, n in enumerate(ROLES)],
    )
    model = Model(Motor(), "cehA")
    content = {
        "name": "cehA",
        "verdict": verdict,
        "steps": tuple(steps),
        "base": model,
        "model": model,
        "fit_before": fit,
        "fit_after": fit,
        "noise": NOISE,
        "outputs": {"train": output_gaps(gap, left), "validate": output_gaps(1.2 * gap, 1.2 * left, 0.01)},
        "recordings": recordings,
        "locations": (),
        "regions": regions(left) if gap else (),
        "overlays": tuple(overlay(n, r, k, left) for k, (n, r) in enumerate(ROLES.items()) if r != "fit"),
        "shifts": (),
        "waterfall": (),
        "not_testable": (AIR,),
        "probabilities": ODDS[verdict],
        "screened": 74,
        "fitted": 2,
        "given": {"train": 3, "validate": 2},
        "seconds": 31.4,
        "provenance": {"version": "0.3.0", "thresholds": {"told": 0.01}},
    }
    return Discovery(**(content | more))


FRICTION_ALONE, LEAK_ALONE = FRICTION.label, LEAK.label
ODDS = {  # of structures, by verdict; what is missing to 1 is spread over many
    "named": {
        "nothing": 0.0, FRICTION_ALONE: 0.951, f"command_deadband at command + {FRICTION_ALONE}": 0.02,
        "something else": 0.019,
    },
    "class": {"nothing": 0.0, LEAK_ALONE: 0.62, PUMP_SLIP.label: 0.36, "something else": 0.02},
    "none": {"nothing": 0.93, DEAD_TIME.label: 0.02, "something else": 0.05},
    "unknown": {"nothing": 0.0, LEAK_ALONE: 0.03, "something else": 0.97},
    "two": {"nothing": 0.0, f"{FRICTION_ALONE} + {LEAK_ALONE}": 0.71, FRICTION_ALONE: 0.27, "something else": 0.02},
}  # fmt: skip
LOCATIONS = (
    Location(
        *("arm_angle", 102.0, False, "arm_angle is 102 noise off where cylinder.rod.v < -0.01 m/s"),
        (("command", -0.83, 0.02),),
    ),
    Location("pressure_cap", 30.1, False, "pressure_cap is 30 noise off where cylinder.rod.v < -0.01 m/s"),
    Location("motor_speed", 1.0, True, ""),
)
SHIFTS = (
    Shift("motor.gain", "rad/(s.V)", 118.1, 0.4, 119.9, 0.05),
    Shift("motor.lag", "s", 0.051, 0.002, 0.0304, 0.0002),
    Shift("cylinder.friction.viscous", "N.s/m", 9.1e3, 4e2, 5.02e3, 40.0),
    Shift("cylinder.oil.bulk_modulus", "Pa", 1.61e9, 3e7, 1.74e9, 8e6),
)


@cache
def named():
    """Coulomb friction, closed to the noise."""
    first = step((FRICTION, STRIBECK, LEAK, DEAD_TIME, *LOOKED_AT), FRICTION)
    rungs = (Rung("base model", 68.0), Rung("Coulomb friction at cylinder.rod", 1.01))
    return discovery("named", (first,), after=0.004, locations=LOCATIONS, shifts=SHIFTS, waterfall=rungs)


@cache
def one_of_a_class():
    """A leak: inside the cylinder or inside the pump."""
    members = (
        replace(LEAK, fate="named", reason="", left=11.9, gap_closed=0.991),
        replace(PUMP_SLIP, left=12.7, gap_closed=0.99),
    )
    first = step((*members, DEAD_TIME, *LOOKED_AT), members[0], members=members[1:], source="Merritt 1967, ch. 6")
    time = np.linspace(0.0, 30.0, 1501)
    experiment = Experiment(
        *("command", "V", time, 2.0 * np.sign(np.sin(0.6 * time)) * (time > 2), "holding steps", 7.3, 0.8),
        "hold the arm at standstill under load for 10 s: a leak and slip then differ by 7.3 times the noise (now 0.8)",
    )
    rungs = (Rung("base model", 68.0), Rung("internal leakage at cylinder.cap-cylinder.annulus", 1.02))
    return discovery("class", (first,), locations=LOCATIONS, shifts=SHIFTS[:2], waterfall=rungs, experiment=experiment)


@cache
def none():
    """Noise and nothing else."""
    at_noise = tuple(Location(name, 1.0, True, "") for name in UNITS)
    tried = tuple(replace(r, fate="rejected", left=1.3, gap_closed=NAN) for r in (DEAD_TIME, LEAK)) + LOOKED_AT
    return discovery("none", locations=at_noise, last_ranked=tried)


@cache
def unknown():
    """A gap that follows the velocity and fits no effect."""
    told = Unknown(
        *("arm_angle", "rad", ("cylinder.rod.v", "arm_angle"), 0.87),
        "What is left of arm_angle grows with the fifth power of the velocity and vanishes above 20°",
        "0.013 v^5",
    )
    findings = ("gap: motor.gain and pump.displacement cannot be told apart in these recordings",)
    tried = (LEAK, DEAD_TIME, *LOOKED_AT)
    return discovery("unknown", locations=LOCATIONS, last_ranked=tried, unknown=(told,), findings=findings)


@cache
def two_effects():
    """Friction and a leak that ruins one recording, with a value that no cylinder has and a parameter at its bound."""
    wild = parameter("leak.conductance", 3e-10, "m3/(s.Pa)", 1e-12, "leakage conductance", (1e-14, 1e-11))
    leak = replace(LEAK, fate="named", reason="", left=21.0, gap_closed=0.9, parameters=(wild,), probability=0.71)
    steps = (step((FRICTION, STRIBECK, LEAK), FRICTION), step((leak, DEAD_TIME), leak, source="Merritt 1967"))
    rungs = (Rung("base model", 68.0), Rung("Coulomb friction at cylinder.rod", 12.0), Rung("internal leakage", 2.6))
    shifts = (*SHIFTS, Shift("cylinder.cap_dead_volume", "m3", 8e-5, NAN, 1e-6, NAN, at_bound=True))
    more = {"shifts": shifts, "waterfall": rungs, "probabilities": ODDS["two"]}
    made = discovery("named", steps, after=0.03, locations=LOCATIONS, **more)
    ruined = replace(made.recordings[-1], outputs=output_gaps(0.2, 0.6))
    return replace(made, recordings=(*made.recordings[:-1], ruined))


ALL = {"named": named, "class": one_of_a_class, "none": none, "unknown": unknown, "two": two_effects}


def written(found, folder):
    """The report's files in a folder."""
    return write_gap_report(found, folder, command="hydrotwin gap cehA run_1.csv", date=DATE)


def first_screen(found):
    """What stands above the first section, as text."""
    page = gap_page(found, command="", date=DATE)
    return "\n".join((page.title, page.answer, *page.results, *page.facts, *page.notices))
