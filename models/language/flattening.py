"""From a component tree to one explicit ODE.

Connections become equations; equations are matched to unknowns and solved block by block; ``der()`` of a variable that
is no state follows from differentiating the expression that determines it (index reduction).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca

from .additions import Addition, wire
from .component import Component, declarations, given_in_si
from .dimensions import check_units, refuse_hand_conversions
from .elaboration import BoundPort, Elaboration, Equation, _current
from .errors import DeclarationError, TopologyError
from .solving import LinearBlock, NonlinearBlock, Unknown, solve_block
from .structure import match, ordered_blocks
from .units import parse_unit
from .user_code import numbers_refused, unsaid


@dataclass(frozen=True, eq=False)
class Solved:
    """A model whose every unknown is an expression of time, states, inputs and parameters."""

    elaboration: Elaboration
    bindings: Mapping[int, ca.SX]  # hash of a dependent parameter -> its expression
    expressions: Mapping[int, ca.SX]  # hash of an unknown -> expression
    linear: tuple[LinearBlock, ...]  # that divide by something
    nonlinear: tuple[NonlinearBlock, ...]
    dead_times: Mapping[str, str]  # input -> parameter that delays it
    undelayed_inputs: frozenset[str]  # inputs that rates or outputs use as they are

    def of(self, expression: ca.SX) -> ca.SX:
        """``expression`` with every unknown and dependent parameter replaced."""
        return replace(replace(expression, self.expressions), self.bindings)


def elaborate(
    root: Component, name: str, overrides: Sequence[str] = (), additions: Sequence[Addition] = ()
) -> tuple[Elaboration, Component]:
    """Bind a component tree to symbols and add parts to it.

    Dependent parameters named in ``overrides`` become independent.
    """
    elaboration = Elaboration(name)
    token = _current.set(elaboration)
    try:
        with numbers_refused():
            bound = root.bind("", elaboration)
            wire(elaboration, additions, declarations(type(root)))
            entries = {p.path: p for p in elaboration.parameters}
            for path, (function, scope) in list(elaboration.bindings.items()):
                elaboration.bindings[path] = given_in_si(elaboration, function, scope, entries[path])
    finally:
        _current.reset(token)
    for path in overrides:
        elaboration.bindings.pop(path, None)
    return elaboration, bound


def connection_equations(elaboration: Elaboration) -> list[Equation]:
    """Equal potentials and zero-sum flows of every connection set.

    Within the component that connects, ports of its parts count with their own sign, its own ports with the opposite
    one (Modelica's inside and outside connectors). Ports nobody connects are left open; the balance check names them.
    """
    sets: dict[tuple[str, str], set] = {}  # (owner, port path) -> shared set of ports
    equations = []
    for owner, connection in elaboration.connections:
        ends = (connection.first, connection.second)
        if not isinstance(ends[0], BoundPort):
            equations.append(Equation(ends[0], ends[1], owner))
            for end in ends:
                elaboration.open_signals.pop(str(end), None)
            continue
        merged = set(ends)
        for end in ends:
            merged |= sets.get((owner, end.path), set())
        for end in merged:
            sets[(owner, end.path)] = merged
    seen = set()
    for (owner, _), members in sets.items():
        if id(members) in seen:
            continue
        seen.add(id(members))
        ports = sorted(members, key=lambda port: port.path)
        for port in ports[1:]:
            equations.append(Equation(port.potential, ports[0].potential, owner))
        total = ca.SX(0)
        for port in ports:
            total = total - port.flow if _parent(port.path) == owner else total + port.flow
        equations.append(Equation(total, ca.SX(0), owner))
    return equations


def _parent(path: str) -> str:
    return path.rpartition(".")[0]


def open_ports(elaboration: Elaboration) -> list[str]:
    """Ports that nothing is connected to, and input signals that no component around them connects or sets."""
    inside = {
        end.path
        for owner, c in elaboration.connections
        for end in (c.first, c.second)
        if isinstance(end, BoundPort) and _parent(end.path) != owner
    }
    signals = {symbol.element_hash(): path for path, symbol in elaboration.open_signals.items()}
    set_outside = {
        signals[key]
        for equation in elaboration.equations
        for key in equation.symbols
        if key in signals and _parent(signals[key]) != equation.owner
    }
    return [path for path in (*elaboration.ports, *signals.values()) if path not in inside | set_outside]


def solve(elaboration: Elaboration) -> Solved:
    """Check units and balance, then solve for every unknown."""
    name = elaboration.name
    symbol_of = {p.path: p.symbol for p in elaboration.parameters}
    follow = {path: e for path, e in elaboration.bindings.items() if not e.is_constant()}
    bound = [Equation(symbol_of[path], e, path.rpartition(".")[0]) for path, e in follow.items()]
    equations = [*elaboration.equations, *connection_equations(elaboration)]
    check_units(name, [*equations, *elaboration.initial_equations], elaboration.units)
    refuse_hand_conversions(name, [*bound, *equations], _other_units(elaboration))
    bindings = _resolved_bindings(elaboration)
    unknowns = [
        Unknown(v.path, v.symbol, v.declaration.nominal, getattr(v.declaration, "start", 0.0))
        for v in elaboration.variables
    ]
    states = {s.symbol.element_hash(): s for s in elaboration.states}
    for key, entry in states.items():
        rate = elaboration.derivatives[key][1]
        unknowns.append(Unknown(f"der({entry.path})", rate, entry.declaration.nominal))
    check_balance(elaboration, equations, unknowns)
    waiting = {key: pair for key, pair in elaboration.derivatives.items() if key not in states}
    while True:
        expressions, blocks = _solve_once(elaboration, equations, unknowns, waiting)
        ready = _explicit_derivatives(elaboration, expressions, waiting, states)
        if not waiting:
            break
        if not ready:
            stuck = ", ".join(str(pair[0]) for pair in waiting.values())
            raise TopologyError(
                f"{name}: the time derivative of {stuck} cannot be found: it depends on the derivative of an input or "
                "on itself. Put a state (a lag, a mass, a volume) where it is needed."
            )
        for key, rate in ready.items():
            symbol, unknown = waiting.pop(key)
            equations.append(Equation(unknown, rate, f"der({symbol})"))
            unknowns.append(Unknown(f"der({symbol})", unknown))
    delayed, dead_times = _resolve_delays(elaboration, expressions, bindings)
    undelayed = _inputs_used(elaboration, expressions)
    expressions = {key: replace(e, delayed) for key, e in expressions.items()}
    linear, nonlinear = (tuple(b for b in blocks if isinstance(b, kind)) for kind in (LinearBlock, NonlinearBlock))
    return Solved(elaboration, bindings, {**expressions, **delayed}, linear, nonlinear, dead_times, undelayed)


def _other_units(elaboration: Elaboration) -> dict[int, tuple[str, float]]:
    """Quantities that are declared in another unit than SI, with that unit and its factor."""
    groups = (elaboration.parameters, elaboration.states, elaboration.variables, elaboration.inputs)
    entries = [(e, getattr(e.declaration, "written_in", "")) for group in groups for e in group]
    return {
        e.symbol.element_hash(): (unit, parse_unit(unit).factor)
        for e, unit in entries
        if unit and parse_unit(unit).factor != 1
    }


def _resolved_bindings(elaboration: Elaboration) -> dict[int, ca.SX]:
    """Dependent parameters as expressions of independent ones, in any order of declaration."""
    symbol_of = {p.path: p.symbol for p in elaboration.parameters}
    bindings = {symbol_of[path].element_hash(): ca.SX(e) for path, e in elaboration.bindings.items()}
    for _ in range(len(bindings)):
        bindings = {key: replace(e, bindings) for key, e in bindings.items()}
    for path in elaboration.bindings:
        left = ca.symvar(bindings[symbol_of[path].element_hash()])
        if any(s.element_hash() in bindings for s in left):
            raise DeclarationError(f"{elaboration.name}.{path}: this parameter is bound to itself. Give it a number.")
    return bindings


def check_balance(elaboration: Elaboration, equations, unknowns) -> None:
    """As many equations as unknowns, or an error that names the open ports and the component that is off."""
    unconnected = open_ports(elaboration)
    if len(equations) == len(unknowns) and not unconnected:
        return
    message = f"{elaboration.name}: {len(equations)} equations for {len(unknowns)} unknowns."
    if unconnected:
        message += f" Not connected: {', '.join(unconnected)}. Connect them, or close them with a plug, stop or source."
    else:
        _, unmatched, surplus = match(_incidence(equations, unknowns), len(unknowns))
        if unmatched:
            message += f" Nothing determines {', '.join(unknowns[j].path for j in unmatched)}."
        if surplus:
            message += f" Over-determined by {_said(elaboration, [equations[i] for i in surplus[:3]])}."
    if len(equations) < len(unknowns):
        message += "".join(f" {hint}" for kind in elaboration.kinds for hint in unsaid(kind, Component))
    raise TopologyError(message)


def _said(elaboration: Elaboration, equations: Sequence[Equation]) -> str:
    """Equations with the parts and the lines that state them."""
    lines = [f" ({e.at.removesuffix(': ')})" if e.place else "" for e in equations]
    return "; ".join(f"{e.owner or elaboration.name}: {e}{at}" for e, at in zip(equations, lines, strict=True))


def _incidence(equations, unknowns) -> list[set[int]]:
    index = {u.symbol.element_hash(): j for j, u in enumerate(unknowns)}
    return [{index[key] for key in equation.symbols if key in index} for equation in equations]


def _solve_once(elaboration, equations, unknowns, waiting):
    """Match, order and solve; derivatives that still wait count as known, and only what they need is solved then."""
    incidence = _incidence(equations, unknowns)
    unknown_of, unmatched, surplus = match(incidence, len(unknowns))
    if unmatched or surplus:
        raise TopologyError(
            f"{elaboration.name}: structurally singular. Nothing determines "
            f"{', '.join(unknowns[j].path for j in unmatched)}; one too many for the rest is "
            f"{_said(elaboration, [equations[i] for i in surplus])}. "
            "Two states that a rigid connection makes one are the usual cause: merge the masses, or add a stiffness."
        )
    expressions: dict[int, ca.SX] = {}
    records: list[LinearBlock | NonlinearBlock] = []
    blocks = ordered_blocks(incidence, unknown_of)
    wanted = {j for j, u in enumerate(unknowns) if u.symbol.element_hash() in waiting}
    numbers = {p.symbol.element_hash(): p.declaration.value for p in elaboration.parameters}
    values = {key: value for key, value in numbers.items() if not callable(value)}
    for block in _leading_to(wanted, blocks, incidence, unknown_of) if waiting else blocks:
        members = [unknowns[int(unknown_of[i])] for i in block]
        given = _given_outright(equations[block[0]], members[0].symbol) if len(block) == 1 else None
        if given is not None:
            expressions[members[0].symbol.element_hash()] = replace(given, expressions)
            continue
        residuals = [_residual(equations[i], expressions) for i in block]

        def describe(block=block):
            return _said(elaboration, [equations[i] for i in block[:6]])

        solution, record = solve_block(elaboration.name, members, residuals, describe, values)
        for member, expression in zip(members, solution, strict=True):
            expressions[member.symbol.element_hash()] = expression
        if record:
            records.append(record)
    return expressions, records


def _given_outright(equation: Equation, symbol: ca.SX) -> ca.SX | None:
    """What an equation says a symbol is, where one side is that symbol and the other is free of it."""
    key, (left, right) = symbol.element_hash(), equation.sides
    if equation.left.is_symbolic() and key in left and key not in right:
        return equation.right
    return equation.left if equation.right.is_symbolic() and key in right and key not in left else None


def _residual(equation: Equation, expressions: Mapping[int, ca.SX]) -> ca.SX:
    """Left less right side, what is known put in."""
    known = [key for key in equation.symbols if key in expressions]
    residual = equation.left - equation.right
    if not known:
        return residual
    return ca.substitute([residual], [equation.symbols[k] for k in known], [expressions[k] for k in known])[0]


def _leading_to(wanted: set[int], blocks, incidence, unknown_of) -> list:
    """The blocks that the wanted unknowns are solved in, and those before them that they need; still in order."""
    needed, kept = set(wanted), []
    for block in reversed(blocks):
        if any(int(unknown_of[i]) in needed for i in block):
            kept.append(block)
            needed.update(*(incidence[i] for i in block))
    return kept[::-1]


def _explicit_derivatives(elaboration, expressions, waiting, states) -> dict[int, ca.SX]:
    """Time derivatives of those waiting symbols that are by now functions of states, time and parameters."""
    allowed = set(states) | elaboration._known_constant | {elaboration.time.element_hash()}
    ready = {}
    for key in waiting:
        if key not in expressions:
            continue
        expression = expressions[key]
        symbols = ca.symvar(expression)
        if all(s.element_hash() in allowed for s in symbols):
            ready[key] = elaboration.derivative(expression)
    return ready


def _inputs_used(elaboration, expressions) -> frozenset[str]:
    """Inputs that the rates and outputs use without a delay."""
    ends = [elaboration.derivatives[s.symbol.element_hash()][1] for s in elaboration.states]
    ends += [o.symbol for o in elaboration.outputs]
    used = {s.element_hash() for end in ends for s in ca.symvar(replace(end, expressions))}
    return frozenset(i.path for i in elaboration.inputs if i.symbol.element_hash() in used)


def _resolve_delays(elaboration, expressions, bindings):
    """Delayed inputs: each delay symbol becomes the input itself, marked with the parameter that delays it."""
    replaced, dead_times = {}, {}
    inputs = {i.symbol.element_hash(): i.path for i in elaboration.inputs}
    parameters = {p.symbol.element_hash(): p.path for p in elaboration.parameters}
    for item in elaboration.delays:
        source = replace(item.argument, expressions)
        path = inputs.get(source.element_hash()) if source.is_symbolic() else None
        dead_time = replace(item.time, bindings)
        parameter = parameters.get(dead_time.element_hash()) if dead_time.is_symbolic() else None
        if path is None or parameter is None or dead_times.get(path, parameter) != parameter:
            raise TopologyError(
                f"{elaboration.name}: '{item.symbol}' delays {source} by {item.time}. Only an input of the model can "
                "be delayed, by one parameter. Move the dead time to the input, or use a lag."
            )
        dead_times[path] = parameter
        replaced[item.symbol.element_hash()] = source
    return replaced, dead_times


def replace(expression: ca.SX, replacements: Mapping[int, ca.SX]) -> ca.SX:
    """``expression`` with the symbols whose hashes are in ``replacements`` replaced."""
    if expression.is_scalar() and expression.is_symbolic():
        return replacements.get(expression.element_hash(), expression)
    symbols = [s for s in ca.symvar(expression) if s.element_hash() in replacements]
    if not symbols:
        return expression
    return ca.substitute([expression], symbols, [replacements[s.element_hash()] for s in symbols])[0]
