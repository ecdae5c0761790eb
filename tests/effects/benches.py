"""Small machines with every kind of site, each of which fits on a page."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from hydrotwin.models.components import (
    Cylinder,
    FourEdgeValve,
    LinearLoad,
    PressureSource,
    Pump,
    Reservoir,
    SpeedControlledMotor,
)
from hydrotwin.models.components.mechanical import ForceSource
from hydrotwin.models.effects import add_effect
from hydrotwin.models.language import (
    Component,
    Input,
    Model,
    Output,
    Parameter,
    RotationalFlange,
    State,
    connect,
    der,
)
from hydrotwin.models.laws import Viscous
from hydrotwin.simulation import prepare


class PumpBench(Component):
    """A motor, a pump in a closed circuit, a cylinder and a mass."""

    command = Input("V", "speed command", nominal=5.0)
    position = Output("m", "position", nominal=0.1)
    pressure = Output("Pa", "pressure, cap side", nominal=1e6)
    motor = SpeedControlledMotor()
    pump = Pump(displacement=2e-7, return_ratio=0.8)
    cylinder = Cylinder(friction=Viscous(viscous=2000.0), cap_dead_volume=5e-4, rod_dead_volume=5e-4)
    load = LinearLoad(load_force=300.0)

    def equations(self):
        yield connect(self.command, self.motor.command)
        yield connect(self.motor.shaft, self.pump.shaft)
        yield connect(self.pump.cap, self.cylinder.cap)
        yield connect(self.pump.rod, self.cylinder.annulus)
        yield connect(self.cylinder.rod, self.load.flange)
        yield self.position == self.load.position
        yield self.pressure == self.cylinder.cap_pressure


class ValveBench(Component):
    """A valve that the input moves itself, between a supply, a tank and a cylinder."""

    spool = Input("1", "position of the spool")
    position = Output("m", "position", nominal=0.1)
    valve = FourEdgeValve()
    supply = PressureSource(pressure=1e7)
    tank = Reservoir(pressure=2e5)
    cylinder = Cylinder(friction=Viscous(viscous=4000.0), cap_dead_volume=5e-4, rod_dead_volume=5e-4)
    load = LinearLoad()

    def equations(self):
        yield connect(self.spool, self.valve.spool)
        yield connect(self.supply.port, self.valve.supply)
        yield connect(self.tank.port, self.valve.tank)
        yield connect(self.valve.a, self.cylinder.cap)
        yield connect(self.valve.b, self.cylinder.annulus)
        yield connect(self.cylinder.rod, self.load.flange)
        yield self.position == self.load.position


class Axis(Component):
    """A mass that a force pushes."""

    force = Input("N", "force", nominal=100.0)
    position = Output("m", "position", nominal=0.1)
    velocity = Output("m/s", "velocity", nominal=0.1)
    motor = ForceSource()
    carriage = LinearLoad(friction=Viscous(viscous=200.0), mass=500.0, load_force=0.0)

    def equations(self):
        yield connect(self.force, self.motor.force)
        yield connect(self.motor.flange, self.carriage.flange)
        yield self.position == self.carriage.position
        yield self.velocity == self.carriage.velocity


class Table(Component):
    """A table that turns on its flange."""

    flange = RotationalFlange("where it is turned")
    inertia = Parameter(2.0, "kg.m2", "inertia", bounds=(1e-3, 1e3), source="geometry")
    damping = Parameter(3.0, "N.m.s/rad", "of the bearing", bounds=(0, 1e3), source="bearing")
    angle = State(0.0, "rad", "angle", nominal=0.5)
    rate = State(0.0, "rad/s", "rate", nominal=0.5)

    def equations(self):
        yield self.flange.phi == self.angle
        yield der(self.angle) == self.rate
        yield self.inertia * der(self.rate) == self.flange.tau - self.damping * self.rate


class Actuator(Component):
    """A torque on a flange."""

    flange = RotationalFlange("where it turns")
    torque = Input("N.m", "torque", nominal=10.0)

    def equations(self):
        yield self.flange.tau == -self.torque


class TurningTable(Component):
    """A table that a torque turns."""

    torque = Input("N.m", "torque", nominal=10.0)
    angle = Output("rad", "angle", nominal=0.5)
    actuator = Actuator()
    table = Table()

    def equations(self):
        yield connect(self.torque, self.actuator.torque)
        yield connect(self.actuator.flange, self.table.flange)
        yield self.angle == self.table.angle


class Tanks(Component):
    """Two tanks, the upper one draining into the lower one; the outlets are linear."""

    inflow = Input("m/s", "inflow over the area of a tank", nominal=0.01)
    level = Output("m", "level of the lower tank")
    rate = Parameter(0.1, "1/s", "share of the level that drains per second", bounds=(1e-6, 10))
    upper = State(0.5, "m", "level of the upper tank", bounds=(0.0, 10.0))
    lower = State(0.4, "m", "level of the lower tank", bounds=(0.0, 10.0))

    def equations(self):
        yield der(self.upper) == self.inflow - self.rate * self.upper
        yield der(self.lower) == self.rate * (self.upper - self.lower)
        yield self.level == self.lower


def pump_bench() -> Model:
    return Model(PumpBench(), "pump_bench")


def valve_bench() -> Model:
    return Model(ValveBench(), "valve_bench", step=5e-4)


def axis() -> Model:
    return Model(Axis(), "axis")


def turning_table() -> Model:
    return Model(TurningTable(), "turning_table")


def tanks() -> Model:
    return Model(Tanks(), "tanks")


class PassOn(Component):
    """A signal that comes out as it goes in."""

    command = Input("V", "in", nominal=2.0)
    reading = Output("V", "out", nominal=2.0)
    memory = State(0.0, "V.s", "a model has a state")

    def equations(self):
        yield der(self.memory) == self.command
        yield self.reading == self.command


def pass_on() -> Model:
    return Model(PassOn(), "pass_on", step=5e-4)


def run(model: Model, time, /, *inputs, **values):
    """Outputs (n, ny) over ``time`` (n,) for inputs (n,) each; values: parameters by path, dots as two underscores."""
    flat = getattr(model, "flat", model)
    p = flat.parameter_vector({k.replace("__", "."): v for k, v in values.items()})
    u = np.column_stack(inputs)
    x = np.asarray(flat.start_given()(u[0], p, [])).ravel()
    return np.asarray(prepare(flat, method="vm").run(np.asarray(time), u, p, x)[0])


def passed(effect: str, site: str, time, signal, /, **values):
    """What an effect at one end of `pass_on` makes of a signal (n,), linear between the samples."""
    flat = add_effect(pass_on(), effect, site, values).flat
    smooth = tuple(replace(i, interpolation="linear") for i in flat.inputs)
    return run(replace(flat, inputs=smooth), time, signal)[:, 0]


def play(signal, h, start=0.0):
    """The play operator of half width h (Krasnosel'skii): clip the last value into the band around the present one."""
    followed = [signal[0] + start * h]
    for value in signal[1:]:
        followed.append(min(max(followed[-1], value - h), value + h))
    return np.array(followed)


def seen(model: Model, paths, u=(), **states):
    """Any variables of a model by path, at its start but for ``states`` (dots as two underscores)."""
    flat = model.flat
    changes = {k.replace("__", "."): v for k, v in states.items()}
    start = np.asarray(flat.start_given()(list(u), flat.parameter_vector(), [])).ravel()
    x = [changes.get(s.name, v) for s, v in zip(flat.states, start, strict=True)]
    return np.asarray(model.observe(paths)(0.0, x, list(u), flat.parameter_vector())).ravel()
