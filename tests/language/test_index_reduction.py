"""der() of what is no state: the equation that determines it is differentiated."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models.language import (
    Component,
    Flange,
    Input,
    Model,
    Output,
    Parameter,
    RotationalFlange,
    State,
    TopologyError,
    Variable,
    connect,
    der,
)
from tests.language.parts import Attached, LoadedOscillator, Mass, Oscillator, observed, rates


def test_a_bolted_mass_adds_its_inertia():
    x, v, force = 0.1, 0.2, 3.0
    loaded = rates(Model(LoadedOscillator()), [x, v], [force])
    assert loaded == pytest.approx([v, (force - 1e4 * x - 5 * v) / (2.0 + 3.0)], rel=1e-13)


def test_the_bolt_carries_the_inertia_of_the_bolted_mass():
    model = Model(LoadedOscillator())
    acceleration = (3.0 - 1e4 * 0.1 - 5 * 0.2) / 5
    seen = observed(model, ["extra.end.f", "der(mass.velocity)", "extra.speed"], [0.1, 0.2], [3.0])
    assert seen == pytest.approx([3 * acceleration, acceleration, 0.2], rel=1e-13)


def test_two_bolted_masses_add_up():
    class Stack(LoadedOscillator):
        further = Attached(mass=5.0)

        def equations(self):
            yield from super().equations()
            yield connect(self.extra.end, self.further.end)

    assert rates(Model(Stack()), [0.1, 0.0], [0.0])[1] == pytest.approx(-1000.0 / 10.0)


class Crank(Component):
    """A lever of inertia J whose flange moves along s = r sin(phi): geometry differentiated twice."""

    torque = Input("N.m")
    end = Flange("pin")
    radius = Parameter(0.4, "m")
    inertia = Parameter(1.5, "kg.m2")
    angle = State(0.3, "rad")
    speed = State(0.0, "rad/s")

    def equations(self):
        yield der(self.angle) == self.speed
        yield self.inertia * der(self.speed) == self.torque + self.radius * ca.cos(self.angle) * self.end.f
        yield self.end.s == self.radius * ca.sin(self.angle)


class CrankedMass(Component):
    torque = Input("N.m")
    crank = Crank()
    load = Attached(mass=7.0)

    def equations(self):
        yield connect(self.torque, self.crank.torque)
        yield connect(self.crank.end, self.load.end)


def test_a_mass_on_a_crank_is_the_inertia_that_lagrange_gives():
    # kinetic energy 1/2 (J + m r^2 cos^2 phi) phi'^2 under the torque T
    a, w, torque = 0.5, 1.7, 4.0
    r, inertia, m = 0.4, 1.5, 7.0
    expected = (torque + m * r**2 * np.cos(a) * np.sin(a) * w**2) / (inertia + m * r**2 * np.cos(a) ** 2)
    assert rates(Model(CrankedMass()), [a, w], [torque])[1] == pytest.approx(expected, rel=1e-12)


def test_the_derivative_of_a_derivative_may_be_written_at_once():
    class Ideal(Component):
        end = Flange("end")
        mass = Parameter(3.0, "kg")

        def equations(self):
            yield self.mass * der(der(self.end.s)) == self.end.f

    class Rig(Oscillator):
        extra = Ideal()

        def equations(self):
            yield from super().equations()
            yield connect(self.mass.end, self.extra.end)

    direct = rates(Model(LoadedOscillator()), [0.1, 0.2], [3.0])
    assert rates(Model(Rig()), [0.1, 0.2], [3.0]) == pytest.approx(direct, rel=1e-13)


def test_a_gear_between_two_rotors_reflects_inertia_with_the_ratio_squared():
    class Rotor(Component):
        torque = Input("N.m")
        shaft = RotationalFlange("shaft")
        inertia = Parameter(0.2, "kg.m2")
        angle = State(0.0, "rad")
        speed = State(0.0, "rad/s")

        def equations(self):
            yield der(self.angle) == self.speed
            yield self.inertia * der(self.speed) == self.torque + self.shaft.tau
            yield self.shaft.phi == self.angle

    class Gear(Component):
        fast = RotationalFlange("fast side")
        slow = RotationalFlange("slow side")
        ratio = Parameter(5.0, "1")

        def equations(self):
            yield self.fast.phi == self.ratio * self.slow.phi
            yield self.slow.tau == -self.ratio * self.fast.tau

    class Load(Component):
        shaft = RotationalFlange("shaft")
        inertia = Parameter(4.0, "kg.m2")
        speed = Variable("rad/s")

        def equations(self):
            yield self.speed == der(self.shaft.phi)
            yield self.inertia * der(self.speed) == self.shaft.tau

    class Train(Component):
        torque = Input("N.m")
        acceleration = Output("rad/s2")
        rotor = Rotor()
        gear = Gear()
        load = Load()

        def equations(self):
            yield connect(self.torque, self.rotor.torque)
            yield connect(self.rotor.shaft, self.gear.fast)
            yield connect(self.gear.slow, self.load.shaft)
            yield self.acceleration == der(self.load.speed)

    model = Model(Train())
    expected = 1.3 / (0.2 + 4.0 / 25)
    assert rates(model, [0.0, 2.0], [1.3])[1] == pytest.approx(expected, rel=1e-13)
    assert observed(model, ["acceleration"], [0.0, 2.0], [1.3]) == pytest.approx([expected / 5], rel=1e-13)


def test_the_derivative_of_an_input_is_refused_by_name():
    class Differentiator(Component):
        u = Input("V")
        y = Output("V/s")

        def equations(self):
            yield self.y == der(self.u)

    with pytest.raises(TopologyError, match="time derivative of u cannot be found"):
        Model(Differentiator()).flat  # noqa: B018


def test_two_masses_bolted_together_are_refused_and_both_are_named():
    class Bolted(Component):
        push = Input("N")
        left = Mass()
        right = Mass()

        def equations(self):
            yield connect(self.push, self.left.force)
            yield connect(self.push, self.right.force)
            yield connect(self.left.end, self.right.end)

    with pytest.raises(TopologyError) as refusal:
        Model(Bolted()).flat  # noqa: B018
    message = str(refusal.value)
    assert "singular" in message and "left" in message and "right" in message
    assert "merge the masses, or add a stiffness" in message


def test_a_crank_at_its_dead_centre_is_solved_without_dividing_by_its_lever():
    dead_centre = np.pi / 2  # there the load's speed vanishes and only the crank's inertia is left
    assert rates(Model(CrankedMass()), [dead_centre, 1.7], [4.0])[1] == pytest.approx(4.0 / 1.5, rel=1e-12)
