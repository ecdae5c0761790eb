"""Places of a model: nodes, signals, parts and states, found by kind of port alone."""

from __future__ import annotations

import pytest

from hydrotwin.models import cehA, spool_valve
from hydrotwin.models.components import Cylinder, Ground, LinearLoad, LineVolume, Mass, Orifice, Plug, SpringDamper
from hydrotwin.models.effects.sites import (
    drives,
    flange_joints,
    flanges,
    hydraulic_pairs,
    low_pressure_node,
    pumps,
    sources,
    valve_signals,
    valve_spools,
)
from hydrotwin.models.language import Component, Flange, HydraulicPort, Input, Model, Parameter, Shaft, connect
from hydrotwin.models.language.additions import Addition
from hydrotwin.models.language.places import Places


@pytest.fixture(scope="module")
def valve():
    return Places(spool_valve.model())


@pytest.fixture(scope="module")
def eha():
    return Places(cehA.model())


def test_ports_that_are_connected_are_one_node_named_by_a_part_with_memory(valve):
    nodes = {node.name: set(node.ports) for node in valve.nodes_of(HydraulicPort)}
    assert nodes["cylinder.cap"] == {"cylinder.cap", "valve.a"}
    assert nodes["cylinder.annulus"] == {"cylinder.annulus", "valve.b"}
    assert len(nodes) == 4


def test_a_tank_and_a_supply_are_prescribed_and_a_chamber_is_not(valve):
    prescribed = {node.name: valve.is_prescribed(node) for node in valve.nodes_of(HydraulicPort)}
    assert prescribed == {
        "supply.port": True,
        "tank.port": True,
        "cylinder.cap": False,
        "cylinder.annulus": False,
    }
    assert valve.has_memory(valve.node_at("valve.a")) and not valve.has_memory(valve.node_at("valve.tank"))


def test_a_port_that_is_on_no_node_has_none(valve):
    assert valve.node_at("valve.nothing") is None


class Group(Component):
    """A cylinder and its mass in one part, with the cylinder's ports led out."""

    cap = HydraulicPort()
    annulus = HydraulicPort()
    cylinder = Cylinder()
    mass = Mass()

    def equations(self):
        yield connect(self.cap, self.cylinder.cap)
        yield connect(self.annulus, self.cylinder.annulus)
        yield connect(self.cylinder.rod, self.mass.flange)


class Plumbing(Component):
    """Two grouped cylinders, cap to cap and annulus to annulus."""

    one = Group()
    two = Group()

    def equations(self):
        yield connect(self.one.cap, self.two.cap)
        yield connect(self.one.annulus, self.two.annulus)


def test_a_node_reaches_through_the_ports_a_part_leads_out():
    nodes = Places(Model(Plumbing())).nodes_of(HydraulicPort)
    assert {frozenset(n.ports) for n in nodes} == {
        frozenset({"one.cap", "two.cap", "one.cylinder.cap", "two.cylinder.cap"}),
        frozenset({"one.annulus", "two.annulus", "one.cylinder.annulus", "two.cylinder.annulus"}),
    }


def test_signals_have_their_role_unit_and_nominal(valve):
    wires = {wire.path: wire for wire in valve.wires}
    assert wires["current"].role == "input" and wires["current"].delayed
    assert wires["slide.target"].role == wires["valve.spool"].role == "inside"
    assert "solenoid.current" not in wires, "it is the model's input, which has its place already"
    assert (wires["pressure_a"].role, wires["pressure_a"].unit, wires["pressure_a"].nominal) == ("output", "Pa", 5e6)


def test_an_input_without_a_dead_time_of_its_own_is_not_delayed(eha):
    assert not next(w for w in eha.wires if w.path == "command").delayed


def test_a_part_tells_its_ports_signals_and_states(valve, eha):
    slide = valve.part("slide")
    assert (slide.kind, slide.inputs, slide.outputs) == ("Spool", ("target",), ("displacement",))
    assert slide.states == ("slide.position", "slide.velocity")
    pump = eha.part("pump")
    assert pump.ports_of(HydraulicPort) == ("cap", "rod") and pump.ports_of(Shaft) == ("shaft",)
    assert eha.part("nothing") is None


def test_laws_are_no_parts(eha):
    assert {part.path for part in eha.parts} == {"motor", "pump", "cylinder", "arm"}


def test_states_have_unit_nominal_and_bounds(eha):
    states = {s.path: s for s in eha.states}
    assert len(states) == 5
    assert (states["cylinder.cap_pressure"].unit, states["cylinder.cap_pressure"].nominal) == ("Pa", 1e6)


def test_every_variable_has_its_declaration(eha):
    assert eha.variables["pump.shaft.w"].unit == "rad/s"


def test_signals_upstream_are_found_through_parts_and_end_at_the_input(valve):
    assert valve.upstream("valve.spool") == ("slide.target", "solenoid.current", "current")
    assert valve.upstream("slide.target") == ("solenoid.current", "current")
    assert valve.upstream("position") == ()


def test_what_is_added_offers_no_places_and_renames_none():
    class Line(Component):
        a = HydraulicPort()
        b = HydraulicPort()
        resistance = Parameter(1e9, "Pa.s/m3")

        def equations(self):
            yield self.a.q + self.b.q == 0
            yield self.b.p == self.a.p - self.resistance * self.a.q

    model = spool_valve.model()
    places = Places(model.plus([Addition("line", Line(), between="supply.port")]))
    assert places.nodes == Places(model).nodes and places.wires == Places(model).wires
    assert places.part("line") is None
    assert "line.resistance" in {p.name for p in places.model.flat.parameters}


def test_a_closed_end_holds_nothing_and_a_given_pressure_does():
    class Vessel(Component):
        pressure = Input("Pa")
        given = Source()
        feed = Orifice()
        line = LineVolume()
        end = Plug()

        def equations(self):
            yield connect(self.pressure, self.given.pressure)
            yield connect(self.given.port, self.feed.a)
            yield connect(self.feed.b, self.line.a)
            yield connect(self.line.b, self.end.port)

    places = Places(Model(Vessel()))
    held = {n.name: places.is_prescribed(n) for n in places.nodes}
    assert held == {"feed.a": True, "line.a": False, "line.b": False}
    assert names(sources(places)) == ["given.port"]


class Source(Component):
    """A pressure from outside."""

    port = HydraulicPort()
    pressure = Input("Pa")

    def equations(self):
        yield self.port.p == self.pressure


# -- kinds of sites ----------------------------------------------------------------------------------------------
def names(sites):
    return [site.name for site in sites]


def test_pumps_are_parts_with_a_shaft_and_two_ports(valve, eha):
    (site,) = pumps(eha)
    assert site.ties == {"a": "pump.cap", "b": "pump.rod"}
    assert site.reads == {"w": "pump.shaft.w", "q": "pump.cap.q"}
    assert not names(pumps(valve))


def test_what_turns_the_pump_is_the_drive(valve, eha):
    assert names(drives(eha)) == ["motor.shaft"]
    assert not names(drives(valve))


def test_moving_flanges_and_joints_are_found_once_each(valve, eha):
    assert names(flanges(valve)) == ["cylinder.rod"]
    assert names(flange_joints(valve)) == ["cylinder.rod"]
    assert names(flange_joints(eha)) == ["cylinder.rod"]


def test_pairs_of_nodes_are_found_once_each_and_never_between_two_prescribed_ones(valve):
    pairs = {frozenset(site.ties.values()) for site in hydraulic_pairs(valve)}
    assert len(pairs) == len(names(hydraulic_pairs(valve))) == 5
    assert frozenset({"supply.port", "tank.port"}) not in pairs


def test_supply_and_tank_are_sources(valve, eha):
    assert sorted(names(sources(valve))) == ["supply.port", "tank.port"]
    assert not names(sources(eha))


def test_the_tank_is_told_from_the_supply_by_its_pressure(valve, eha):
    assert low_pressure_node(valve).name == "tank.port"
    assert low_pressure_node(eha) is None


def test_a_pump_is_no_valve_and_a_valve_is_found_by_its_ports(valve, eha):
    assert names(valve_spools(valve)) == names(valve_signals(valve)) == ["valve.spool"]
    assert not names(valve_signals(eha))


def test_a_flange_at_a_fixed_place_moves_nothing():
    class Hung(Component):
        wall = Ground()
        spring = SpringDamper()
        load = LinearLoad()

        def equations(self):
            yield connect(self.wall.flange, self.spring.a)
            yield connect(self.spring.b, self.load.flange)

    places = Places(Model(Hung()))
    assert names(flanges(places)) == ["load.flange"]
    assert [places.is_prescribed(n) for n in places.nodes_of(Flange) if "wall.flange" in n.ports] == [True]
