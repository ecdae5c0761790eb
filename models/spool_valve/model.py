"""Spool valve, differential cylinder and load. See README.md for the equations."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import casadi as ca

from hydrotwin.models.components import (
    Cylinder,
    FourEdgeValve,
    LinearLoad,
    PressureSource,
    ProportionalSolenoid,
    Reservoir,
    Spool,
)
from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, connect, der
from hydrotwin.models.language.parameter_file import read_parameters
from hydrotwin.models.laws import Viscous

_PARAMETERS = Path(__file__).with_name("parameters.toml")


class SpoolValve(Component):
    """Valve-driven actuator: solenoid, spool, four metering edges, two oil volumes, mass and load.

    It starts with ``start_pressure_b`` on the rod side and the cap side at static equilibrium.
    """

    current = Input("1", "normalised solenoid current", nominal=1.0, interpolation="hold")
    position = Output("m", "stroke of the rod", nominal=0.3)
    spool = Output("1", "spool position", nominal=1.0)
    pressure_a = Output("Pa", "pressure, cap side", nominal=5e6)
    pressure_b = Output("Pa", "pressure, rod side", nominal=5e6)
    velocity = Output("m/s", "velocity of the rod", nominal=0.1)

    solenoid = ProportionalSolenoid()
    slide = Spool()
    valve = FourEdgeValve()
    supply = PressureSource()
    tank = Reservoir()
    cylinder = Cylinder(
        friction=Viscous(),
        cap_pressure=State(6e6, "Pa", "pressure, cap side", nominal=1e6, fixed=False),
        rod_pressure=State(6e6, "Pa", "pressure, rod side", nominal=1e6, fixed=False),
    )
    load = LinearLoad(position=State(0.45, "m", "position of the load", nominal=0.1))
    start_pressure_b = Parameter(60e5, "Pa", "rod-side pressure at the start", bounds=(1e5, 5e7), source="assumed")

    def equations(self):
        yield connect(self.current, self.solenoid.current)
        yield connect(self.solenoid.target, self.slide.target)
        yield connect(self.slide.displacement, self.valve.spool)
        yield connect(self.supply.port, self.valve.supply)
        yield connect(self.tank.port, self.valve.tank)
        yield connect(self.valve.a, self.cylinder.cap)
        yield connect(self.valve.b, self.cylinder.annulus)
        yield connect(self.cylinder.rod, self.load.flange)
        yield self.position == self.load.position
        yield self.spool == self.slide.position
        yield self.pressure_a == self.cylinder.cap_pressure
        yield self.pressure_b == self.cylinder.rod_pressure
        yield self.velocity == self.load.velocity

    def initial_equations(self):
        yield self.cylinder.rod_pressure == self.start_pressure_b
        yield der(self.load.velocity) == 0


class FlowCurve(Component):
    """Steady velocity of cylinder and valve at a spool position, all dynamics but the spool's left out.

    For x > 0, with q = k_q x sqrt(dp) at both edges and p_a A_a - p_b A_b = F + b v:

        S (v/(k x))^2 + b v = F_0,   S = A_a^3 + A_b^3,   F_0 = A_a p_s - A_b p_t - F
        v = 2 k x F_0 / (b k x + sqrt((b k x)^2 + 4 S |F_0|))

    and for x < 0 the same, inwards, with F_0 = A_b p_s - A_a p_t + F. A load beyond the supply (F_0 < 0) pushes the
    oil back. Serves recordings at 10 Hz, where the chambers are always in equilibrium.
    Source: Merritt (1967), section 5.2 with unequal areas.
    """

    spool = Input("1", "spool position")
    position_out = Output("m", "stroke")
    velocity_out = Output("m/s", "velocity")
    flow_coefficient = Parameter(6e-8, "m3/(s.sqrt(Pa))", "k_q at spool 1", bounds=(1e-12, 1e-3), source="data sheet")
    cap_area = Parameter(1.96e-3, "m2", "piston area A_a", bounds=(1e-6, 1), source="geometry")
    rod_area = Parameter(1.37e-3, "m2", "annulus area A_b", bounds=(1e-6, 1), source="geometry")
    supply_pressure = Parameter(180e5, "Pa", "supply pressure p_s", bounds=(1e5, 1e9), source="setting")
    tank_pressure = Parameter(5e5, "Pa", "tank pressure p_t", bounds=(0, 1e8), source="setting")
    load_force = Parameter(4000.0, "N", "force F against extension", bounds=(-1e7, 1e7), source="load")
    viscous = Parameter(4000.0, "N.s/m", "viscous friction b", bounds=(0, 1e8), source="data sheet")
    stroke = State(0.45, "m", "stroke", nominal=0.1)

    def equations(self):
        A_a, A_b, p_s, p_t, F = self.cap_area, self.rod_area, self.supply_pressure, self.tank_pressure, self.load_force
        out = self._speed(ca.fmax(self.spool, 0), A_a * p_s - A_b * p_t - F)
        back = self._speed(ca.fmax(-self.spool, 0), A_b * p_s - A_a * p_t + F)
        yield self.velocity_out == out - back
        yield der(self.stroke) == self.velocity_out
        yield self.position_out == self.stroke

    def _speed(self, x, F_0):
        k, b, S = self.flow_coefficient, self.viscous, self.cap_area**3 + self.rod_area**3
        return 2 * k * x * F_0 / (b * k * x + ca.sqrt((b * k * x) ** 2 + 4 * S * ca.fabs(F_0)))


class QuasiStaticSpoolValve(Component):
    """Spool dynamics and the steady flow curve, no chambers: for recordings at 10 Hz."""

    current = Input("1", "normalised solenoid current", nominal=1.0, interpolation="hold")
    position = Output("m", "stroke of the rod", nominal=0.3)
    spool = Output("1", "spool position", nominal=1.0)
    velocity = Output("m/s", "velocity of the rod", nominal=0.1)

    solenoid = ProportionalSolenoid()
    slide = Spool()
    curve = FlowCurve()

    def equations(self):
        yield connect(self.current, self.solenoid.current)
        yield connect(self.solenoid.target, self.slide.target)
        yield connect(self.slide.displacement, self.curve.spool)
        yield self.position == self.curve.stroke
        yield self.spool == self.slide.position
        yield self.velocity == self.curve.velocity_out


@cache  # immutable: its equations are solved once
def model() -> Model:
    """The spool valve with the values of parameters.toml."""
    return Model(SpoolValve(), "spool_valve", settings=read_parameters(_PARAMETERS), step=5e-4)


_QUASI_STATIC = {
    "valve.orifice.flow_coefficient": "curve.flow_coefficient",
    "cylinder.cap_area": "curve.cap_area",
    "cylinder.rod_area": "curve.rod_area",
    "supply.pressure": "curve.supply_pressure",
    "tank.pressure": "curve.tank_pressure",
    "load.load_force": "curve.load_force",
    "cylinder.friction.viscous": "curve.viscous",
}


@cache  # immutable: its equations are solved once
def quasi_static() -> Model:
    """The quasi-static variant with the same values."""
    settings = {}
    for path, setting in read_parameters(_PARAMETERS).items():
        if path in _QUASI_STATIC or path.startswith(("solenoid.", "slide.")):
            settings[_QUASI_STATIC.get(path, path)] = setting
    return Model(QuasiStaticSpoolValve(), "spool_valve_quasi_static", settings=settings, step=1e-3)
