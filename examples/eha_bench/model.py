"""A pump-controlled cylinder on a test bench, driven by the measured speed of its pump. See README.md."""

from __future__ import annotations

import math

import casadi as ca

from hydrotwin.models.components import Cylinder, Pump, Reservoir
from hydrotwin.models.language import (
    Component,
    Flange,
    HydraulicPort,
    Input,
    Model,
    Output,
    Parameter,
    Shaft,
    Slot,
    State,
    connect,
    der,
)
from hydrotwin.models.laws import (
    ConstantBulkModulus,
    ConstantVolumetricEfficiency,
    NoFriction,
    OrificeLaw,
    PumpSlip,
    TurbulentOrifice,
)

CM3_PER_REV = 1e-6 / (2 * math.pi)  # m3/rad
PLAUSIBLE_EFFICIENCY = Parameter(
    0.92, "1", "volumetric efficiency eta_v", bounds=(0.85, 0.98), source="typical of gear pumps; 0.92: bench's author"
)


class SpeedDrive(Component):
    """A shaft that turns as its speed sensor says; the torque it takes is not looked at."""

    shaft = Shaft("drive shaft")
    speed = Input("rad/s", "measured speed", nominal=100.0)

    def equations(self):
        yield self.shaft.w == self.speed


class DirectionValve(Component):
    """Two solenoid seats between the chambers and the tank line; the one that is not driven opens.

    ``direction`` +1 opens b to the tank, -1 opens a, 0 closes both, so the driven chamber keeps its oil.
    """

    a = HydraulicPort("chamber a")
    b = HydraulicPort("chamber b")
    tank = HydraulicPort("tank line")
    direction = Input("1", "+1 extend, -1 retract, 0 hold")
    orifice = Slot(OrificeLaw, default=TurbulentOrifice())

    def equations(self):
        d, flow, p_t = self.direction, self.orifice.flow, self.tank.p
        yield self.a.q == flow(ca.fmax(-d, 0), self.a.p - p_t)
        yield self.b.q == flow(ca.fmax(d, 0), self.b.p - p_t)
        yield self.a.q + self.b.q + self.tank.q == 0


class BrakingLoad(Component):
    """A rod without inertia that sticks, slides, and is braked by ``force`` when it extends, not when it retracts.

        b ds/dt = max(f - F - F_c, 0) + min(f + F_c, 0),   dF/dt = 0

    Coulomb friction F_c with exact sticking and viscous friction b. A second cylinder that presses its oil through a
    relief valve and draws it back through a check valve is such a load. ``force`` is a state without a rate: a
    constant whose start belongs to the recording, not to the machine.

    Validity: motion slow against m/b, 1 ms for 50 kg.
    """

    flange = Flange("rod end; s grows as the rod extends")
    coulomb = Parameter(1000.0, "N", "Coulomb friction F_c, both directions", bounds=(0, 1e5), source="guess: 5 bar")
    viscous = Parameter(4e4, "N.s/m", "viscous friction b", bounds=(2e4, 1e6), source="guess: 500 N at 12 mm/s")
    usual_force = Parameter(2000.0, "N", "force F unless a recording has its own", bounds=(-2e4, 2e4), source="guess")
    position = State(0.0, "m", "position between the end stops", nominal=0.05, bounds=(-1e-4, 0.0751))
    force = State(lambda load: load.usual_force, "N", "force F against extension", nominal=2000.0, bounds=(-2e4, 2e4))

    def equations(self):
        f, F, F_c = self.flange.f, self.force, self.coulomb
        yield self.flange.s == self.position
        yield self.viscous * der(self.position) == ca.fmax(f - F - F_c, 0) + ca.fmin(f + F_c, 0)
        yield der(self.force) == 0


class EhaBench(Component):
    """Pump-controlled cylinder against a brake, driven by measured motor speed and valve direction."""

    motor_speed = Input("rad/s", "measured motor speed", nominal=100.0, interpolation="linear")
    valve_direction = Input("1", "which solenoid is on: +1 extend, -1 retract, 0 none")
    position = Output("m", "stroke of the rod", nominal=0.05)
    pressure_a = Output("Pa", "pressure, bore side", nominal=1e6)
    pressure_b = Output("Pa", "pressure, rod side", nominal=1e6)

    drive = SpeedDrive()
    pump = Pump(displacement=1.6 * CM3_PER_REV, loss=ConstantVolumetricEfficiency(efficiency=PLAUSIBLE_EFFICIENCY))
    valve = DirectionValve(orifice=TurbulentOrifice(flow_coefficient=1e-8))
    accumulator = Reservoir(pressure=5e5)
    cylinder = Cylinder(
        cap_area=1963.5e-6,
        rod_area=1649.3e-6,
        cap_dead_volume=5e-5,
        rod_dead_volume=5e-5,
        rod_reference=0.075,
        friction=NoFriction(),
        oil=ConstantBulkModulus(bulk_modulus=1e9),
        cap_pressure=State(5e5, "Pa", "pressure, bore side", nominal=1e6),
        rod_pressure=State(5e5, "Pa", "pressure, rod side", nominal=1e6),
    )
    load = BrakingLoad()

    def equations(self):
        yield connect(self.motor_speed, self.drive.speed)
        yield connect(self.valve_direction, self.valve.direction)
        yield connect(self.drive.shaft, self.pump.shaft)
        yield connect(self.pump.cap, self.cylinder.cap)
        yield connect(self.valve.a, self.cylinder.cap)
        yield connect(self.pump.rod, self.cylinder.annulus)
        yield connect(self.valve.b, self.cylinder.annulus)
        yield connect(self.valve.tank, self.accumulator.port)
        yield connect(self.cylinder.rod, self.load.flange)
        yield self.position == self.load.position
        yield self.pressure_a == self.cylinder.cap_pressure
        yield self.pressure_b == self.cylinder.rod_pressure


ALWAYS_FREE = ("valve.orifice.flow_coefficient", "accumulator.pressure", "load.coulomb", "load.viscous")
STIFFNESS = "cylinder.oil.bulk_modulus"
SLIP = "pump.loss.slip_conductance"


def _freed(bench: EhaBench, name: str, *free: str) -> Model:
    return Model(bench, name, settings={path: {"free": True} for path in free}, step=5e-4)


def model() -> Model:
    """The plain bench: stiff oil, a pump without slip, nominal sizes."""
    return _freed(EhaBench(), "eha_bench", "pump.loss.efficiency", *ALWAYS_FREE)


def soft() -> Model:
    """The bench with the stiffness of oil and hoses free, started low."""
    return _freed(EhaBench(cylinder=_soft()), "eha_bench_soft", "pump.loss.efficiency", STIFFNESS, *ALWAYS_FREE)


def leaking() -> Model:
    """The bench whose pump slips with pressure instead of losing a constant share."""
    return _freed(EhaBench(pump=_slipping()), "eha_bench_leaking", SLIP, *ALWAYS_FREE)


def soft_and_leaking() -> Model:
    """Both at once."""
    bench = EhaBench(cylinder=_soft(), pump=_slipping())
    return _freed(bench, "eha_bench_soft_and_leaking", SLIP, STIFFNESS, *ALWAYS_FREE)


def _soft() -> Cylinder:
    return EhaBench.cylinder.but(oil=ConstantBulkModulus(bulk_modulus=5e7))


def _slipping() -> Pump:
    return EhaBench.pump.but(loss=PumpSlip(slip_conductance=1e-12))
