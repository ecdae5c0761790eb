"""The unit check: both sides of every equation must have the same dimension.

The expression graph is walked once. A literal zero fits any dimension, every other literal is a pure number; angles
are pure numbers.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import combinations, product

import casadi as ca
import numpy as np

from .elaboration import Equation, unit_of
from .errors import DeclarationError, UnitError
from .units import BASE_UNITS, dimension

Dimension = tuple[Fraction, ...]
NUMBER: Dimension = (Fraction(0),) * 7
_TIME: Dimension = dimension("s")
ANY = None  # the dimension of a literal zero

_LITERAL = " A number with a unit is a Parameter(number, unit): a literal but zero is a pure number."

SAME_FACTOR = 1e-4  # relative: a literal is the factor of a unit
SCALE, SCALED = 3.0, 4  # by which everything is made larger, at how many points, to see what grows with it

_SAME = {ca.OP_ADD, ca.OP_SUB, ca.OP_FMIN, ca.OP_FMAX, ca.OP_FMOD, ca.OP_REMAINDER, ca.OP_HYPOT}
_COMPARE = {ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE}
_KEEP = {ca.OP_ASSIGN, ca.OP_NEG, ca.OP_FABS, ca.OP_TWICE, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_COPYSIGN}
_NUMBER_ONLY = {
    ca.OP_EXP, ca.OP_LOG, ca.OP_SIN, ca.OP_COS, ca.OP_TAN, ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATAN, ca.OP_SINH, ca.OP_COSH,
    ca.OP_TANH, ca.OP_ASINH, ca.OP_ACOSH, ca.OP_ATANH, ca.OP_ERF, ca.OP_EXPM1, ca.OP_LOG1P, ca.OP_ERFINV,
}  # fmt: skip
_LOGIC = {ca.OP_AND, ca.OP_OR, ca.OP_NOT}


def written(d: Dimension) -> str:
    """A dimension as a product of base units: ``kg.m-1.s-2``.

    >>> written(dimension("Pa"))
    'm-1.kg.s-2'
    """
    parts = [f"{u}{'' if e == 1 else e}" for u, e in zip(BASE_UNITS, d, strict=True) if e]
    return ".".join(parts) or "1"


def dimensions_of(expressions: Sequence[ca.SX], units: Mapping[int, str]) -> list[Dimension | None]:
    """Dimension of each expression, or raise `UnitError` with the operation that mixes two of them.

    ``units`` maps the hash of a symbol to its unit.
    """
    return [_dimension_of(e, units) for e in expressions]


def _dimension_of(expression: ca.SX, units: Mapping[int, str]) -> Dimension | None:
    if expression.is_symbolic():
        return dimension(unit_of(expression, units))
    symbols = ca.symvar(expression)
    f = ca.Function("f", symbols, [expression])
    work: dict[int, Dimension | None] = {}
    constants: dict[int, float] = {}
    result: Dimension | None = NUMBER
    for k in range(f.n_instructions()):
        op, inputs, outputs = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if op == ca.OP_INPUT:
            work[outputs[0]] = dimension(unit_of(symbols[inputs[0]], units))
            constants.pop(outputs[0], None)
        elif op == ca.OP_OUTPUT:
            result = work[inputs[0]]
        elif op == ca.OP_CONST:
            value = f.instruction_constant(k)
            if not math.isfinite(value):
                raise DeclarationError(f"a number in it is not finite (got {value}). Write a finite number.")
            work[outputs[0]], constants[outputs[0]] = (ANY if value == 0 else NUMBER), value
        else:
            arguments = [work[i] for i in inputs]
            if op in _COMPARE and len(arguments) == 2:
                arguments = _in_seconds(arguments, [i in constants for i in inputs])
            exponent = constants.get(inputs[1]) if op in (ca.OP_POW, ca.OP_CONSTPOW) else None
            work[outputs[0]] = _apply(op, arguments, exponent)
            constants.pop(outputs[0], None)
    return result


def _apply(op: int, arguments: list[Dimension | None], exponent: float | None) -> Dimension | None:
    """Dimension of one operation's result."""
    a, b = arguments[0], arguments[-1]
    if op in _SAME or op in _COMPARE:
        if a is not ANY and b is not ANY and a != b:
            verb = "compared with" if op in _COMPARE else "added to" if op in (ca.OP_ADD, ca.OP_SUB) else "mixed with"
            raise UnitError(f"{written(a)} is {verb} {written(b)}")
        return NUMBER if op in _COMPARE else (b if a is ANY else a)
    if op in _KEEP:
        return a
    if op in (ca.OP_MUL, ca.OP_IF_ELSE_ZERO):
        return ANY if b is ANY else tuple(x + y for x, y in zip(a or NUMBER, b, strict=True)) if a is not ANY else ANY
    if op == ca.OP_DIV:
        return ANY if a is ANY else tuple(x - y for x, y in zip(a, b or NUMBER, strict=True))
    if op == ca.OP_INV:
        return tuple(-x for x in a or NUMBER)
    if op in (ca.OP_SQ, ca.OP_SQRT):
        factor = Fraction(2) if op == ca.OP_SQ else Fraction(1, 2)
        return ANY if a is ANY else tuple(x * factor for x in a)
    if op in (ca.OP_POW, ca.OP_CONSTPOW):
        if exponent is not None:
            power = Fraction(exponent).limit_denominator(1000)
            return ANY if a is ANY else tuple(x * power for x in a)
        _pure(arguments, "raised to a power that is no literal")
        return NUMBER
    if op == ca.OP_SIGN or op in _LOGIC:
        return NUMBER
    if op == ca.OP_ATAN2:
        _apply(ca.OP_ADD, arguments, None)
        return NUMBER
    if op in _NUMBER_ONLY:
        _pure(arguments, "the argument of a transcendental function")
        return NUMBER
    if op == ca.OP_CALL:
        raise DeclarationError(
            "a function object of CasADi is called in it. Write the formula itself; ca.pw_lin(x, xs, ys) for a table, "
            "and a Variable with an equation of its own for what a rootfinder would find."
        )
    raise UnitError(f"an operation of CasADi (number {op}) that has no rule for units")


def _in_seconds(arguments: list[Dimension | None], literal: list[bool]) -> list[Dimension | None]:
    """A literal that is compared with a time is in seconds: ``time > 1``."""
    return [
        ANY if own and other == _TIME else a for a, own, other in zip(arguments, literal, arguments[::-1], strict=True)
    ]


def _pure(arguments, role: str) -> None:
    for a in arguments:
        if a is not ANY and a != NUMBER:
            raise UnitError(f"{written(a)} is {role}")


def check_units(model: str, equations: Sequence[Equation], units: Mapping[int, str]) -> None:
    """Check every equation of a model.

    Raises
    ------
    UnitError : names the component, the equation and the two dimensions.
    """
    for equation in equations:
        where = f"{model}.{equation.owner}" if equation.owner else model
        try:
            left, right = dimensions_of([equation.left, equation.right], units)
        except UnitError as error:
            raise UnitError(
                f"{equation.at}{where}: units do not balance in '{equation}' (got {error}). "
                f"Check the units of the quantities that meet there.{_LITERAL}"
            ) from None
        except DeclarationError as error:
            raise DeclarationError(f"{equation.at}{where}: '{equation}': {error}") from None
        if left is not ANY and right is not ANY and left != right:
            raise UnitError(
                f"{equation.at}{where}: units do not balance in '{equation}' (got {written(left)} on the left and "
                f"{written(right)} on the right). Both sides must have the same unit.{_LITERAL}"
            )


def refuse_hand_conversions(
    model: str, equations: Sequence[Equation], factors: Mapping[int, tuple[str, float]]
) -> None:
    """In equations every quantity is in SI, whatever unit it is declared in: a factor to that unit is one too many.

    factors : hash of a symbol declared in another unit -> that unit and its factor to SI.

    Raises
    ------
    UnitError : names the factor; that it is meant otherwise is said by declaring the quantity in SI.
    """
    for equation in equations:
        for unit, factor in (factors[key] for key in equation.symbols if key in factors):
            numbers = [abs(v) for side in (equation.left, equation.right) for v in literals(side)]
            if any(math.isclose(abs(math.log(v / factor)), 0.0, abs_tol=SAME_FACTOR) for v in _products(numbers)):
                raise UnitError(
                    f"{equation.at}{model}: '{equation}' converts to or from {unit} by hand ({factor:g}). Equations "
                    "are in SI whatever the unit of a declaration: leave the factor out, or declare the quantity in SI."
                )


def literals(expression: ca.SX, ones: bool = False) -> list[float]:
    """The numbers written in an expression, but for those that change nothing or a sign, unless ``ones`` count too."""
    f = ca.Function("f", ca.symvar(expression), [expression])
    found = [f.instruction_constant(k) for k in range(f.n_instructions()) if f.instruction_id(k) == ca.OP_CONST]
    return [v for v in found if v not in ((0.0,) if ones else (0.0, 1.0, -1.0))]


def grows_with(expression: ca.SX, symbols: ca.SX) -> bool:
    """Whether an expression is k times as large where all ``symbols`` are: nothing in it is added to them."""
    others = ca.vertcat(ca.SX(0, 1), *ca.symvar(ca.vertcat(expression, symbols)))
    larger = ca.substitute(expression, symbols, SCALE * symbols)
    both = ca.Function("both", [others], [expression, larger])
    draw = np.random.default_rng(0).uniform(0.5, 1.5, (SCALED, others.numel()))
    here, there = np.array([[float(v) for v in both(point)] for point in draw]).T
    return bool(np.nan_to_num(here).any() and np.allclose(there, SCALE * here, rtol=1e-9, atol=0, equal_nan=True))


def _products(literals: Sequence[float]) -> Iterator[float]:
    """Every product of up to three of the literals and of their reciprocals."""
    for count in range(1, min(3, len(literals)) + 1):
        for some in combinations(literals, count):
            for signs in product((1, -1), repeat=count):
                yield math.prod(v**sign for v, sign in zip(some, signs, strict=True))
