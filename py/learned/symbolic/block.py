"""A learned formula as a Block: increments of the outputs as one expression each; no training library needed.

    z[k]   = (y[k], d[k-1] ... d[k-n], u[k] ... u[k-m+1])          over readable scales that carry the units
    d[k]   = clip(f(z[k]))                                         increments, per period
    y[k+1] = clip(y[k] + d[k])

The file holds f as data: a list of tokens in prefix order (the operator before its operands), one formula per output
after the other, and the constants in the order in which they appear. Every token is checked when the file is opened;
nothing in it is ever executed as text. The clips lie outside everything seen in training: a free run stays bounded.

Every function is defined for every number: log and sqrt are those of the absolute value, and `TINY` and `LARGEST` keep
a quotient, a logarithm, a root and an exponential finite, with their derivatives.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DataError

from ..block_file import LearnedKind, Shapes, register_kind
from ..network.narx import NarxShape, narx_functions, scale_shapes

ADD, SUBTRACT, MULTIPLY, COSINE, SINE, TANH, CONSTANT, DIVIDE, EXP, LOG, SQRT, SQUARE, ABSOLUTE = range(13)
VARIABLE = 100  # VARIABLE + i is feature i
ARITY = dict.fromkeys((ADD, SUBTRACT, MULTIPLY, DIVIDE), 2) | {CONSTANT: 0}
ARITY |= dict.fromkeys((COSINE, SINE, TANH, EXP, LOG, SQRT, SQUARE, ABSOLUTE), 1)
MOST_TOKENS = 10_000
TINY = 1e-24  # stands for a divisor of zero, and is the least of what a logarithm or a root is taken of
LARGEST = 60.0  # argument of an exponential: 1e26, far outside every bound


@dataclass(frozen=True)
class Formula:
    """One or several expressions in prefix order; ``constants`` in the order in which CONSTANT appears."""

    tokens: tuple[int, ...]
    constants: tuple[float, ...]

    def __add__(self, other: Formula) -> Formula:
        return Formula(self.tokens + other.tokens, self.constants + other.constants)


def evaluate(tokens: Sequence[int], constants, features, *, library=np, where: str = "formula") -> list:
    """The values of the expressions in ``tokens``, in their order; numbers, arrays or CasADi symbols alike.

    constants, features : sequences to pick from. library : the module with the functions for them, NumPy or CasADi;
    SymPy gets them plain, without `TINY` and `LARGEST`.

    Raises `DataError` for a token that is none, a missing operand, a feature or a constant that does not exist.

    >>> evaluate((ADD, VARIABLE, MULTIPLY, CONSTANT, VARIABLE + 1), [0.5], [1.0, 4.0])
    [3.0]
    """
    functions = _functions(library)
    stack, unused = [], len(constants)
    for position in reversed(range(len(tokens))):
        token = tokens[position]
        if token >= VARIABLE:
            stack.append(_picked(features, token - VARIABLE, "feature", position, where))
        elif token == CONSTANT:
            unused -= 1
            stack.append(_picked(constants, unused, "constant", position, where))
        elif token not in ARITY:
            raise DataError(f"{where}: token {position} is none (got {token!r}). Write the block again.")
        elif len(stack) < ARITY[token]:
            raise DataError(f"{where}: token {position} lacks an operand (got code {token}). Write the block again.")
        elif token in functions:
            stack.append(functions[token](stack.pop()))
        else:
            a, b = stack.pop(), stack.pop()
            stack.append(_combined(token, a, b, library))
    if unused:
        raise DataError(f"{where}: {unused} constants are never used. Write the block again.")
    return stack[::-1]


def _functions(library) -> dict:
    """The functions of one argument by token."""
    least = (lambda a: library.fmax(abs(a), TINY)) if _numeric(library) else abs
    most = (lambda a: library.fmin(a, LARGEST)) if _numeric(library) else (lambda a: a)
    return {
        COSINE: library.cos,
        SINE: library.sin,
        TANH: library.tanh,
        EXP: lambda a: library.exp(most(a)),
        LOG: lambda a: library.log(least(a)),
        SQRT: lambda a: library.sqrt(least(a)),
        SQUARE: lambda a: a * a,
        ABSOLUTE: abs,
    }


def _combined(token: int, a, b, library):
    if token == DIVIDE:
        return a / (b + TINY * (b == 0) if _numeric(library) else b)
    return a + b if token == ADD else a - b if token == SUBTRACT else a * b


def _numeric(library) -> bool:
    return hasattr(library, "fmax")


def formula_shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    """Arrays of a formula block: its tokens and constants, the scales and the bounds of a free run."""
    shape = formula_shape(structure, inputs, outputs)
    if min(shape.output_lags, shape.input_lags - 1) < 0:
        raise TypeError("no counts of lags")
    return token_shapes(structure) | scale_shapes(inputs, outputs)


def token_shapes(structure: Mapping[str, int]) -> Shapes:
    """The arrays of the formula itself; raises `TypeError` for counts that are none."""
    tokens, constants = structure.get("tokens"), structure.get("constants")
    if not (isinstance(tokens, int) and isinstance(constants, int) and 0 <= constants <= tokens <= MOST_TOKENS):
        raise TypeError("no counts of tokens and constants")
    return {"tokens": (tokens,), "constants": (constants,)}


def formula_shape(structure: Mapping[str, int], inputs: int, outputs: int) -> NarxShape:
    """The lags of a formula block, as those of a network without hidden units."""
    lags = {key: value for key, value in structure.items() if key not in ("tokens", "constants")}
    return NarxShape(inputs, outputs, hidden=0, **lags)


def formula_functions(
    arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]
) -> tuple[ca.Function, ca.Function]:
    """The CasADi ``step`` and ``start`` of a formula."""
    shape = formula_shape(structure, len(arrays["input_scale"]), len(arrays["output_scale"]))
    tokens, constants = whole_tokens(arrays["tokens"]), arrays["constants"].tolist()

    return narx_functions(shape, arrays, lambda z: expressions(tokens, constants, z, shape.outputs))


def expressions(tokens: Sequence[int], constants: Sequence[float], z: ca.SX, outputs: int) -> ca.SX:
    """The values (outputs,) of the tokens of a block for its features z; raises `DataError` for another number."""
    f = evaluate(tokens, constants, ca.vertsplit(z), library=ca)
    if len(f) != outputs:
        raise DataError(f"formula: {len(f)} expressions for {outputs} outputs. Write the block again.")
    return ca.vertcat(*f)


def whole_tokens(values: np.ndarray) -> tuple[int, ...]:
    """The tokens of an array of a file; raises `DataError` for one that is none."""
    broken = np.flatnonzero((values != np.round(values)) | (values < 0) | (values > VARIABLE + MOST_TOKENS))
    if len(broken):
        raise DataError(f"formula: token {broken[0]} is none (got {values[broken[0]]:g}). Write the block again.")
    return tuple(int(v) for v in values)


def _picked(values, index: int, what: str, position: int, where: str):
    if not 0 <= index < len(values):
        raise DataError(
            f"{where}: token {position} asks for {what} {index} (there are {len(values)}). Write the block again."
        )
    return values[index]


SYMBOLIC = register_kind(LearnedKind("symbolic", 1, formula_shapes, formula_functions))
