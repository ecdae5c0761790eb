"""Kinds of sites, found by kind of port: the words in which effects say where they fit."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import lru_cache
from itertools import combinations

import casadi as ca
import numpy as np

from hydrotwin.models.language import (
    Component,
    ElectricPin,
    Flange,
    HydraulicPort,
    Input,
    Output,
    Parameter,
    RotationalFlange,
    Shaft,
)
from hydrotwin.models.language.additions import Addition
from hydrotwin.models.language.declarations import PLACEHOLDER
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.models.language.places import Node, Places
from hydrotwin.models.language.units import compatible

from .effect import Site
from .survey import bare

HIGHEST_TANK_PRESSURE = 2e6  # Pa
HIGHEST_OPEN_PRESSURE = 1.2e5  # Pa: that of the surroundings, gauge or absolute
POINTS = 12  # at which two derivatives are compared
SAME = 1e-6  # relative
SCALES = ("m", "rad", "Pa", "K")  # where a zero is a convention


def flanges(places: Places) -> Iterator[Site]:
    """Every moving flange; the effect's port is ``flange``."""
    for node in places.nodes_of(Flange):
        if not places.is_prescribed(node):
            yield Site(node.name, ties={"flange": node.name})


def hydraulic_nodes(places: Places) -> Iterator[Site]:
    """Every hydraulic node whose pressure nothing prescribes; the effect's port is ``port``."""
    for node in places.nodes_of(HydraulicPort):
        if not places.is_prescribed(node):
            yield Site(node.name, ties={"port": node.name})


def hydraulic_pairs(places: Places) -> Iterator[Site]:
    """Every two hydraulic nodes of which not both are prescribed; the effect's ports are ``a`` and ``b``."""
    nodes = sorted(places.nodes_of(HydraulicPort), key=lambda n: n.name)
    for one, other in combinations(nodes, 2):
        if not (places.is_prescribed(one) and places.is_prescribed(other)):
            yield Site(f"{one.name}-{other.name}", ties={"a": one.name, "b": other.name})


def pumps(places: Places) -> Iterator[Site]:
    """Every part with a shaft and two hydraulic ports: ports ``a`` (filled at positive speed, the first declared) and
    ``b``, inputs ``w`` (shaft speed) and ``q`` (flow into the part at ``a``: what it delivers there, negative)."""
    for part in places.parts:
        shafts, ports = part.ports_of(Shaft), part.ports_of(HydraulicPort)
        if len(shafts) == 1 and len(ports) == 2 and all(places.node_at(f"{part.path}.{p}") for p in ports):
            a, b = (f"{part.path}.{p}" for p in ports)
            yield Site(part.path, ties={"a": a, "b": b}, reads={"w": f"{part.path}.{shafts[0]}.w", "q": f"{a}.q"})


def model_inputs(places: Places) -> Iterator[Site]:
    """Every input of the model."""
    yield from (_through(wire) for wire in places.wires if wire.role == "input")


def signals_of_fixed_gain(places: Places) -> Iterator[Site]:
    """Inputs of the model and signals inside whose gain no free parameter changes."""
    known = free_gains(places)
    yield from (site for site in every_signal(places) if site.through not in known)


class _Gains(Component):
    """A gain in a signal."""

    u = Input(PLACEHOLDER, "in")
    y = Output(PLACEHOLDER, "out")
    error = Parameter(0.0, "1", "error of the gain", source="none")

    def equations(self):
        yield self.y == (1 + self.error) * self.u


@lru_cache(maxsize=64)
def free_gains(places: Places) -> frozenset[str]:
    """Inputs of a model and signals inside of which its free parameters together do what scaling them does.

    The derivatives of rates and outputs by such a gain are then the same combination of those by the free parameters
    at every point; tried at some. What a black box does is not known: all.
    """
    signals = [(f"gain_{k}", site) for k, site in enumerate(every_signal(places))]
    if places.model.flat.black_box:
        return frozenset(site.through for _, site in signals)
    parts = ((name, _Gains(u=Input(s.unit), y=Output(s.unit)), s.through) for name, s in signals)
    flat = bare(places.model).plus([Addition(n, part, through=path) for n, part, path in parts], sought=True).flat
    gains = [f"{name}.error" for name, _ in signals]
    free = [j for j, p in enumerate(flat.parameters) if p.free and p.name not in gains]
    rows = _slopes(flat, [flat.index_of(name) for name in gains], free)
    wanted, given = rows[:, : len(gains)], rows[:, len(gains) :]
    step, *_ = np.linalg.lstsq(given, wanted, rcond=None)
    left = np.linalg.norm(given @ step - wanted, axis=0)
    return frozenset(site.through for (_, site), rest in zip(signals, left, strict=True) if rest < SAME)


def _slopes(flat: FlatModel, wanted: list[int], given: list[int]) -> np.ndarray:
    """(rows, n): rates and outputs by these parameters at points around the start, each column of length 1."""
    t, x, u, p = flat.ode.sx_in()
    by_parameters = ca.jacobian(ca.vertcat(*flat.ode(t, x, u, p)), p)[:, [*wanted, *given]]
    derivatives = ca.Function("derivatives", [t, x, u, p], [ca.densify(by_parameters)])
    draw, values = np.random.default_rng(0), flat.parameter_vector()
    start = np.nan_to_num(flat.start_given()([i.default for i in flat.inputs], values, []).full().ravel())
    found = []
    for _ in range(POINTS):
        at = start + draw.uniform(-1, 1, len(start)) * [s.nominal for s in flat.states]
        inputs = draw.uniform(-1, 1, len(flat.inputs)) * [i.nominal for i in flat.inputs]
        found.append(derivatives(0, at, inputs, values).full())
    rows = np.concatenate(found)
    rows = rows[np.isfinite(rows).all(axis=1)]
    rows = rows / np.maximum(np.abs(rows).max(axis=1, keepdims=True, initial=0.0), 1e-300)
    return rows / np.maximum(np.linalg.norm(rows, axis=0), 1e-300)


def commands(places: Places) -> Iterator[Site]:
    """Inputs that are held between samples: what a controller puts out. A measured quantity is no command."""
    held = {i.name for i in places.model.flat.inputs if i.held}
    yield from (site for site in model_inputs(places) if site.through in held)


def model_outputs(places: Places) -> Iterator[Site]:
    """Every output of the model: its sensor."""
    yield from (_through(wire) for wire in places.wires if wire.role == "output")


def valve_spools(places: Places) -> Iterator[Site]:
    """Signals that open a part with two hydraulic ports or more."""
    hydraulic = {part.path for part in places.parts if len(part.ports_of(HydraulicPort)) >= 2}
    for wire in places.wires:
        if wire.role == "inside" and wire.path.rpartition(".")[0] in hydraulic:
            yield _through(wire)


def inside_signals(places: Places) -> Iterator[Site]:
    """Signals between the parts of the model, beside those that come from outside."""
    yield from (replace(_through(wire), further=True) for wire in places.wires if wire.role == "inside")


def every_signal(places: Places) -> Iterator[Site]:
    """Inputs of the model, then the signals inside."""
    yield from model_inputs(places)
    yield from inside_signals(places)


def every_command(places: Places) -> Iterator[Site]:
    """Commands, then the signals inside that open no valve, which has words of its own for what happens there."""
    yield from commands(places)
    opening = {site.through for site in valve_signals(places)}
    yield from (site for site in inside_signals(places) if site.through not in opening)


def signed_outputs(places: Places) -> Iterator[Site]:
    """Outputs whose zero is a state of the machine, not a mark on a scale as that of a position or a pressure."""
    for site in model_outputs(places):
        if not any(compatible(site.unit, unit) for unit in SCALES):
            yield site


def sources(places: Places) -> Iterator[Site]:
    """Ports of supplies that hold their pressure; between them and their node a part with ports ``a``, ``b`` fits."""
    for node in places.nodes_of(HydraulicPort):
        for port in node.ports:
            if places.holds(port):
                yield Site(port, between=port)


def driving_port(places: Places, node: Node) -> str | None:
    """The port of a moving node through which it is driven: that of a part with oil, else the first; None for one."""
    owners = {p: places.part(p.rpartition(".")[0]) for p in node.ports}
    moving = [p for p, part in owners.items() if part]
    if len(moving) < 2 or places.is_prescribed(node):
        return None
    return next((p for p in moving if owners[p].ports_of(HydraulicPort)), moving[0])


def flange_joints(places: Places) -> Iterator[Site]:
    """Joints between two moving parts: the port of one of them, behind which a part ``a``-``b`` fits."""
    for node in places.nodes_of(Flange):
        port = driving_port(places, node)
        if port:
            yield Site(port, between=port)


def parameters(unit: str, wanted: Callable[[str], bool] = lambda path: True):
    """Fixed parameters of the model in a unit, whose path is ``wanted``: a function of the places that finds them."""

    def found(places: Places) -> Iterator[Site]:
        for p in (*places.model.flat.parameters, *(p for p, _ in places.model.followers)):
            added = any(p.name.startswith(f"{a.name}.") for a in places.model.additions if a.part is not None)
            if not p.free and not added and p.value != 0 and compatible(p.unit, unit) and wanted(p.name):
                yield Site(p.name, frees=p.name, unit=p.unit, nominal=p.nominal)

    return found


def rotational_flanges(places: Places) -> Iterator[Site]:
    """Every rotational flange; the effect's port is ``flange``."""
    for node in places.nodes_of(RotationalFlange):
        if not places.is_prescribed(node):
            yield Site(node.name, ties={"flange": node.name})


def _through(wire) -> Site:
    return Site(wire.path, through=wire.path, unit=wire.unit, nominal=wire.nominal)


def drives(places: Places) -> Iterator[Site]:
    """Ports of parts that turn a shaft; between them and what they turn a part with ports ``a``, ``b`` fits.

    A drive that repeats a measured speed (an input in rad/s, linear between samples) loses none under load. Where the
    model has a sensor of the drive's speed, the part stands before that as well: ``u_speed``, ``y_speed``.
    """
    measured = [i for i in places.model.flat.inputs if not i.held and compatible(i.unit, "rad/s")]
    for node in places.nodes_of(Shaft):
        owners = {port: places.part(port.rpartition(".")[0]) for port in node.ports}
        owners = {port: part for port, part in owners.items() if part}
        driving = [port for port, part in owners.items() if set(part.ports.values()) == {Shaft}]
        driving += [port for port, part in owners.items() if ElectricPin in part.ports.values()]
        driving = [p for p in driving if owners[p].states or (owners[p].inputs and not measured)]
        if len(owners) > 1 and len(driving) == 1:
            own = [s for s in places.measured if s.name.rpartition(".")[0] == owners[driving[0]].path]
            seen = next((s.measured_by for s in own if compatible(s.unit, "rad/s")), None)
            yield Site(driving[0], between=driving[0], through={"speed": seen} if seen else None)


def scattered(places: Places, paths: list[str]) -> np.ndarray:
    """(len(paths), POINTS): values of variables of a model at states and inputs anywhere around its start."""
    flat, draw = places.model.flat, np.random.default_rng(0)
    observe, p = places.model.observe(paths), flat.parameter_vector()
    start = np.nan_to_num(flat.start_given()([i.default for i in flat.inputs], p, []).full().ravel())
    found = []
    for _ in range(POINTS):
        at = start + draw.uniform(-1, 1, len(start)) * [s.nominal for s in flat.states]
        inputs = draw.uniform(-1, 1, len(flat.inputs)) * [i.nominal for i in flat.inputs]
        found.append(observe(0, at, inputs, p).full().ravel())
    return np.nan_to_num(np.array(found)).T


def low_pressure_node(places: Places) -> Node | None:
    """The node of the tank: the lowest prescribed pressure, if it is below 20 bar."""
    return _lowest_held(places, HIGHEST_TANK_PRESSURE)


def open_tank_node(places: Places) -> Node | None:
    """The node of a tank whose pressure is that of the surroundings."""
    return _lowest_held(places, HIGHEST_OPEN_PRESSURE)


def _lowest_held(places: Places, highest: float) -> Node | None:
    """The node of the lowest prescribed pressure, if it is below ``highest`` [Pa]."""
    pressures = {}
    for node in places.nodes_of(HydraulicPort):
        if places.is_prescribed(node):
            owners = {port.rpartition(".")[0] for port in node.ports}
            held = [
                p.value
                for p in places.model.flat.parameters
                if p.name.rpartition(".")[0] in owners and compatible(p.unit, "Pa")
            ]
            if held and min(held) < highest:
                pressures[node] = min(held)
    return min(pressures, key=pressures.get, default=None)


def valve_signals(places: Places) -> Iterator[Site]:
    """Signals that open a part with two hydraulic ports or more and no shaft, whoever sends them."""
    for part in places.parts:
        if len(part.ports_of(HydraulicPort)) >= 2 and not part.ports_of(Shaft):
            for path in (f"{part.path}.{name}" for name in part.inputs):
                declared = places.variables[path]
                yield Site(path, through=path, unit=declared.unit, nominal=declared.nominal)
