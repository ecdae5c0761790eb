"""Masses, loads, the arm, and what holds or frees a flange."""

from __future__ import annotations

import casadi as ca

from hydrotwin.models.language import Component, Flange, Input, Parameter, Shaft, Slot, State, Variable, der
from hydrotwin.models.laws import FrictionLaw, NoFriction


class Mass(Component):
    """A sliding mass with position and velocity: ``m dv/dt = f``."""

    flange = Flange("where forces act")
    friction = Slot(FrictionLaw, default=NoFriction())
    mass = Parameter(350.0, "kg", "moved mass", bounds=(1e-6, 1e7), source="geometry")
    position = State(0.0, "m", "position", nominal=0.1)
    velocity = State(0.0, "m/s", "velocity", nominal=0.1)

    def equations(self):
        yield self.flange.s == self.position
        yield der(self.position) == self.velocity
        yield self.mass * der(self.velocity) == self.flange.f - self.friction.force(self.velocity)


class AttachedMass(Component):
    """A mass that rides on a flange whose position something else determines: ``f = m d2s/dt2``. It has no state."""

    flange = Flange("where it is attached")
    mass = Parameter(1.0, "kg", "attached mass", bounds=(0, 1e7), source="geometry")
    velocity = Variable("m/s", "velocity of the flange", nominal=0.1)

    def equations(self):
        yield self.velocity == der(self.flange.s)
        yield self.flange.f == self.mass * der(self.velocity)


class LinearLoad(Component):
    """Mass, constant force and friction on a straight slide: ``m dv/dt = f - F_load - F_friction(v)``.

    ``load_force`` is positive when it pushes the rod in.
    """

    flange = Flange("rod end; s grows as the rod extends")
    friction = Slot(FrictionLaw, default=NoFriction())
    mass = Parameter(350.0, "kg", "moved mass", bounds=(1e-3, 1e7), source="geometry")
    load_force = Parameter(
        4000.0, "N", "constant force against extension", bounds=(-1e7, 1e7), nominal=1e3, source="load"
    )
    position = State(0.0, "m", "position of the load", nominal=0.1)
    velocity = State(0.0, "m/s", "velocity of the load", nominal=0.1)

    def equations(self):
        v = self.velocity
        yield self.flange.s == self.position
        yield der(self.position) == v
        yield self.mass * der(v) == self.flange.f - self.load_force - self.friction.force(v)


class Arm(Component):
    """One-link arm on a joint, moved by an actuator whose foot lies ``base_length`` below the joint.

    C-EHA paper, Eq. 10-14:

        (m1 L^2 + m2 L^2/3) theta'' = h(theta) F - (m1 + m2/2) g L cos(theta)
        s = sqrt(l^2 + d^2 + 2 l d sin(theta)),   h = l sin(alpha) = ds/dtheta = l d cos(theta)/s

    The flange's position is the stroke ``s - retracted_length``. ``base_length`` follows from
    ``s(0) = retracted_length`` (assumed: the paper does not give it).
    """

    pin = Flange("actuator head; s is the stroke")
    extra_mass = Parameter(46.7, "kg", "mass m1 at the end", bounds=(0, 1e5), source="C-EHA paper, Table 1")
    arm_mass = Parameter(1.64, "kg", "mass m2 of the arm", bounds=(0, 1e5), source="C-EHA paper, Table 1")
    length = Parameter(0.488, "m", "length L up to the weight", bounds=(1e-3, 100), source="C-EHA paper, Table 1")
    pin_length = Parameter(
        0.225, "m", "length l up to the actuator's head pin", bounds=(1e-3, 100), source="C-EHA paper, Table 1"
    )
    retracted_length = Parameter(
        0.3055, "m", "actuator length x0 at stroke 0", bounds=(1e-3, 100), source="C-EHA paper, Table 1"
    )
    base_length = Parameter(
        lambda arm: ca.sqrt(arm.retracted_length**2 - arm.pin_length**2),
        "m",
        "distance d from the joint down to the actuator's foot",
        bounds=(1e-3, 100),
        source="assumed: s(0) = x0",
    )
    gravity = Parameter(9.80665, "m/s2", "standard gravity g", bounds=(0, 20), source="standard, CGPM 1901")
    angle = State(0.0, "rad", "arm angle theta above the horizontal", nominal=0.5)
    angular_velocity = State(0.0, "rad/s", "rate of the arm angle", nominal=0.3)

    def equations(self):
        m1, m2, L, l, d = self.extra_mass, self.arm_mass, self.length, self.pin_length, self.base_length
        theta = self.angle
        s = ca.sqrt(l**2 + d**2 + 2 * l * d * ca.sin(theta))
        h = l * d * ca.cos(theta) / s
        yield self.pin.s == s - self.retracted_length
        yield der(theta) == self.angular_velocity
        yield (m1 * L**2 + m2 * L**2 / 3) * der(self.angular_velocity) == (
            h * self.pin.f - (m1 + m2 / 2) * self.gravity * L * ca.cos(theta)
        )


class SpringDamper(Component):
    """Spring and damper between two flanges: ``f = k (s_a - s_b - free_length) + b (v_a - v_b)``."""

    a = Flange("one end")
    b = Flange("other end")
    stiffness = Parameter(1e6, "N/m", "spring rate k", bounds=(0, 1e12), source="geometry")
    damping = Parameter(1e3, "N.s/m", "damping b", bounds=(0, 1e9), source="geometry")
    free_length = Parameter(0.0, "m", "s_a - s_b without force", bounds=(-100, 100), nominal=0.1, source="geometry")

    def equations(self):
        stretch = self.a.s - self.b.s - self.free_length
        yield self.a.f == self.stiffness * stretch + self.damping * (der(self.a.s) - der(self.b.s))
        yield self.a.f + self.b.f == 0


class Ground(Component):
    """A fixed place."""

    flange = Flange("fixed")
    position = Parameter(0.0, "m", "where it is", bounds=(-1e3, 1e3), nominal=0.1, source="geometry")

    def equations(self):
        yield self.flange.s == self.position


class Freewheel(Component):
    """A free end: no force."""

    flange = Flange("free")

    def equations(self):
        yield self.flange.f == 0


class ForceSource(Component):
    """A prescribed force that pushes the flange towards larger s."""

    flange = Flange("where it acts")
    force = Input("N", "force on the flange", nominal=1e3)

    def equations(self):
        yield self.flange.f == -self.force


class SpeedSource(Component):
    """A prescribed shaft speed, whatever torque it takes: a drive whose speed was measured."""

    shaft = Shaft("driven shaft")
    speed = Input("rad/s", "speed of the shaft", nominal=100.0)

    def equations(self):
        yield self.shaft.w == self.speed


class TorqueSource(Component):
    """A prescribed torque on a shaft: the load of a motor."""

    shaft = Shaft("where it acts")
    torque = Input("N.m", "torque on the shaft", nominal=1.0)

    def equations(self):
        yield self.shaft.tau == -self.torque
