"""The Modelica text of a model: an independent Modelica compiler accepts it and simulates the same motion."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.cehA.model import third_order
from hydrotwin.models.language import (
    Component,
    DeclarationError,
    Flange,
    HydraulicPort,
    Input,
    Model,
    Output,
    Parameter,
    State,
    Variable,
    connect,
    der,
)
from hydrotwin.models.language.modelica import identifier, modelica_main, modelica_path, modelica_text
from hydrotwin.models.language.modelica_expression import modelica_expression, modelica_number
from tests.language.parts import (
    Damper,
    FlowSource,
    Friction,
    LoadedOscillator,
    Mass,
    Oscillator,
    PressureSource,
    QuadraticFriction,
    Restriction,
    Volume,
)
from tests.language.test_flattening import Bristle

rumoca = pytest.importorskip("rumoca")


def compiled(model):
    return rumoca.Session().loads(modelica_text(model), model=modelica_main(model))


def driven_text(model, drives: dict[str, str]) -> str:
    """The package with one more class, in which the inputs are functions of time."""
    text, name = modelica_text(model), identifier(model.name)
    equations = " ".join(f"plant.{modelica_path(k)} = {e};" for k, e in drives.items())
    driven = f"model Driven Main plant; equation {equations} end Driven;\n"
    return text[: text.rindex(f"end {name}")] + driven + f"end {name};\n"


def both_motions(model, drives, seconds, dead_time=0.0):
    """States over time: from the Modelica compiler and from our ODE under SciPy; shapes (n, nx)."""
    text = driven_text(model, {name: formula for name, (formula, _) in drives.items()})
    session = rumoca.Session().loads(text, model=f"{identifier(model.name)}.Driven")
    config = rumoca.SimConfig(rtol=1e-9, atol=1e-10, max_wall_seconds=30)
    theirs = session.simulate(seconds, dt=seconds / 200, config=config)
    flat = model.flat
    p = flat.parameter_vector()

    def inputs(t):
        return [drives[i.name][1](max(t - dead_time, 0.0)) for i in flat.inputs]

    x0 = np.array(flat.start_given()(inputs(0.0), p, [])).ravel()
    ours = solve_ivp(
        lambda t, x: np.array(flat.ode(t, x, inputs(t), p)[0]).ravel(),
        (0, seconds),
        x0,
        method="LSODA",
        rtol=1e-9,
        atol=1e-9 * np.array([s.nominal for s in flat.states]),
        t_eval=np.clip(np.array(theirs.time), 0, seconds),
    )
    columns = [np.array(theirs[f"plant.{modelica_path(s.name)}"]) for s in flat.states]
    return np.stack(columns, axis=1), ours.y.T


def largest_difference(model, drives, seconds, dead_time=0.0) -> float:
    """Largest difference between the two motions over the span of each state."""
    theirs, ours = both_motions(model, drives, seconds, dead_time)
    assert np.ptp(ours, axis=0).min() > 0
    return float((np.abs(theirs - ours).max(axis=0) / np.ptp(ours, axis=0)).max())


PUSH = {"force": ("3*sin(10*time)", lambda t: 3 * np.sin(10 * t))}


@pytest.mark.parametrize("root", [Oscillator(), LoadedOscillator()], ids=repr)
def test_the_modelica_oscillator_moves_as_ours(root):
    assert largest_difference(Model(root), PUSH, 0.5) < 1e-6


def test_other_parameter_values_reach_the_modelica_text():
    model = Model(Oscillator()).with_parameters({"spring.stiffness": 2e3, "damper.friction.viscous": 40.0})
    assert "spring(stiffness=2000)" in modelica_text(model)
    assert "damper(friction(viscous=40))" in modelica_text(model)
    assert largest_difference(model, PUSH, 0.5) < 1e-6


def test_the_modelica_text_of_the_c_eha_moves_as_ours():
    drives = {"command": ("2*sin(3*time)", lambda t: 2 * np.sin(3 * t))}
    assert largest_difference(cehA.model(), drives, 1.0) < 2e-5


def test_the_third_order_c_eha_compiles():
    structure = compiled(third_order()).structure()
    assert structure.is_balanced and structure.is_matched


def test_the_modelica_text_of_the_spool_valve_moves_as_ours():
    model = spool_valve.model().with_parameters({"solenoid.dead_time": 0.02})
    drives = {"current": ("0.2*sin(3*time)", lambda t: 0.2 * np.sin(3 * t))}
    assert largest_difference(model, drives, 0.5, dead_time=0.02) < 3e-3  # their delay interpolates


def test_outputs_and_inputs_of_the_model_are_those_of_the_modelica_class():
    theirs = compiled(cehA.model())
    flat = cehA.model().flat
    assert list(theirs.inputs.names) == [i.name for i in flat.inputs]
    assert list(theirs.outputs.names) == [o.name for o in flat.outputs]
    assert {p.name for p in flat.parameters} <= set(theirs.parameters.names)


def test_parameters_carry_unit_bounds_value_and_meaning():
    text = modelica_text(cehA.model())
    expected = 'parameter Real viscous(unit="N.s/m", min=0, max=1e8) = 741.36 "viscous friction F_v";'
    assert expected in text
    value = compiled(cehA.model()).parameters["cylinder.friction.viscous"]
    assert (value.value, value.unit) == (741.36, "N.s/m")


def test_a_bound_parameter_is_a_modifier():
    assert "Pump pump(return_ratio=cylinder.rod_area/cylinder.cap_area);" in modelica_text(cehA.model())


def test_two_parts_of_one_class_share_it_and_another_law_makes_another_class():
    class Two(Component):
        force = Input("N")
        mass = Mass()
        first = Damper(friction=Friction(viscous=3.0))
        second = Damper(friction=Friction(viscous=4.0))
        third = Damper(friction=QuadraticFriction())

        def equations(self):
            yield connect(self.force, self.mass.force)
            for damper in (self.first, self.second, self.third):
                yield connect(self.mass.end, damper.end)

    text = modelica_text(Model(Two()))
    assert text.count("model Damper") == 2
    assert "Damper first(friction(viscous=3));" in text
    assert "Damper_2 third;" in text
    assert largest_difference(Model(Two(), "two"), PUSH, 0.3) < 1e-6


def test_words_of_modelica_get_an_underscore():
    assert modelica_path("mass.end.f") == "mass.end_.f"
    text = modelica_text(Model(Oscillator()))
    assert "Flange end_" in text and "connect(mass.end_, spring.end_);" in text


def test_a_start_that_follows_parameters_is_written_as_it_is():
    class Rig(Oscillator):
        sag = Parameter(0.02, "m")
        mass = Mass(position=lambda rig: -2 * rig.sag)

    model = Model(Rig())
    assert "Mass mass(position(start=-2*sag));" in modelica_text(model)
    theirs, _ = both_motions(model, PUSH, 0.1)
    assert theirs[0, 0] == pytest.approx(-0.04)


def test_a_start_that_follows_a_state_becomes_an_initial_equation():
    class Follower(Component):
        seconds = Parameter(1.0, "s")
        leader = State(3.0, "1")
        follower = State(lambda c: 2 * c.leader, "1")

        def equations(self):
            yield self.seconds * der(self.leader) == -self.leader
            yield self.seconds * der(self.follower) == self.leader - self.follower

    assert "initial equation\n    follower = 2*leader;" in modelica_text(Model(Follower())).replace("      ", "    ")
    assert largest_difference(Model(Follower()), {}, 1.0) < 1e-6


def test_a_static_equilibrium_is_found_by_the_modelica_compiler_too():
    class Resting(Mass):
        position = State(0.0, "m", fixed=False)

        def initial_equations(self):
            yield der(self.velocity) == 0

    push = {"force": ("50 + sin(5*time)", lambda t: 50 + np.sin(5 * t))}
    theirs, ours = both_motions(Model(Oscillator(mass=Resting())), push, 0.2)
    assert theirs[0, 0] == pytest.approx(50 / 1e4)
    assert theirs == pytest.approx(ours, abs=1e-7)


def test_ports_seen_from_inside_keep_their_sign():
    class LeakyVessel(Component):
        port = HydraulicPort("outside")
        volume = Volume()
        drain = Restriction()
        tank = PressureSource()

        def equations(self):
            yield connect(self.port, self.volume.port)
            yield connect(self.port, self.drain.a)
            yield connect(self.drain.b, self.tank.port)

    class Filled(Component):
        flow = Input("m3/s")
        pump = FlowSource()
        vessel = LeakyVessel()

        def equations(self):
            yield connect(self.flow, self.pump.flow)
            yield connect(self.pump.port, self.vessel.port)

    drives = {"flow": ("1e-4 + 5e-5*sin(3*time)", lambda t: 1e-4 + 5e-5 * np.sin(3 * t))}
    assert largest_difference(Model(Filled()), drives, 0.5) < 1e-6


def test_a_law_with_memory_moves_as_ours():
    model = Model(Oscillator(damper=Damper(friction=Bristle(viscous=5.0))))
    assert "model Bristle" in modelica_text(model)
    assert largest_difference(model, PUSH, 0.3) < 1e-5


def test_an_equation_that_reaches_around_its_component_is_written_where_all_is_seen():
    class Probe(Component):
        y = Output("m")

        def equations(self):
            yield self.y == self.parent.mass.position

    class Watched(Oscillator):
        probe = Probe()

    text = modelica_text(Model(Watched()))
    assert "probe.y = mass.position;" in text


# -- expressions -----------------------------------------------------------------------------------------------------
a, b, c = (ca.SX.sym(n) for n in "abc")
EXPRESSIONS = [
    a + b + c, a - (b - c), a - (b + c), -(a + b), -a - b, a * (b + c), a / (b * c), a / b / c, (a / b) * c,
    a * -b, a - (-b), (-a) ** 2, a**3, (a**2) ** 1.5, 2.5**a, a**b, 2 * (a + b), 1 / (a + b), (a + b) ** 2,
    ca.sqrt(a), ca.exp(-(a**2)), ca.log(a + 1), ca.sin(a) * ca.cos(b) + ca.tan(c), ca.asin(a / 2), ca.acos(a / 2),
    ca.atan(a), ca.atan2(a, -b), ca.sinh(a), ca.cosh(a), ca.tanh(a - b), ca.asinh(a), ca.acosh(a + 1.5),
    ca.atanh(a / 4), ca.fabs(a - b), ca.sign(a - b), ca.fmin(a, b), ca.fmax(a, -b), ca.floor(3 * a), ca.ceil(3 * a),
    ca.fmod(7 * a, b), ca.hypot(a, b), ca.copysign(a, b - a), ca.expm1(a), ca.log1p(a), ca.if_else(a < b, a, 2 * b),
    ca.if_else(a >= b, a, 2 * b), ca.if_else(ca.logic_and(a < b, b < c), a, c), (a < b) * c,
    ca.if_else(ca.logic_or(a > b, ca.logic_not(b < c)), a * b, ca.if_else(c > 1, b, c)), ca.if_else(a == b, a, b),
    ca.if_else(a != b, a, b), ca.if_else(a, b, c), 1.234567890123456789e-7 * a + 3e12 * b,
]  # fmt: skip
VALUES = [(0.7, 1.3, 0.4), (1.1, 0.6, 1.9), (0.5, 0.5, 2.0)]


@pytest.mark.parametrize("values", VALUES, ids=str)
def test_every_operation_means_the_same_in_modelica(values):
    lines = [f"  Real y{k} = {modelica_expression(e, str)};" for k, e in enumerate(EXPRESSIONS)]
    given = ", ".join(f"{n} = {v}" for n, v in zip("abc", values, strict=True))
    text = f"model M\n  parameter Real {given};\n  Real x(start=0, fixed=true);\n" + "\n".join(lines)
    model = rumoca.Session().loads(text + "\nequation\n  der(x) = 1;\nend M;\n", model="M")
    result = model.simulate(0.1, dt=0.1)
    theirs = [result[f"y{k}"][0] if f"y{k}" in result else np.nan for k in range(len(EXPRESSIONS))]
    ours = np.array(ca.Function("f", [a, b, c], [ca.vertcat(*EXPRESSIONS)])(*values)).ravel()
    assert theirs == pytest.approx(ours, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("expression", "text"),
    [
        (a - (b - c), "a - (b - c)"),
        (a * (b + c), "a*(b + c)"),
        (a / (b / c), "a/(b/c)"),
        ((a + b) ** 2, "(a + b)^2"),
        (ca.if_else(a < b, a, c), "noEvent(if a < b then a else c)"),
        (ca.fabs(a), "noEvent(abs(a))"),
    ],
    ids=str,
)
def test_no_more_parentheses_than_needed(expression, text):
    assert modelica_expression(expression, str) == text


@pytest.mark.parametrize("value", [0.1, 1 / 3, np.pi, 1.747e9, 8.042e-4, -2.5, 1e-12, 6.02214076e23, 0.0, 1e5 + 1 / 7])
def test_a_number_reads_back_as_itself(value):
    assert float(modelica_number(value)) == value


def test_an_operation_without_a_modelica_form_is_refused():
    with pytest.raises(DeclarationError, match="Modelica has no form"):
        modelica_expression(ca.erf(a), str)


def test_a_long_equation_names_what_it_uses_twice():
    class Long(Component):
        x = State(0.3, "1")
        seconds = Parameter(1.0, "s")
        y = Variable("1")

        def equations(self):
            term = ca.sin(self.x) + ca.cos(self.x) ** 2 / (1 + self.x**2)
            for _ in range(6):
                term = ca.sin(term) + term * ca.cos(term + 0.1)
            yield self.y == term
            yield self.seconds * der(self.x) == -self.y

    text = modelica_text(Model(Long()))
    assert "Real shared_1;" in text
    assert max(map(len, text.splitlines())) < 1300
    assert largest_difference(Model(Long()), {}, 1.0) < 1e-6


def test_a_flange_may_be_used_in_a_second_derivative():
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

    text = modelica_text(Model(Rig()))
    assert "mass*der(" in text
    assert largest_difference(Model(Rig()), PUSH, 0.3) < 1e-6


def test_names_that_modelica_cannot_take_or_has_taken_are_changed():
    class Main(Mass):
        pass

    class RealInput(Oscillator):
        mass = Main()

    model = Model(RealInput(), "3rd bench-run (left)")
    assert modelica_main(model) == "_3rd_bench_run__left_.Main"
    assert "model RealInput_2" in modelica_text(model) and "Main_2 mass;" in modelica_text(model)
    assert largest_difference(model, PUSH, 0.2) < 1e-6
