"""Winch: motor and pump, two hoses, a hydraulic motor, a drum, a load on a rope. The shelf lacks the drum."""

from __future__ import annotations

from hydrotwin.models.components import LinearLoad, LineVolume, Passage, Pump, Reservoir, SpeedControlledMotor
from hydrotwin.models.language import Component, Flange, Input, Model, Output, Parameter, Shaft, State, connect, der
from hydrotwin.models.laws import ConstantBulkModulus, LaminarLeakage, Viscous


class Drum(Component):
    """A shaft winds a rope: ``ds/dt = r w``, ``J dw/dt = tau + r f``."""

    shaft = Shaft("drive shaft")
    rope = Flange("rope; s grows as it is wound")
    radius = Parameter(0.01, "m", "rope per turn r, gear included", bounds=(1e-4, 10), source="drawing")
    inertia = Parameter(0.05, "kg.m2", "inertia J at the shaft", bounds=(1e-6, 1e4), source="drawing")

    def equations(self):
        yield self.radius * self.shaft.w == der(self.rope.s)
        yield self.inertia * der(self.shaft.w) == self.shaft.tau + self.radius * self.rope.f


def _hose(pressure: float = 2e6) -> LineVolume:
    oil = ConstantBulkModulus(bulk_modulus=Parameter(8e8, "Pa", "hose and oil", bounds=(5e7, 5e9), free=True))
    start = State(pressure, "Pa", "pressure in the hose", nominal=1e6, fixed=False)
    return LineVolume(oil=oil, volume=1e-3, pressure=start)


class Winch(Component):
    """The pump feeds hose a; the load turns the motor back against it. Hose b is fed from the boost supply."""

    command = Input("V", "command of the motor", nominal=5.0, interpolation="hold")
    rope_position = Output("m", "height of the load", nominal=1.0)
    motor_speed = Output("rad/s", "speed of the pump's motor", nominal=100.0)
    pressure_a = Output("Pa", "pressure, hose a", nominal=1e7)
    pressure_b = Output("Pa", "pressure, hose b", nominal=1e6)

    motor = SpeedControlledMotor(
        gain=Parameter(30.0, "rad/(s.V)", "speed per command", bounds=(1, 300), free=True),
        time_constant=Parameter(0.05, "s", "lag of the speed loop", bounds=(1e-3, 1), free=True),
    )
    pump = Pump(displacement=4e-6)
    hose_a = _hose(9e6)
    hose_b = _hose()
    hydraulic_motor = Pump(displacement=1.6e-5)
    drum = Drum()
    load = LinearLoad(
        mass=1200.0,
        friction=Viscous(viscous=Parameter(4000.0, "N.s/m", "drag of drum and rope", bounds=(0, 1e6), free=True)),
        load_force=lambda machine: machine.gravity * machine.load.mass,
        position=State(1.5, "m", "height of the load", nominal=1.0),
    )
    feed = Passage(law=LaminarLeakage(conductance=2e-10))
    boost = Reservoir(pressure=2e6)
    gravity = Parameter(9.80665, "m/s2", "standard gravity", bounds=(0, 20), source="standard, CGPM 1901")

    def equations(self):
        yield connect(self.command, self.motor.command)
        yield connect(self.motor.shaft, self.pump.shaft)
        yield connect(self.pump.cap, self.hose_a.a)
        yield connect(self.hose_a.b, self.hydraulic_motor.rod)
        yield connect(self.hydraulic_motor.cap, self.hose_b.a)
        yield connect(self.hose_b.b, self.pump.rod)
        yield connect(self.pump.rod, self.feed.a)
        yield connect(self.feed.b, self.boost.port)
        yield connect(self.hydraulic_motor.shaft, self.drum.shaft)
        yield connect(self.drum.rope, self.load.flange)
        yield self.rope_position == self.load.position
        yield self.motor_speed == self.motor.speed
        yield self.pressure_a == self.hose_a.pressure
        yield self.pressure_b == self.hose_b.pressure

    def initial_equations(self):
        yield self.hose_b.pressure == self.boost.pressure
        yield der(self.load.velocity) == 0


def winch() -> Model:
    return Model(Winch(), "winch", step=1e-3)
