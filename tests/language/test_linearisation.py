"""Linear models and modes against closed forms."""

from __future__ import annotations

import control
import numpy as np
import pytest

from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.language import (
    Component,
    DeclarationError,
    Input,
    Model,
    Output,
    Parameter,
    SolveError,
    State,
    delay,
    der,
)
from hydrotwin.models.language.linearisation import linearise, modes, operating_point
from tests.language.parts import LoadedOscillator, Oscillator
from tests.language.test_initial_equations import Pendulum, RestingMass


class OilSpring(Component):
    """A mass between two closed chambers: k = beta (A1^2/V1 + A2^2/V2)."""

    load = Input("N")
    position = Output("m")
    mass = Parameter(400.0, "kg")
    viscous = Parameter(2000.0, "N.s/m")
    beta = Parameter(1.4e9, "Pa")
    cap = Parameter(2e-3, "m2")
    rod = Parameter(1.4e-3, "m2")
    cap_volume = Parameter(4e-4, "m3")
    rod_volume = Parameter(6e-4, "m3")
    p1 = State(3.5e6, "Pa", nominal=1e6, fixed=False)
    p2 = State(5e6, "Pa", nominal=1e6)
    x = State(0.0, "m", nominal=0.1)
    v = State(0.0, "m/s", nominal=0.1)

    def equations(self):
        yield der(self.p1) == -self.beta / self.cap_volume * self.cap * self.v
        yield der(self.p2) == self.beta / self.rod_volume * self.rod * self.v
        yield der(self.x) == self.v
        yield self.mass * der(self.v) == self.p1 * self.cap - self.p2 * self.rod - self.viscous * self.v - self.load
        yield self.position == self.x

    def initial_equations(self):
        yield der(self.v) == 0


STIFFNESS = 1.4e9 * (2e-3**2 / 4e-4 + 1.4e-3**2 / 6e-4)


def test_an_oil_spring_vibrates_at_the_root_of_stiffness_over_mass():
    mode = modes(Model(OilSpring())).hydraulic
    assert mode.frequency == pytest.approx(np.sqrt(STIFFNESS / 400) / (2 * np.pi), rel=1e-9)
    assert mode.damping == pytest.approx(2000 / (2 * np.sqrt(STIFFNESS * 400)), rel=1e-9)


def test_stiffer_oil_raises_the_hydraulic_frequency_with_its_root():
    soft = Model(OilSpring())
    stiff = soft.with_parameters({"beta": 4 * 1.4e9})
    assert modes(stiff).hydraulic.frequency == pytest.approx(2 * modes(soft).hydraulic.frequency, rel=1e-9)


def test_velocity_and_pressures_share_the_hydraulic_mode_and_position_does_not():
    share = modes(Model(OilSpring())).hydraulic.participation
    assert sum(share.values()) == pytest.approx(1.0)
    assert share["v"] == pytest.approx(0.5, abs=0.02)
    assert share["p1"] + share["p2"] == pytest.approx(0.5, abs=0.02)
    assert share["x"] < 1e-6


def test_every_pole_is_kept():
    poles = modes(Model(OilSpring())).poles
    assert len(poles) == 4
    assert np.sum(np.abs(poles) < 1e-6 * np.abs(poles).max()) == 2  # mean pressure and position are neutral


def test_a_machine_without_oil_has_no_hydraulic_mode():
    found = modes(Model(Oscillator()))
    assert found.hydraulic is None
    assert found.modes[0].frequency == pytest.approx(np.sqrt(1e4 / 2) / (2 * np.pi))
    assert modes(Model(LoadedOscillator())).modes[0].frequency == pytest.approx(np.sqrt(1e4 / 5) / (2 * np.pi))


def test_the_linear_model_keeps_the_names_and_the_matrices():
    system = Model(Oscillator()).linearize()
    assert isinstance(system, control.StateSpace)
    assert system.state_labels == ["mass.position", "mass.velocity"]
    assert (system.input_labels, system.output_labels, system.name) == (["force"], ["position"], "oscillator")
    assert pytest.approx(np.array([[0, 1], [-5e3, -2.5]])) == system.A
    assert pytest.approx(np.array([[0], [0.5]])) == system.B
    assert pytest.approx(np.array([[1, 0]])) == system.C
    assert system.dcgain() == pytest.approx(1e-4)


def test_the_point_is_the_static_equilibrium_of_the_given_inputs():
    point = operating_point(Model(Oscillator(mass=RestingMass())), {"force": 50.0})
    assert point.states == {"mass.position": pytest.approx(5e-3), "mass.velocity": 0.0}
    assert list(point.rates.values()) == pytest.approx([0, 0], abs=1e-12)


def test_a_given_state_is_where_the_model_is_linearised():
    hanging = Model(Pendulum()).linearize({"angle": 1.0, "torque": 0.0})
    assert hanging.A[1, 0] == pytest.approx(-20 / 2 * np.cos(1.0))


def test_a_steady_state_is_found_without_initial_equations():
    point = operating_point(Model(Oscillator()), {"force": 50.0}, steady=True)
    assert point.states["mass.position"] == pytest.approx(5e-3)
    assert point.states["mass.velocity"] == pytest.approx(0.0, abs=1e-9)


def test_a_machine_that_never_rests_is_told_so():
    class Runaway(Component):
        x = State(0.0, "m")
        speed = Input("m/s", default=1.0)

        def equations(self):
            yield der(self.x) == self.speed

    with pytest.raises(SolveError, match="no steady state found: x keep moving"):
        operating_point(Model(Runaway()), steady=True)


def test_an_unknown_name_asks_for_the_nearest():
    with pytest.raises(DeclarationError, match=r"no input or state 'torqe'\. Did you mean 'torque'\?"):
        linearise(Model(Pendulum()), {"torqe": 1.0})


def test_the_closed_spool_valve_vibrates_on_its_oil():
    model = spool_valve.model()
    x = 0.45
    p = {q.name: q.value for q in model.flat.parameters}
    v_a = p["cylinder.cap_dead_volume"] + p["cylinder.cap_area"] * x
    v_b = p["cylinder.rod_dead_volume"] + p["cylinder.rod_area"] * (p["cylinder.rod_reference"] - x)
    beta = p["cylinder.oil.bulk_modulus"]
    k = beta * (p["cylinder.cap_area"] ** 2 / v_a + p["cylinder.rod_area"] ** 2 / v_b)
    found = modes(model, {"load.position": x, "current": 0.0}).hydraulic
    assert found.frequency == pytest.approx(np.sqrt(k / p["load.mass"]) / (2 * np.pi), rel=1e-6)


def test_the_c_eha_vibrates_between_34_and_36_hertz_lightly_damped():
    found = modes(cehA.model(), {"command": 0.0, "arm.angle": 0.0}).hydraulic
    assert 34 < found.frequency < 36
    assert found.damping < 0.1


def test_an_integrator_is_a_pole_at_zero_not_at_rounding():
    slow = [m.pole for m in modes(cehA.model(), steady=True).modes if abs(m.pole) < 1e-6]
    assert slow == [0.0, 0.0]  # the angle of the arm and the mean pressure


def test_a_dead_time_delays_the_phase_of_the_linear_model():
    prompt = spool_valve.model().linearize()
    late = spool_valve.model().with_parameters({"solenoid.dead_time": 0.02}).linearize()
    w = 30.0
    k = prompt.output_labels.index("spool")
    lag = np.angle(late(1j * w)[k, 0] / prompt(1j * w)[k, 0])
    assert lag == pytest.approx(-0.02 * w, abs=1e-4)
    assert abs(late(1j * w)[k, 0]) == pytest.approx(abs(prompt(1j * w)[k, 0]), rel=1e-9)
    assert late.state_labels[-1] == "current.delayed[3]"


def test_the_linear_model_follows_the_nonlinear_one_for_a_small_push():
    model = Model(Pendulum())
    point = operating_point(model, {"torque": 5.0})
    system = linearise(model, {"torque": 5.0})
    flat, p = model.flat, model.flat.parameter_vector()
    x0, step = np.array(list(point.states.values())), np.array([1e-5, -2e-5])
    exact = np.array(flat.ode(0, x0 + step, [5.0 + 1e-5], p)[0]).ravel()
    assert system.A @ step + system.B.ravel() * 1e-5 == pytest.approx(exact, abs=1e-9)


def test_a_dead_time_that_passes_straight_to_an_output_turns_its_phase_only():
    class Wire(Component):
        u = Input("1")
        y = Output("1")
        dead_time = Parameter(0.02, "s")

        def equations(self):
            yield self.y == 3 * delay(self.u, self.dead_time)

    response = Model(Wire()).linearize()(40j)
    assert response == pytest.approx(3 * np.exp(-0.8j), rel=1e-4)
