"""Formulas in words: simplified by SymPy, printed as text and LaTeX, with the units that the scales carry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import sympy

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal

from ..network.narx import NarxShape
from .block import ADD, CONSTANT, COSINE, MULTIPLY, SINE, TANH, VARIABLE, Formula, evaluate

DIGITS = 4  # of a printed constant
_FUNCTIONS = {sympy.cos: COSINE, sympy.sin: SINE, sympy.tanh: TANH}


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
    if expression.is_number:
        return Formula((CONSTANT,), (float(expression),))
    parts = [_as_tokens(a, index) for a in expression.args]
    if expression.func in _FUNCTIONS:
        return Formula((_FUNCTIONS[expression.func], *parts[0].tokens), parts[0].constants)
    if expression.is_Pow and expression.exp.is_Integer and expression.exp > 1:
        return _joined(MULTIPLY, [parts[0]] * int(expression.exp))
    if expression.is_Add or expression.is_Mul:
        return _joined(ADD if expression.is_Add else MULTIPLY, parts)
    raise DataError(f"formula: cannot write {expression.func.__name__} as tokens. Report the formula: {expression}.")


def _joined(operator: int, parts: Sequence[Formula]) -> Formula:
    whole = Formula((operator,) * (len(parts) - 1), ())
    for part in parts:
        whole += part
    return whole


def equation_text(
    formula: Formula,
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    shape: NarxShape,
    scales: Mapping[str, np.ndarray],
    whole_value: bool = False,
) -> tuple[str, str]:
    """The equations as text and as LaTeX, each with the meaning and unit of its x1, x2, ...

    whole_value : write the next value, as the formula was found, instead of the increment.
    """
    meanings = _meanings(inputs, outputs, shape, scales)
    used = {t - VARIABLE for t in formula.tokens if t >= VARIABLE}
    used = sorted(used | set(range(len(outputs)))) if whole_value else sorted(used)
    symbols = {i: sympy.Symbol(f"x{n}", real=True) for n, i in enumerate(used, 1)}
    expressions = as_expressions(formula, [symbols.get(i, sympy.Integer(0)) for i in range(shape.features)])
    text, latex = [], []
    for i, (output, expression) in enumerate(zip(outputs, expressions, strict=True)):
        part = "output" if whole_value else "increment"
        if whole_value:
            expression = expression + symbols[i]
        rounded = _rounded(expression)
        scale, centre = float(scales[f"{part}_scale"][i]), float(scales["output_centre"][i]) if whole_value else 0.0
        unit, fancy = _units(output)
        shift = f"{centre:g}{unit} + " if centre else ""
        before = "" if whole_value else f"{output.name}[k] + "
        text.append(f"{output.name}[k+1] = {before}{shift}{scale:g}{unit} * ({sympy.sstr(rounded)})")
        word = _latex_word(output.name)
        own = "" if whole_value else rf"{word}[k] + "
        own += f"{centre:g}{fancy} + " if centre else ""
        latex.append(rf"{word}[k+1] = {own}{scale:g}{fancy}\left({sympy.latex(rounded)}\right)")
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


def _scaled(signal: Signal, at: str, centre, scale) -> tuple[str, str]:
    centre, scale, (unit, fancy) = float(centre), float(scale), _units(signal)
    plain, word = f"{signal.name}[{at}]", f"{_latex_word(signal.name)}[{at}]"
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
