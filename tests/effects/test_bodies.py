"""What turns rubs as what slides does: the same laws, in torques and rates of angles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydrotwin.models import cehA
from hydrotwin.models.effects import add_effect, candidates
from hydrotwin.models.effects.bodies import BodySite
from hydrotwin.models.effects.friction import (
    AsymmetricFriction,
    CoulombFriction,
    PositionDependentFriction,
    StribeckFriction,
    ViscousFriction,
)
from hydrotwin.models.effects.inertia import moved_mass
from hydrotwin.models.effects.mechanism import LateFriction, LateLoad
from hydrotwin.models.language.places import Places
from tests.components.bench import at, bench, run
from tests.effects import benches, hoses

FRICTIONS = (
    "viscous_friction",
    "coulomb_friction",
    "stribeck_friction",
    "presliding_friction",
    "asymmetric_friction",
    "asymmetric_viscous_friction",
)
RATES = (-3.0, -0.2, 0.2, 3.0)


def turned(effect, body, **values):
    """A friction on a body that turns, each value in N.m, rad and s."""
    part = effect.at(BodySite("here", body=body))
    return part.but(**{name: replace(part.declared(name), value=value) for name, value in values.items()})


def torque(part, rate, angle=0.0):
    """Torque [N.m] on a shaft or a rotational flange that turns at a rate [rad/s]."""
    sliding = {"part.bristles": float(np.sign(rate))} if hasattr(type(part), "bristles") else {}
    if part.body == "shaft":
        return at(bench(part, flange="potential"), sliding, flange=rate)["flange_tau"]
    moving = {"flange_end.place": angle, "flange_end.speed": rate}
    return at(bench(part, flange="potential"), {**moving, **sliding})["flange_tau"]


@pytest.mark.parametrize("body", ("shaft", "rotational"))
@pytest.mark.parametrize("w", RATES)
def test_torques_on_what_turns_follow_the_formulas_of_friction(body, w):
    assert torque(turned(ViscousFriction, body, viscous=0.4), w) == pytest.approx(0.4 * w)
    assert torque(turned(CoulombFriction, body, force=5.0), w) == pytest.approx(5.0 * np.sign(w), rel=1e-6)
    stribeck = turned(StribeckFriction, body, force=5.0, excess=3.0, stribeck_velocity=0.5)
    expected = (5.0 + 3.0 * np.exp(-((w / 0.5) ** 2))) * np.sign(w)
    assert torque(stribeck, w) == pytest.approx(expected, rel=1e-6)
    sided = turned(AsymmetricFriction, body, out=6.0, back=2.0)
    assert torque(sided, w) == pytest.approx(6.0 if w > 0 else -2.0, rel=1e-6)


def test_friction_of_a_joint_changes_along_the_angle():
    part = turned(PositionDependentFriction, "rotational", force=2.0, slope=4.0)
    assert torque(part, 0.5, angle=0.5) == pytest.approx(4.0)
    assert torque(part, 0.5, angle=-1.0) == pytest.approx(0.0, abs=1e-9)


def test_a_drum_without_load_and_bearing_stops_evenly_under_dry_friction_on_its_shaft():
    """J w' = c_p dp - M sign(w); with the load away the torque is that of the oil, and w' differs by M/J."""
    model = hoses.winch(1)
    site = next(c.site.name for c in candidates(model, ["coulomb_friction"]))
    rubbing = add_effect(model, "coulomb_friction", site, {"force": 30.0})
    states = {"drum.speed": 4.0}
    part = next(a.name for a in rubbing.additions)
    free, held = at(model, states), at(rubbing, {**states, f"{part}.bristles": 1.0})
    assert held["der(drum.speed)"] == pytest.approx(free["der(drum.speed)"] - 30.0 / 5.0, rel=1e-9)


@pytest.mark.parametrize("effect", FRICTIONS)
def test_every_body_that_turns_has_every_friction(effect):
    shafts = {c.site.name for c in candidates(hoses.winch(1), [effect])}
    assert len(shafts) == 1 and shafts <= {"drum.shaft", "motor.shaft"}
    assert [c.site.name for c in candidates(benches.turning_table(), [effect])] == ["table.flange"]
    assert [c.site.name for c in candidates(cehA.model(), [effect])] == ["arm.pin", "arm"]


def test_the_inertia_behind_a_shaft_and_a_rotational_flange_is_that_which_turns():
    assert moved_mass(Places(benches.turning_table()), "table.flange") == pytest.approx(2.0)
    assert moved_mass(Places(hoses.winch(1)), "drum.shaft") == pytest.approx(5.0)
    assert np.isnan(moved_mass(Places(cehA.model()), "motor.shaft"))  # it turns as it is told


def test_a_table_rests_under_a_torque_that_its_friction_holds_and_turns_evenly_under_a_larger_one():
    """J w' = M - M_c - b w: from rest to (M - M_c)/b with the time constant J/b."""
    time = np.linspace(0, 4, 401)
    held = add_effect(benches.turning_table(), "coulomb_friction", values={"force": 8.0})
    resting, turning = run(held, time, torque=6.0), run(held, time, torque=14.0)
    assert np.abs(resting["angle"]).max() < 1e-4
    w, T = (14.0 - 8.0) / 3.0, 2.0 / 3.0
    assert np.allclose(turning["angle"], w * (time - T * (1 - np.exp(-time / T))), atol=0.02)


def test_a_link_slows_down_in_its_joint_by_the_torque_over_its_inertia():
    model = cehA.model()
    rubbing = add_effect(model, "coulomb_friction", "arm", {"force": 0.7})
    states = {"arm.angle": 0.3, "arm.angular_velocity": 0.5, "cylinder.cap_pressure": 4e6, "cylinder.rod_pressure": 2e6}
    free = at(model, states)["der(arm.angular_velocity)"]
    held = at(rubbing, {**states, "coulomb_friction_arm.bristles": 1.0})["der(arm.angular_velocity)"]
    assert held == pytest.approx(free - 0.7, rel=1e-9)


# -- what engages late ---------------------------------------------------------------------------------------------
def force(part, place, speed=0.0, **more):
    moving = {"flange_end.place": place, "flange_end.speed": speed}
    return at(bench(part, flange="potential"), {**moving, **more})["flange_f"]


@pytest.mark.parametrize(("place", "expected"), [(0.1, 0.0), (0.199, 0.0), (0.21, 550.0), (0.3, 1000.0)])
def test_a_late_load_is_nothing_before_its_place_and_a_spring_with_a_step_behind_it(place, expected):
    part = LateLoad(force=500.0, stiffness=5e3, start=0.2)
    assert force(part, place) == pytest.approx(expected)


def test_a_mass_that_runs_into_a_late_load_moves_as_an_independent_solver_says():
    from scipy.integrate import solve_ivp

    values = {"force": 60.0, "stiffness": 300.0, "start": 0.1}
    time = np.linspace(0, 6, 61)
    ours = run(add_effect(benches.axis(), "late_load", values=values), time, force=100.0)["position"]

    def rates(_, x):
        beyond = x[0] - 0.1
        load = np.where(beyond > 0, 60.0 * min(beyond / 1e-3, 1.0) + 300.0 * max(beyond, 0), 0.0)
        return [x[1], (100.0 - load - 200.0 * x[1]) / 500.0]

    theirs = solve_ivp(rates, (0, 6), [0.0, 0.0], t_eval=time, rtol=1e-9, atol=1e-12, max_step=1e-3).y[0]
    assert theirs.max() > 0.2
    assert np.allclose(ours, theirs, atol=2e-4)  # it sets in over a millimetre, with another curve


@pytest.mark.parametrize(
    ("place", "speed", "expected"), [(0.1, 0.1, 0), (0.3, 0.1, 80), (0.3, -0.1, -20), (0.1, -1, 0)]
)
def test_a_late_brake_acts_against_motion_behind_its_place_alone(place, speed, expected):
    part = LateFriction(out=80.0, back=20.0, start=0.2)
    found = force(part, place, speed, **{"part.bristles": float(np.sign(speed))})
    assert found == pytest.approx(expected, abs=1e-9)


def test_places_at_which_something_may_engage_lie_in_the_way_seen():
    seen = {"flange.s": np.linspace(0.2, 0.6, 50)}
    for effect in (LateLoad, LateFriction):
        assert all(0.2 < probe["start"] < 0.6 for probe in effect.probes_for(seen))
