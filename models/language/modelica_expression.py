"""A CasADi expression as Modelica text.

CasADi raises no events, so conditions and corners are written inside ``noEvent``.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import casadi as ca

from .errors import DeclarationError

LONGEST_EQUATION = 1200  # characters; beyond it, what is used twice gets a variable of its own
SHORTEST_SHARED = 30

IF, NOT, RELATION, SUM, PRODUCT, POWER, PRIMARY = 0, 3, 4, 5, 6, 7, 8  # how tightly a text binds

_BINARY = {  # operator, how tightly it binds, what its left and right operand must at least
    ca.OP_ADD: (" + ", SUM, SUM, PRODUCT),
    ca.OP_SUB: (" - ", SUM, SUM, PRODUCT),
    ca.OP_MUL: ("*", PRODUCT, PRODUCT, POWER),
    ca.OP_DIV: ("/", PRODUCT, PRODUCT, POWER),
    ca.OP_POW: ("^", POWER, PRIMARY, PRIMARY),
    ca.OP_CONSTPOW: ("^", POWER, PRIMARY, PRIMARY),
    ca.OP_LT: (" < ", RELATION, SUM, SUM),
    ca.OP_LE: (" <= ", RELATION, SUM, SUM),
}
_TEMPLATES = {  # text, how tightly it binds, what its operands must at least
    ca.OP_NEG: ("-{0}", SUM, PRODUCT),
    ca.OP_TWICE: ("2*{0}", PRODUCT, POWER),
    ca.OP_INV: ("1/{0}", PRODUCT, POWER),
    ca.OP_SQ: ("{0}^2", POWER, PRIMARY),
    ca.OP_EXPM1: ("exp({0}) - 1", SUM, IF),
    ca.OP_LOG1P: ("log(1 + {0})", PRIMARY, SUM),
    ca.OP_HYPOT: ("sqrt({0}^2 + {1}^2)", PRIMARY, PRIMARY),
    ca.OP_ASINH: ("log({0} + sqrt({0}^2 + 1))", PRIMARY, PRIMARY),
    ca.OP_ACOSH: ("log({0} + sqrt({0}^2 - 1))", PRIMARY, PRIMARY),
    ca.OP_ATANH: ("0.5*log((1 + {0})/(1 - {0}))", PRODUCT, PRIMARY),
    ca.OP_COPYSIGN: ("noEvent(if {1} >= 0 then abs({0}) else -abs({0}))", PRIMARY, PRIMARY),
    ca.OP_EQ: ("abs({0} - {1}) <= 0", RELATION, PRODUCT),
    ca.OP_NE: ("abs({0} - {1}) > 0", RELATION, PRODUCT),
}
_FUNCTIONS = {
    ca.OP_SQRT: "sqrt", ca.OP_EXP: "exp", ca.OP_LOG: "log", ca.OP_SIN: "sin", ca.OP_COS: "cos", ca.OP_TAN: "tan",
    ca.OP_ASIN: "asin", ca.OP_ACOS: "acos", ca.OP_ATAN: "atan", ca.OP_ATAN2: "atan2", ca.OP_SINH: "sinh",
    ca.OP_COSH: "cosh", ca.OP_TANH: "tanh",
}  # fmt: skip
_WITH_CORNERS = {
    ca.OP_FABS: "abs", ca.OP_SIGN: "sign", ca.OP_FMIN: "min", ca.OP_FMAX: "max", ca.OP_FLOOR: "floor",
    ca.OP_CEIL: "ceil", ca.OP_FMOD: "rem",
}  # fmt: skip
_LOGIC = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_AND, ca.OP_OR, ca.OP_NOT}


@dataclass(frozen=True, eq=False)
class Node:
    """One operation of an expression graph; ``value`` is a number or the name of a symbol."""

    op: int
    operands: tuple[Node, ...] = ()
    value: float | str = ""


def modelica_equation(
    left: ca.SX, right: ca.SX, name_of: Callable[[ca.SX], str], shared_name: Callable[[], str]
) -> tuple[str, list[tuple[str, str]]]:
    """``left = right`` as text, and the (name, text) of the variables that keep a long one short."""
    sides = _graph([left, right], name_of)
    text = " = ".join(_Writer({}).write(side, SUM) for side in sides)
    if len(text) <= LONGEST_EQUATION:
        return text, []
    names: dict[Node, str] = {}
    shared: list[tuple[str, str]] = []
    for node in _used_twice(sides):
        definition = _Writer(names).write(node, SUM)
        if len(definition) >= SHORTEST_SHARED:
            names[node] = shared_name()
            shared.append((names[node], definition))
    return " = ".join(_Writer(names).write(side, SUM) for side in sides), shared


def modelica_expression(expression: ca.SX, name_of: Callable[[ca.SX], str]) -> str:
    """An expression as text.

    Raises
    ------
    DeclarationError : it uses an operation that Modelica has no form for.
    """
    return _Writer({}).write(_graph([expression], name_of)[0], IF)


def modelica_number(value: float) -> str:
    """The shortest text that reads back as the same number.

    >>> modelica_number(0.1), modelica_number(2.0), modelica_number(1.747e9), modelica_number(1 / 3)
    ('0.1', '2', '1.747e9', '0.3333333333333333')
    """
    value = float(value)
    text = f"{value:g}" if float(f"{value:g}") == value else repr(value)
    return re.sub(r"e([+-])0*", lambda sign: "e-" if sign[1] == "-" else "e", text)


def _graph(expressions, name_of) -> list[Node]:
    """The graph of expressions, walked in the order CasADi evaluates it."""
    symbols = ca.symvar(ca.vertcat(*expressions))
    f = ca.Function("f", symbols, list(expressions))
    names = [name_of(symbol) for symbol in symbols]
    work: dict[int, Node] = {}
    results = [Node(ca.OP_CONST, (), 0.0)] * len(expressions)
    for k in range(f.n_instructions()):
        op, inputs, outputs = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if op == ca.OP_INPUT:
            work[outputs[0]] = Node(op, (), names[inputs[0]])
        elif op == ca.OP_CONST:
            work[outputs[0]] = Node(op, (), f.instruction_constant(k))
        elif op == ca.OP_OUTPUT:
            results[outputs[0]] = work[inputs[0]]
        else:
            work[outputs[0]] = Node(op, tuple(work[i] for i in inputs))
    return results


def _used_twice(roots: list[Node]) -> list[Node]:
    """Inner operations that more than one other operation uses, operands first."""
    uses: dict[Node, int] = {}
    order: list[Node] = []

    def visit(node: Node) -> None:
        uses[node] = uses.get(node, 0) + 1
        if uses[node] == 1:
            for operand in node.operands:
                visit(operand)
            order.append(node)

    for root in roots:
        visit(root)
    return [n for n in order if uses[n] > 1 and n.operands and n.op not in _LOGIC | {ca.OP_IF_ELSE_ZERO}]


class _Writer:
    """Writes nodes as text; nodes in ``names`` are written as these names."""

    def __init__(self, names: dict[Node, str]):
        self.names = dict(names)
        self.text = lru_cache(maxsize=None)(self._text)

    def write(self, node: Node, at_least: int) -> str:
        """Text of a number, in parentheses unless it binds tightly enough."""
        text, binds = self.text(node)
        if node.op in _LOGIC:
            text, binds = f"noEvent(if {text} then 1 else 0)", PRIMARY
        return text if binds >= at_least else f"({text})"

    def condition(self, node: Node, at_least: int = IF) -> str:
        """Text of a Boolean."""
        text, binds = self.text(node) if node.op in _LOGIC else (f"abs({self.write(node, IF)}) > 0", RELATION)
        return text if binds >= at_least else f"({text})"

    def _text(self, node: Node) -> tuple[str, int]:
        op, operands = node.op, node.operands
        if node in self.names:
            return self.names[node], PRIMARY
        if op == ca.OP_INPUT:
            return str(node.value), PRIMARY
        if op == ca.OP_CONST:
            return modelica_number(node.value), SUM if node.value < 0 else PRIMARY
        if op == ca.OP_ASSIGN:
            return self.text(operands[0])
        if (choice := _choice(node)) is not None:
            condition, yes, no = choice
            otherwise = self.write(no, IF) if no else "0"
            return f"noEvent(if {self.condition(condition)} then {self.write(yes, IF)} else {otherwise})", PRIMARY
        if op == ca.OP_NOT:
            return f"not {self.condition(operands[0], RELATION)}", NOT
        if op in (ca.OP_AND, ca.OP_OR):
            word = " and " if op == ca.OP_AND else " or "
            return word.join(self.condition(each, RELATION) for each in operands), IF
        if op in _BINARY:
            sign, binds, left, right = _BINARY[op]
            if binds == PRODUCT and operands[0].op == ca.OP_CONST and operands[0].value < 0:
                binds, left = SUM, SUM  # Modelica reads -2*a as -(2*a)
            return f"{self.write(operands[0], left)}{sign}{self.write(operands[1], right)}", binds
        if op in _TEMPLATES:
            template, binds, inner = _TEMPLATES[op]
            return template.format(*(self.write(each, inner) for each in operands)), binds
        arguments = ", ".join(self.write(each, IF) for each in operands)
        if op in _FUNCTIONS:
            return f"{_FUNCTIONS[op]}({arguments})", PRIMARY
        if op in _WITH_CORNERS:
            return f"noEvent({_WITH_CORNERS[op]}({arguments}))", PRIMARY
        raise DeclarationError(f"Modelica has no form for operation {op} of ({arguments}). Write it with others.")


def _choice(node: Node) -> tuple[Node, Node, Node | None] | None:
    """(condition, yes, no) of ``if_else``, which CasADi writes as ``(c ? yes : 0) + (!c ? no : 0)``."""
    if node.op == ca.OP_IF_ELSE_ZERO:
        return node.operands[0], node.operands[1], None
    if node.op != ca.OP_ADD or any(each.op != ca.OP_IF_ELSE_ZERO for each in node.operands):
        return None
    (yes_if, yes), (no_if, no) = (each.operands for each in node.operands)
    return (yes_if, yes, no) if no_if.op == ca.OP_NOT and no_if.operands[0] is yes_if else None
