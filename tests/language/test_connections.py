"""Connection sets: equal potentials, flows that sum to zero, ports seen from inside and from outside."""

from __future__ import annotations

import pytest

from hydrotwin.models.language import (
    Component,
    Flange,
    HydraulicPort,
    Input,
    Model,
    Output,
    Parameter,
    TopologyError,
    connect,
)
from tests.language.parts import (
    Damper,
    FlowSource,
    Lag,
    Mass,
    PressureSource,
    Restriction,
    Spring,
    Volume,
    observed,
    outputs,
    rates,
)


class LeakyVessel(Component):
    """A volume and its own drain behind one port: flow enters through the outside port."""

    port = HydraulicPort("outside")
    volume = Volume()
    drain = Restriction()
    tank = PressureSource()

    def equations(self):
        yield connect(self.port, self.volume.port)
        yield connect(self.port, self.drain.a)
        yield connect(self.drain.b, self.tank.port)


class FilledVessel(Component):
    flow = Input("m3/s")
    pump = FlowSource()
    vessel = LeakyVessel()

    def equations(self):
        yield connect(self.flow, self.pump.flow)
        yield connect(self.pump.port, self.vessel.port)


def test_flow_through_an_outside_port_reaches_the_parts_inside():
    model = Model(FilledVessel())
    p, q = 3e6, 2e-4
    drained = 1e-11 * (p - 2e5)
    assert rates(model, [p], [q]) == pytest.approx([1.5e12 * (q - drained)], rel=1e-12)
    names = ["vessel.port.q", "vessel.volume.port.q", "vessel.drain.a.q", "pump.port.q"]
    assert observed(model, names, [p], [q]) == pytest.approx([q, q - drained, drained, -q], rel=1e-12)


class Box(Component):
    """Three levels deep: a port that is only passed on."""

    port = HydraulicPort("outside")
    inner = LeakyVessel()

    def equations(self):
        yield connect(self.port, self.inner.port)


def test_a_port_passed_through_two_levels_is_the_same_place():
    class Deep(Component):
        flow = Input("m3/s")
        pump = FlowSource()
        box = Box()

        def equations(self):
            yield connect(self.flow, self.pump.flow)
            yield connect(self.pump.port, self.box.port)

    p, q = 3e6, 2e-4
    assert rates(Model(Deep()), [p], [q]) == pytest.approx(rates(Model(FilledVessel()), [p], [q]), rel=1e-14)


@pytest.mark.parametrize("order", [(0, 1, 2), (2, 1, 0), (1, 2, 0)])
def test_a_junction_does_not_depend_on_the_order_of_its_connections(order):
    class Junction(Component):
        force = Input("N")
        mass = Mass()
        spring = Spring()
        second = Spring(stiffness=500.0)
        damper = Damper()

        def equations(self):
            yield connect(self.force, self.mass.force)
            pairs = [
                connect(self.mass.end, self.spring.end),
                connect(self.second.end, self.damper.end),
                connect(self.damper.end, self.spring.end),
            ]
            yield from (pairs[k] for k in order)

    expected = (3 - 1.05e4 * 0.2 - 100 * 0.3) / 2
    assert rates(Model(Junction()), [0.2, 0.3], [3.0])[1] == pytest.approx(expected, rel=1e-13)


def test_connecting_twice_says_nothing_new():
    class Twice(Component):
        force = Input("N")
        mass = Mass()
        spring = Spring()

        def equations(self):
            yield connect(self.force, self.mass.force)
            yield connect(self.mass.end, self.spring.end)
            yield connect(self.spring.end, self.mass.end)

    assert rates(Model(Twice()), [0.2, 0.0], [0.0])[1] == pytest.approx(-1000.0)


def test_signals_run_from_outputs_to_inputs_through_levels():
    class Drive(Component):
        command = Input("V")
        speed = Output("rad/s")
        lag = Lag()

        def equations(self):
            yield connect(self.command, self.lag.u)
            yield connect(self.lag.y, self.speed)

    class Bench(Component):
        u = Input("V")
        y = Output("rad/s")
        drive = Drive()

        def equations(self):
            yield connect(self.u, self.drive.command)
            yield connect(self.drive.speed, self.y)

    assert rates(Model(Bench()), [30.0], [0.5]) == pytest.approx([1000.0])
    assert outputs(Model(Bench()), [30.0], [0.5]) == pytest.approx([30.0])


def test_an_input_of_a_part_may_be_set_by_an_equation():
    class Halved(Component):
        u = Input("V")
        share = Parameter(0.5, "1")
        lag = Lag()

        def equations(self):
            yield self.lag.u == self.share * self.u

    assert rates(Model(Halved()), [0.0], [1.0]) == pytest.approx([2000.0])


def test_ports_of_different_kinds_are_not_connected():
    class Wrong(Component):
        mass = Mass()
        volume = Volume()

        def equations(self):
            yield connect(self.mass.end, self.volume.port)

    with pytest.raises(TopologyError, match=r"mass\.end \(Flange\) and volume\.port \(HydraulicPort\)"):
        Model(Wrong()).flat  # noqa: B018


def test_a_variable_is_no_end_of_a_connection():
    class Wrong(Component):
        mass = Mass()
        lag = Lag()

        def equations(self):
            yield connect(self.mass.position, self.lag.u)

    with pytest.raises(TopologyError, match=r"'mass\.position' is neither a port nor a signal"):
        Model(Wrong()).flat  # noqa: B018


def test_a_port_names_its_letters_when_asked_for_another():
    class Wrong(Component):
        end = Flange("end")

        def equations(self):
            yield self.end.force == 0

    with pytest.raises(Exception, match=r"end: no quantity 'force'. This port has 's' and 'f'"):
        Model(Wrong()).flat  # noqa: B018
