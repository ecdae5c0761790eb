"""Boom raised by a cylinder behind a spool valve: parts of the shelf alone."""

from __future__ import annotations

from hydrotwin.models.components import (
    Arm,
    Cylinder,
    FourEdgeValve,
    PressureSource,
    ProportionalSolenoid,
    Reservoir,
    Spool,
)
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, connect, der
from hydrotwin.models.laws import ConstantBulkModulus, TurbulentOrifice, Viscous


def _pressure(name: str) -> State:
    return State(5e6, "Pa", f"pressure, {name} side", nominal=1e6, fixed=False)


class LiftBoom(Component):
    """Solenoid, spool, four edges, cylinder, boom."""

    current = Input("1", "normalised solenoid current", nominal=1.0, interpolation="hold")
    boom_angle = Output("rad", "boom above the horizontal", nominal=0.5)
    spool = Output("1", "spool position", nominal=1.0)
    pressure_a = Output("Pa", "pressure, cap side", nominal=1e7)
    pressure_b = Output("Pa", "pressure, rod side", nominal=1e7)
    rod_position = Output("m", "stroke", nominal=0.2)

    solenoid = ProportionalSolenoid()
    slide = Spool(
        natural_frequency=Parameter(90.0, "rad/s", "natural frequency", bounds=(10, 1000), free=True),
        damping=Parameter(0.7, "1", "damping ratio", bounds=(0.1, 3), free=True),
    )
    valve = FourEdgeValve(
        orifice=TurbulentOrifice(
            flow_coefficient=Parameter(3.5e-8, "m3/(s.sqrt(Pa))", "k_q, fully open", bounds=(1e-9, 1e-6), free=True)
        )
    )
    supply = PressureSource(pressure=180e5)
    tank = Reservoir(pressure=5e5)
    cylinder = Cylinder(
        cap_area=1.96e-3,
        rod_area=1.37e-3,
        cap_dead_volume=Parameter(3e-4, "m3", "cap-side volume at stroke 0", bounds=(1e-5, 1e-2), free=True),
        rod_dead_volume=Parameter(3e-4, "m3", "rod-side volume, rod out", bounds=(1e-5, 1e-2), free=True),
        rod_reference=0.5,
        oil=ConstantBulkModulus(bulk_modulus=Parameter(1e9, "Pa", "oil and lines", bounds=(5e7, 1e10), free=True)),
        friction=Viscous(viscous=Parameter(15000.0, "N.s/m", "seals and pins", bounds=(0, 1e6), free=True)),
        cap_pressure=_pressure("cap"),
        rod_pressure=_pressure("rod"),
    )
    boom = Arm(
        extra_mass=100.0,
        arm_mass=80.0,
        length=2.5,
        pin_length=0.6,
        base_length=0.8,
        retracted_length=0.82,
        angle=State(0.2, "rad", "boom above the horizontal", nominal=0.5),
    )
    start_pressure_b = Parameter(50e5, "Pa", "rod-side pressure at the start", bounds=(1e5, 5e7), source="assumed")

    def equations(self):
        yield connect(self.current, self.solenoid.current)
        yield connect(self.solenoid.target, self.slide.target)
        yield connect(self.slide.displacement, self.valve.spool)
        yield connect(self.supply.port, self.valve.supply)
        yield connect(self.tank.port, self.valve.tank)
        yield connect(self.valve.a, self.cylinder.cap)
        yield connect(self.valve.b, self.cylinder.annulus)
        yield connect(self.cylinder.rod, self.boom.pin)
        yield self.boom_angle == self.boom.angle
        yield self.spool == self.slide.position
        yield self.pressure_a == self.cylinder.cap_pressure
        yield self.pressure_b == self.cylinder.rod_pressure
        yield self.rod_position == self.cylinder.rod.s

    def initial_equations(self):
        yield self.cylinder.rod_pressure == self.start_pressure_b
        yield der(self.boom.angular_velocity) == 0


def lift_boom() -> Model:
    return Model(LiftBoom(), "lift_boom", step=5e-4)
