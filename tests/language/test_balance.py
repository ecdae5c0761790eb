"""A model has as many equations as unknowns, or says what is missing or too much."""

from __future__ import annotations

import pytest

from hydrotwin.models.language import (
    Component,
    DeclarationError,
    Input,
    Model,
    Output,
    State,
    TopologyError,
    connect,
    der,
)
from tests.language.parts import FlowSource, Lag, Mass, Oscillator, PressureSource, Restriction, Spring, Volume


def refusal(component) -> str:
    with pytest.raises(TopologyError) as refused:
        Model(component, "rig").flat  # noqa: B018
    return str(refused.value)


def test_open_ports_are_named_exactly():
    class Open(Component):
        flow = Input("m3/s")
        pump = FlowSource()
        vessel = Volume()
        drain = Restriction()
        tank = PressureSource()

        def equations(self):
            yield connect(self.flow, self.pump.flow)
            yield connect(self.pump.port, self.vessel.port)

    message = refusal(Open())
    assert "Not connected: drain.a, drain.b, tank.port." in message
    assert message.startswith("rig: ") and "equations for" in message


def test_an_open_signal_is_named():
    class Open(Component):
        lag = Lag()

    assert "Not connected: lag.u." in refusal(Open())


def test_the_count_of_equations_and_unknowns_is_told():
    class Loose(Component):
        y = Output("1")
        z = Output("1")

        def equations(self):
            yield self.y == 2

    message = refusal(Loose())
    assert "1 equations for 2 unknowns" in message and "Nothing determines z" in message


def test_an_equation_too_many_is_shown_with_its_owner():
    class Twice(Oscillator):
        def equations(self):
            yield from super().equations()
            yield self.position == 2 * self.spring.end.s

    message = refusal(Twice())
    assert "Over-determined by rig: " in message


def test_a_state_without_a_rate_is_named():
    class Idle(Component):
        x = State(0.0, "m")
        y = Output("m")

        def equations(self):
            yield self.y == self.x

    assert "Nothing determines der(x)" in refusal(Idle())


def test_a_balanced_but_singular_model_is_refused_and_names_what_is_undetermined():
    class Singular(Component):
        x = State(0.0, "m")
        y = Output("m")

        def equations(self):
            yield der(self.x) == 1.0 * self.rate
            yield der(self.x) == 2.0 * self.rate

        rate = Input("m/s")

    message = refusal(Singular())
    assert "structurally singular" in message and "Nothing determines y" in message


def test_the_same_equation_twice_in_a_loop_is_refused():
    class Repeated(Component):
        x = State(0.0, "m")
        a = Output("m")
        b = Output("m")

        def equations(self):
            yield der(self.x) == -self.x / self.seconds
            yield self.a + self.b == self.x
            yield 2 * self.a + 2 * self.b == 2 * self.x

        seconds = Input("s", default=1.0)

    message = refusal(Repeated())
    assert "a, b" in message or "b" in message
    assert "singular" in message


@pytest.mark.parametrize("statement", [True, 3.0, "x == y", None])
def test_what_is_no_equation_is_refused(statement):
    class Wrong(Component):
        y = Output("1")

        def equations(self):
            yield self.y == 1
            yield statement

    with pytest.raises(DeclarationError, match="no equation"):
        Model(Wrong()).flat  # noqa: B018


def test_an_expression_that_is_no_equation_is_shown():
    class Wrong(Component):
        y = Output("1")

        def equations(self):
            yield self.y + 1

    with pytest.raises(DeclarationError, match=r"no equation\. Yield 'left == right'"):
        Model(Wrong()).flat  # noqa: B018


def test_the_same_expression_on_both_sides_is_refused():
    class Empty(Component):
        y = Output("1")

        def equations(self):
            yield self.y == self.y

    assert "same two sides" in refusal(Empty())


def test_der_outside_equations_is_refused():
    with pytest.raises(DeclarationError, match="only have a meaning inside"):
        der(1.0)


def test_masses_need_a_connection_for_their_flange():
    class Unbolted(Component):
        push = Input("N")
        mass = Mass()
        spring = Spring()

        def equations(self):
            yield connect(self.push, self.mass.force)

    assert "Not connected: mass.end, spring.end." in refusal(Unbolted())
