"""Parts added to a model from outside: how a named effect enters a machine that does not know it.

An `Addition` hangs one component into an elaborated tree, without touching the classes the tree is made of: it joins
nodes, reads variables, takes over a signal, or is put between a port and its node. Several additions on one signal act
one after the other in the order they are given, the later ones nearer to the machine at an input and nearer to the
recorder at an output.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import casadi as ca

from .component import Component, declarations
from .declarations import Input, Output, Port
from .elaboration import BoundPort, Connection, Elaboration, Equation, _current
from .elaboration import connect as join
from .errors import DeclarationError, TopologyError, nearest


@dataclass(frozen=True, eq=False)
class Addition:
    """One part and how it is tied in; at least one of the ways is used.

    name : its path in the model; its parameters are ``<name>.<parameter>``.
    ties : port of the part -> port of the model whose node it joins.
    reads : input of the part -> path of any variable or parameter of the model, or ``der(path)``.
    through : a signal (input or output of the model, input of a part, or ``der(state)``): the part's ``u`` takes what
        was there, its ``y`` goes on. Several by name: ``u_<name>`` and ``y_<name>``.
    between : a port of the model: the part's ``a`` is joined to it, the part's ``b`` to the node it was on. Several by
        name: ``a_<name>`` and ``b_<name>``.
    frees : a parameter of the model that becomes free; needs no part.
    holds : parameters that follow others and shall stay as they are from now on.
    effect, site : what a model file calls it.
    """

    name: str
    part: Component | None = None
    ties: Mapping[str, str] = field(default_factory=dict)
    reads: Mapping[str, str] = field(default_factory=dict)
    through: str | Mapping[str, str] | None = None
    between: str | Mapping[str, str] | None = None
    frees: str | None = None
    effect: str = ""
    site: str = ""
    holds: tuple[str, ...] = ()


def named(additions: Sequence[Addition], what: str) -> str:
    """What was done to additions, in words: ``internal_leakage at pump.a-pump.b added``; "" without any."""
    some = [f"{a.effect} at {a.site}" if a.effect else a.name or a.frees for a in additions]
    return f"{', '.join(map(str, some))} {what}" if some else ""


def outputs_without(additions: Sequence[Addition], elaboration: Elaboration, outputs: list[ca.SX]) -> list[ca.SX]:
    """Output expressions with every added part at the values it is declared with, where it changes nothing.

    A sensor whose bias is looked for measures its state nonetheless.
    """
    added = tuple(f"{a.name}." for a in additions if a.part is not None)
    own = [q for q in elaboration.parameters if added and q.path.startswith(added)]
    own = [q for q in own if not callable(q.declaration.value)]
    if not own:
        return outputs
    return ca.substitute(outputs, [q.symbol for q in own], [ca.SX(q.declaration.value) for q in own])


def wire(elaboration: Elaboration, additions: Sequence[Addition], taken: Sequence[str]) -> None:
    """Bind the parts of additions and tie them in; ``taken`` are names of the root component."""
    seen, ends = set(taken), {}
    for addition in additions:
        if addition.part is None:
            continue
        if addition.name in seen:
            raise DeclarationError(
                f"{elaboration.name}: '{addition.name}' is there already. Give the added part another name."
            )
        seen.add(addition.name)
        _hang(elaboration, addition, ends)


def _hang(elaboration: Elaboration, addition: Addition, ends: dict) -> None:
    """One addition. What its own equations say must not be rewired: the model is changed before they are collected.

    ``ends``: input of the model -> the part last put there and its output, behind which the next one goes.
    """
    paths = by_end(addition.through)
    known = {} if addition.through and _delays(addition.part) else ends
    opened = {end: _open(elaboration, path, known.get(path)) for end, path in paths.items()}
    part = addition.part.bind(addition.name, elaboration)
    for own, port in addition.ties.items():
        owner = _owner(elaboration, _port(elaboration, port))
        elaboration.connections.append((owner, join(_port(elaboration, port), _end(part, own))))
    for own, path in addition.reads.items():
        elaboration.equations.append(Equation(_end(part, own), _variable(elaboration, path), ""))
    for end, close in opened.items():
        close(_end(part, f"u{end}"), _end(part, f"y{end}"))
        if known is ends and paths[end] in {entry.path for entry in elaboration.inputs}:
            ends[paths[end]] = (addition.name, getattr(part, f"y{end}"))
    for end, port in by_end(addition.between).items():
        _put_between(elaboration, _port(elaboration, port), _end(part, f"a{end}"), _end(part, f"b{end}"))


def by_end(where: str | Mapping[str, str] | None) -> dict[str, str]:
    """What the names of a part's two ends there end with -> the place: "" for a single one."""
    if isinstance(where, Mapping):
        return {f"_{name}": place for name, place in where.items()}
    return {"": where} if where else {}


def _end(part: Component, name: str):
    """A port or signal of an added part."""
    own = [k for k, d in declarations(type(part)).items() if isinstance(d, (Port, Input, Output))]
    if name not in own:
        raise DeclarationError(f"{part.path}: the added part has no port or signal '{name}'. {nearest(name, own)}")
    return getattr(part, name)


def _port(elaboration: Elaboration, path: str) -> BoundPort:
    if path not in elaboration.ports:
        raise DeclarationError(f"{elaboration.name}: no port '{path}'. {nearest(path, elaboration.ports)}")
    return elaboration.ports[path]


def _owner(elaboration: Elaboration, port: BoundPort) -> str:
    """Path of the component that connects a port from outside."""
    for owner, connection in elaboration.connections:
        if port in (connection.first, connection.second) and _parent(port.path) != owner:
            return owner
    raise TopologyError(f"{elaboration.name}: port '{port.path}' is not connected to anything. Choose a connected one.")


def _parent(path: str) -> str:
    return path.rpartition(".")[0]


def _variable(elaboration: Elaboration, path: str) -> ca.SX:
    groups = ("variables", "states", "inputs", "parameters")
    known = {e.path: e.symbol for group in groups for e in getattr(elaboration, group)}
    known |= {f"der({s.path})": elaboration.derivatives[s.symbol.element_hash()][1] for s in elaboration.states}
    if path not in known:
        raise DeclarationError(f"{elaboration.name}: no variable '{path}'. {nearest(path, known)}")
    return known[path]


def _put_between(elaboration: Elaboration, port: BoundPort, near: BoundPort, far: BoundPort) -> None:
    """``near`` is joined to the port, ``far`` to what the port was joined to."""
    owner = _owner(elaboration, port)
    elaboration.connections[:] = [
        (o, Connection(*(far if end is port and o == owner else end for end in (c.first, c.second))))
        for o, c in elaboration.connections
    ]
    elaboration.connections.append((owner, join(port, near)))


def _delays(part: Component) -> bool:
    """A dead time is in the part: it stands before everything else at an input."""
    alone = Elaboration("")
    token = _current.set(alone)
    try:
        part.bind("part", alone)
    finally:
        _current.reset(token)
    return bool(alone.delays)


def _open(elaboration: Elaboration, path: str, behind: tuple[str, ca.SX] | None):
    """Cut a signal open, or what came ``behind`` it last; the answer closes it over a part: ``close(u, y)``."""
    if behind:
        name, last = behind
        gap = _cut(elaboration, last, inside=name)
        return lambda u, y: _close(elaboration, gap, y, last, u)
    symbol = _variable(elaboration, path)
    if any(entry.path == path for entry in elaboration.inputs):
        source = _delayed(elaboration, symbol)
        gap = _cut(elaboration, source, inside=None)
        return lambda u, y: _close(elaboration, gap, y, source, u)
    inside = _parent(path) if path in elaboration.open_signals else None
    is_rate = path.startswith("der(")
    if not (is_rate or inside is not None or any(entry.path == path for entry in elaboration.outputs)):
        raise DeclarationError(
            f"{elaboration.name}: nothing can be put into '{path}'. It must be an input or output of the model, an "
            "input of a part, or der(state)."
        )
    gap = _cut(elaboration, symbol, inside)
    return lambda u, y: _close(elaboration, gap, u, symbol, y)


def _cut(elaboration: Elaboration, symbol: ca.SX, inside: str | None) -> ca.SX:
    """Put a new symbol where ``symbol`` stands, but for the equations of the component ``inside`` whose input it is."""
    gap = ca.SX.sym(f"gap({symbol})")
    elaboration.units[gap.element_hash()] = elaboration.units[symbol.element_hash()]
    for k, equation in enumerate(elaboration.equations):
        if inside is None or not (equation.owner == inside or equation.owner.startswith(f"{inside}.")):
            elaboration.equations[k] = equation.with_instead(symbol, gap)
    for k, (owner, c) in enumerate(elaboration.connections):
        if not isinstance(c.first, BoundPort) and owner != inside:
            ends = (gap if end.element_hash() == symbol.element_hash() else end for end in (c.first, c.second))
            elaboration.connections[k] = (owner, Connection(*ends))
    return gap


def _close(elaboration: Elaboration, gap: ca.SX, taker: ca.SX, symbol: ca.SX, giver: ca.SX) -> None:
    """The gap becomes ``taker``; ``symbol`` and ``giver`` are one."""
    elaboration.equations[:] = [equation.with_instead(gap, taker) for equation in elaboration.equations]
    for k, (owner, c) in enumerate(elaboration.connections):
        if not isinstance(c.first, BoundPort):
            ends = (taker if end.element_hash() == gap.element_hash() else end for end in (c.first, c.second))
            elaboration.connections[k] = (owner, Connection(*ends))
    if symbol.element_hash() in elaboration.signals and giver.element_hash() in elaboration.signals:
        elaboration.connections.append(("", Connection(symbol, giver)))
    else:
        elaboration.equations.append(Equation(symbol, giver, ""))


def _delayed(elaboration: Elaboration, symbol: ca.SX) -> ca.SX:
    """What a part at an input takes: the input, or the input after the dead time that delays it.

    A dead time is that of an input alone, so everything else stands behind it; for anything without memory, and
    anything linear, the order makes no difference.
    """
    same, grown = {symbol.element_hash()}, True
    while grown:
        ends = [
            {c.first.element_hash(), c.second.element_hash()}
            for _, c in elaboration.connections
            if not isinstance(c.first, BoundPort)
        ]
        more = set().union(*(pair for pair in ends if pair & same)) - same
        same, grown = same | more, bool(more)
    late = [d.symbol for d in elaboration.delays if d.argument.element_hash() in same]
    return late[0] if late else symbol
