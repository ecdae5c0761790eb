"""C-EHA with its one-link arm: motor, pump, cylinder, arm. See README.md for the equations and their corrections."""

from __future__ import annotations

from functools import cache
from pathlib import Path

from hydrotwin.models.components import Arm, Cylinder, Pump, SpeedControlledMotor
from hydrotwin.models.language import (
    Component,
    Flange,
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
from hydrotwin.models.language.parameter_file import read_parameters
from hydrotwin.models.laws import BulkModulusLaw, ConstantBulkModulus, FrictionLaw, Stribeck

_PARAMETERS = Path(__file__).with_name("parameters.toml")


def _area_ratio(machine):
    """Return flow over delivered flow of the C-EHA (Eq. 6): the cylinder's area ratio."""
    return machine.cylinder.rod_area / machine.cylinder.cap_area


class CehA(Component):
    """Compact electrohydraulic actuator that lifts a one-link arm.

    The mean pressure of the area-matched circuit is a neutral mode, so the rod side starts at ``precharge`` and the
    cap side at static equilibrium.
    """

    command = Input("V", "motor command", nominal=5.0, interpolation="hold")
    arm_angle = Output("rad", "arm angle above the horizontal", nominal=0.5)
    motor_speed = Output("rad/s", "motor speed", nominal=300.0)
    rod_position = Output("m", "stroke of the rod", nominal=0.05)
    pressure_cap = Output("Pa", "pressure, cap side", nominal=1e6)
    pressure_rod = Output("Pa", "pressure, rod side", nominal=1e6)
    piston_force = Output("N", "hydraulic force on the piston", nominal=1e3)

    motor = SpeedControlledMotor()
    pump = Pump(return_ratio=_area_ratio)
    cylinder = Cylinder(
        cap_pressure=State(2e6, "Pa", "pressure, cap side", nominal=1e6, fixed=False),
        rod_pressure=State(2e6, "Pa", "pressure, rod side", nominal=1e6, fixed=False),
    )
    arm = Arm()
    precharge = Parameter(2e6, "Pa", "rod-side pressure at the start", bounds=(1e5, 3e7), source="assumed")

    def equations(self):
        yield connect(self.command, self.motor.command)
        yield connect(self.motor.shaft, self.pump.shaft)
        yield connect(self.pump.cap, self.cylinder.cap)
        yield connect(self.pump.rod, self.cylinder.annulus)
        yield connect(self.cylinder.rod, self.arm.pin)
        yield self.arm_angle == self.arm.angle
        yield self.motor_speed == self.motor.speed
        yield self.rod_position == self.cylinder.rod.s
        yield self.pressure_cap == self.cylinder.cap_pressure
        yield self.pressure_rod == self.cylinder.rod_pressure
        yield self.piston_force == (
            self.cylinder.cap_area * self.cylinder.cap_pressure - self.cylinder.rod_area * self.cylinder.rod_pressure
        )

    def initial_equations(self):
        yield self.cylinder.rod_pressure == self.precharge
        yield der(self.arm.angular_velocity) == 0


class ForceActuator(Component):
    """Pump and cylinder with the piston force as the only hydraulic state (corrected Eq. 7 of the C-EHA paper).

        F' = -beta (A_cap^2/V_cap + A_rod^2/V_rod) v + beta c_p (A_cap/V_cap + A_rod^2/(A_cap V_rod)) w

    Pressures cannot be told from it, and the pump's torque is ``c_p F / A_cap``.
    """

    shaft = Shaft("drive shaft")
    rod = Flange("piston rod")
    friction = Slot(FrictionLaw, default=Stribeck())
    oil = Slot(BulkModulusLaw, default=ConstantBulkModulus())
    displacement = Parameter(
        1.05e-7, "m3/rad", "volumetric capacity c_p", bounds=(1e-10, 1e-3), source="C-EHA paper, Table 1"
    )
    cap_area = Parameter(8.042e-4, "m2", "piston area, cap side", bounds=(1e-6, 1), source="C-EHA paper, Table 1")
    rod_area = Parameter(6.319e-4, "m2", "annulus area", bounds=(1e-6, 1), source="C-EHA paper, Table 1")
    cap_dead_volume = Parameter(8e-5, "m3", "cap-side volume at s = 0", bounds=(1e-7, 1), source="assumed")
    rod_dead_volume = Parameter(8e-5, "m3", "rod-side volume at s = 0", bounds=(1e-7, 1), source="assumed")
    force = State(800.0, "N", "hydraulic force on the piston", nominal=1e3, fixed=False)

    def equations(self):
        A_cap, A_rod, c_p, w = self.cap_area, self.rod_area, self.displacement, self.shaft.w
        s, v, F = self.rod.s, der(self.rod.s), self.force
        V_cap = self.cap_dead_volume + A_cap * s
        V_rod = self.rod_dead_volume - A_rod * s
        beta = self.oil.effective(F / A_cap)
        yield der(F) == (
            -beta * (A_cap**2 / V_cap + A_rod**2 / V_rod) * v
            + beta * c_p * (A_cap / V_cap + A_rod**2 / (A_cap * V_rod)) * w
        )
        yield -self.rod.f == F - self.friction.force(v)
        yield self.shaft.tau == c_p * F / A_cap


class CehAThirdOrder(Component):
    """The C-EHA in the third-order form of the paper (Eq. 16, corrected): angle, rate and piston force."""

    command = Input("V", "motor command", nominal=5.0, interpolation="hold")
    arm_angle = Output("rad", "arm angle above the horizontal", nominal=0.5)
    motor_speed = Output("rad/s", "motor speed", nominal=300.0)
    rod_position = Output("m", "stroke of the rod", nominal=0.05)
    piston_force = Output("N", "hydraulic force on the piston", nominal=1e3)

    motor = SpeedControlledMotor()
    actuator = ForceActuator()
    arm = Arm()

    def equations(self):
        yield connect(self.command, self.motor.command)
        yield connect(self.motor.shaft, self.actuator.shaft)
        yield connect(self.actuator.rod, self.arm.pin)
        yield self.arm_angle == self.arm.angle
        yield self.motor_speed == self.motor.speed
        yield self.rod_position == self.actuator.rod.s
        yield self.piston_force == self.actuator.force

    def initial_equations(self):
        yield der(self.arm.angular_velocity) == 0


@cache  # immutable: its equations are solved once
def model() -> Model:
    """The C-EHA with the values of parameters.toml."""
    return Model(CehA(), "cehA", settings=read_parameters(_PARAMETERS), step=1e-3)


@cache  # immutable: its equations are solved once
def third_order() -> Model:
    """The third-order variant with the same values."""
    settings = {
        path.replace("cylinder.", "actuator.").replace("pump.", "actuator."): setting
        for path, setting in read_parameters(_PARAMETERS).items()
        if path not in ("precharge", "cylinder.rod_reference")
    }
    return Model(CehAThirdOrder(), "cehA_third_order", settings=settings, step=1e-3)
