"""Motors and their supply."""

from __future__ import annotations

from hydrotwin.models.language import Component, ElectricPin, Input, Parameter, Shaft, State, der


class SpeedControlledMotor(Component):
    """Motor with its controller as a first-order lag: ``tau dw/dt + w = k u``; the load does not slow it.

    Source: C-EHA paper, Fig. 10 (speed is linear in the command); gain and lag assumed.
    """

    shaft = Shaft("drive shaft")
    command = Input("V", "speed command", nominal=5.0)
    gain = Parameter(120.0, "rad/(s.V)", "speed per command k", bounds=(1, 1e4), source="5 V give 0.08 m/s")
    time_constant = Parameter(0.03, "s", "lag of the speed loop", bounds=(1e-4, 10), source="assumed")
    speed = State(0.0, "rad/s", "motor speed", nominal=100.0)

    def equations(self):
        yield self.shaft.w == self.speed
        yield self.time_constant * der(self.speed) + self.speed == self.gain * self.command


class DcMotor(Component):
    """Brushed DC motor: ``L di/dt = v - R i - k w``, ``J dw/dt = k i - b w + tau``.

    Source: Krause, Analysis of Electric Machinery (2002), section 2.3.
    """

    positive = ElectricPin("positive terminal")
    negative = ElectricPin("negative terminal")
    shaft = Shaft("drive shaft")
    resistance = Parameter(0.5, "ohm", "armature resistance R", bounds=(1e-4, 1e4), source="data sheet")
    inductance = Parameter(1e-3, "H", "armature inductance L", bounds=(1e-7, 10), source="data sheet")
    torque_constant = Parameter(0.05, "N.m/A", "torque per current k", bounds=(1e-5, 100), source="data sheet")
    inertia = Parameter(1e-4, "kg.m2", "rotor inertia J", bounds=(1e-9, 1e3), source="data sheet")
    damping = Parameter(1e-5, "N.m.s/rad", "viscous drag b", bounds=(0, 10), nominal=1e-5, source="data sheet")
    current = State(0.0, "A", "armature current", nominal=10.0)
    speed = State(0.0, "rad/s", "rotor speed", nominal=100.0)

    def equations(self):
        v, i, w, k = self.positive.v - self.negative.v, self.current, self.speed, self.torque_constant
        yield self.positive.i == i
        yield self.positive.i + self.negative.i == 0
        yield self.shaft.w == w
        yield self.inductance * der(i) == v - self.resistance * i - k * w
        yield self.inertia * der(w) == k * i - self.damping * w + self.shaft.tau


class VoltageSource(Component):
    """A prescribed voltage between two pins."""

    positive = ElectricPin("positive terminal")
    negative = ElectricPin("negative terminal")
    voltage = Input("V", "voltage", nominal=24.0)

    def equations(self):
        yield self.positive.v - self.negative.v == self.voltage
        yield self.positive.i + self.negative.i == 0


class ElectricGround(Component):
    """Zero potential."""

    pin = ElectricPin("ground")

    def equations(self):
        yield self.pin.v == 0
