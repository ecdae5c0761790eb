"""Both sides of every equation have the same dimension, whatever operations made them."""

from __future__ import annotations

import casadi as ca
import pytest

from hydrotwin.models.language import Component, Input, Model, Output, Parameter, State, UnitError, der
from hydrotwin.models.language.dimensions import ANY, NUMBER, dimensions_of, written
from hydrotwin.models.language.units import dimension

metre, second, pascal, number = (ca.SX.sym(n) for n in ("metre", "second", "pascal", "number"))
UNITS = {
    metre.element_hash(): "m",
    second.element_hash(): "s",
    pascal.element_hash(): "Pa",
    number.element_hash(): "1",
}


def dimension_of(expression):
    return dimensions_of([ca.SX(expression)], UNITS)[0]


@pytest.mark.parametrize(
    ("expression", "unit"),
    [
        (metre + 2 * metre, "m"),
        (metre * metre, "m2"),
        (metre**3, "m3"),
        (metre / second, "m/s"),
        (1 / second, "Hz"),
        (ca.sqrt(pascal), "sqrt(Pa)"),
        (pascal**0.5, "sqrt(Pa)"),
        (pascal**1.5 / pascal, "sqrt(Pa)"),
        (-metre, "m"),
        (ca.fabs(metre), "m"),
        (ca.fmax(metre, 0), "m"),
        (ca.fmin(metre, 2 * metre), "m"),
        (ca.sign(metre), "1"),
        (ca.sin(number), "1"),
        (ca.tanh(metre / (2 * metre)), "1"),
        (ca.exp(-number), "1"),
        (ca.atan2(metre, metre), "1"),
        (ca.if_else(metre > 0, pascal, 2 * pascal), "Pa"),
        (ca.if_else(ca.logic_and(metre > 0, second > 0), pascal, 0), "Pa"),
        (ca.hypot(metre, metre), "m"),
        (ca.copysign(metre, number), "m"),
        (number**number, "1"),
        (2.0 + number, "1"),
        (ca.fmod(metre, metre), "m"),
        (metre < 2 * metre, "1"),
    ],
    ids=str,
)
def test_an_operation_has_the_dimension_physics_gives_it(expression, unit):
    assert dimension_of(expression) == dimension(unit)


@pytest.mark.parametrize(
    ("expression", "said"),
    [
        (metre + second, "m is added to s"),
        (metre - second, "m is added to s"),
        (metre + 1.0, "added to"),
        (ca.fmax(metre, second), "m is mixed with s"),
        (metre < second, "m is compared with s"),
        (metre > 1.0, "is compared with"),
        (ca.sin(metre), "m is the argument of a transcendental function"),
        (ca.exp(pascal), "the argument of a transcendental function"),
        (ca.tanh(metre), "m is the argument"),
        (metre**number, "m is raised to a power that is no literal"),
        (2.0**metre, "raised to a power that is no literal"),
        (ca.atan2(metre, second), "m is added to s"),
        (ca.hypot(metre, second), "m is mixed with s"),
        (ca.if_else(number > 0, metre, second), "m is added to s"),
    ],
    ids=str,
)
def test_an_operation_that_mixes_dimensions_is_told(expression, said):
    with pytest.raises(UnitError) as refused:
        dimension_of(expression)
    assert said in str(refused.value)


def test_zero_fits_any_dimension_and_other_literals_are_numbers():
    assert dimension_of(ca.SX(0)) is ANY
    assert dimension_of(ca.SX(3)) == NUMBER
    assert dimension_of(metre + 0 * second) == dimension("m")


def test_a_dimension_is_written_in_base_units():
    assert written(dimension("Pa")) == "m-1.kg.s-2"
    assert written(dimension("1")) == "1"
    assert written(dimension("m3/(s.sqrt(Pa))")) == "m7/2.kg-1/2"


class PaperEquation7(Component):
    """Eq. 7 of the C-EHA paper: force rate F' = T1 v + T2 w, with T2 as printed."""

    speed = Input("rad/s")
    velocity = Input("m/s")
    displacement = Parameter(1.05e-7, "m3/rad")
    bulk_modulus = Parameter(1.747e9, "Pa")
    area_1 = Parameter(8.042e-4, "m2")
    area_2 = Parameter(6.319e-4, "m2")
    volume_1 = Parameter(8e-5, "m3")
    volume_2 = Parameter(8e-5, "m3")
    force = State(0.0, "N", nominal=1e3)

    def pump_gain(self):
        return self.area_1 / self.volume_1 - self.area_2**2 / (self.volume_1 * self.volume_2)

    def equations(self):
        stiffness = self.bulk_modulus * (self.area_1**2 / self.volume_1 + self.area_2**2 / self.volume_2)
        gain = self.bulk_modulus * self.displacement * self.pump_gain()
        yield der(self.force) == -stiffness * self.velocity + gain * self.speed


class CorrectedEquation7(PaperEquation7):
    """Its consistent form: the return flow in the area ratio."""

    def pump_gain(self):
        return self.area_1 / self.volume_1 + self.area_2**2 / (self.area_1 * self.volume_2)


def test_equation_7_of_the_paper_as_printed_subtracts_1_per_m2_from_1_per_m():
    with pytest.raises(UnitError) as refused:
        Model(PaperEquation7()).flat  # noqa: B018
    message = str(refused.value)
    assert "units do not balance" in message
    assert "m-1 is added to m-2" in message


def test_equation_7_corrected_balances():
    flat = Model(CorrectedEquation7()).flat
    assert len(flat.states) == 1


def test_the_component_and_both_units_of_an_unbalanced_equation_are_named():
    class Part(Component):
        y = Output("m")
        x = State(1.0, "m/s")

        def equations(self):
            yield der(self.x) == -self.x / self.seconds
            yield self.y == self.x

        seconds = Parameter(1.0, "s")

    class Whole(Component):
        part = Part()

    with pytest.raises(UnitError, match=r"whole\.part: .*got m on the left and m\.s-1 on the right"):
        Model(Whole()).flat  # noqa: B018


def test_initial_equations_are_checked_too():
    class Part(Component):
        x = State(1.0, "m", fixed=False)
        seconds = Parameter(1.0, "s")

        def equations(self):
            yield der(self.x) == -self.x / self.seconds

        def initial_equations(self):
            yield self.x == self.seconds

    with pytest.raises(UnitError, match="m on the left and s on the right"):
        Model(Part()).flat  # noqa: B018


def test_the_rate_of_a_rate_has_seconds_squared():
    class Part(Component):
        x = State(1.0, "m")
        v = State(0.0, "m/s")
        a = Output("m/s")

        def equations(self):
            yield der(self.x) == self.v
            yield der(self.v) == 0
            yield self.a == der(der(self.x))

    with pytest.raises(UnitError, match=r"m\.s-2"):
        Model(Part()).flat  # noqa: B018


def test_an_unknown_unit_is_named():
    with pytest.raises(UnitError, match=r"test_dimensions\.py: line \d+: Output: unit 'parsec': not known"):

        class Part(Component):
            y = Output("parsec")


def test_a_dependent_parameter_has_the_dimension_it_declares():
    class Part(Component):
        length = Parameter(2.0, "m")
        area = Parameter(lambda part: 3 * part.length, "m2")
        y = Output("m2")

        def equations(self):
            yield self.y == self.area

    with pytest.raises(UnitError, match="area"):
        Model(Part()).flat  # noqa: B018
