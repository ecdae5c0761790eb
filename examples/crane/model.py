"""A small crane: boom and jib, each raised by a cylinder with its own spool valve. See README.md."""

from __future__ import annotations

from pathlib import Path

import casadi as ca

from hydrotwin.models.components import Cylinder, FourEdgeValve, PressureSource, ProportionalSolenoid, Reservoir, Spool
from hydrotwin.models.effects import add_effect
from hydrotwin.models.language import Component, Flange, Input, Model, Output, Parameter, State, connect, der
from hydrotwin.models.language.parameter_file import read_parameters
from hydrotwin.models.laws import ConstantBulkModulus, Coulomb, OverlappedEdge, TurbulentOrifice

PLANT = Path(__file__).with_name("plant.toml")
HYSTERESIS = {axis: f"spool_hysteresis_{axis}_slide_target" for axis in ("boom", "jib")}


class TwoLinks(Component):
    """Boom and jib as uniform rods in a vertical plane, a payload at the tip, an actuator on each joint.

        M(theta) w' + c(theta, w) + g(theta) = (h_1 F_1, h_2 F_2)
        M = [I_1 + I_2 + 2 k cos(theta_2), I_2 + k cos(theta_2); ., I_2],   k = b L_1
        c = k sin(theta_2) (-2 w_1 w_2 - w_2^2, w_1^2)
        g = g (a cos(theta_1) + b cos(theta_1 + theta_2), b cos(theta_1 + theta_2))
        a = (m_1/2 + m_2 + m) L_1,   b = (m_2/2 + m) L_2
        I_1 = (m_1/3 + m_2 + m) L_1^2,   I_2 = (m_2/3 + m) L_2^2

    The actuator between a foot at distance d from its joint and a pin at distance l, at the angle psi = theta + offset:

        L^2 = d^2 + l^2 - 2 d l cos(psi),   s = L - L_0,   h = ds/dtheta = d l sin(psi)/L

    theta_1 is the boom's angle above the horizontal, theta_2 that of the jib above the boom's direction.
    Source: Craig, Introduction to Robotics (2005), section 6.7, with rods for point masses.
    """

    boom_pin = Flange("head of the boom's actuator; s is its stroke")
    jib_pin = Flange("head of the jib's actuator; s is its stroke")
    boom_mass = Parameter(120.0, "kg", "mass m_1 of the boom", bounds=(1, 1e5), source="data sheet")
    jib_mass = Parameter(60.0, "kg", "mass m_2 of the jib", bounds=(1, 1e5), source="data sheet")
    payload = Parameter(100.0, "kg", "mass m at the tip", bounds=(0, 1e5), source="weighed")
    boom_length = Parameter(2.5, "m", "length L_1", bounds=(0.1, 50), source="drawing")
    jib_length = Parameter(2.0, "m", "length L_2", bounds=(0.1, 50), source="drawing")
    boom_foot = Parameter(0.9, "m", "d of the boom", bounds=(0.01, 10), source="drawing")
    boom_reach = Parameter(0.8, "m", "l of the boom", bounds=(0.01, 10), source="drawing")
    boom_offset = Parameter(1.5708, "rad", "psi - theta_1", bounds=(0, 3.2), source="drawing: foot below the joint")
    boom_retracted = Parameter(1.0, "m", "length L_0 of its actuator, rod in", bounds=(0.1, 10), source="drawing")
    jib_foot = Parameter(1.0, "m", "d of the jib", bounds=(0.01, 10), source="drawing")
    jib_reach = Parameter(0.35, "m", "l of the jib", bounds=(0.01, 10), source="drawing")
    jib_offset = Parameter(2.4435, "rad", "psi - theta_2", bounds=(0, 3.2), source="drawing: 140 deg")
    jib_retracted = Parameter(0.75, "m", "length L_0 of its actuator, rod in", bounds=(0.1, 10), source="drawing")
    gravity = Parameter(9.80665, "m/s2", "standard gravity g", bounds=(0, 20), source="standard, CGPM 1901")
    boom_angle = State(0.6, "rad", "theta_1", nominal=0.5)
    jib_angle = State(-1.0, "rad", "theta_2", nominal=0.5)
    boom_rate = State(0.0, "rad/s", "w_1", nominal=0.1)
    jib_rate = State(0.0, "rad/s", "w_2", nominal=0.1)

    def equations(self):
        q1, q2, w1, w2, g = self.boom_angle, self.jib_angle, self.boom_rate, self.jib_rate, self.gravity
        m1, m2, m, L1, L2 = self.boom_mass, self.jib_mass, self.payload, self.boom_length, self.jib_length
        a, b = (m1 / 2 + m2 + m) * L1, (m2 / 2 + m) * L2
        I1, I2, k = (m1 / 3 + m2 + m) * L1**2, (m2 / 3 + m) * L2**2, b * L1
        s1, h1 = _actuator(self.boom_foot, self.boom_reach, q1 + self.boom_offset)
        s2, h2 = _actuator(self.jib_foot, self.jib_reach, q2 + self.jib_offset)
        yield self.boom_pin.s == s1 - self.boom_retracted
        yield self.jib_pin.s == s2 - self.jib_retracted
        yield der(q1) == w1
        yield der(q2) == w2
        yield (I1 + I2 + 2 * k * ca.cos(q2)) * der(w1) + (I2 + k * ca.cos(q2)) * der(w2) == (
            h1 * self.boom_pin.f + k * ca.sin(q2) * (2 * w1 * w2 + w2**2) - g * (a * ca.cos(q1) + b * ca.cos(q1 + q2))
        )
        yield (I2 + k * ca.cos(q2)) * der(w1) + I2 * der(w2) == (
            h2 * self.jib_pin.f - k * ca.sin(q2) * w1**2 - g * b * ca.cos(q1 + q2)
        )


def _actuator(foot, reach, psi):
    """Length and lever of an actuator."""
    length = ca.sqrt(foot**2 + reach**2 - 2 * foot * reach * ca.cos(psi))
    return length, foot * reach * ca.sin(psi) / length


class Axis(Component):
    """A cylinder on a spool valve with overlap, at constant supply pressure."""

    current = Input("1", "normalised solenoid current")
    rod = Flange("rod end; s is the stroke")
    solenoid = ProportionalSolenoid()
    slide = Spool(natural_frequency=60.0)
    valve = FourEdgeValve(
        orifice=TurbulentOrifice(),
        supply_to_a=OverlappedEdge(),
        supply_to_b=OverlappedEdge(),
        a_to_tank=OverlappedEdge(),
        b_to_tank=OverlappedEdge(),
    )
    supply = PressureSource()
    tank = Reservoir()
    cylinder = Cylinder(
        friction=Coulomb(coulomb=300.0, viscous=1.5e4, smoothing_velocity=2e-3),
        oil=ConstantBulkModulus(bulk_modulus=1e9),
        cap_dead_volume=4e-4,
        rod_dead_volume=4e-4,
        cap_pressure=State(6e6, "Pa", "pressure, cap side", nominal=1e6, fixed=False),
        rod_pressure=State(6e6, "Pa", "pressure, rod side", nominal=1e6, fixed=False),
    )
    start_pressure = Parameter(40e5, "Pa", "rod-side pressure at the start", bounds=(1e5, 5e7), source="assumed")
    stroke = Output("m", "stroke of the rod", nominal=0.1)
    velocity = Output("m/s", "velocity of the rod", nominal=0.1)

    def equations(self):
        yield connect(self.current, self.solenoid.current)
        yield connect(self.solenoid.target, self.slide.target)
        yield connect(self.slide.displacement, self.valve.spool)
        yield connect(self.supply.port, self.valve.supply)
        yield connect(self.tank.port, self.valve.tank)
        yield connect(self.valve.a, self.cylinder.cap)
        yield connect(self.valve.b, self.cylinder.annulus)
        yield connect(self.cylinder.rod, self.rod)
        yield self.stroke == self.rod.s
        yield self.velocity == der(self.rod.s)

    def initial_equations(self):
        yield self.cylinder.rod_pressure == self.start_pressure


class Crane(Component):
    """Two axes on two links. It starts at rest, the cap sides carrying the weight."""

    boom_current = Input("1", "current of the boom's valve, normalised", nominal=1.0)
    jib_current = Input("1", "current of the jib's valve, normalised", nominal=1.0)
    boom_stroke = Output("m", "stroke of the boom's cylinder", nominal=0.1)
    jib_stroke = Output("m", "stroke of the jib's cylinder", nominal=0.1)
    boom_velocity = Output("m/s", "velocity of the boom's cylinder", nominal=0.1)
    jib_velocity = Output("m/s", "velocity of the jib's cylinder", nominal=0.1)
    boom_spool = Output("1", "position of the boom's spool", nominal=1.0)
    jib_spool = Output("1", "position of the jib's spool", nominal=1.0)
    boom_angle = Output("rad", "angle of the boom", nominal=0.5)
    jib_angle = Output("rad", "angle of the jib to the boom", nominal=0.5)

    boom = Axis()
    jib = Axis()
    links = TwoLinks()

    def equations(self):
        yield connect(self.boom_current, self.boom.current)
        yield connect(self.jib_current, self.jib.current)
        yield connect(self.boom.rod, self.links.boom_pin)
        yield connect(self.jib.rod, self.links.jib_pin)
        for axis in ("boom", "jib"):
            part = getattr(self, axis)
            yield getattr(self, f"{axis}_stroke") == part.stroke
            yield getattr(self, f"{axis}_velocity") == part.velocity
            yield getattr(self, f"{axis}_spool") == part.slide.position
            yield getattr(self, f"{axis}_angle") == getattr(self.links, f"{axis}_angle")

    def initial_equations(self):
        yield der(self.links.boom_rate) == 0
        yield der(self.links.jib_rate) == 0


def crane() -> Model:
    """The crane as its data sheets have it."""
    return Model(Crane(), "crane", step=5e-4)


def plant(payload: float | None = None) -> Model:
    """The crane as it is: plant.toml, with hysteresis in both spools. No inverse is told these values."""
    model = crane()
    for axis in ("boom", "jib"):
        model = add_effect(model, "spool_hysteresis", f"{axis}.slide.target")
    settings = read_parameters(PLANT)
    if payload is not None:
        settings["links.payload"] = {"value": payload}
    return model.with_settings(settings)
