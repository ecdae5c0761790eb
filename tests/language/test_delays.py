"""Dead time: a delayed input is the input itself, marked with the parameter that delays it."""

from __future__ import annotations

import pytest

from hydrotwin.models.language import (
    Component,
    Input,
    Model,
    Output,
    Parameter,
    State,
    TopologyError,
    connect,
    delay,
    der,
)
from tests.language.parts import rates


class Valve(Component):
    u = Input("1", "command")
    dead_time = Parameter(0.02, "s", bounds=(0, 1))
    time_constant = Parameter(0.1, "s")
    spool = State(0.0, "1")

    def equations(self):
        yield self.time_constant * der(self.spool) == delay(self.u, self.dead_time) - self.spool


class Plant(Component):
    command = Input("1", "command")
    position = Output("1")
    valve = Valve()

    def equations(self):
        yield connect(self.command, self.valve.u)
        yield self.position == self.valve.spool


def test_a_delayed_input_names_the_parameter_that_delays_it():
    flat = Model(Plant()).flat
    assert flat.inputs[0].dead_time == "valve.dead_time"
    assert "valve.dead_time" in [p.name for p in flat.parameters]


def test_the_ode_takes_the_delayed_value_as_its_input():
    assert rates(Model(Plant()), [0.3], [0.8]) == pytest.approx([5.0])


def test_a_model_without_delay_has_no_dead_time():
    class Direct(Plant):
        def equations(self):
            yield from super().equations()

    class Prompt(Valve):
        def equations(self):
            yield self.time_constant * der(self.spool) == self.u - self.spool

    assert Model(Direct(valve=Prompt())).flat.inputs[0].dead_time is None


def test_an_input_used_delayed_and_not_delayed_is_refused():
    class Both(Plant):
        direct = Output("1")

        def equations(self):
            yield from super().equations()
            yield self.direct == self.command

    with pytest.raises(TopologyError, match=r"'command' is used both delayed by valve\.dead_time and not delayed"):
        Model(Both()).flat  # noqa: B018


def test_a_state_cannot_be_delayed():
    class Echo(Component):
        x = State(1.0, "1")
        dead_time = Parameter(0.02, "s")
        rate = Parameter(1.0, "1/s")

        def equations(self):
            yield der(self.x) == -self.rate * delay(self.x, self.dead_time)

    with pytest.raises(TopologyError, match="Only an input of the model can be delayed"):
        Model(Echo()).flat  # noqa: B018


def test_an_expression_cannot_be_delayed():
    class Echo(Component):
        u = Input("1")
        y = Output("1")
        dead_time = Parameter(0.02, "s")

        def equations(self):
            yield self.y == delay(2 * self.u, self.dead_time)

    with pytest.raises(TopologyError, match="Only an input of the model can be delayed"):
        Model(Echo()).flat  # noqa: B018


def test_two_dead_times_of_one_input_are_refused():
    class Two(Plant):
        second = Valve(dead_time=0.05)

        def equations(self):
            yield from super().equations()
            yield connect(self.command, self.second.u)

    with pytest.raises(TopologyError, match="by one parameter"):
        Model(Two()).flat  # noqa: B018


def test_two_inputs_may_have_dead_times_of_their_own():
    class Two(Plant):
        other = Input("1")
        second = Valve(dead_time=0.05)

        def equations(self):
            yield from super().equations()
            yield connect(self.other, self.second.u)

    flat = Model(Two()).flat
    assert [i.dead_time for i in flat.inputs] == ["valve.dead_time", "second.dead_time"]


def test_a_dead_time_in_metres_is_refused():
    class Wrong(Valve):
        dead_time = Parameter(0.02, "m")

    with pytest.raises(Exception, match=r"dead_time.*s"):
        Model(Plant(valve=Wrong())).flat  # noqa: B018


def test_a_dead_time_bound_to_another_parameter_names_the_one_that_can_be_changed():
    class Bound(Plant):
        transport = Parameter(0.03, "s")
        valve = Valve(dead_time=lambda plant: plant.transport)

    flat = Model(Bound()).flat
    assert flat.inputs[0].dead_time == "transport"
    assert "valve.dead_time" not in [p.name for p in flat.parameters]
