"""Masses, springs and the arm against trigonometry, closed forms and the conservation of energy."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.components import (
    Arm,
    AttachedMass,
    ForceSource,
    Freewheel,
    Ground,
    LinearLoad,
    Mass,
    SpeedSource,
    SpringDamper,
    TorqueSource,
)
from hydrotwin.models.language import Component, Input, Model, Output, connect
from hydrotwin.models.laws import Viscous
from tests.components.bench import at, bench, jacobian, observed, run

G = 9.80665
ANGLES = [-0.9, -0.3, 0.0, 0.12, 0.5, 1.2]


def test_a_pushed_mass_follows_half_f_over_m_t_squared():
    time = np.linspace(0, 1, 11)
    y = run(bench(Mass(mass=20.0), flange="flow"), time, flange=50.0)
    assert y["flange_s"] == pytest.approx(0.5 * 50 / 20 * time**2, abs=1e-12)


def test_a_mass_in_viscous_friction_reaches_f_over_b_with_the_time_constant_m_over_b():
    model = bench(Mass(mass=20.0, friction=Viscous(viscous=100.0)), flange="flow")
    time = np.linspace(0, 2, 201)
    s = run(model, time, flange=50.0)["flange_s"]
    assert s == pytest.approx(0.5 * (time - 0.2 * (1 - np.exp(-time / 0.2))), abs=1e-9)


def test_an_attached_mass_needs_m_a_and_has_no_state():
    model = bench(AttachedMass(mass=7.0), flange="potential")
    assert at(model, flange=3.0)["flange_f"] == pytest.approx(21.0)
    assert [s.name for s in model.flat.states if s.name.startswith("part.")] == []


def test_an_attached_mass_slows_the_mass_it_rides_on():
    class Pair(Component):
        """A mass, another bolted to it, a push."""

        mass, rider, source = Mass(mass=3.0), AttachedMass(mass=2.0), ForceSource()
        push = Input("N", "push")
        velocity = Output("m/s", "velocity")

        def equations(self):
            yield connect(self.push, self.source.force)
            yield connect(self.mass.flange, self.rider.flange)
            yield connect(self.mass.flange, self.source.flange)
            yield self.velocity == self.mass.velocity

    assert at(Model(Pair(), "pair"), push=10.0)["der(mass.velocity)"] == pytest.approx(2.0)


def test_a_linear_load_stands_still_when_the_rod_pushes_with_its_force():
    model = bench(LinearLoad(mass=350.0, load_force=4000.0, friction=Viscous(viscous=4000.0)), flange="flow")
    assert at(model, flange=4000.0)["der(part.velocity)"] == 0
    assert at(model, {"part.velocity": 0.1}, flange=4400.0)["der(part.velocity)"] == pytest.approx(0, abs=1e-12)
    assert at(model, flange=0.0)["der(part.velocity)"] == pytest.approx(-4000 / 350)


def test_a_spring_and_damper_ring_a_mass_at_the_root_of_k_over_m():
    class Ringing(Component):
        """Ground, spring and damper, mass."""

        ground, spring = Ground(position=0.2), SpringDamper(stiffness=8e4, damping=40.0, free_length=0.3)
        mass = Mass(mass=20.0, position=0.6)
        position = Output("m", "position")

        def equations(self):
            yield connect(self.mass.flange, self.spring.a)
            yield connect(self.spring.b, self.ground.flange)
            yield self.position == self.mass.position

    model, time = Model(Ringing(), "ringing"), np.linspace(0, 1, 1001)
    w0, D = np.sqrt(8e4 / 20), 40 / (2 * np.sqrt(8e4 * 20))
    wd = w0 * np.sqrt(1 - D**2)
    swing = np.exp(-D * w0 * time) * (np.cos(wd * time) + D * w0 / wd * np.sin(wd * time))
    assert run(model, time)["position"] == pytest.approx(0.5 + 0.1 * swing, abs=1e-6)


def test_a_spring_pulls_both_ends_alike():
    moved = {"a_end.place": 0.01, "a_end.speed": 0.2, "b_end.place": 0.004, "b_end.speed": -0.1}
    y = at(bench(SpringDamper(), a="potential", b="potential"), moved)
    assert y["a_f"] == pytest.approx(1e6 * 0.006 + 1e3 * 0.3)
    assert y["b_f"] == -y["a_f"]


def test_ends_hold_free_or_push():
    assert at(bench(Ground(position=0.4), flange="flow"), flange=1e4)["flange_s"] == 0.4
    assert at(bench(Freewheel(), flange="potential"))["flange_f"] == 0
    assert at(bench(ForceSource(), flange="potential"), force=30.0)["flange_f"] == -30
    assert at(bench(SpeedSource(), shaft="flow"), speed=90.0, shaft=7.0)["shaft_w"] == 90
    assert at(bench(TorqueSource(), shaft="potential"), torque=3.0)["shaft_tau"] == -3


# -- arm --------------------------------------------------------------------------------------------------------------
def arm_places(theta):
    """Pin and foot of the actuator, the joint at the origin: foot straight below, arm at theta above the horizontal."""
    d = np.sqrt(0.3055**2 - 0.225**2)
    return np.array([0.225 * np.cos(theta), 0.225 * np.sin(theta)]), np.array([0.0, -d])


ARM = bench(Arm(), pin="flow")


def test_the_base_length_that_makes_the_actuator_as_long_as_x0_at_zero_is_206_65_mm():
    assert observed(ARM, ["part.base_length"], {}) == pytest.approx(0.20665, abs=5e-6)
    pin, foot = arm_places(0.0)
    assert np.linalg.norm(pin - foot) == pytest.approx(0.3055)


@pytest.mark.parametrize("theta", ANGLES)
def test_the_stroke_is_the_distance_from_foot_to_pin_less_the_retracted_length(theta):
    pin, foot = arm_places(theta)
    y = at(ARM, {"part.angle": theta})
    assert y["pin_s"] == pytest.approx(np.linalg.norm(pin - foot) - 0.3055, abs=1e-15)


@pytest.mark.parametrize("theta", ANGLES)
def test_the_pin_force_turns_the_arm_by_its_distance_from_the_joint(theta):
    """Lever = |joint to the actuator's line| by the cross product; torque over inertia."""
    pin, foot = arm_places(theta)
    along = (pin - foot) / np.linalg.norm(pin - foot)
    lever = pin[0] * along[1] - pin[1] * along[0]
    inertia = 46.7 * 0.488**2 + 1.64 * 0.488**2 / 3
    torque = (at(ARM, {"part.angle": theta}, pin=1000.0)["der(part.angular_velocity)"]
              - at(ARM, {"part.angle": theta})["der(part.angular_velocity)"]) * inertia  # fmt: skip
    assert torque == pytest.approx(1000 * lever, rel=1e-9)


@pytest.mark.parametrize("theta", ANGLES)
def test_the_rod_feeds_the_arm_with_force_times_velocity(theta):
    """f ds/dt = rate of kinetic and potential energy."""
    w, f = 0.7, 1234.0
    rate = at(ARM, {"part.angle": theta, "part.angular_velocity": w}, pin=f)["der(part.angular_velocity)"]
    inertia = 46.7 * 0.488**2 + 1.64 * 0.488**2 / 3
    h = 1e-6
    v = (at(ARM, {"part.angle": theta + h})["pin_s"] - at(ARM, {"part.angle": theta - h})["pin_s"]) / (2 * h) * w
    assert inertia * w * rate + (46.7 + 0.82) * G * 0.488 * np.cos(theta) * w == pytest.approx(f * v, rel=1e-6)


def test_a_released_arm_swings_without_losing_energy():
    class Pendulum(Component):
        """The arm with nothing on its pin, hanging."""

        arm, free = Arm(angle=-1.2), Freewheel()
        angle = Output("rad", "angle")
        rate = Output("rad/s", "rate")

        def equations(self):
            yield connect(self.arm.pin, self.free.flange)
            yield self.angle == self.arm.angle
            yield self.rate == self.arm.angular_velocity

    model = Model(Pendulum(), "pendulum")
    y = run(model, np.linspace(0, 5, 1001))
    inertia, moment = (46.7 + 1.64 / 3) * 0.488**2, (46.7 + 0.82) * G * 0.488
    energy = 0.5 * inertia * y["rate"] ** 2 + moment * np.sin(y["angle"])
    assert np.ptp(energy) < 1e-6 * moment
    poles = np.linalg.eigvals(jacobian(model)(0, [-np.pi / 2, 0], [], model.flat.parameter_vector()).full())
    assert poles.imag.max() == pytest.approx(np.sqrt(moment / inertia), rel=1e-12)
