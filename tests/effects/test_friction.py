"""Friction opposes, takes energy, and has the force that its formula says."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models import cehA
from hydrotwin.models.components import Arm
from hydrotwin.models.components.mechanical import ForceSource
from hydrotwin.models.effects import add_effect, candidates
from hydrotwin.models.effects.friction import (
    AsymmetricFriction,
    CoulombFriction,
    PositionDependentFriction,
    PreslidingFriction,
    PressureDependentFriction,
    StribeckFriction,
    ViscousFriction,
)
from hydrotwin.models.effects.inertia import moved_mass
from hydrotwin.models.effects.sticking import Sticking
from hydrotwin.models.language import Component, Flange, Input, Model, Output, Parameter, State, connect, der
from hydrotwin.models.language.places import Places
from hydrotwin.simulation import prepare
from tests.components.bench import at, bench, run
from tests.discovery.slides import pushes
from tests.effects import benches

SPEEDS = (-0.5, -0.05, -0.01, 0.01, 0.05, 0.5)
ALL = (
    ViscousFriction(viscous=80.0),
    CoulombFriction(force=50.0),
    StribeckFriction(force=40.0, excess=25.0, stribeck_velocity=0.02),
    PreslidingFriction(force=50.0, displacement=1e-4, rise=0.4),
    PositionDependentFriction(force=20.0, slope=400.0),
    AsymmetricFriction(out=60.0, back=20.0),
    PressureDependentFriction(force=10.0, piston_seal=2e-5, rod_seal=1e-5),
)


def force(part, speed, place=0.0, **inputs):
    """Force on a flange that moves at a speed [m/s], at a place [m]."""
    states = {"flange_end.place": place, "flange_end.speed": speed}
    if isinstance(part, Sticking):
        states["part.bristles"] = float(np.sign(speed))  # where they stand once it slides
        assert at(bench(part, flange="potential"), states, **inputs)["der(part.bristles)"] == 0.0
    return at(bench(part, flange="potential"), states, **inputs)["flange_f"]


@pytest.mark.parametrize("v", SPEEDS)
def test_viscous_friction_grows_in_proportion_to_speed(v):
    assert force(ViscousFriction(viscous=80.0), v) == pytest.approx(80.0 * v)


@pytest.mark.parametrize("v", SPEEDS)
def test_coulomb_friction_is_the_same_at_every_speed(v):
    assert force(CoulombFriction(force=50.0), v) == pytest.approx(50.0 * np.sign(v), rel=1e-6)


@pytest.mark.parametrize("v", SPEEDS)
def test_stribeck_friction_falls_from_static_to_kinetic(v):
    expected = (40.0 + 25.0 * np.exp(-((v / 0.02) ** 2))) * np.sign(v)
    assert force(ALL[2], v) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("v", SPEEDS)
def test_stribeck_friction_without_excess_is_coulomb_friction(v):
    assert force(StribeckFriction(force=50.0), v) == force(CoulombFriction(force=50.0), v)


def test_friction_of_either_direction_has_its_own_size():
    assert force(AsymmetricFriction(out=60.0, back=20.0), 0.1) == pytest.approx(60.0)
    assert force(AsymmetricFriction(out=60.0, back=20.0), -0.1) == pytest.approx(-20.0)


def test_friction_of_equal_sizes_is_coulomb_friction():
    for v in (*SPEEDS, 3e-4):
        assert force(AsymmetricFriction(out=50.0, back=50.0), v) == pytest.approx(force(ALL[1], v))


@pytest.mark.parametrize(("place", "expected"), [(0.0, 20.0), (0.1, 60.0), (-0.04, 4.0), (-0.2, 0.0)])
def test_friction_changes_along_the_way_and_never_drives(place, expected):
    part = PositionDependentFriction(force=20.0, slope=400.0)
    assert force(part, 0.1, place) == pytest.approx(expected, abs=1e-12)
    assert force(part, -0.1, place) == pytest.approx(-expected, abs=1e-12)


def test_seals_rub_more_under_pressure_whichever_side_it_is_on():
    part = PressureDependentFriction(force=10.0, piston_seal=2e-5)
    assert force(part, 0.1, p_a=5e6, p_b=1e6) == pytest.approx(90.0)
    assert force(part, 0.1, p_a=1e6, p_b=5e6) == pytest.approx(90.0)
    assert force(part, -0.1, p_a=3e6, p_b=3e6) == pytest.approx(-10.0)


def test_the_seal_of_the_rod_feels_the_pressure_on_its_own_side_only():
    part = PressureDependentFriction(force=10.0, rod_seal=2e-5)
    assert force(part, 0.1, p_a=5e6, p_b=1e6) == pytest.approx(30.0)
    assert force(part, 0.1, p_a=1e6, p_b=5e6) == pytest.approx(110.0)


@pytest.mark.parametrize("part", ALL, ids=lambda p: p.id)
def test_friction_takes_energy_on_any_motion(part):
    time = np.linspace(0, 2, 2001)
    motion = 0.8 * np.sin(9 * time) + 0.5 * np.cos(23 * time)
    inputs = {"p_a": 4e6, "p_b": 1e6} if isinstance(part, PressureDependentFriction) else {}
    y = run(bench(part, flange="potential"), time, flange=motion, **inputs)
    power = y["flange_f"] * np.gradient(y["flange_s"], time)
    assert np.trapezoid(power, time) > 0
    assert np.all(
        power > -(0.1 if isinstance(part, (PreslidingFriction, Sticking)) else 1e-3) * power.max()
    )  # bristles spring back


def test_a_coasting_mass_loses_speed_in_proportion_to_time():
    model = add_effect(benches.axis(), "coulomb_friction", values={"force": 50.0}).with_parameters(
        {"carriage.friction.viscous": 0.0}
    )
    time = np.linspace(0, 3, 31)
    y = run(model, time, start={"carriage.velocity": 0.4})
    assert np.allclose(y["velocity"], 0.4 - 50.0 / 500.0 * time, atol=2e-4)  # the bristles bend first, for 1 ms


def test_bristles_are_a_spring_before_they_slide():
    model = bench(PreslidingFriction(force=50.0, displacement=1e-4), flange="potential")
    time = np.linspace(0, 0.1, 101)
    y = run(model, time, flange=2 * 1e-6 / 0.1**2)  # 1 um in 0.1 s, a hundredth of the displacement before sliding
    assert np.allclose(y["flange_f"], 50.0 * y["flange_s"] / 1e-4, rtol=0.01, atol=1e-3)


@pytest.mark.parametrize("v", (-0.4, -0.02, 0.02, 0.4))
def test_sliding_bristles_rub_with_the_stribeck_force(v):
    model = bench(
        PreslidingFriction(force=50.0, displacement=1e-4, rise=0.4, stribeck_velocity=0.02), flange="potential"
    )
    y = run(model, np.linspace(0, 1, 101), start={"flange_end.speed": v})
    assert y["flange_f"][-1] == pytest.approx(50.0 * (1 + 0.4 * np.exp(-((v / 0.02) ** 2))) * np.sign(v), rel=1e-4)


@pytest.mark.parametrize(("effect", "give", "within"), [("presliding", 1e-4, 0.1), ("coulomb", 6.25e-8, 0.3)])
def test_friction_holds_a_mass_that_is_pushed_less_than_it_takes(effect, give, within):
    time = np.linspace(0, 20, 4001)
    push = 40.0 * np.minimum(time / 5, 1.0)
    damped = benches.axis().with_parameters({"carriage.friction.viscous": 3000.0})
    held = run(add_effect(damped, f"{effect}_friction", values={"force": 50.0}), time, force=push)["position"]
    dahl = give * np.log(50.0 / (50.0 - 40.0))  # F = F_c (1 - exp(-s/delta))
    assert held[-1] == pytest.approx(dahl, rel=within)  # the push is held for 5 ms at a time: firm bristles ring
    assert held[-1] - held[2000] < 1e-6


@pytest.mark.parametrize("v", (0.05, 0.5, 5.0, 50.0))
def test_bristles_are_never_faster_than_the_step_of_the_model(v):
    rate = [
        at(bench(PreslidingFriction(displacement=2e-5), flange="potential"), {**moving, "part.bristles": zeta})
        for moving in [{"flange_end.place": 0.0, "flange_end.speed": v}]
        for zeta in (0.0, 1.0)
    ]
    assert 0 < rate[0]["der(part.bristles)"] - rate[1]["der(part.bristles)"] <= 1000.0


@pytest.mark.parametrize("effect", [e.id for e in map(type, ALL)])
def test_every_friction_slows_a_machine_down(effect):
    model = benches.axis() if effect != "pressure_dependent_friction" else benches.valve_bench()
    (found,) = candidates(model, [effect])
    time = np.linspace(0, 1, 101)
    word, value = ("force", 300.0) if effect != "pressure_dependent_friction" else ("spool", 0.2)
    free, rubbing = (run(m, time, **{word: value})["position"] for m in (model, _at_a_start(model, found)))
    start = free[0]
    assert 0 <= rubbing[-1] - start < free[-1] - start


def _at_a_start(model, candidate):
    return model.plus([candidate.addition]).with_parameters(candidate.probes[0])


def test_a_slope_of_friction_shows_in_its_first_derivative():
    model = add_effect(benches.axis(), "position_dependent_friction")
    time = np.linspace(0, 2, 201)
    plain = run(model, time, force=200.0)["velocity"]
    little = run(model.with_parameters({"position_dependent_friction.slope": 1e-3}), time, force=200.0)["velocity"]
    more = run(model.with_parameters({"position_dependent_friction.slope": 2e-3}), time, force=200.0)["velocity"]
    assert plain[-1] - little[-1] == pytest.approx((plain[-1] - more[-1]) / 2, rel=1e-3) and plain[-1] > little[-1]


@pytest.mark.parametrize(
    ("effect", "forces", "seed"), [("asymmetric_friction", (800.0, 330.0), 5), ("coulomb_friction", (800.0,), 18)]
)
def test_derivatives_of_what_sticks_and_slips_are_those_of_finer_steps(effect, forces, seed):
    """At the step of the model the run is right, its derivatives are not: the bristles swing 3 rad in one."""
    (found,) = (c for c in candidates(cehA.model(), [effect]) if c.label.endswith("at arm.pin"))
    flat = cehA.model().plus([found.addition]).flat
    free = ("cylinder.cap_dead_volume", "cylinder.oil.bulk_modulus", *found.free)
    values = {**dict(zip(found.free, forces, strict=True)), "cylinder.friction.viscous": 3500.0}
    p, time = flat.parameter_vector(values), np.arange(0, 6, 0.01)
    u = np.interp(time, *pushes(seed, 6.0, 1.5))[:, None]
    x0 = flat.start_given(())(u[0], p, []).full().ravel()

    def run_at(step=None, method="explicit"):
        propagator = prepare(flat, free_parameters=free, step=step, method=method)
        y, dy, *_ = propagator.sensitivity(time, u, p, x0, np.zeros((len(x0), len(free))))
        return propagator.step, y / np.ptp(y, axis=0), dy / np.ptp(y, axis=0)[:, None]

    def apart(one, other):
        return np.linalg.norm(one - other, axis=(0, 1)) / np.linalg.norm(other, axis=(0, 1))

    (_, y, exact), (_, near, wrong), (step, _, chosen) = run_at(1.25e-4), run_at(flat.step), run_at(method="auto")
    assert np.abs(near - y).max() < 0.02 and apart(wrong, exact).max() > 0.4
    assert step == flat.step / 2 and apart(chosen, exact).max() < 0.15


@pytest.mark.parametrize(("mass", "expected"), [(500.0, 7e8), (5.0, 7e6)])
def test_what_is_held_is_held_as_firmly_as_the_step_follows_with_its_mass(mass, expected):
    """A light slide on bristles that hold an excavator would swing thirty times in a step."""
    model = benches.axis().with_parameters({"carriage.mass": mass})
    flat = add_effect(model, "coulomb_friction").flat
    assert next(p.value for p in flat.parameters if p.name == "coulomb_friction.stiffness") == expected


@pytest.mark.parametrize("angle", [-0.3, 0.2, 0.7])
def test_the_mass_behind_a_linkage_is_that_which_its_flange_feels(angle):
    """J / h^2, h the lever of the paper's Eq. 12: not the weight on the arm."""
    m1, m2, L, pin, x0 = 46.7, 1.64, 0.488, 0.225, 0.3055
    d = np.sqrt(x0**2 - pin**2)
    h = pin * d * np.cos(angle) / np.sqrt(pin**2 + d**2 + 2 * pin * d * np.sin(angle))
    model = cehA.model().but(arm=Arm(angle=angle))
    assert moved_mass(Places(model), "arm.pin") == pytest.approx((m1 + m2 / 3) * L**2 / h**2, rel=1e-6)


class Floating(Component):
    """A massless carriage between a spring and a dashpot: a force moves it at a speed, at once."""

    flange = Flange("where forces act")
    damping = Parameter(400.0, "N.s/m", "dashpot")
    stiffness = Parameter(1e4, "N/m", "spring")
    position = State(0.0, "m", "position", nominal=0.1)

    def equations(self):
        yield self.flange.s == self.position
        yield self.damping * der(self.position) + self.stiffness * self.position == self.flange.f


class Pushed(Component):
    """The carriage, pushed."""

    force = Input("N", "force", nominal=10.0)
    place = Output("m", "measured position", nominal=0.1)
    carriage = Floating()
    source = ForceSource()

    def equations(self):
        yield connect(self.force, self.source.force)
        yield connect(self.source.flange, self.carriage.flange)
        yield self.place == self.carriage.position


def test_what_has_no_mass_is_held_as_firmly_as_is_usual():
    model = Model(Pushed())
    assert np.isnan(moved_mass(Places(model), "carriage.flange"))
    flat = add_effect(model, "coulomb_friction").flat
    held = next(p.value for p in flat.parameters if p.name == "coulomb_friction.stiffness")
    assert held == CoulombFriction.stiffness.value


def test_a_level_below_nothing_is_no_friction():
    """A friction that falls along the stroke ends where it reaches zero."""
    part = PositionDependentFriction(force=20.0, slope=-400.0)
    assert force(part, 0.2, place=0.1) == pytest.approx(0.0, abs=1e-9)
