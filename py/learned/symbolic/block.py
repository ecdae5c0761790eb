"""A learned formula as a Block: increments of the outputs as one expression each; no training library needed.

    z[k]   = (y[k], d[k-1] ... d[k-n], u[k] ... u[k-m+1])          over readable scales that carry the units
    d[k]   = clip(f(z[k]))                                         increments, per period
    y[k+1] = clip(y[k] + d[k])

The file holds f as data: a list of tokens in prefix order (the operator before its operands), one formula per output
after the other, and the constants in the order in which they appear. Every token is checked when the file is opened;
nothing in it is ever executed as text. The clips lie outside everything seen in training: a free run stays bounded.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DataError

from ..block_file import LearnedKind, Shapes, register_kind
from ..network.narx import NarxShape

ADD, SUBTRACT, MULTIPLY, COSINE, SINE, TANH, CONSTANT = range(7)
VARIABLE = 100  # VARIABLE + i is feature i
ARITY = {ADD: 2, SUBTRACT: 2, MULTIPLY: 2, COSINE: 1, SINE: 1, TANH: 1, CONSTANT: 0}
MOST_TOKENS = 10_000


@dataclass(frozen=True)
class Formula:
    """One or several expressions in prefix order; ``constants`` in the order in which CONSTANT appears."""

    tokens: tuple[int, ...]
    constants: tuple[float, ...]

    def __add__(self, other: Formula) -> Formula:
        return Formula(self.tokens + other.tokens, self.constants + other.constants)


def evaluate(tokens: Sequence[int], constants, features, *, library=np, where: str = "formula") -> list:
    """The values of the expressions in ``tokens``, in their order; numbers, arrays or CasADi symbols alike.

    constants, features : sequences to pick from; library : what has ``cos``, ``sin`` and ``tanh`` for them.

    Raises `DataError` for a token that is none, a missing operand, a feature or a constant that does not exist.

    >>> evaluate((ADD, VARIABLE, MULTIPLY, CONSTANT, VARIABLE + 1), [0.5], [1.0, 4.0])
    [3.0]
    """
    functions = {COSINE: library.cos, SINE: library.sin, TANH: library.tanh}
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
            stack.append(a + b if token == ADD else a - b if token == SUBTRACT else a * b)
    if unused:
        raise DataError(f"{where}: {unused} constants are never used. Write the block again.")
    return stack[::-1]


def formula_shapes(structure: Mapping[str, int], inputs: int, outputs: int) -> Shapes:
    """Arrays of a formula block: its tokens and constants, the scales and the bounds of a free run."""
    counts = dict(structure)
    tokens, constants = counts.pop("tokens", None), counts.pop("constants", None)
    if not (isinstance(tokens, int) and isinstance(constants, int) and 0 <= constants <= tokens <= MOST_TOKENS):
        raise TypeError("no counts of tokens and constants")
    shape = formula_shape(structure, inputs, outputs)
    if min(shape.output_lags, shape.input_lags - 1) < 0:
        raise TypeError("no counts of lags")
    return (
        {"tokens": (tokens,), "constants": (constants,)}
        | {
            f"{part}_{what}": (size,)
            for part, size in (("input", inputs), ("output", outputs))
            for what in ("centre", "scale")
        }
        | {name: (outputs,) for name in ("increment_scale", "increment_limit", "output_lower", "output_upper")}
    )


def formula_shape(structure: Mapping[str, int], inputs: int, outputs: int) -> NarxShape:
    """The lags of a formula block, as those of a network without hidden units."""
    lags = {key: value for key, value in structure.items() if key not in ("tokens", "constants")}
    return NarxShape(inputs, outputs, hidden=0, **lags)


def formula_functions(
    arrays: Mapping[str, np.ndarray], structure: Mapping[str, int]
) -> tuple[ca.Function, ca.Function]:
    """The CasADi ``step`` and ``start`` of a formula; scales in SI, ``increment_limit`` in increment scales."""
    nu, ny = len(arrays["input_scale"]), len(arrays["output_scale"])
    shape = formula_shape(structure, nu, ny)
    tokens = _whole_tokens(arrays["tokens"])
    a = {name: ca.DM(value) for name, value in arrays.items()}
    x = ca.SX.sym("x", shape.fed_back + nu * (shape.input_lags - 1))
    u, p = ca.SX.sym("u", nu), ca.SX.sym("p", 0)
    y, increments, past_u = ca.vertsplit(x, [0, ny, shape.fed_back, x.numel()])
    u_line = ca.vertcat(u, past_u)
    z = ca.vertcat(
        (y - a["output_centre"]) / a["output_scale"],
        increments / ca.repmat(a["increment_scale"], shape.output_lags, 1),
        (u_line - ca.repmat(a["input_centre"], shape.input_lags, 1)) / ca.repmat(a["input_scale"], shape.input_lags, 1),
    )
    f = evaluate(tokens, arrays["constants"].tolist(), ca.vertsplit(z), library=ca)
    if len(f) != ny:
        raise DataError(f"formula: {len(f)} expressions for {ny} outputs. Write the block again.")
    d = ca.fmin(ca.fmax(ca.vertcat(*f), -a["increment_limit"]), a["increment_limit"]) * a["increment_scale"]
    y_next = ca.fmin(ca.fmax(y + d, a["output_lower"]), a["output_upper"])
    delayed = ca.vertcat(d, increments)[: shape.fed_back - ny, :], u_line[: nu * (shape.input_lags - 1), :]
    x_next = ca.vertcat(y_next, *delayed)
    step = ca.Function("step", [x, u, p], [ca.densify(x_next), y], ["x", "u", "p"], ["x_next", "y"])
    y_first = ca.SX.sym("y", ny)
    at_rest = ca.vertcat(y_first, ca.SX.zeros(shape.fed_back - ny), ca.repmat(u, shape.input_lags - 1, 1))
    start = ca.Function("start", [u, y_first, p], [ca.densify(at_rest)], ["u", "y", "p"], ["x"])
    return step, start


def _whole_tokens(values: np.ndarray) -> tuple[int, ...]:
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
