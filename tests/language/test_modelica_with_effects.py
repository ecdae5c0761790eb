"""A machine with added parts as Modelica: extended where that is enough, opened where not, moving as ours."""

from __future__ import annotations

import re

import numpy as np
import pytest

from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.effects import add_effect, candidates
from hydrotwin.models.language import Component, Flange, Input, Model, Output, Parameter, State, connect, der
from hydrotwin.models.language.additions import Addition
from hydrotwin.models.language.modelica import modelica_main, modelica_text
from tests.language.parts import Oscillator
from tests.language.test_modelica import PUSH, both_motions, largest_difference

rumoca = pytest.importorskip("rumoca")

MACHINES = {
    "cehA": cehA.model,
    "spool_valve": lambda: spool_valve.model().with_parameters({"solenoid.dead_time": 0.02}),  # their delay takes no 0
}
FIRST = {(name, c.id): c for name, machine in MACHINES.items() for c in reversed(candidates(machine()))}
LACKED = {effect: name for name, effect in FIRST}  # effect -> a machine that may lack it
UNMATCHED = ("structural_compliance", "backlash")  # they tie positions: matched after index reduction only
LIFT = {"command": ("2*sin(3*time)", lambda t: 2 * np.sin(3 * t))}


def with_effect(model, candidate):
    """The model with a candidate at its first probe."""
    values = {**candidate.neutral, **(candidate.probes[0] if candidate.probes else {})}
    return model.plus([candidate.addition], sought=True).with_parameters(values)


@pytest.mark.parametrize(("effect", "name"), sorted(LACKED.items()), ids=str)
def test_a_modelica_compiler_accepts_every_effect_of_the_catalogue(name, effect):
    candidate = FIRST[name, effect]
    model = with_effect(MACHINES[name](), candidate)
    compiled = rumoca.Session().loads(modelica_text(model), model=modelica_main(model))
    structure = compiled.structure()
    assert structure.is_balanced
    assert structure.is_matched or effect in UNMATCHED
    assert {p.name for p in model.flat.parameters} <= {re.sub(r"_$", "", n) for n in compiled.parameters.names}
    assert list(compiled.inputs.names) == [i.name for i in model.flat.inputs]
    assert [name for name in compiled.outputs.names if "." not in name] == [o.name for o in model.flat.outputs]


@pytest.mark.parametrize(
    ("effect", "word"),
    [
        ("coulomb_friction", "model CehAExtended"),  # a tie
        ("pump_slip", "model CehAExtended"),  # ties and a speed that is read
        ("area_error", "model Main"),  # a value
        ("command_deadband", "model CehAOpened"),  # in an input
        ("sensor_lag", "model CehAOpened"),  # in an output
        ("entrained_air", "model CylinderOpened"),  # in the rates of states
        ("structural_compliance", "model CehAOpened"),  # behind a port
    ],
)
def test_every_way_of_adding_a_part_moves_in_modelica_as_ours(effect, word):
    base = MACHINES["cehA"]()
    model = with_effect(base, FIRST["cehA", effect])
    text = modelica_text(model)
    assert f"{word} " in text
    assert ("Opened" in text) == ("Opened" in word)
    assert largest_difference(model, LIFT, 0.5) < 2e-5


def test_a_part_that_only_ties_leaves_the_text_of_the_machine_as_it_was():
    base = cehA.model()
    model = add_effect(base, "coulomb_friction", values={"force": 80.0})
    plain, text = modelica_text(base), modelica_text(model)
    machine = plain[: plain.index("  model Main ")]
    assert text.startswith(machine)
    added = text[len(machine) :]
    assert "extends CehA;" in added
    assert "connect(arm.pin, coulomb_friction.flange);" in added
    assert "extends CehAExtended(" in added and "coulomb_friction(force=80)" in added


def test_an_opened_machine_is_extended_by_what_only_ties():
    model = add_effect(cehA.model(), "command_deadband", values={"width": 0.1})
    model = add_effect(model, "coulomb_friction", values={"force": 80.0})
    text = modelica_text(model)
    assert "connect(command, command_deadband.u);" in text
    assert (
        "connect(command_deadband.y, motor.command);" in text or "connect(motor.command, command_deadband.y);" in text
    )
    assert "extends CehAOpened;" in text and "extends CehAExtended(" in text
    assert largest_difference(model, LIFT, 0.5) < 2e-5


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", MACHINES)
def test_any_three_effects_together_are_accepted(name, seed):
    base = MACHINES[name]()
    fitting = [c for c in candidates(base) if c.id not in UNMATCHED]
    chosen = np.random.default_rng(seed).choice(len(fitting), 3, replace=False)
    model = base.plus([fitting[k].addition for k in chosen])
    structure = rumoca.Session().loads(modelica_text(model), model=modelica_main(model)).structure()
    assert structure.is_balanced and structure.is_matched, [fitting[k].label for k in chosen]


def test_two_effects_on_one_input_act_in_their_order():
    model = add_effect(cehA.model(), "command_saturation", values={"limit": 1.0})
    model = add_effect(model, "actuator_lag", values={"time_constant": 0.1})
    assert largest_difference(model, LIFT, 0.8) < 2e-5


def test_a_signal_that_the_machine_delays_is_opened_behind_the_delay():
    base = MACHINES["spool_valve"]()
    model = add_effect(base, "null_bias", "current", values={"offset": 0.05})
    text = modelica_text(model)
    solenoid = text[text.index("model ProportionalSolenoidOpened") : text.index("end ProportionalSolenoidOpened")]
    assert "RealOutput null_bias_u" in solenoid and "RealInput null_bias_y" in solenoid
    assert "delay(current, dead_time) = null_bias_u;" in solenoid
    drives = {"current": ("0.2*sin(3*time)", lambda t: 0.2 * np.sin(3 * t))}
    assert largest_difference(model, drives, 0.3, dead_time=0.02) < 5e-3  # their delay interpolates


def test_play_moves_as_ours_once_its_tangent_is_spelled_out(monkeypatch):
    """The compiler of the tests cannot differentiate tanh where positions are tied; written with exp it can."""
    model = with_effect(MACHINES["cehA"](), FIRST["cehA", "backlash"])
    spelled, found = re.subn(r"tanh\((.*?/force_scale)\)", r"(1 - 2/(exp(2*(\1)) + 1))", modelica_text(model))
    assert found == 1
    monkeypatch.setattr("tests.language.test_modelica.modelica_text", lambda _: spelled)
    assert largest_difference(model, LIFT, 0.3) < 1e-4


# -- machines made of machines -----------------------------------------------------------------------------------------
class Rig(Component):
    """An oscillator inside another machine."""

    force = Input("N", "push")
    axis = Oscillator()

    def equations(self):
        yield connect(self.force, self.axis.force)


class Rub(Component):
    """A damper that is added."""

    flange = Flange("where")
    viscous = Parameter(0.0, "N.s/m", "b", bounds=(0, 1e4))

    def equations(self):
        yield self.flange.f == self.viscous * der(self.flange.s)


class Slowed(Component):
    """A signal that is followed with a lag."""

    u = Input("N", "in")
    y = Output("N", "out")
    behind = State(0.0, "N", "w")
    seconds = Parameter(0.02, "s", "T", bounds=(1e-4, 1))

    def equations(self):
        yield self.seconds * der(self.behind) == self.u - self.behind
        yield self.y == self.behind


class Weaker(Component):
    """A force of which a part is lost."""

    u = Input("N", "in")
    y = Output("N", "out")
    factor = Parameter(1.0, "1", "k", bounds=(0, 10))

    def equations(self):
        yield self.y == self.factor * self.u


class Harder(Component):
    """An acceleration that is scaled."""

    u = Input("m/s2", "in")
    y = Output("m/s2", "out")
    factor = Parameter(1.0, "1", "k", bounds=(0, 10))

    def equations(self):
        yield self.y == self.factor * self.u


@pytest.mark.parametrize(
    "addition",
    [
        Addition("rub", Rub(viscous=30.0), ties={"flange": "axis.mass.end"}),
        Addition("weaker", Weaker(factor=0.7), through="axis.mass.force"),
        Addition("harder", Harder(factor=0.5), through="der(axis.mass.velocity)"),
        Addition("late", Slowed(), through="force"),
    ],
    ids=["tie", "inside signal", "rate", "input"],
)
def test_a_part_deep_in_a_machine_is_declared_where_it_is_connected(addition):
    model = Model(Rig(), additions=[addition])
    text = modelica_text(model)
    assert ("OscillatorOpened" in text) == (addition.name != "late")
    assert largest_difference(model, PUSH, 0.3) < 1e-6


def test_values_of_a_part_deep_in_a_machine_reach_it():
    model = Model(Rig(), additions=[Addition("rub", Rub(), ties={"flange": "axis.mass.end"})])
    other = model.with_parameters({"rub.viscous": 50.0})
    assert "axis(rub(viscous=50))" in modelica_text(other)
    theirs, ours = both_motions(other, PUSH, 0.2)
    assert np.abs(theirs - ours).max() < 1e-6
    assert np.abs(theirs - both_motions(model, PUSH, 0.2)[0]).max() > 1e-4
