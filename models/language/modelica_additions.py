"""Added parts on their way into Modelica: what a class that extends the machine can say, and what must be opened.

A part that only ties, reads or frees is declared in a class that extends the machine. Modelica cannot take back a
connection or an equation, so where a part stands in a signal, a rate or behind a port, the class around it is written
anew with the part in it; a class whose own equation the part enters gets signal connectors to it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import casadi as ca

from .additions import Addition, by_end
from .component import Component
from .declarations import Input
from .elaboration import BoundPort, Connection, Elaboration, Equation
from .flattening import elaborate


@dataclass(frozen=True, eq=False)
class SignalTo:
    """A signal connector of a class whose equation uses a signal of a part outside it."""

    word: str
    is_output: bool
    unit: str
    symbol: ca.SX  # stands in the equations of the class
    part_signal: ca.SX


@dataclass(eq=False)
class WithAdditions:
    """A machine with its added parts, sorted into places of Modelica classes.

    parts : bound parts by path, the path of the class that declares them in front; extending : those of the class that
    extends the machine. signals : connectors by path of the class that gets them.
    renamed : parameter paths that another class than the root declares: name of the part -> its path.
    """

    elaboration: Elaboration
    root: Component
    parts: Mapping[str, Component]
    extending: frozenset[str]
    renamed: Mapping[str, str]
    signals: dict[str, list[SignalTo]] = field(default_factory=dict)

    def within(self, owner: str) -> list[Component]:
        """The parts that the class at ``owner`` declares, those of the extending class aside."""
        return [p for path, p in self.parts.items() if _parent(path) == owner and path not in self.extending]

    def is_opened(self, owner: str) -> bool:
        """The class at ``owner`` is written anew."""
        return bool(self.within(owner) or self.signals.get(owner))

    def part_of(self, path: str) -> str | None:
        """The part that a variable belongs to."""
        return next((part for part in self.parts if path.startswith(f"{part}.")), None)


def with_additions(model) -> WithAdditions:
    """Elaborate a model with its additions, every part under the path of the class that will declare it."""
    plain, _ = elaborate(model.root, model.name)
    homes = {a.name: _home(a, plain) for a in model.additions if a.part is not None}
    renamed = {name: f"{home}.{name}" for name, home in homes.items() if home}
    additions = [replace(a, name=renamed.get(a.name, a.name)) for a in model.additions]
    elaboration, root = elaborate(model.root, model.name, (), additions)
    parts = {a.name: _bound(elaboration, a.name) for a in additions if a.part is not None}
    only_tied = frozenset(
        a.name for a in additions if a.part is not None and not (a.through or a.between) and "." not in a.name
    )
    found = WithAdditions(elaboration, root, parts, only_tied, renamed)
    _put_rates_and_delays_at_home(found)
    _signals_across_classes(found)
    return found


def _home(addition: Addition, plain: Elaboration) -> str:
    """Path of the innermost class from which everything the part is tied to can be named and connected."""
    levels = [_parent(_parent(port)) for port in (*addition.ties.values(), *by_end(addition.between).values())]
    for path in by_end(addition.through).values():
        inner = path.removeprefix("der(").removesuffix(")")
        levels.append(_parent(_parent(inner)) if inner != path or path in plain.open_signals else "")
    levels += [_parent(path.removeprefix("der(").removesuffix(")")) for path in addition.reads.values()]
    return _common(levels)


def _common(paths: Iterable[str]) -> str:
    """The longest path that is an ancestor of all, or one of them."""
    split = [path.split(".") if path else [] for path in paths]
    shared = []
    for words in zip(*split, strict=False):
        if len(set(words)) > 1:
            break
        shared.append(words[0])
    return ".".join(shared)


def _bound(elaboration: Elaboration, name: str) -> Component:
    """The bound component of an added part, from any quantity it declares."""
    entries = (*elaboration.parameters, *elaboration.variables, *elaboration.states)
    return next(e.owner for e in entries if _parent(e.path) == name and isinstance(e.owner, Component))


def _put_rates_and_delays_at_home(tied: WithAdditions) -> None:
    """``der(x) = y`` of a part in a rate belongs to the class that has the state and has lost its equation.

    In the same way ``delay(x, T) = u`` belongs to the class that delays.
    """
    e = tied.elaboration
    home_of = {e.derivatives[s.symbol.element_hash()][1].element_hash(): s.path for s in e.states}
    home_of |= {d.symbol.element_hash(): str(d.argument) for d in e.delays}
    for k, equation in enumerate(e.equations):
        path = home_of.get(equation.left.element_hash()) if equation.left.is_symbolic() else None
        if path and not equation.owner and equation.right.is_symbolic():
            e.equations[k] = Equation(equation.left, equation.right, _parent(path))


def _signals_across_classes(tied: WithAdditions) -> None:
    """Replace signals of parts in the equations of other classes by connectors of those classes, and connect them."""
    e = tied.elaboration
    known = {v.symbol.element_hash(): v for v in e.variables}
    provided: set[int] = set()
    for k, equation in enumerate(e.equations):
        for symbol in ca.symvar(ca.vertcat(equation.left, equation.right)):
            entry = known.get(symbol.element_hash())
            part = tied.part_of(entry.path) if entry else None
            if part is None or equation.owner == part or equation.owner.startswith(f"{part}."):
                continue
            if f"{part}.".startswith(f"{equation.owner}.") or not equation.owner:
                continue  # the class declares the part
            signal = _signal(tied, equation.owner, part, entry, provided)
            equation = Equation(
                *ca.substitute([equation.left, equation.right], [symbol], [signal.symbol]), equation.owner
            )
        e.equations[k] = equation


def _signal(tied: WithAdditions, owner: str, part: str, entry, provided: set[int]) -> SignalTo:
    """The connector of ``owner`` for a signal of a part, made and connected the first time it is asked for."""
    signals = tied.signals.setdefault(owner, [])
    for signal in signals:
        if signal.part_signal.element_hash() == entry.symbol.element_hash():
            return signal
    e, leaf = tied.elaboration, entry.path.rpartition(".")[2]
    word = f"{part.rpartition('.')[2]}_{leaf}"
    symbol = e.symbol(f"{owner}.{word}", entry.unit)
    e.signals[symbol.element_hash()] = f"{owner}.{word}"
    gives = isinstance(entry.declaration, Input) and entry.symbol.element_hash() not in provided
    provided.add(entry.symbol.element_hash())
    signals.append(SignalTo(word, gives, entry.unit, symbol, entry.symbol))
    e.connections.append((_parent(part), Connection(symbol, entry.symbol)))
    return signals[-1]


def mentions(tied: WithAdditions, ends: Iterable, path_of) -> bool:
    """Whether a connection or equation names a part of the extending class."""
    paths = [end.path if isinstance(end, BoundPort) else path_of(end) for end in ends]
    return any(path and tied.part_of(path) in tied.extending for path in paths)


def _parent(path: str) -> str:
    return path.rpartition(".")[0]
