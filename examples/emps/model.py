"""A positioning axis pushed by a motor force, as a first guess writes it. See README.md."""

from __future__ import annotations

from hydrotwin.models.components import ForceSource, LinearLoad
from hydrotwin.models.language import Component, Input, Model, Output, connect
from hydrotwin.models.laws import Coulomb, Viscous


class Axis(Component):
    """Mass, viscous friction and a constant force: ``M dv/dt = F - F_v v - F_0``."""

    force = Input("N", "motor force", nominal=50.0, interpolation="linear")
    position = Output("m", "position of the carriage", nominal=0.1)
    motor = ForceSource()
    carriage = LinearLoad(friction=Viscous(viscous=200.0), mass=100.0, load_force=0.0)

    def equations(self):
        yield connect(self.force, self.motor.force)
        yield connect(self.motor.flange, self.carriage.flange)
        yield self.position == self.carriage.position


def _identified(axis: Axis, name: str, *further: str) -> Model:
    free = ("carriage.mass", "carriage.friction.viscous", "carriage.load_force", *further)
    return Model(axis, name, settings={path: {"free": True} for path in free}, step=4e-3)


def axis() -> Model:
    """The axis without dry friction."""
    return _identified(Axis(), "emps_axis")


def axis_with_coulomb() -> Model:
    """The axis with dry friction."""
    dry = Coulomb(coulomb=10.0, viscous=200.0)
    carriage = LinearLoad(friction=dry, mass=100.0, load_force=0.0)
    return _identified(Axis(carriage=carriage), "emps_axis_with_coulomb", "carriage.friction.coulomb")
