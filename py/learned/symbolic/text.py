"""Formulas in words: simplified by SymPy, printed as text and LaTeX, with the units that the scales carry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import sympy

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal

from ..network.narx import NarxShape
from .block import (
    ABSOLUTE,
    ADD,
    CONSTANT,
    COSINE,
    DIVIDE,
    EXP,
    LOG,
    MULTIPLY,
    SINE,
    SQRT,
    SQUARE,
    TANH,
    VARIABLE,
    Formula,
    evaluate,
)
from .static_block import StaticShape

DIGITS = 4  # of a printed constant
MOST_FACTORS = 9  # of a whole power written as a product
_FUNCTIONS = {
    sympy.cos: COSINE,
    sympy.sin: SINE,
    sympy.tanh: TANH,
    sympy.exp: EXP,
    sympy.log: LOG,
    sympy.Abs: ABSOLUTE,
}
_ONE = Formula((CONSTANT,), (1.0,))


def as_expressions(formula: Formula, symbols: Sequence[sympy.Symbol]) -> list[sympy.Expr]:
    """The expressions, with constants folded and like terms collected."""
    constants = [sympy.Float(c, 17) for c in formula.constants]
    return evaluate(formula.tokens, constants, symbols, library=sympy)


def simplified(formula: Formula, features: int) -> Formula:
    """The same values with fewer tokens: constants folded, like terms collected, terms far below rounding dropped."""
    symbols = [sympy.Symbol(f"z{i}", real=True) for i in range(features)]
    index = {s: VARIABLE + i for i, s in enumerate(symbols)}
    whole = Formula((), ())
    for expression in as_expressions(formula, symbols):
        whole += _as_tokens(expression, index)
    return whole


def _as_tokens(expression: sympy.Expr, index: Mapping[sympy.Symbol, int]) -> Formula:
    if expression in index:
        return Formula((index[expression],), ())
    if expression.is_number or expression.has(sympy.nan, sympy.zoo, sympy.oo):
        return Formula((CONSTANT,), (_real(expression),))
    if expression.func in _FUNCTIONS:
        return _before(_FUNCTIONS[expression.func], _as_tokens(_bare(expression), index))
    if expression.is_Pow:
        return _power(expression.base, expression.exp, index)
    if expression.is_Add:
        return _joined(ADD, [_as_tokens(a, index) for a in expression.args])
    if expression.is_Mul:
        under = [a for a in expression.args if a.is_Pow and a.exp.is_number and a.exp < 0]
        over = [_as_tokens(a, index) for a in expression.args if a not in under] or [_ONE]
        below = [_power(a.base, -a.exp, index) for a in under]
        return _joined(DIVIDE, [_joined(MULTIPLY, p) for p in (over, below) if p])
    raise DataError(f"formula: cannot write {expression.func.__name__} as tokens. Report the formula: {expression}.")


def _real(number: sympy.Expr) -> float:
    value = complex(number) if number.is_number else complex("nan")
    return value.real if value.imag == 0 else float("nan")


def _bare(function: sympy.Expr) -> sympy.Expr:
    """The argument; without the absolute value in a logarithm, which has it."""
    inside = function.args[0]
    return inside.args[0] if function.func is sympy.log and inside.func is sympy.Abs else inside


def _before(operator: int, part: Formula) -> Formula:
    return Formula((operator, *part.tokens), part.constants)


def _power(base: sympy.Expr, exponent: sympy.Expr, index) -> Formula:
    """A power: whole and half ones by products and roots, another one as exp(exponent log|base|)."""
    if exponent.is_number and exponent < 0:
        return _joined(DIVIDE, [_ONE, _power(base, -exponent, index)])
    twice = 2 * exponent
    if not (twice.is_Integer and twice < 2 * MOST_FACTORS):
        return _before(EXP, _joined(MULTIPLY, [_as_tokens(exponent, index), _before(LOG, _as_tokens(base, index))]))
    rooted = base.args[0] if base.func is sympy.Abs and exponent == sympy.Rational(1, 2) else base
    part = _as_tokens(rooted, index)
    half = [_before(SQRT, part)] if twice % 2 else []
    return _joined(MULTIPLY, _factors(part, int(twice // 2)) + half)


def _factors(part: Formula, count: int) -> list[Formula]:
    """What ``count`` of them multiply to; a square where a product would have its constants twice."""
    if len(part.tokens) == 1 or count < 2:
        return [part] * count
    return [_before(SQUARE, f) for f in _factors(part, count // 2)] + [part] * (count % 2)


def _joined(operator: int, parts: Sequence[Formula]) -> Formula:
    whole = Formula((operator,) * (len(parts) - 1), ())
    for part in parts:
        whole += part
    return whole


def equation_text(
    formula: Formula,
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    shape: NarxShape | StaticShape,
    scales: Mapping[str, np.ndarray],
    whole_value: bool = False,
    own: Sequence[int] | None = None,
) -> tuple[str, str]:
    """The equations as text and as LaTeX, each with the meaning and unit of its x1, x2, ...

    whole_value : write the next value, as the formula was found, instead of the increment. own : the outputs that
    ``formula`` has expressions for; None: all.
    """
    static = isinstance(shape, StaticShape)
    own = range(len(outputs)) if own is None else own
    meanings = _static_meanings(inputs, scales) if static else _meanings(inputs, outputs, shape, scales)
    used = {t - VARIABLE for t in formula.tokens if t >= VARIABLE}
    used = sorted(used | set(own)) if whole_value else sorted(used)
    symbols = {i: sympy.Symbol(f"x{n}", real=True) for n, i in enumerate(used, 1)}
    expressions = as_expressions(formula, [symbols.get(i, sympy.Integer(0)) for i in range(shape.features)])
    text, latex = [], []
    for i, expression in zip(own, expressions, strict=True):
        rounded = _rounded(expression + symbols[i] if whole_value else expression)
        whole = static or whole_value
        scale = float(scales["output_scale" if whole else "increment_scale"][i])
        unit, fancy = _units(outputs[i])
        name, word = outputs[i].name, _latex_word(outputs[i].name)
        centre = float(scales["output_centre"][i]) if whole else 0.0
        before, own_word = (f"{centre:g}{unit} + ", f"{centre:g}{fancy} + ") if centre else ("", "")
        if not whole:
            before, own_word = f"{name}[k] + ", rf"{word}[k] + "
        at = "" if static else "[k+1]"
        text.append(f"{name}{at} = {before}{scale:g}{unit} * ({sympy.sstr(rounded)})")
        latex.append(rf"{word}{at} = {own_word}{scale:g}{fancy}\left({sympy.latex(rounded)}\right)")
    text += [f"x{n} = {meanings[i][0]}" for n, i in enumerate(used, 1)]
    latex += [f"x_{{{n}}} = {meanings[i][1]}" for n, i in enumerate(used, 1)]
    return "; ".join(text), r" \\ ".join(latex)


def _rounded(expression: sympy.Expr) -> sympy.Expr:
    def short(number):
        value = float(f"{float(number):.{DIGITS}g}")
        return sympy.Integer(int(value)) if value == int(value) and abs(value) < 1e4 else sympy.Float(value, DIGITS)

    return expression.xreplace({n: short(n) for n in expression.atoms(sympy.Float)})


def _meanings(inputs, outputs, shape: NarxShape, scales) -> list[tuple[str, str]]:
    """What every feature is, in words and in LaTeX."""
    words = []
    for i, s in enumerate(outputs):
        words.append(_scaled(s, "k", scales["output_centre"][i], scales["output_scale"][i]))
    for lag in range(1, shape.output_lags + 1):
        for i, s in enumerate(outputs):
            later = "k" if lag == 1 else f"k-{lag - 1}"
            scale, word, (unit, fancy) = float(scales["increment_scale"][i]), _latex_word(s.name), _units(s)
            words.append(
                (
                    f"({s.name}[{later}] - {s.name}[k-{lag}])/({scale:g}{unit})",
                    rf"({word}[{later}] - {word}[k-{lag}])/({scale:g}{fancy})",
                )
            )
    for lag in range(shape.input_lags):
        for i, s in enumerate(inputs):
            at = f"k-{lag}" if lag else "k"
            words.append(_scaled(s, at, scales["input_centre"][i], scales["input_scale"][i]))
    return words


def _static_meanings(inputs: Sequence[Signal], scales) -> list[tuple[str, str]]:
    return [_scaled(s, "", scales["input_centre"][i], scales["input_scale"][i]) for i, s in enumerate(inputs)]


def _scaled(signal: Signal, at: str, centre, scale) -> tuple[str, str]:
    centre, scale, (unit, fancy), at = float(centre), float(scale), _units(signal), at and f"[{at}]"
    plain, word = f"{signal.name}{at}", f"{_latex_word(signal.name)}{at}"
    if centre:
        plain, word = f"({plain} - {centre:g}{unit})", f"({word} - {centre:g}{fancy})"
    return f"{plain}/({scale:g}{unit})", f"{word}/({scale:g}{fancy})"


def _units(signal: Signal) -> tuple[str, str]:
    """The unit behind a number, in text and in LaTeX; nothing for pure numbers."""
    return ("", "") if signal.unit == "1" else (f" {signal.unit}", rf"\,\mathrm{{{_escaped(signal.unit)}}}")


def _latex_word(name: str) -> str:
    return rf"\mathrm{{{_escaped(name)}}}"


def _escaped(word: str) -> str:
    return word.replace("_", r"\_").replace("%", r"\%").replace("#", r"\#")
