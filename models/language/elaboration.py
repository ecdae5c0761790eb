"""From declarations to symbols: one walk over a component tree that collects everything a model is made of."""

from __future__ import annotations

import contextvars
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

import casadi as ca

from .declarations import Input, Output, Parameter, Port, State, Variable
from .errors import DeclarationError, TopologyError, UnitError
from .units import compatible
from .user_code import place, place_of, running

_NO_EQUATION = "Yield 'left == right' of scalar expressions, at least one of them a quantity, or connect(a, b)."
_END = object()
_current: contextvars.ContextVar[Elaboration | None] = contextvars.ContextVar("elaboration", default=None)


@dataclass(frozen=True, eq=False)
class Entry:
    """One declared quantity and its symbol."""

    path: str
    symbol: ca.SX
    unit: str
    declaration: object
    owner: object = None


@dataclass(frozen=True, eq=False)
class BoundPort:
    """A port of a bound component; its potential and flow are attributes with the physical letters."""

    path: str
    declaration: Port
    potential: ca.SX
    flow: ca.SX

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        for (letter, _), symbol in (
            (self.declaration.potential, self.potential),
            (self.declaration.flow, self.flow),
        ):
            if name == letter:
                return symbol
        letters = f"'{self.declaration.potential[0]}' and '{self.declaration.flow[0]}'"
        raise DeclarationError(f"{self.path}: no quantity '{name}'. This port has {letters}.")


@dataclass(frozen=True, eq=False)
class Equation:
    """``left == right`` with the path of the component that states it."""

    left: ca.SX
    right: ca.SX
    owner: str
    place: tuple[str, int] | None = None  # file and line that state it

    @property
    def at(self) -> str:
        """``file: line n: ``, or nothing."""
        return place(*self.place) if self.place else ""

    def __str__(self):
        text = f"{self.left} == {self.right}"
        return text if len(text) < 160 else text[:157] + "..."

    @cached_property
    def sides(self) -> tuple[dict[int, ca.SX], dict[int, ca.SX]]:
        """The symbols of the left and of the right side, by hash."""
        return _symbols(self.left), _symbols(self.right)

    @cached_property
    def symbols(self) -> dict[int, ca.SX]:
        """The symbols of both sides, by hash."""
        return self.sides[0] | self.sides[1]

    def with_instead(self, symbol: ca.SX, other: ca.SX) -> Equation:
        """The same equation with ``other`` where ``symbol`` stands."""
        if symbol.element_hash() not in self.symbols:
            return self
        return Equation(*ca.substitute([self.left, self.right], [symbol], [other]), self.owner, self.place)


def _symbols(expression: ca.SX) -> dict[int, ca.SX]:
    found = [expression] if expression.is_symbolic() else ca.symvar(expression)
    return {s.element_hash(): s for s in found}


def unit_of(symbol: ca.SX, units: Mapping[int, str]) -> str:
    """The unit a symbol is declared in, or an error for one that nobody declared."""
    unit = units.get(symbol.element_hash())
    if unit is None:
        raise DeclarationError(
            f"'{symbol}' is a symbol that no component declares. Declare it in the class body, "
            f"{symbol} = Variable(unit), and write self.{symbol}."
        )
    return unit


@dataclass(frozen=True, eq=False)
class Connection:
    """Two ports or two signals that are the same place."""

    first: object
    second: object


@dataclass(frozen=True, eq=False)
class Delay:
    """A symbol that stands for ``argument(t - time)``."""

    symbol: ca.SX
    argument: ca.SX
    time: ca.SX


@dataclass
class Elaboration:
    """Everything found on the walk. Lives only while a model is flattened."""

    name: str
    parameters: list[Entry] = field(default_factory=list)
    bindings: dict[str, object] = field(default_factory=dict)  # path -> expression of a dependent parameter
    states: list[Entry] = field(default_factory=list)
    variables: list[Entry] = field(default_factory=list)
    inputs: list[Entry] = field(default_factory=list)  # of the root
    outputs: list[Entry] = field(default_factory=list)  # of the root
    ports: dict[str, BoundPort] = field(default_factory=dict)
    open_signals: dict[str, ca.SX] = field(default_factory=dict)  # inputs below the root, not yet connected
    equations: list[Equation] = field(default_factory=list)
    initial_equations: list[Equation] = field(default_factory=list)
    connections: list[tuple[str, Connection]] = field(default_factory=list)
    derivatives: dict[int, tuple[ca.SX, ca.SX]] = field(default_factory=dict)  # hash -> (symbol, its derivative)
    kinds: dict[type, None] = field(default_factory=dict)  # classes of the components, each once
    delays: list[Delay] = field(default_factory=list)
    units: dict[int, str] = field(default_factory=dict)  # hash of a symbol -> unit
    signals: dict[int, str] = field(default_factory=dict)  # hash -> path of every Input and Output
    time: ca.SX = field(default_factory=lambda: ca.SX.sym("time"))

    def __post_init__(self):
        self.units[self.time.element_hash()] = "s"
        self._known_constant = set()

    # -- symbols -----------------------------------------------------------------------------------------------
    def symbol(self, path: str, unit: str) -> ca.SX:
        symbol = ca.SX.sym(path)
        self.units[symbol.element_hash()] = unit
        return symbol

    def parameter(self, path: str, declaration: Parameter, owner) -> ca.SX:
        entry = Entry(path, self.symbol(path, declaration.unit), declaration.unit, declaration, owner)
        self._known_constant.add(entry.symbol.element_hash())
        self.parameters.append(entry)
        return entry.symbol

    def state(self, path: str, declaration: State, owner) -> ca.SX:
        entry = Entry(path, self.symbol(path, declaration.unit), declaration.unit, declaration, owner)
        rate = self.symbol(f"der({path})", f"({declaration.unit})/s")
        self.derivatives[entry.symbol.element_hash()] = (entry.symbol, rate)
        self.states.append(entry)
        return entry.symbol

    def variable(self, path: str, declaration, owner=None) -> ca.SX:
        entry = Entry(path, self.symbol(path, declaration.unit), declaration.unit, declaration, owner)
        if isinstance(declaration, (Input, Output)):
            self.signals[entry.symbol.element_hash()] = path
            if "." not in path:
                (self.inputs if isinstance(declaration, Input) else self.outputs).append(entry)
                if isinstance(declaration, Input):
                    return entry.symbol
            elif isinstance(declaration, Input):
                self.open_signals[path] = entry.symbol
        self.variables.append(entry)
        return entry.symbol

    def port(self, path: str, declaration: Port) -> BoundPort:
        (letter, unit), (flow, flow_unit) = declaration.potential, declaration.flow
        nominal, flow_nominal = declaration.nominals
        potential = self.variable(f"{path}.{letter}", Variable(unit, declaration.description, nominal))
        flow_symbol = self.variable(f"{path}.{flow}", Variable(flow_unit, declaration.description, flow_nominal))
        self.ports[path] = bound = BoundPort(path, declaration, potential, flow_symbol)
        return bound

    # -- derivatives -------------------------------------------------------------------------------------------
    def derivative(self, expression: ca.SX) -> ca.SX:
        """d/dt by the chain rule; a symbol that is no state gets a derivative symbol of its own."""
        total = ca.SX(0)
        for symbol in ca.symvar(expression):
            partial = ca.jacobian(expression, symbol)
            total = total + partial * self._derivative_of(symbol)
        return total

    def _derivative_of(self, symbol: ca.SX) -> ca.SX:
        key = symbol.element_hash()
        if key in self._known_constant:
            return ca.SX(0)
        if key == self.time.element_hash():
            return ca.SX(1)
        if key not in self.derivatives:
            rate = self.symbol(f"der({symbol})", f"({unit_of(symbol, self.units)})/s")
            self.derivatives[key] = (symbol, rate)
        return self.derivatives[key][1]

    # -- equations ---------------------------------------------------------------------------------------------
    def collect(self, method: Callable[[], Iterable], owner: str, into: list[Equation]) -> None:
        """What a component's ``equations`` or ``initial_equations`` says."""
        where = owner or self.name
        with running(where):
            statements = method()
        steps = iter(self._checked(statements, where))
        while True:
            with running(where):
                statement = next(steps, _END)
            if statement is _END:
                break
            if isinstance(statement, Connection):
                self.connections.append((owner, statement))
            else:
                self._state(statement, owner, into, place_of(statements))

    def _checked(self, statements, where: str) -> Iterable:
        """Something to go through, or the reason why it is nothing of the kind."""
        if statements is None or isinstance(statements, (list, tuple)) or hasattr(statements, "__next__"):
            return statements or ()
        raise DeclarationError(
            f"{where}: equations() returns no equations (got {str(statements)[:160]}). "
            "Yield each: 'yield left == right', 'yield connect(a, b)'."
        )

    def _state(self, statement, owner: str, into: list[Equation], at: tuple[str, int] | None) -> None:
        where = f"{place(*at) if at else ''}{owner or self.name}"
        if not isinstance(statement, ca.SX) or not statement.is_scalar():
            several = isinstance(statement, (tuple, list))
            hint = "Yield each equation by itself: yield a == b, then yield c == d." if several else _NO_EQUATION
            raise DeclarationError(f"{where}: this is no equation (got {statement!r}). {hint}")
        if statement.is_op(ca.OP_EQ):
            into.append(Equation(statement.dep(0), statement.dep(1), owner, at))
        elif statement.is_constant() and float(statement) == 1:
            raise TopologyError(f"{where}: an equation has the same two sides. Drop it.")
        else:
            raise DeclarationError(f"{where}: '{statement}' is no equation. {_NO_EQUATION}")


def current() -> Elaboration:
    """The elaboration under way; equations can only be written inside one."""
    elaboration = _current.get()
    if elaboration is None:
        raise DeclarationError("der, connect, delay and time only have a meaning inside a component's equations().")
    return elaboration


def der(expression: ca.SX) -> ca.SX:
    """Time derivative of a state, of any other variable (index reduction) or of an expression of them."""
    return current().derivative(ca.SX(expression))


class _Time:
    """Simulation time [s]: ``time`` in an equation, or ``time()``."""

    def __call__(self) -> ca.SX:
        return current().time

    __SX__ = __call__  # how CasADi reads a foreign object

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return getattr(current().time, name)

    def __repr__(self):
        return "time"


def _as_symbol(name: str):
    return lambda self, *others: getattr(self(), name)(*others)


for _name in (
    *("add", "sub", "mul", "truediv", "pow", "floordiv", "mod", "radd", "rsub", "rmul", "rtruediv", "rpow", "rmod"),
    *("neg", "pos", "abs", "lt", "le", "gt", "ge", "eq", "ne", "bool", "float", "hash"),
):
    setattr(_Time, f"__{_name}__", _as_symbol(f"__{_name}__"))
time = _Time()


def delay(argument: ca.SX, dead_time: ca.SX) -> ca.SX:
    """``argument(t - dead_time)``; the argument must be an input of the model, directly or through connections."""
    elaboration = current()
    for part, role in ((argument, "argument"), (dead_time, "dead time")):
        if not (isinstance(part, ca.SX) and part.is_symbolic()):
            raise TopologyError(
                f"{elaboration.name}: the {role} of delay is an expression (got {part}). "
                "Only an input of the model can be delayed, by one parameter. "
                "Give the expression a variable or parameter of its own."
            )
    unit = unit_of(dead_time, elaboration.units)
    if not compatible(unit, "s"):
        raise UnitError(f"{elaboration.name}.{dead_time}: a dead time must be in s (got {unit}). Correct its unit.")
    symbol = elaboration.symbol(f"delay({argument})", unit_of(argument, elaboration.units))
    elaboration.delays.append(Delay(symbol, argument, dead_time))
    return symbol


def connect(first, second) -> Connection:
    """Make two ports (or two signals) one: equal potentials, flows that sum to zero."""
    kinds = []
    for end in (first, second):
        if isinstance(end, BoundPort):
            kinds.append(type(end.declaration))
        elif isinstance(end, ca.SX) and end.is_symbolic() and end.element_hash() in current().signals:
            kinds.append("signal")
        else:
            raise TopologyError(f"connect: '{end}' is neither a port nor a signal. Give a port, an Input or an Output.")
    if kinds[0] != kinds[1]:
        names = [end.path if isinstance(end, BoundPort) else str(end) for end in (first, second)]
        shown = [k if isinstance(k, str) else k.__name__ for k in kinds]
        raise TopologyError(
            f"connect: {names[0]} ({shown[0]}) and {names[1]} ({shown[1]}) are of different kinds. "
            "Connect ports of the same kind, or put a component between them."
        )
    return Connection(first, second)
