"""Machines with hoses, drawn in as many pieces as one likes: the physics is the same."""

from __future__ import annotations

from hydrotwin.models.components import (
    Cylinder,
    FourEdgeValve,
    LinearLoad,
    LineVolume,
    Passage,
    PressureSource,
    Pump,
    Reservoir,
)
from hydrotwin.models.language import (
    Component,
    HydraulicPort,
    Input,
    Model,
    Output,
    Parameter,
    Shaft,
    State,
    connect,
    der,
)
from hydrotwin.models.laws import ConstantBulkModulus, LaminarLeakage, Viscous

HOSE = 4e-4  # m3 of oil in a hose
FITTING = 1e-7  # m3/(s.Pa), its conductance: 6 l/min lose 10 mbar in it


def fitting(conductance: float = FITTING) -> Component:
    """A short pipe."""
    given = Parameter(conductance, "m3/(s.Pa)", "conductance", bounds=(0, 1e-5), source="geometry")
    return Passage(law=LaminarLeakage(conductance=given))


def hose(pieces: int, conductance: float = FITTING) -> Component:
    """A hose between ports ``a`` and ``b``, of as many volumes with fittings between them."""
    content: dict = {"__module__": __name__, "__doc__": "A hose.", "a": HydraulicPort("end"), "b": HydraulicPort("end")}
    for k in range(pieces):
        content[f"piece_{k}"] = LineVolume(
            volume=HOSE / pieces, oil=ConstantBulkModulus(bulk_modulus=3e8), pressure=State(3e6, "Pa", nominal=1e6)
        )
    for k in range(1, pieces):
        content[f"fitting_{k}"] = fitting(conductance)

    def equations(self):
        yield connect(self.a, self.piece_0.a)
        for k in range(1, pieces):
            joint = getattr(self, f"fitting_{k}")
            yield connect(getattr(self, f"piece_{k - 1}").b, joint.a)
            yield connect(joint.b, getattr(self, f"piece_{k}").a)
        yield connect(getattr(self, f"piece_{pieces - 1}").b, self.b)

    return type("Hose", (Component,), {**content, "equations": equations})()


class Drum(Component):
    """A drum with a load on its rope: ``J w' = tau - m g r``."""

    shaft = Shaft("drum")
    inertia = Parameter(5.0, "kg.m2", "inertia J", bounds=(1e-3, 1e4), source="geometry")
    load = Parameter(120.0, "N.m", "torque of the load", bounds=(-1e5, 1e5), source="load")
    damping = Parameter(8.0, "N.m.s/rad", "of the bearing", bounds=(0, 1e4), source="bearing", free=True)
    speed = State(0.0, "rad/s", "speed", nominal=5.0)

    def equations(self):
        yield self.shaft.w == self.speed
        yield self.inertia * der(self.speed) == self.shaft.tau - self.load - self.damping * self.speed


class _Bench(Component):
    """A valve between a supply, a tank and two hoses."""

    spool = Input("1", "position of the spool")
    pressure_a = Output("Pa", "pressure behind the valve", nominal=1e6)
    valve = FourEdgeValve()
    supply = PressureSource(pressure=1.2e7)
    tank = Reservoir(pressure=2e5)

    def equations(self):
        yield connect(self.spool, self.valve.spool)
        yield connect(self.supply.port, self.valve.supply)
        yield connect(self.tank.port, self.valve.tank)
        yield connect(self.valve.a, self.hose_a.a)
        yield connect(self.valve.b, self.hose_b.a)
        yield self.pressure_a == self.valve.a.p


class _Winch(_Bench):
    """A valve, two hoses, a hydraulic motor and a drum."""

    speed = Output("rad/s", "speed of the drum", nominal=5.0)
    motor = Pump(displacement=2e-5)
    drum = Drum()

    def equations(self):
        yield from super().equations()
        yield connect(self.hose_a.b, self.motor.rod)
        yield connect(self.hose_b.b, self.motor.cap)
        yield connect(self.motor.shaft, self.drum.shaft)
        yield self.speed == self.drum.speed


class _TestCylinder(_Bench):
    """A valve, two hoses behind short pipes, a cylinder and a mass."""

    position = Output("m", "position", nominal=0.1)
    pipe_a, pipe_b = fitting(), fitting()
    cylinder = Cylinder(friction=Viscous(viscous=4000.0), cap_dead_volume=5e-4, rod_dead_volume=5e-4)
    load = LinearLoad()

    def equations(self):
        yield from super().equations()
        yield connect(self.hose_a.b, self.pipe_a.a)
        yield connect(self.hose_b.b, self.pipe_b.a)
        yield connect(self.pipe_a.b, self.cylinder.cap)
        yield connect(self.pipe_b.b, self.cylinder.annulus)
        yield connect(self.cylinder.rod, self.load.flange)
        yield self.position == self.load.position


def winch(pieces: int, conductance: float = FITTING) -> Model:
    """The winch with hoses of so many pieces."""
    hoses = {"hose_a": hose(pieces, conductance), "hose_b": hose(pieces, conductance)}
    return Model(type("Winch", (_Winch,), hoses)(), "winch", step=5e-4)


def cylinder_bench(pieces: int, conductance: float = FITTING) -> Model:
    """The test cylinder with hoses of so many pieces."""
    hoses = {"hose_a": hose(pieces, conductance), "hose_b": hose(pieces, conductance)}
    return Model(type("TestCylinder", (_TestCylinder,), hoses)(), "test_cylinder", step=5e-4)
