"""Parts added to a model from outside: nodes joined, variables read, signals taken over, ports put apart."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest

from hydrotwin.models.language import (
    Component,
    Flange,
    HydraulicPort,
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
from hydrotwin.models.language.additions import Addition
from tests.language.parts import (
    Chain,
    Gain,
    Hydraulics,
    Leak,
    Oscillator,
    Throttle,
    observed,
    outputs,
    rates,
)


class Limit(Component):
    u = Input("1")
    y = Output("1")
    limit = Parameter(1.0, "1", bounds=(0, 10))

    def equations(self):
        yield self.y == ca.fmin(self.u, self.limit)


class Late(Component):
    u = Input("1")
    y = Output("1")
    dead_time = Parameter(0.1, "s", bounds=(0, 1))

    def equations(self):
        yield self.y == delay(self.u, self.dead_time)


class LateChain(Chain):
    """The same with a dead time of its own."""

    late = Late()

    def equations(self):
        yield connect(self.command, self.late.u)
        yield connect(self.late.y, self.gain.u)
        yield connect(self.gain.y, self.follower.u)
        yield self.position == self.follower.y
        yield self.shown == self.gain.y


class Plant(Component):
    """Hydraulics inside a part, seen from outside by its pressure alone."""

    pressure = Output("Pa")
    inside = Hydraulics()

    def equations(self):
        yield self.pressure == self.inside.vessel.pressure


def plus(model, *parts, **ways):
    """The model with parts on one and the same place."""
    return model.plus([Addition(f"part{k}", part, **ways) for k, part in enumerate(parts)])


# -- signals -----------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("parts", "rate"), [((Limit(), Gain()), 2.0), ((Gain(), Limit()), 1.0)])
def test_parts_at_an_input_act_in_the_order_given_from_the_input_on(parts, rate):
    model = plus(Model(Chain()), *parts, through="command")
    assert rates(model, [0.0], [1.5]) == pytest.approx([rate])


@pytest.mark.parametrize(("parts", "rate"), [((Limit(), Gain()), 2.0), ((Gain(), Limit()), 1.0)])
def test_parts_at_an_input_act_in_that_order_also_when_added_one_after_the_other(parts, rate):
    model = Model(Chain())
    for k, part in enumerate(parts):
        model = model.plus([Addition(f"part{k}", part, through="command")])
    assert rates(model, [0.0], [1.5]) == pytest.approx([rate])


@pytest.mark.parametrize(("parts", "rate"), [((Limit(), Gain()), 2.0), ((Gain(), Limit()), 1.0)])
def test_parts_at_the_input_of_a_part_act_in_the_order_given(parts, rate):
    model = plus(Model(Chain()), *parts, through="follower.u")
    assert rates(model, [0.0], [1.5]) == pytest.approx([rate])


@pytest.mark.parametrize(("parts", "reading"), [((Limit(), Gain()), 2.0), ((Gain(), Limit()), 1.0)])
def test_parts_at_an_output_act_in_the_order_given_towards_the_recorder(parts, reading):
    model = plus(Model(Chain()), *parts, through="position")
    assert outputs(model, [1.5], [0.0])[0] == pytest.approx(reading)
    assert rates(model, [1.5], [0.3]) == pytest.approx([0.3])


def test_three_parts_at_an_input_keep_their_order():
    model = plus(Model(Chain()), Gain(factor=3.0), Limit(), Gain(factor=5.0), through="command")
    assert rates(model, [0.0], [0.2]) == pytest.approx([3.0])
    assert rates(model, [0.0], [0.9]) == pytest.approx([5.0])


def test_what_is_read_off_before_a_part_stays_as_it_was_and_what_comes_behind_it_changes():
    behind = plus(Model(Chain()), Gain(factor=3.0), through="command")
    assert outputs(behind, [0.0], [1.0])[1] == pytest.approx(3.0)
    inside = plus(Model(Chain()), Gain(factor=3.0), through="follower.u")
    assert outputs(inside, [0.0], [1.0])[1] == pytest.approx(1.0)
    assert rates(inside, [0.0], [1.0]) == pytest.approx([3.0])


@pytest.mark.parametrize("where", [0, 1, 2])
def test_a_dead_time_stands_at_the_input_wherever_it_is_in_the_order(where):
    parts = [Limit(), Gain()]
    parts.insert(where, Late())
    model = plus(Model(Chain()), *parts, through="command")
    assert model.flat.inputs[0].dead_time == f"part{where}.dead_time"
    assert rates(model, [0.0], [1.5]) == pytest.approx([2.0])


def test_parts_at_an_input_that_the_model_delays_stand_behind_its_dead_time():
    model = plus(Model(LateChain()), Limit(), Gain(), through="command")
    assert model.flat.inputs[0].dead_time == "late.dead_time"
    assert rates(model, [0.0], [1.5]) == pytest.approx([2.0])


def test_a_second_dead_time_at_one_input_is_refused():
    with pytest.raises(TopologyError, match="delay"):
        _ = plus(Model(LateChain()), Late(), through="command").flat


def test_a_rate_can_be_taken_over():
    class Ceiling(Component):
        u = Input("1/s")
        y = Output("1/s")
        level = Input("1")
        top = Parameter(1.0, "1")

        def equations(self):
            yield self.y == ca.if_else(self.level > self.top, ca.fmin(self.u, 0), self.u)

    part = Addition("rim", Ceiling(), reads={"level": "follower.x"}, through="der(follower.x)")
    model = Model(Chain()).plus([part])
    assert rates(model, [0.5], [2.0]) == pytest.approx([2.0])
    assert rates(model, [1.5], [2.0]) == pytest.approx([0.0])
    assert rates(model, [1.5], [-2.0]) == pytest.approx([-2.0])


def test_a_part_with_two_signals_takes_both_over():
    class Swap(Component):
        u_one = Input("1")
        y_one = Output("1")
        u_two = Input("1")
        y_two = Output("1")

        def equations(self):
            yield self.y_one == self.u_two
            yield self.y_two == self.u_one

    part = Addition("swap", Swap(), through={"one": "position", "two": "shown"})
    before, after = (outputs(m, [7.0], [3.0]) for m in (Model(Chain()), Model(Chain()).plus([part])))
    assert before.tolist() == [7.0, 3.0] and after.tolist() == [3.0, 7.0]


# -- nodes -------------------------------------------------------------------------------------------------------
def test_a_part_joins_a_node_inside_a_part():
    model = Model(Plant()).plus([Addition("leak", Leak(), ties={"port": "inside.vessel.port"})])
    flow = 1e-11 * (2e5 - 1e5) - 1e-11 * 1e5
    assert rates(model, [1e5]) == pytest.approx([1.5e9 / 1e-3 * flow], abs=1e-9)
    assert rates(Model(Plant()), [1e5]) == pytest.approx([1.5e9 / 1e-3 * 1e-6])


def test_two_leaks_at_one_node_add_up():
    ways = {"ties": {"port": "vessel.port"}}
    model = plus(Model(Hydraulics()), Leak(conductance=2e-12), Leak(conductance=3e-12), **ways)
    inflow = observed(model, ["vessel.port.q"], [1e5])[0]
    assert inflow == pytest.approx(1e-6 - 5e-12 * 1e5)


def test_it_is_one_node_whichever_of_its_ports_is_named():
    found = [
        rates(Model(Hydraulics()).plus([Addition("leak", Leak(), ties={"port": port})]), [1.2e5])
        for port in ("vessel.port", "feed.b")
    ]
    np.testing.assert_allclose(found[0], found[1])


@pytest.mark.parametrize("path", ["source.port", "inside.source.port"])
def test_a_part_between_a_port_and_its_node_carries_what_flows_there(path):
    root = Plant() if path.startswith("inside") else Hydraulics()
    prefix = path.removesuffix("source.port")
    model = Model(root).plus([Addition("line", Throttle(resistance=1e11), between=path)])
    inlet, into = observed(model, [f"{prefix}feed.a.p", f"{prefix}feed.a.q"], [1e5])
    assert into == pytest.approx(1e-6 / 2)  # the restriction is 1e11 too
    assert inlet == pytest.approx(2e5 - 1e11 * into)
    without = Model(root).plus([Addition("line", Throttle(), between=path)])
    assert rates(without, [1e5]) == pytest.approx(rates(Model(root), [1e5]))


def test_what_was_tied_to_a_port_before_goes_along_with_the_node():
    parts = [
        Addition("leak", Leak(conductance=1e-12), ties={"port": "source.port"}),
        Addition("line", Throttle(resistance=1e11), between="source.port"),
    ]
    behind, leaked = observed(Model(Hydraulics()).plus(parts), ["feed.a.p", "leak.port.q"], [1e5])
    assert leaked == pytest.approx(1e-12 * behind) and behind < 2e5


def test_a_force_joins_a_flange_and_may_follow_its_speed():
    class Drag(Component):
        flange = Flange()
        drag = Parameter(3.0, "N.s/m")

        def equations(self):
            yield self.flange.f == self.drag * der(self.flange.s)

    model = Model(Oscillator()).plus([Addition("drag", Drag(), ties={"flange": "spring.end"})])
    push, position, velocity, mass = 1.0, 0.1, 0.4, 2.0
    expected = (push - 1e4 * position - (5.0 + 3.0) * velocity) / mass
    assert rates(model, [position, velocity], [push]) == pytest.approx([velocity, expected])


def test_a_part_reads_states_flows_and_rates():
    class Watch(Component):
        port = HydraulicPort()
        p = Input("Pa")
        q = Input("m3/s")
        rise = Input("Pa/s")
        share = Parameter(0.1, "1")
        time = Parameter(1.0, "s")
        seen = State(0.0, "Pa")

        def equations(self):
            yield self.port.q == -self.share * self.q
            yield der(self.seen) == (self.p - self.seen) / self.time + self.rise

    reads = {"p": "vessel.pressure", "q": "feed.a.q", "rise": "der(vessel.pressure)"}
    model = Model(Hydraulics()).plus([Addition("watch", Watch(), ties={"port": "vessel.port"}, reads=reads)])
    names = [s.name for s in model.flat.states]
    given = {"vessel.pressure": 1e5, "watch.seen": 2e4}
    found = dict(zip(names, rates(model, [given[n] for n in names]), strict=True))
    assert found["vessel.pressure"] == pytest.approx(1.1e-6 * 1.5e9 / 1e-3)
    assert found["watch.seen"] == pytest.approx((1e5 - 2e4) / 1.0 + found["vessel.pressure"])


# -- models ------------------------------------------------------------------------------------------------------
def test_adding_leaves_the_model_it_is_added_to_as_it_was():
    model = Model(Chain())
    before = rates(model, [0.0], [1.5])
    plus(model, Gain(), through="command").flat  # noqa: B018
    assert not model.additions
    assert rates(model, [0.0], [1.5]) == pytest.approx(before)


def test_parameters_of_an_added_part_have_its_name_and_can_be_set():
    model = Model(Chain()).plus([Addition("extra", Gain(), through="command")])
    assert rates(model, [0.0], [1.0], extra__factor=4.0) == pytest.approx([4.0])
    assert rates(model.with_parameters({"extra.factor": 5.0}), [0.0], [1.0]) == pytest.approx([5.0])


def test_a_parameter_is_freed_and_nothing_else_changes():
    model = Model(Chain()).plus([Addition("", frees="gain.factor")])
    free = {p.name: p.free for p in model.flat.parameters}
    assert free == {"gain.factor": True, "follower.rate": False}
    assert rates(model, [0.0], [1.0]) == pytest.approx(rates(Model(Chain()), [0.0], [1.0]))


def test_a_state_stays_measured_by_an_output_whose_sensor_does_nothing_as_declared():
    class Bias(Component):
        u = Input("1")
        y = Output("1")
        offset = Parameter(0.0, "1")

        def equations(self):
            yield self.y == self.u + self.offset

    model = plus(Model(Chain()), Bias(), through="position").with_parameters({"part0.offset": 0.3})
    assert model.flat.states[0].measured_by == "position"
    assert outputs(model, [1.0], [0.0])[0] == pytest.approx(1.3)
