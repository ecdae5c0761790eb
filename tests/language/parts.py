"""Small machines the language is tested on; every one has an ODE that fits on one line of paper."""

from __future__ import annotations

import numpy as np

from hydrotwin.models.language import (
    Component,
    Flange,
    HydraulicPort,
    Input,
    Law,
    Output,
    Parameter,
    Slot,
    State,
    Variable,
    connect,
    der,
)


class Friction(Law):
    """Viscous friction."""

    viscous = Parameter(100.0, "N.s/m", "viscous friction", bounds=(0, 1e9), free=True)

    def force(self, v):
        return self.viscous * v


class QuadraticFriction(Friction):
    """Viscous friction and drag: what a subclass adds to a law."""

    drag = Parameter(7.0, "N.s2/m2", "drag", bounds=(0, 1e9))

    def force(self, v):
        return super().force(v) + self.drag * v * v


class Damper(Component):
    """A damper to the ground with a law of friction in its slot."""

    end = Flange("end")
    friction = Slot(Friction, default=Friction())

    def equations(self):
        yield self.end.f == self.friction.force(der(self.end.s))


class Spring(Component):
    """A spring to the ground."""

    end = Flange("end")
    stiffness = Parameter(1e4, "N/m", "spring rate", bounds=(0, 1e12))

    def equations(self):
        yield self.end.f == self.stiffness * self.end.s


class Mass(Component):
    """A mass that is pushed."""

    end = Flange("end")
    force = Input("N", "push")
    mass = Parameter(2.0, "kg", "mass", bounds=(1e-6, 1e6))
    position = State(0.1, "m", "position", nominal=0.1)
    velocity = State(0.0, "m/s", "velocity")

    def equations(self):
        yield der(self.position) == self.velocity
        yield self.mass * der(self.velocity) == self.end.f + self.force
        yield self.end.s == self.position


class Attached(Component):
    """A mass without states of its own: it moves with whatever it is bolted to."""

    end = Flange("end")
    mass = Parameter(3.0, "kg", "mass", bounds=(0, 1e6))
    speed = Variable("m/s", "speed")

    def equations(self):
        yield self.speed == der(self.end.s)
        yield self.mass * der(self.speed) == self.end.f


class Oscillator(Component):
    """A mass on a spring and a damper."""

    force = Input("N", "push")
    position = Output("m", "position of the mass")
    mass = Mass()
    spring = Spring()
    damper = Damper(friction=Friction(viscous=5.0))

    def equations(self):
        yield connect(self.force, self.mass.force)
        yield connect(self.mass.end, self.spring.end)
        yield connect(self.mass.end, self.damper.end)
        yield self.position == self.mass.position


class LoadedOscillator(Oscillator):
    """The same with a second mass bolted on."""

    extra = Attached()

    def equations(self):
        yield from super().equations()
        yield connect(self.mass.end, self.extra.end)


class Volume(Component):
    """Compressible oil in a rigid vessel: V p' = beta q."""

    port = HydraulicPort("port")
    volume = Parameter(1e-3, "m3", "volume", bounds=(1e-9, 1))
    bulk_modulus = Parameter(1.5e9, "Pa", "bulk modulus", bounds=(1e6, 1e11))
    pressure = State(1e5, "Pa", "pressure", nominal=1e6)

    def equations(self):
        yield self.volume * der(self.pressure) == self.bulk_modulus * self.port.q
        yield self.port.p == self.pressure


class Restriction(Component):
    """Laminar resistance between two ports: q = G dp, no storage."""

    a = HydraulicPort("one side")
    b = HydraulicPort("other side")
    conductance = Parameter(1e-11, "m3/(s.Pa)", "conductance", bounds=(0, 1))

    def equations(self):
        yield self.a.q == self.conductance * (self.a.p - self.b.p)
        yield self.a.q + self.b.q == 0


class PressureSource(Component):
    """A port held at a pressure."""

    port = HydraulicPort("port")
    pressure = Parameter(2e5, "Pa", "pressure")

    def equations(self):
        yield self.port.p == self.pressure


class FlowSource(Component):
    """Pumps the commanded flow out of its port."""

    port = HydraulicPort("port")
    flow = Input("m3/s", "flow out of the port")

    def equations(self):
        yield self.port.q == -self.flow


class Lag(Component):
    """First-order lag: tau y' + y = k u."""

    u = Input("V", "in")
    y = Output("rad/s", "out")
    gain = Parameter(120.0, "rad/(s.V)", "gain")
    time_constant = Parameter(0.03, "s", "time constant", bounds=(1e-6, 1e3))
    speed = State(0.0, "rad/s", "speed")

    def equations(self):
        yield self.time_constant * der(self.speed) + self.speed == self.gain * self.u
        yield self.y == self.speed


def rates(model, x, u=(), t=0.0, **parameters):
    """x' of a model as a NumPy vector; ``parameters`` by path with dots written as two underscores."""
    flat = model.flat
    changes = {k.replace("__", "."): v for k, v in parameters.items()}
    return np.array(flat.ode(t, list(x), list(u), flat.parameter_vector(changes))[0]).ravel()


def outputs(model, x, u=(), t=0.0):
    """y of a model as a NumPy vector."""
    flat = model.flat
    return np.array(flat.ode(t, list(x), list(u), flat.parameter_vector())[1]).ravel()


def observed(model, paths, x, u=(), t=0.0):
    """Any variables of a model by path."""
    flat = model.flat
    return np.array(model.observe(paths)(t, list(x), list(u), flat.parameter_vector())).ravel()


class Gain(Component):
    u = Input("1")
    y = Output("1")
    factor = Parameter(2.0, "1", bounds=(-10, 10))

    def equations(self):
        yield self.y == self.factor * self.u


class Follower(Component):
    """x' = k u, with a part of its own for the gain."""

    u = Input("1")
    y = Output("1")
    rate = Parameter(1.0, "1/s")
    x = State(0.0, "1")

    def equations(self):
        yield der(self.x) == self.rate * self.u
        yield self.y == self.x


class Chain(Component):
    """Command, gain, integrator, output; the output tells the command too."""

    command = Input("1")
    position = Output("1")
    shown = Output("1")
    gain = Gain(factor=1.0)
    follower = Follower()

    def equations(self):
        yield connect(self.command, self.gain.u)
        yield connect(self.gain.y, self.follower.u)
        yield self.position == self.follower.y
        yield self.shown == self.gain.y


class Hydraulics(Component):
    """A volume fed from a source through a restriction."""

    source = PressureSource(pressure=2e5)
    feed = Restriction(conductance=1e-11)
    vessel = Volume()

    def equations(self):
        yield connect(self.source.port, self.feed.a)
        yield connect(self.feed.b, self.vessel.port)


class Leak(Component):
    port = HydraulicPort()
    conductance = Parameter(1e-11, "m3/(s.Pa)")

    def equations(self):
        yield self.port.q == self.conductance * self.port.p


class Throttle(Component):
    a = HydraulicPort()
    b = HydraulicPort()
    resistance = Parameter(0.0, "Pa.s/m3")

    def equations(self):
        yield self.a.q + self.b.q == 0
        yield self.b.p == self.a.p - self.resistance * self.a.q
