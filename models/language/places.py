"""The places of a model where something may be added: nodes, signals, parts, states. Found by kind of port alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import casadi as ca

from .component import Component, Law
from .declarations import Variable
from .elaboration import BoundPort, Elaboration
from .flat import StateVariable
from .flattening import elaborate


@dataclass(frozen=True)
class Node:
    """Ports that are one place; ``kind`` is the class of port."""

    kind: type
    ports: tuple[str, ...]

    @property
    def name(self) -> str:
        """The port it is called by: one of a part with states if there is one, else the first by name."""
        return self.ports[0]


@dataclass(frozen=True)
class Wire:
    """A signal: input or output of the model, or input of a part that another part feeds.

    ``delayed``: the model has a dead time of its own on this input.
    """

    path: str
    unit: str
    nominal: float
    role: str  # "input" | "output" | "inside"
    delayed: bool = False


@dataclass(frozen=True)
class Part:
    """A component with its ports by name, its signals and its own states."""

    path: str
    kind: str
    ports: Mapping[str, type]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    states: tuple[str, ...]

    def ports_of(self, kind: type) -> tuple[str, ...]:
        """Names of its ports of one kind."""
        return tuple(name for name, k in self.ports.items() if issubclass(k, kind))


@dataclass(frozen=True)
class StatePlace:
    """A state with its unit, nominal and bounds."""

    path: str
    unit: str
    nominal: float
    bounds: tuple[float, float]


class Places:
    """Every place of a model. ``model`` is a `Model`; what was added to it offers no places and renames none."""

    def __init__(self, model):
        elaboration, root = elaborate(model.root, model.name, tuple(model.settings))
        self.model = model
        self._elaboration: Elaboration = elaboration
        self._bound = {part.path: part for part in _walk(root)}

    @cached_property
    def nodes(self) -> tuple[Node, ...]:
        """Sets of connected ports, each node once."""
        together: dict[str, set[str]] = {path: {path} for path in self._elaboration.ports}
        for _, connection in self._elaboration.connections:
            if isinstance(connection.first, BoundPort):
                merged = together[connection.first.path] | together[connection.second.path]
                for path in merged:
                    together[path] = merged
        seen, found = set(), []
        for path, group in together.items():
            if path not in seen and len(group) > 1:
                seen |= group
                kind = type(self._elaboration.ports[path].declaration)
                found.append(Node(kind, tuple(sorted(group, key=self._rank))))
        return tuple(found)

    def nodes_of(self, kind: type) -> tuple[Node, ...]:
        """Nodes of one kind of port."""
        return tuple(node for node in self.nodes if issubclass(node.kind, kind))

    def is_prescribed(self, node: Node) -> bool:
        """A part with this port alone fixes the potential there: a tank, a supply, a stop."""
        return any(self.holds(path) for path in node.ports)

    def holds(self, port: str) -> bool:
        """The part of this port, its only one, fixes the potential there: the flow is in none of its equations."""
        part = self.part(port.rpartition(".")[0])
        return bool(part) and not part.states and self._silent(part, self._elaboration.ports[port].flow)

    def _silent(self, part: Part, symbol: ca.SX) -> bool:
        """A part with one port says nothing about one of the two quantities there."""
        mine = [e for e in self._elaboration.equations if f"{e.owner}.".startswith(f"{part.path}.")]
        sides = ca.vertcat(*(side for e in mine for side in (e.left, e.right)))
        return len(part.ports) == 1 and not ca.depends_on(sides, symbol)

    def has_memory(self, node: Node) -> bool:
        """A part on this node has states of its own."""
        owners = [self.part(path.rpartition(".")[0]) for path in node.ports if "." in path]
        return any(p.states for p in owners if p)

    @cached_property
    def wires(self) -> tuple[Wire, ...]:
        """Inputs and outputs of the model, and the inputs of its parts that other parts feed."""
        e = self._elaboration
        delayed = {str(d.argument) for d in e.delays}
        same = self._connected_signals()
        found = [
            Wire(i.path, i.unit, i.declaration.nominal, "input", bool(same.get(i.path, {i.path}) & delayed))
            for i in e.inputs
        ]
        inputs = {i.path for i in e.inputs}
        for path, symbol in e.open_signals.items():
            if inputs & same.get(path, set()):
                continue  # the model's own input: it has its place there
            entry = next(v for v in e.variables if v.symbol.element_hash() == symbol.element_hash())
            found.append(Wire(path, entry.unit, entry.declaration.nominal, "inside"))
        found += [Wire(o.path, o.unit, o.declaration.nominal, "output") for o in e.outputs]
        return tuple(found)

    @cached_property
    def measured(self) -> tuple[StateVariable, ...]:
        """States that an output of the model measures."""
        own = type(self.model)(self.model.root, self.model.name) if self.model.additions else self.model
        return tuple(s for s in own.flat.states if s.measured_by)

    @cached_property
    def parts(self) -> tuple[Part, ...]:
        """Components that are no laws, the root and mere assemblies of others aside: each place once, where it is."""
        found = [path for path, c in self._bound.items() if path and not isinstance(c, Law)]
        return tuple(self.part(path) for path in found if not self._is_assembly(path, found))

    def _is_assembly(self, path: str, parts: list[str]) -> bool:
        """A component whose ports and inputs are those of parts inside it: its own equations speak of none of them."""
        if not any(inner.startswith(f"{path}.") for inner in parts):
            return False
        e = self._elaboration
        own = [s for port, b in e.ports.items() if _owner(port) == path for s in (b.potential, b.flow)]
        own += [symbol for signal, symbol in e.open_signals.items() if _owner(signal) == path]
        said = {key for equation in e.equations if equation.owner == path for key in equation.symbols}
        return not any(symbol.element_hash() in said for symbol in own)

    def part(self, path: str) -> Part | None:
        """The component at a path."""
        component = self._bound.get(path)
        if component is None:
            return None
        e = self._elaboration
        mine = {p.rpartition(".")[2]: type(b.declaration) for p, b in e.ports.items() if p.rpartition(".")[0] == path}
        return Part(
            path,
            type(component).__name__,
            mine,
            tuple(s.rpartition(".")[2] for s in e.open_signals if s.rpartition(".")[0] == path),
            tuple(
                v.path.rpartition(".")[2]
                for v in e.variables
                if v.path.rpartition(".")[0] == path
                and v.symbol.element_hash() in e.signals
                and v.path not in e.open_signals
            ),
            tuple(s.path for s in e.states if s.path.startswith(f"{path}.")),
        )

    def node_at(self, port: str) -> Node | None:
        """The node of a port."""
        return next((node for node in self.nodes if port in node.ports), None)

    def upstream(self, path: str) -> tuple[str, ...]:
        """Signals that a signal comes from, nearest first, through the parts that make it, to the model's inputs."""
        same, found, waiting = self._connected_signals(), [], [path]
        while waiting:
            ends = same.get(waiting.pop(0), set())
            found += [i.path for i in self._elaboration.inputs if i.path in ends and i.path not in found]
            for part in self.parts:
                if any(f"{part.path}.{name}" in ends for name in part.outputs):
                    more = [f"{part.path}.{name}" for name in part.inputs]
                    waiting += [p for p in more if p not in found]
                    found += [p for p in more if p not in found]
        return tuple(found)

    @cached_property
    def states(self) -> tuple[StatePlace, ...]:
        """All states."""
        return tuple(
            StatePlace(s.path, s.unit, s.declaration.nominal, s.declaration.bounds) for s in self._elaboration.states
        )

    @cached_property
    def variables(self) -> Mapping[str, Variable]:
        """Every algebraic variable by path."""
        return {v.path: v.declaration for v in self._elaboration.variables}

    def _connected_signals(self) -> dict[str, set[str]]:
        together: dict[str, set[str]] = {}
        for _, c in self._elaboration.connections:
            if not isinstance(c.first, BoundPort):
                names = [str(c.first), str(c.second)]
                merged = set(names).union(*(together.get(n, set()) for n in names))
                for name in merged:
                    together[name] = merged
        return together

    def _rank(self, path: str):
        owner = path.rpartition(".")[0]
        memory = any(s.path.startswith(f"{owner}.") for s in self._elaboration.states)
        return (not memory, path.count("."), path)


def _owner(path: str) -> str:
    return path.rpartition(".")[0]


def _walk(component: Component):
    yield component
    for value in list(vars(component).values()):
        if isinstance(value, Component) and value is not component.parent:
            yield from _walk(value)
