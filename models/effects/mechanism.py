"""Cylinder and mechanism: geometry, masses, loads, play, give, stops."""

from __future__ import annotations

from dataclasses import replace

import casadi as ca
import numpy as np

from hydrotwin.models.language import Flange, Input, Output, Parameter, RotationalFlange, State, der
from hydrotwin.models.language.places import Places
from hydrotwin.models.language.units import compatible

from .bodies import OnBody, links
from .effect import Effect, Site
from .exceeded import exceeded, fallen_below
from .sites import flange_joints, flanges, parameters
from .stepping import Lagged, stepped
from .sticking import Sticking

CONTACT = "K. L. Johnson, Contact Mechanics, 1985: a pin in its hole, 1e-9 to 1e-7"
DEPTHS = (3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1)  # of the range of positions: a stiff stop shows when barely reached
FAR = 1e3  # m, where a stop is that nothing reaches
TOLERANCES = "tolerances of the geometry"
MACHINE_ELEMENTS = "Decker, Maschinenelemente: pins and their fits"
HUNT = "K. H. Hunt and F. R. E. Crossley, Coefficient of restitution interpreted as damping in vibroimpact, 1975"


class AreaError(Effect):
    """A piston area that is not what the drawing says; the parameter becomes free."""

    id, title = "area_error", "area other than stated"
    equation = "A = A_stated (1 + e)"
    source = TOLERANCES
    typical = {"value": (0.9, 1.1)}
    probes = ({"value": 1.05}, {"value": 0.95})
    confused_with = ("displacement_error", "sensor_scale")
    experiment = "pressures and position together, at two loads"

    sites = staticmethod(parameters("m2"))


class PayloadError(Effect):
    """A mass or an inertia that is not what was stated; the parameter becomes free."""

    id, title = "payload_error", "mass other than stated"
    equation = "m = m_stated (1 + e)"
    source = "what is carried changes"
    typical = {"value": (0.7, 1.5)}
    probes = ({"value": 1.2}, {"value": 0.8})
    confused_with = ("constant_load", "gravity_tilt", "linkage_error", "area_error")
    experiment = (
        "fast and slow motion in several positions, with pressures: a force acts at rest, a mass when it speeds"
    )

    @classmethod
    def sites(cls, places: Places):
        yield from parameters("kg")(places)
        yield from parameters("kg.m2")(places)


class LinkageError(Effect):
    """A length of a linkage that is not what was stated; the parameter becomes free.

    Lengths are the parameters in metres that cannot be zero, of parts with a flange; positions are none. A length that
    follows from others is one as well: it stays where it is when one of them is freed, as the other bars do.
    """

    id, title = "linkage_error", "length of the linkage other than stated"
    equation = "l = l_stated (1 + e)"
    source = TOLERANCES
    typical = {"value": (0.97, 1.03)}
    probes = ({"value": 1.01}, {"value": 0.99})
    confused_with = ("sensor_scale", "payload_error", "sensor_bias")
    experiment = "the whole stroke, slowly, with stroke and angle both measured"

    @classmethod
    def sites(cls, places: Places):
        model = places.model
        every = (*model.flat.parameters, *(p for p, _ in model.followers))
        free = {p.name for p in every if p.free}
        metres = {p.name for p in every if compatible(p.unit, "m") and p.bounds[0] > 0}
        moving = [p.path for p in places.parts if p.ports_of(Flange) or p.ports_of(RotationalFlange)]
        follows = {p.name: {p.name, *sources} for p, sources in model.followers if not sources & free}

        def is_length(path: str) -> bool:
            return path in metres and path.rpartition(".")[0] in moving

        for site in parameters("m", is_length)(places):
            bars = (name for name, ours in follows.items() if is_length(name) and site.frees in ours)
            yield replace(site, holds=tuple(bars))


class ConstantLoad(OnBody):
    """A force that never changes: a weight on a slide, a spring with little rate.

        F = F_0,   positive against larger s

    On one axis with one mass a tilted guide is the same.
    """

    id, title = "constant_load", "constant force"
    equation = "F = F_0"
    source = "J. Watton, Fundamentals of Fluid Power Control, 2009"
    typical = {"force": (-3000.0, 3000.0)}
    probes = ({"force": 200.0}, {"force": -200.0}, {"force": 2000.0}, {"force": -2000.0})
    confused_with = ("asymmetric_friction", "null_bias", "payload_error", "gravity_tilt")
    experiment = "hold in several positions and move slowly both ways, with pressures"

    bodies = ("flange", "rotational", "shaft")

    force = Parameter(0.0, "N", "F_0, against larger s", bounds=(-1e6, 1e6), nominal=500.0, source="load", free=True)

    def equations(self):
        yield self.against(self.force)


class GravityTilt(Effect):
    """The base of a turning link stands at an angle: gravity comes from another side.

        der(w) = ... + kappa sin(angle),   kappa = (M g L/J) delta for a tilt of delta << 1

    which is what is left of M g L (cos(angle) - cos(angle + delta))/J where the angle is measured from the
    horizontal. A slide that is tilted feels a constant force: that is `constant_load`.
    Source: geometry.
    """

    id, title = "gravity_tilt", "tilted base"
    equation = "w' = ... + kappa sin(angle)"
    source = "geometry: gravity turned by a small angle"
    typical = {"rate": (-3.0, 3.0)}  # g/L times 0.1 rad
    probes = ({"rate": 0.5}, {"rate": -0.5}, {"rate": 3.0}, {"rate": -3.0})
    confused_with = ("payload_error", "linkage_error", "constant_load", "sensor_bias")
    experiment = "hold in many angles over the whole range, with pressures"

    u = Input("rad/s2", "angular acceleration")
    y = Output("rad/s2", "angular acceleration with the tilt")
    angle = Input("rad", "angle above the horizontal")
    rate = Parameter(0.0, "1/s2", "kappa", bounds=(-100, 100), nominal=1.0, source="g/L times the tilt", free=True)

    @classmethod
    def sites(cls, places: Places):
        for part, angle, speed in links(places):
            yield Site(part, reads={"angle": angle}, through=f"der({speed})")

    def equations(self):
        yield self.y == self.u + self.rate * ca.sin(self.angle)


class EndStop(Effect):
    """The end of the stroke, where nothing in the model holds the motion.

        f = k e_high (1 + d v) - k e_low (1 - d v),   e_high = max(s - s_high, 0), e_low = max(s_low - s, 0)

    Each bracket at least 0: a stop never pulls. Either end may lie where nothing comes. No data sheet tells how hard a
    stop is; what is softer than the softest cushion is a spring that acts from somewhere on. Source: Hunt and Crossley.
    """

    id, title = "end_stop", "end of the stroke"
    equation = "s_low <= s <= s_high, by a stiff contact"
    source = HUNT
    typical = {"low": (-0.05, 0.05), "high": (0.02, 1.0), "stiffness": (1e6, 1e9), "damping": (0.1, 20.0)}
    probes = ({"low": -FAR, "high": 0.5}, {"low": 0.0, "high": FAR})
    confused_with = ("command_saturation", "relief_saturation", "sensor_scale")
    experiment = "drive slowly to both ends and on, with pressures"

    flange = Flange("what comes to the stop")
    low = Parameter(-FAR, "m", "s_low", bounds=(-FAR, FAR), nominal=0.1, source="no stop: far away", free=True)
    high = Parameter(FAR, "m", "s_high", bounds=(-FAR, FAR), nominal=0.1, source="no stop: far away", free=True)
    stiffness = Parameter(2e7, "N/m", "k of the contact", bounds=(1e5, 1e10), nominal=1e7, source="stiff", free=True)
    damping = Parameter(10.0, "s/m", "d of the contact", bounds=(0, 100), nominal=10.0, source=HUNT, free=True)

    sites = staticmethod(flanges)

    def equations(self):
        s, v, d = self.flange.s, der(self.flange.s), self.damping
        above = ca.fmax(s - self.high, 0) * ca.fmax(1 + d * v, 0)
        below = ca.fmax(self.low - s, 0) * ca.fmax(1 - d * v, 0)
        yield self.flange.f == self.stiffness * (above - below)

    @classmethod
    def probes_for(cls, seen) -> list[dict]:
        """Ends so deep in the range of the positions seen, the other one barely reached, then both as deep.

        An end that nothing reaches would stay where it is, though the machine has it: no derivative leads there. One
        that is barely reached and not there moves out of the way.
        """
        low, high = (levels(seen["flange.s"], DEPTHS, ()) for levels in (fallen_below, exceeded))
        ends = [*zip(low, high[:1] * len(low), strict=True), *zip(low[:1] * len(high), high, strict=True)]
        both = list(zip(low, high, strict=True))[2:-1:2]
        return [{"low": e, "high": h} for e, h in dict.fromkeys([*ends, *both])]


class LateLoad(OnBody):
    """A load that engages late in the stroke: a second spring, a press that meets its work, a gap at the load.

        F = (F_0 + k (s - s_0)) for s > s_0, nothing before

    Over the first w behind s_0 it sets in. `EndStop` is a contact and knows no force at its beginning.
    Source: J. Watton, Fundamentals of Fluid Power Control, 2009 (loads of actuators).
    """

    id, title = "late_load", "load that engages late in the stroke"
    equation = "F = F_0 + k (s - s_0) for s > s_0, else 0"
    source = "J. Watton, Fundamentals of Fluid Power Control, 2009"
    typical = {"force": (-3000.0, 3000.0), "stiffness": (0.0, 1e5), "start": (-0.05, 1.0)}
    probes = ({"force": 500.0, "start": 0.1}, {"force": -500.0, "start": 0.1}, {"stiffness": 1e4, "start": 0.1})
    confused_with = ("end_stop", "constant_load", "late_friction", "backlash")
    experiment = "slow strokes over the whole way in both directions, with pressures: where it sets in shows as a step"
    bodies, along = ("flange", "rotational"), True

    force = Parameter(0.0, "N", "F_0, against larger s", bounds=(-1e6, 1e6), nominal=500.0, source="load", free=True)
    stiffness = Parameter(0.0, "N/m", "rate k", bounds=(0, 1e9), nominal=1e4, source="load", free=True)
    start = Parameter(0.0, "m", "where it engages s_0", bounds=(-FAR, FAR), nominal=0.1, source="unknown", free=True)
    width = Parameter(1e-3, "m", "way w over which it sets in", bounds=(1e-6, 1.0), source="numerical")

    @classmethod
    def probes_for(cls, seen) -> list[dict]:
        """Places along the way seen, a force of either direction and a spring at each."""
        return [{**probe, "start": place} for place in _along(seen) for probe in cls.probes]

    def equations(self):
        beyond = self.position() - self.start
        load = self.force + self.stiffness * ca.fmax(beyond, 0)
        yield self.against(load * engaged(beyond / self.width))


class LateFriction(Sticking):
    """A brake, or friction, that engages late in the stroke: a load cylinder behind a gap, a guide that grips.

        F = F_+ sign(v) for v > 0, F_- sign(v) for v < 0, for s > s_0, nothing before;   sign as in `Sticking`

    A load that its oil brakes in one direction alone has F_- = 0. Source: Armstrong-Helouvry et al. 1994.
    """

    id, title = "late_friction", "brake or friction that engages late in the stroke"
    equation = "F = F_+ for v > 0, -F_- for v < 0, where s > s_0"
    source = "B. Armstrong-Helouvry et al., A survey of models for machines with friction, 1994"
    typical = {"out": (10.0, 5000.0), "back": (0.0, 5000.0), "start": (-0.05, 1.0)}
    probes = ({"out": 500.0, "back": 0.0, "start": 0.1}, {"out": 300.0, "back": 300.0, "start": 0.1})
    confused_with = ("position_dependent_friction", "asymmetric_friction", "late_load", "coulomb_friction")
    experiment = "slow strokes over the whole way in both directions, with pressures: a brake acts on motion alone"
    along = True

    out = Parameter(0.0, "N", "F_+, towards larger s", bounds=(0, 1e6), nominal=500.0, source="load", free=True)
    back = Parameter(0.0, "N", "F_-, towards smaller s", bounds=(0, 1e6), nominal=500.0, source="load", free=True)
    start = LateLoad.start
    width = LateLoad.width

    @classmethod
    def probes_for(cls, seen) -> list[dict]:
        """Places along the way seen."""
        return [{**probe, "start": place} for place in _along(seen) for probe in cls.probes]

    def equations(self):
        share = engaged((self.position() - self.start) / self.width)
        out, back = share * self.out, share * self.back
        most = ca.fmax(out, back)
        yield self.sticking(most)
        sign = self.sign(most)
        yield self.against(out * ca.fmax(sign, 0) + back * ca.fmin(sign, 0))


def engaged(way):
    """0 before, 1 behind the first unit of a way, without a corner."""
    share = ca.fmin(ca.fmax(way, 0), 1)
    return share * share * (3 - 2 * share)


def _along(seen) -> list[float]:
    """Places in the way of a body that was seen, at which something may engage."""
    way = next(np.asarray(v, float) for k, v in seen.items() if k in ("flange.s", "flange.phi", "angle"))
    return [float(np.min(way) + share * np.ptp(way)) for share in (0.25, 0.5, 0.75)]


class _Joint(Lagged):
    """Between two flanges that move together: a spring beside a damper, without a loop of equations.

        s_a - s_b = stretch(f),   f + tau f' = F approximately

    The force passes through two small lags, so that no loop arises. Those alone would damp a joint more than steel
    does, so a third one takes back what they are slower than tau:

        T_1 f_1' = F - f_1,   T_0 f_2' = f_1 - f_2,   T_0 f_3' = f_2 - f_3,   f = f_2 + k (f_2 - f_3)
        T_1 = max(T_0, tau - T_0),   k = max(2 - tau/T_0, 0):   T_1 + T_0 - k T_0 = tau

    The same as f + tau f' = F to the first power of s T_0, with a loss at every frequency.
    """

    shortest = 0.75  # all three at half a step would swing too fast for it

    a = Flange("the port of the part")
    b = Flange("what it was joined to")
    relaxation = Parameter(
        0.0, "s", "damping over stiffness tau", bounds=(0, 0.05), nominal=1e-3, source="joints 0.1-5 ms", free=True
    )
    resolution = Parameter(5e-4, "s", "T_0", bounds=(1e-5, 0.1), source="numerical")
    first = State(0.0, "N", "f_1", nominal=1e3, fixed=False)
    passed = State(0.0, "N", "f_2", nominal=1e3, fixed=False)
    last = State(0.0, "N", "f_3", nominal=1e3, fixed=False)

    sites = stepped(flange_joints)

    def stretch(self, force):
        """s_a - s_b [m] under a force [N]."""
        raise NotImplementedError

    def equations(self):
        f_1, f_2, f_3, tau, T_0 = self.first, self.passed, self.last, self.relaxation, self.resolution
        yield ca.fmax(T_0, tau - T_0) * der(f_1) == self.a.f - f_1
        yield T_0 * der(f_2) == f_1 - f_2
        yield T_0 * der(f_3) == f_2 - f_3
        yield self.a.s - self.b.s == self.stretch(f_2 + ca.fmax(2 - tau / T_0, 0) * (f_2 - f_3))
        yield self.a.f + self.b.f == 0

    def initial_equations(self):
        yield self.first == self.a.f
        yield self.passed == self.first
        yield self.last == self.passed


class StructuralCompliance(_Joint):
    """What lies between drive and load gives, and loses some of its work: a bracket, a rod, a frame.

        x + tau x' = c F,   x = s_a - s_b

    A spring 1/c beside a damper tau/c (Kelvin and Voigt). Source: Merritt 1967, section 6.
    """

    id, title = "structural_compliance", "compliance of the structure"
    equation = "x + tau x' = c F,   x = s_a - s_b"
    source = "H. Merritt, Hydraulic Control Systems, 1967"
    typical = {"compliance": (1e-9, 2e-7), "relaxation": (0.0, 5e-3)}
    probes = ({"compliance": 1e-8}, {"compliance": 1e-7}, {"compliance": 6e-7, "relaxation": 3e-3})
    confused_with = (  # a softer structure swings as slowly as a heavier or longer load
        "line_compliance", "entrained_air", "payload_error", "linkage_error", "dead_time", "actuator_lag", "spool_lag",
    )  # fmt: skip
    experiment = "steps of force with position measured on both sides, or with pressures"

    compliance = Parameter(0.0, "m/N", "c", bounds=(0, 1e-6), nominal=1e-8, source="stiffness 1e7-1e9 N/m", free=True)

    def stretch(self, force):
        return self.compliance * force


class Backlash(_Joint):
    """Play of a pin: the load follows only when the other side of the hole is reached, which gives a little.

        s_a - s_b = h/2 sign(f) + c f,   f + tau f' = F,   sign smoothed as tanh(f / F_0)

    The force tells the side, so that the play needs no start of its own. Sources: Decker, Maschinenelemente (play);
    Johnson, Contact Mechanics (what a pin in its hole gives).
    """

    id, title = "backlash", "play of a joint"
    equation = "s_a - s_b = h/2 sign(f) + c f,   f + tau f' = F"
    source = MACHINE_ELEMENTS
    typical = {"gap": (1e-4, 2e-3), "compliance": (0.0, 1e-7), "relaxation": (0.0, 5e-3)}
    probes = ({"gap": 2e-4, "compliance": 2e-8}, {"gap": 1e-3, "compliance": 2e-8})
    refines = {"structural_compliance": {"compliance": "compliance", "relaxation": "relaxation"}}
    confused_with = ("structural_compliance", "command_deadband", "presliding_friction")
    experiment = "reverse the load slowly: position jumps by the play where the force changes sign"
    shortest = 0.6  # a contact is stiffer than a structure

    gap = Parameter(0.0, "m", "play h", bounds=(0, 0.01), nominal=5e-4, source=MACHINE_ELEMENTS, free=True)
    compliance = Parameter(
        0.0, "m/N", "compliance c of the contact", bounds=(0, 1e-6), nominal=1e-8, source=CONTACT, free=True
    )
    force_scale = Parameter(50.0, "N", "F_0", bounds=(1, 1e5), source="numerical: less than what is carried")

    def stretch(self, force):
        return self.gap / 2 * ca.tanh(force / self.force_scale) + self.compliance * force
