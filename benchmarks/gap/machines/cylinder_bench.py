"""Test cylinder under a position controller, fed through hoses that give and resist.

The shelf lacks a controller in metres; its solenoid delays an input of the model, so the controller moves the spool.
"""

from __future__ import annotations

from hydrotwin.models.components import (
    Cylinder,
    FourEdgeValve,
    LinearLoad,
    LineVolume,
    Passage,
    PressureSource,
    Reservoir,
    Spool,
)
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, connect, der
from hydrotwin.models.laws import ConstantBulkModulus, LaminarLeakage, TurbulentOrifice, Viscous


class PositionController(Component):
    """Current in proportion to the error: ``i = k (reference - position)``."""

    reference = Input("m", "wanted position", nominal=0.5)
    position = Input("m", "measured position", nominal=0.5)
    current = Output("1", "normalised current")
    gain = Parameter(40.0, "1/m", "current per error k", bounds=(0.1, 1e4), source="setting")

    def equations(self):
        yield self.current == self.gain * (self.reference - self.position)


def _pressure(name: str) -> State:
    return State(6e6, "Pa", f"pressure, {name}", nominal=1e6, fixed=False)


def _stiffness(value: float, what: str) -> ConstantBulkModulus:
    return ConstantBulkModulus(bulk_modulus=Parameter(value, "Pa", what, bounds=(5e7, 1e10), free=True))


def _hose(name: str) -> LineVolume:
    return LineVolume(volume=5e-4, oil=_stiffness(8e8, "hose and oil"), pressure=_pressure(name))


class CylinderBench(Component):
    """Controller, valve, two hoses, cylinder, sliding mass. A hose is a volume and, behind it, its resistance."""

    reference = Input("m", "wanted position", nominal=0.5, interpolation="hold")
    position = Output("m", "position of the rod", nominal=0.5)
    spool = Output("1", "spool position", nominal=1.0)
    pressure_a = Output("Pa", "pressure, cap side", nominal=1e7)
    pressure_b = Output("Pa", "pressure, rod side", nominal=1e7)

    controller = PositionController()
    slide = Spool(
        natural_frequency=Parameter(150.0, "rad/s", "natural frequency", bounds=(10, 1500), free=True), damping=0.8
    )
    valve = FourEdgeValve(
        orifice=TurbulentOrifice(
            flow_coefficient=Parameter(6e-8, "m3/(s.sqrt(Pa))", "k_q, fully open", bounds=(1e-9, 1e-6), free=True)
        )
    )
    supply = PressureSource(pressure=160e5)
    tank = Reservoir(pressure=5e5)
    hose_a = _hose("hose a")
    hose_b = _hose("hose b")
    line_a = Passage(law=LaminarLeakage(conductance=2e-10))
    line_b = Passage(law=LaminarLeakage(conductance=2e-10))
    cylinder = Cylinder(
        cap_area=1.96e-3,
        rod_area=1.37e-3,
        cap_dead_volume=Parameter(2e-4, "m3", "cap-side volume at stroke 0", bounds=(1e-5, 1e-2), free=True),
        rod_dead_volume=Parameter(2e-4, "m3", "rod-side volume, rod out", bounds=(1e-5, 1e-2), free=True),
        rod_reference=0.9,
        oil=_stiffness(1e9, "oil"),
        friction=Viscous(viscous=Parameter(4000.0, "N.s/m", "seals", bounds=(0, 1e6), free=True)),
        cap_pressure=_pressure("cap side"),
        rod_pressure=_pressure("rod side"),
    )
    load = LinearLoad(mass=350.0, load_force=2000.0, position=State(0.45, "m", "position", nominal=0.5))
    start_pressure_b = Parameter(60e5, "Pa", "rod-side pressure at the start", bounds=(1e5, 5e7), source="assumed")

    def equations(self):
        yield connect(self.reference, self.controller.reference)
        yield self.controller.position == self.load.position
        yield connect(self.controller.current, self.slide.target)
        yield connect(self.slide.displacement, self.valve.spool)
        yield connect(self.supply.port, self.valve.supply)
        yield connect(self.tank.port, self.valve.tank)
        yield connect(self.valve.a, self.hose_a.a)
        yield connect(self.valve.b, self.hose_b.a)
        yield connect(self.hose_a.b, self.line_a.a)
        yield connect(self.hose_b.b, self.line_b.a)
        yield connect(self.line_a.b, self.cylinder.cap)
        yield connect(self.line_b.b, self.cylinder.annulus)
        yield connect(self.cylinder.rod, self.load.flange)
        yield self.position == self.load.position
        yield self.spool == self.slide.position
        yield self.pressure_a == self.cylinder.cap_pressure
        yield self.pressure_b == self.cylinder.rod_pressure

    def initial_equations(self):
        yield self.cylinder.rod_pressure == self.start_pressure_b
        yield der(self.load.velocity) == 0
        yield self.hose_a.pressure == self.cylinder.cap_pressure
        yield self.hose_b.pressure == self.cylinder.rod_pressure


def cylinder_bench() -> Model:
    return Model(CylinderBench(), "cylinder_bench", step=5e-4)
