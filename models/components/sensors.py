"""Sensors: a port's quantity as a signal. They take no flow and no force."""

from __future__ import annotations

from hydrotwin.models.language import Component, Flange, HydraulicPort, Output, RotationalFlange, Shaft


class PressureSensor(Component):
    """Pressure of a node."""

    port = HydraulicPort("measured node")
    pressure = Output("Pa", "pressure", nominal=1e6)

    def equations(self):
        yield self.pressure == self.port.p
        yield self.port.q == 0


class FlowSensor(Component):
    """Flow from ``a`` to ``b``."""

    a = HydraulicPort("upstream")
    b = HydraulicPort("downstream")
    flow = Output("m3/s", "flow from a to b", nominal=1e-4)

    def equations(self):
        yield self.a.p == self.b.p
        yield self.a.q + self.b.q == 0
        yield self.flow == self.a.q


class PositionSensor(Component):
    """Position of a flange."""

    flange = Flange("measured flange")
    position = Output("m", "position", nominal=0.1)

    def equations(self):
        yield self.position == self.flange.s
        yield self.flange.f == 0


class ForceSensor(Component):
    """Force passed from ``a`` to ``b``."""

    a = Flange("side that is pushed")
    b = Flange("side that pushes on")
    force = Output("N", "force passed on", nominal=1e3)

    def equations(self):
        yield self.a.s == self.b.s
        yield self.a.f + self.b.f == 0
        yield self.force == self.a.f


class AngleSensor(Component):
    """Angle of a rotational flange."""

    flange = RotationalFlange("measured flange")
    angle = Output("rad", "angle", nominal=1.0)

    def equations(self):
        yield self.angle == self.flange.phi
        yield self.flange.tau == 0


class SpeedSensor(Component):
    """Speed of a shaft."""

    shaft = Shaft("measured shaft")
    speed = Output("rad/s", "speed", nominal=100.0)

    def equations(self):
        yield self.speed == self.shaft.w
        yield self.shaft.tau == 0
