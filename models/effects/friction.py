"""Friction of what moves: forces and torques against the motion."""

from __future__ import annotations

from collections.abc import Iterator

import casadi as ca

from hydrotwin.models.language import Flange, HydraulicPort, Input, Parameter, State, der
from hydrotwin.models.language.places import Places

from .bodies import OnBody, held
from .effect import Site
from .stepping import Lagged
from .sticking import Sticking

OLSSON = "H. Olsson et al., Friction models and friction compensation, 1998"
CANUDAS = "C. Canudas de Wit et al., A new model for control of systems with friction, 1995"
BONCHIS = "S. Bonchis et al., A pressure-based, velocity independent friction model, ICRA 1999"
ARMSTRONG = "B. Armstrong-Helouvry et al., A survey of models for machines with friction, 1994"


def dry(value: float = 0.0, description: str = "Coulomb friction F_c", source: str = OLSSON) -> Parameter:
    """A dry friction force to be identified; typically 1-10 % of the stall force."""
    return Parameter(value, "N", description, bounds=(0, 1e5), nominal=100.0, source=source, free=True)


def smoothing() -> Parameter:
    """The velocity over which the sign is smoothed."""
    return Parameter(5e-4, "m/s", "v_0 of the smoothed sign", bounds=(1e-6, 0.1), source="numerical")


class ViscousFriction(OnBody):
    """More damping than the model has.

        F = b v

    Source: Olsson et al. 1998.
    """

    id, title = "viscous_friction", "viscous friction"
    equation = "F = b v"
    source = OLSSON
    typical = {"viscous": (10.0, 20000.0)}
    probes = ({"viscous": 100.0}, {"viscous": 3000.0})
    confused_with = ("coulomb_friction", "line_friction", "internal_leakage")
    experiment = "constant speeds over a wide range, with pressures: viscous force grows in proportion"

    viscous = Parameter(0.0, "N.s/m", "added viscous friction b", (0, 1e6), 1000.0, OLSSON, True)

    def equations(self):
        yield self.against(self.viscous * self.speed())


class CoulombFriction(Sticking):
    """Dry friction: one force against the motion, whatever the speed.

        F = F_c sign(v),   sign as in `Sticking`

    Source: Olsson et al. 1998.
    """

    id, title = "coulomb_friction", "Coulomb friction"
    equation = "F = F_c sign(v)"
    source = OLSSON
    typical = {"force": (10.0, 2000.0)}  # 1-10 % of the stall force
    probes = ({"force": 50.0}, {"force": 500.0})
    confused_with = ("stribeck_friction", "command_deadband", "pressure_dependent_friction")
    experiment = "slow motion at several constant speeds in both directions, with pressures"

    force = dry()

    def equations(self):
        yield self.sticking(self.force)
        yield self.against(self.force * self.sign(self.force))


class StribeckFriction(Sticking):
    """Dry friction that is larger at very low speed.

        F = (F_c + (F_s - F_c) exp(-(v/v_s)^2)) sign(v),   sign as in `Sticking`

    Identified: F_c, the excess F_s - F_c, v_s. Source: Olsson et al. 1998.
    """

    id, title = "stribeck_friction", "Stribeck friction"
    equation = "F = (F_c + (F_s - F_c) exp(-(v/v_s)^2)) sign(v)"
    source = OLSSON
    typical = {"force": (10.0, 2000.0), "excess": (1.0, 2000.0), "stribeck_velocity": (0.005, 0.1)}
    probes = (
        {"force": 50.0, "excess": 30.0, "stribeck_velocity": 0.02},
        {"force": 400.0, "excess": 300.0, "stribeck_velocity": 0.01},
        {"force": 400.0, "excess": 300.0, "stribeck_velocity": 0.06},
    )
    refines = {"coulomb_friction": {"force": "force"}}
    confused_with = ("coulomb_friction", "presliding_friction")
    experiment = "constant speeds from 1 mm/s up in both directions, each long enough to settle, with pressures"

    force = dry()
    excess = dry(0.0, "F_s - F_c, more at low speed")
    stribeck_velocity = Parameter(0.02, "m/s", "v_s", bounds=(2e-3, 0.3), nominal=0.02, source=OLSSON, free=True)

    def equations(self):
        most, v = self.force + self.excess, self.speed()
        yield self.sticking(most)
        level = self.force + self.excess * ca.exp(-((v / self.stribeck_velocity) ** 2))
        yield self.against(level * self.sign(most))


class PreslidingFriction(OnBody, Lagged):
    """Dry friction that first gives way like a spring (LuGre without its damping, bristles normalised).

        zeta' = (v - |v| zeta/g(v)) / (delta + |v| T_0),   g = 1 + r exp(-(v/v_s)^2),   F = F_c zeta

    ``delta`` is the displacement before sliding, delta = F_c/sigma_0. T_0 keeps the bristles slower than the
    integration step at any speed; at rest and at slow speed it changes nothing. Unlike a smoothed sign it truly
    sticks. Source: Canudas de Wit et al. 1995.
    """

    id, title = "presliding_friction", "friction with presliding (LuGre)"
    equation = "zeta' = (v - |v| zeta/g(v))/delta, F = F_c zeta, g = 1 + r exp(-(v/v_s)^2)"
    source = CANUDAS
    typical = {"force": (10.0, 2000.0), "displacement": (2e-5, 5e-4), "rise": (0.0, 1.0)}
    probes = (
        {"force": 50.0, "displacement": 1e-4, "rise": 0.1},
        {"force": 500.0, "displacement": 1e-4, "rise": 0.1},
        {"force": 500.0, "displacement": 4e-4, "rise": 0.5},
    )
    refines = {"coulomb_friction": {"force": "force"}}
    confused_with = ("coulomb_friction", "stribeck_friction", "backlash")
    experiment = "reversals so small that it only just moves: the force is then a loop over position"

    force = dry(source=CANUDAS)
    displacement = Parameter(1e-4, "m", "delta before sliding", (2e-5, 5e-3), 1e-4, CANUDAS, True)
    rise = Parameter(0.0, "1", "r = F_s/F_c - 1", bounds=(0, 2), nominal=0.3, source=CANUDAS, free=True)
    stribeck_velocity = Parameter(0.01, "m/s", "v_s", bounds=(1e-3, 0.3), nominal=0.01, source="typical 5-100 mm/s")
    resolution = Parameter(1e-3, "s", "T_0", bounds=(1e-5, 0.1), source="numerical")
    bristles = State(0.0, "1", "zeta, mean deflection of the bristles", bounds=(-3, 3))

    def equations(self):
        v, zeta = self.speed(), self.bristles
        speed = ca.fabs(v)
        g = 1 + self.rise * ca.exp(-((v / self.stribeck_velocity) ** 2))
        yield (self.displacement + speed * self.resolution) * der(zeta) == v - speed * zeta / g
        yield self.against(self.force * zeta)


class PositionDependentFriction(Sticking):
    """Dry friction that changes along the way: a bent rod, a worn guide.

        F = max(F_c + k s, 0) sign(v),   sign as in `Sticking`

    ``F_c`` is the friction at the model's position 0, ``k`` its slope; never a driving force.
    Source: Armstrong-Helouvry et al. 1994.
    """

    id, title = "position_dependent_friction", "friction that depends on position"
    equation = "F = max(F_c + k s, 0) sign(v)"
    source = ARMSTRONG
    typical = {"force": (10.0, 2000.0), "slope": (-10000.0, 10000.0)}
    probes = ({"force": 50.0, "slope": 300.0}, {"force": 300.0, "slope": 3000.0}, {"force": 600.0, "slope": -1000.0})
    refines = {"coulomb_friction": {"force": "force"}}
    confused_with = ("coulomb_friction", "pressure_dependent_friction")
    along = True
    experiment = "the same slow to-and-fro motion in several positions, with pressures"

    force = dry(0.0, "F_c at s = 0", ARMSTRONG)
    slope = Parameter(0.0, "N/m", "k", bounds=(-1e6, 1e6), nominal=1000.0, source=ARMSTRONG, free=True)

    def equations(self):
        level = ca.fmax(self.force + self.slope * self.position(), 0)
        yield self.sticking(level)
        yield self.against(level * self.sign(level))


class AsymmetricFriction(Sticking):
    """Dry friction of another size in each direction, as of lip seals.

        F = F_+ sign(v) for v > 0, F_- sign(v) for v < 0,   sign as in `Sticking`

    Source: Armstrong-Helouvry et al. 1994.
    """

    id, title = "asymmetric_friction", "friction that depends on direction"
    equation = "F = F_+ for v > 0, -F_- for v < 0"
    source = ARMSTRONG
    typical = {"out": (10.0, 2000.0), "back": (10.0, 2000.0)}
    probes = ({"out": 50.0, "back": 150.0}, {"out": 150.0, "back": 50.0}, {"out": 500.0, "back": 200.0})
    refines = {"coulomb_friction": {"out": "force", "back": "force"}}
    confused_with = ("coulomb_friction", "constant_load", "area_error")
    experiment = "slow motion in both directions and a stop in between: a constant load acts at rest too"

    out = dry(0.0, "F_+, towards larger s", ARMSTRONG)
    back = dry(0.0, "F_-, towards smaller s", ARMSTRONG)

    def equations(self):
        most = ca.fmax(self.out, self.back)
        yield self.sticking(most)
        sign = self.sign(most)
        yield self.against(self.out * ca.fmax(sign, 0) + self.back * ca.fmin(sign, 0))


class AsymmetricViscousFriction(OnBody):
    """Damping of another size in each direction, as of a gear that lifts on one side or a seal that drags oil.

        F = b_e |v|

    beside the damping that is there: b_e more of it towards larger s, b_e less towards smaller s. Smoothed as
    v tanh(v / v_0). Source: Armstrong-Helouvry et al. 1994.
    """

    id, title = "asymmetric_viscous_friction", "damping that depends on direction"
    equation = "F = b_e |v|"
    source = ARMSTRONG
    typical = {"difference": (1.0, 2000.0)}
    probes = ({"difference": 50.0}, {"difference": -50.0}, {"difference": 1000.0}, {"difference": -1000.0})
    confused_with = ("asymmetric_friction", "direction_asymmetry", "constant_load")
    experiment = "constant speeds in both directions, slow and fast"

    difference = Parameter(0.0, "N.s/m", "b_e", bounds=(-1e6, 1e6), nominal=100.0, source=ARMSTRONG, free=True)
    smoothing_velocity = smoothing()

    def equations(self):
        v = self.speed()
        yield self.against(self.difference * v * ca.tanh(v / self.smoothing_velocity))


def _pistons(places: Places) -> Iterator[Site]:
    """Moving parts with two chambers."""
    for part in places.parts:
        moving, oil = part.ports_of(Flange), part.ports_of(HydraulicPort)
        node = places.node_at(f"{part.path}.{moving[0]}") if moving and len(oil) == 2 else None
        if node:
            a, b = (f"{part.path}.{port}.p" for port in oil)
            yield Site(part.path, ties={"flange": node.name}, reads={"p_a": a, "p_b": b})


class PressureDependentFriction(Sticking):
    """Seals that are pressed on by the oil rub more.

        F = (F_c + a |p_a - p_b| + r p_b) sign(v),   sign as in `Sticking`

    with the pressures on both sides of a piston: its own seal is pressed on by their difference, that of the rod by the
    pressure on the rod's side. ``a`` and ``r`` are areas: those of the seals times their coefficients of friction.
    Source: Bonchis et al. 1999.
    """

    id, title = "pressure_dependent_friction", "friction that grows with pressure"
    equation = "F = (F_c + a |p_a - p_b| + r p_b) sign(v)"
    source = BONCHIS
    typical = {"force": (0.0, 1000.0), "piston_seal": (2e-6, 2e-4), "rod_seal": (2e-6, 2e-4)}
    probes = (
        {"force": 0.0, "piston_seal": 1e-5, "rod_seal": 0.0},
        {"force": 100.0, "piston_seal": 1e-4, "rod_seal": 0.0},
        {"force": 0.0, "piston_seal": 2e-5, "rod_seal": 2e-5},
    )
    refines = {"coulomb_friction": {"force": "force"}}
    confused_with = ("coulomb_friction", "asymmetric_friction", "area_error")
    experiment = "the same slow motion under two loads, with pressures"

    p_a = Input("Pa", "pressure on one side", nominal=1e6)
    p_b = Input("Pa", "pressure on the side of the rod", nominal=1e6)
    force = dry(source=BONCHIS)
    piston_seal = Parameter(0.0, "N/Pa", "a", bounds=(0, 0.01), nominal=1e-5, source=BONCHIS, free=True)
    rod_seal = Parameter(0.0, "N/Pa", "r", bounds=(0, 0.01), nominal=1e-5, source=BONCHIS, free=True)

    sites = held(_pistons)

    def equations(self):
        level = self.force + self.piston_seal * ca.fabs(self.p_a - self.p_b) + self.rod_seal * self.p_b
        yield self.sticking(level)
        yield self.against(level * self.sign(level))
