"""Parameters: paths, bounds, bindings to other parameters, other values, other laws."""

from __future__ import annotations

import numpy as np
import pytest

from hydrotwin.models.language import (
    Component,
    DeclarationError,
    Flange,
    Input,
    Model,
    Output,
    Parameter,
    Slot,
    State,
    der,
)
from tests.language.parts import (
    Attached,
    Damper,
    Friction,
    LoadedOscillator,
    Mass,
    Oscillator,
    QuadraticFriction,
    Spring,
    Volume,
    rates,
)


class Piston(Component):
    """Two areas, of which the ratio follows."""

    bore = Parameter(0.032, "m", "bore", bounds=(1e-3, 1))
    area = Parameter(lambda piston: np.pi / 4 * piston.bore**2, "m2", "area of the bore")
    twice = Parameter(lambda piston: 2 * piston.area, "m2", "twice the area")
    y = Output("m2")

    def equations(self):
        yield self.y == self.twice


def value(model):
    flat = model.flat
    return float(flat.ode(0, [], [], flat.parameter_vector())[1])


def test_a_dependent_parameter_follows_what_it_depends_on():
    model = Model(Piston())
    assert [p.name for p in model.flat.parameters] == ["bore"]
    assert value(model) == pytest.approx(2 * np.pi / 4 * 0.032**2)
    assert value(model.with_parameters({"bore": 0.064})) == pytest.approx(2 * np.pi / 4 * 0.064**2)


def test_a_number_makes_a_dependent_parameter_independent():
    freed = Model(Piston()).with_parameters({"area": 1e-3})
    assert [p.name for p in freed.flat.parameters] == ["bore", "area"]
    assert value(freed) == pytest.approx(2e-3)
    assert value(Model(Piston(area=1e-3))) == pytest.approx(2e-3)


def test_a_function_binds_a_part_to_the_component_around_it():
    class Pair(Component):
        area = Parameter(3e-3, "m2")
        y = Output("m2")
        piston = Piston(twice=lambda pair: 5 * pair.area)

        def equations(self):
            yield self.y == self.piston.y

    model = Model(Pair())
    assert value(model) == pytest.approx(15e-3)
    assert value(model.with_parameters({"area": 1e-3})) == pytest.approx(5e-3)


def test_a_law_in_a_slot_can_be_bound_to_the_component_that_holds_it():
    class Scaled(Damper):
        size = Parameter(2.0, "N.s/m")
        friction = Slot(Friction, default=Friction(viscous=lambda damper: 10 * damper.size))

    names = [p.name for p in Model(Oscillator(damper=Scaled())).flat.parameters]
    assert "damper.size" in names and "damper.friction.viscous" not in names
    assert rates(Model(Oscillator(damper=Scaled())), [0, 1.0], [0])[1] == pytest.approx(-20.0 / 2)


def test_a_root_can_be_bound_to_itself():
    assert value(Model(Piston(twice=lambda piston: 7 * piston.area))) == pytest.approx(7 * np.pi / 4 * 0.032**2)


def test_parameters_in_a_circle_are_refused_by_name():
    class Circle(Component):
        a = Parameter(lambda c: 2 * c.b, "1")
        b = Parameter(lambda c: 3 * c.a, "1")
        y = Output("1")

        def equations(self):
            yield self.y == self.a

    with pytest.raises(DeclarationError, match=r"circle\.[ab]: this parameter is bound to itself"):
        Model(Circle()).flat  # noqa: B018


def test_new_values_leave_the_original_as_it_was():
    model = Model(Oscillator())
    before = rates(model, [0.1, 0.2], [3.0])
    softer = model.with_parameters({"spring.stiffness": 5e3})
    assert rates(softer, [0.1, 0.2], [3.0])[1] != before[1]
    assert rates(model, [0.1, 0.2], [3.0]) == pytest.approx(before, rel=0)
    assert model.flat.parameter_vector()[1] == 1e4 and softer.flat.parameter_vector()[1] == 5e3


def test_new_values_do_not_solve_the_equations_again():
    model = Model(Oscillator())
    assert model.with_parameters({"spring.stiffness": 5e3}).flat.ode is model.flat.ode


def test_values_given_in_two_steps_add_up():
    model = Model(Oscillator()).with_parameters({"spring.stiffness": 5e3}).with_parameters({"mass.mass": 4.0})
    assert model.flat.parameter_vector().tolist() == [4.0, 5e3, 5.0]


def test_settings_carry_bounds_sigma_source_and_freedom():
    change = {"value": 5e3, "bounds": (1e3, 1e5), "sigma": 12.0, "source": "bench", "free": True}
    p = Model(Oscillator()).with_settings({"spring.stiffness": change}).flat.parameters[1]
    assert (p.value, p.bounds, p.sigma, p.source, p.free) == (5e3, (1e3, 1e5), 12.0, "bench", True)


def test_an_unknown_parameter_asks_for_the_nearest():
    with pytest.raises(DeclarationError) as refused:
        Model(Oscillator()).with_parameters({"damper.friction.viscos": 1.0}).flat  # noqa: B018
    assert "oscillator.damper.friction: no parameter 'viscos'." in str(refused.value)
    assert "Did you mean 'damper.friction.viscous'?" in str(refused.value)


def test_a_value_outside_its_bounds_is_refused_everywhere():
    with pytest.raises(DeclarationError, match=r"damper\.friction\.viscous: .* bounds \(got -1 N\.s/m\)"):
        Model(Oscillator()).with_parameters({"damper.friction.viscous": -1.0}).flat  # noqa: B018
    with pytest.raises(DeclarationError, match=r"Friction\.viscous: value outside its bounds"):
        Friction(viscous=-1.0)
    with pytest.raises(DeclarationError, match="value outside its bounds"):
        Parameter(-1.0, "m", "length", bounds=(0, 1))


def test_another_law_in_the_slot_changes_the_equations():
    model = Model(Oscillator()).but(damper=Damper(friction=QuadraticFriction(viscous=5.0)))
    assert rates(model, [0, 2.0], [0])[1] == pytest.approx(-(5.0 * 2 + 7.0 * 4) / 2)
    assert "damper.friction.drag" in [p.name for p in model.flat.parameters]


def test_a_law_of_another_kind_does_not_fit_the_slot():
    with pytest.raises(DeclarationError, match=r"Damper\.friction: cannot be replaced by Spring\(\)\. Give a Friction"):
        Damper(friction=Spring())
    with pytest.raises(DeclarationError, match=r"Slot\(Friction\): the default is no Friction"):
        Slot(Friction, default=Spring())


def test_a_subclass_extends_its_base():
    assert rates(Model(LoadedOscillator()), [0.1, 0], [0])[1] == pytest.approx(-200.0)

    class Softer(Oscillator):
        spring = Spring(stiffness=1e3)

    assert rates(Model(Softer()), [0.1, 0], [0])[1] == pytest.approx(-50.0)


def test_another_part_replaces_the_first_one_by_name():
    model = Model(LoadedOscillator(extra=Attached(mass=8.0), spring=Spring(stiffness=1e3)))
    assert rates(model, [0.1, 0], [0])[1] == pytest.approx(-10.0)


def test_but_keeps_earlier_changes_and_leaves_the_original():
    first = Mass(mass=4.0)
    second = first.but(position=0.5)
    assert first.changes == {"mass": 4.0}
    assert second.changes == {"mass": 4.0, "position": 0.5}


def test_one_part_used_in_two_machines_belongs_to_neither():
    spring = Spring(stiffness=123.0)
    one, two = Model(Oscillator(spring=spring), "one"), Model(Oscillator(spring=spring), "two")
    assert rates(one, [1, 0], [0]) == pytest.approx(rates(two, [1, 0], [0]))
    assert not hasattr(spring, "path")


def test_start_values_can_be_changed_by_number_or_function():
    class Rig(Oscillator):
        sag = Parameter(0.02, "m")
        mass = Mass(position=lambda rig: -rig.sag, velocity=0.3)

    flat = Model(Rig()).flat
    start = flat.start_given()([0.0], flat.parameter_vector(), [])
    assert np.array(start).ravel() == pytest.approx([-0.02, 0.3])


def test_an_unknown_change_asks_for_the_nearest_name():
    with pytest.raises(DeclarationError, match=r"Volume: no 'volumee'\. Did you mean 'volume'\?"):
        Volume(volumee=1.0)


@pytest.mark.parametrize(
    ("change", "wanted"),
    [
        ({"mass": "heavy"}, "a number in SI units"),
        ({"mass": True}, "a number in SI units"),
        ({"position": "left"}, "a start value or a State"),
        ({"end": 3.0}, "another Flange"),
    ],
)
def test_a_change_of_the_wrong_kind_says_what_is_wanted(change, wanted):
    with pytest.raises(DeclarationError, match=f"Give {wanted}"):
        Mass(**change)


def test_a_declaration_can_replace_a_declaration():
    free = Parameter(4.0, "kg", "mass", bounds=(1, 10), free=True)
    body = Model(Oscillator(mass=Mass(mass=free))).flat.parameters[0]
    assert (body.value, body.bounds, body.free) == (4.0, (1.0, 10.0), True)


def test_numpy_numbers_are_numbers():
    assert Mass(mass=np.float64(3.0)).changes == {"mass": 3.0}
    assert Mass(mass=np.int64(3)).changes == {"mass": 3.0}


def test_a_name_the_language_needs_is_refused():
    with pytest.raises(DeclarationError, match="'path'"):

        class Wrong(Component):
            path = Parameter(1.0, "m")


def test_an_unknown_interpolation_is_refused():
    with pytest.raises(DeclarationError, match="unknown interpolation"):
        Input("V", "command", interpolation="cubic")


def test_a_model_is_made_of_a_component():
    with pytest.raises(DeclarationError, match="is no component"):
        Model(Oscillator)


def test_a_model_can_be_named_and_shows_its_size():
    model = Model(Oscillator(), "bench")
    assert repr(model) == "Model(bench: 2 states, 1 inputs, 1 outputs, 3 parameters)"
    assert Model(Oscillator()).name == "oscillator"


def test_an_unknown_variable_asks_for_the_nearest():
    with pytest.raises(DeclarationError, match=r"no variable 'mass\.positon'\. Did you mean 'mass\.position'\?"):
        Model(Oscillator()).observe(["mass.positon"])


def test_a_second_flange_of_a_part_stays_its_own():
    class Rod(Component):
        left = Flange("left")
        right = Flange("right")
        stiffness = Parameter(1e6, "N/m")
        x = State(0.0, "m")
        seconds = Parameter(1.0, "s")

        def equations(self):
            yield self.left.f == self.stiffness * (self.left.s - self.right.s)
            yield self.left.f + self.right.f == 0
            yield der(self.x) == self.left.s / self.seconds

    assert Rod().but(stiffness=3.0).changes == {"stiffness": 3.0}
