"""A function of scalar operations as numbers, and back: how a model that was written in Python goes into a file.

Every row is one operation: its code, the place of its answer, the places of its arguments, and the constant where it is
one. Reading rebuilds the expression from a list of known operations, so that nothing in a file is ever executed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from operator import add, eq, le, lt, mul, ne, neg, sub, truediv

import casadi as ca
import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError

COLUMNS = 4  # operation, answer, two arguments
OPERATIONS: Mapping[int, Callable] = {
    ca.OP_ASSIGN: lambda a: a, ca.OP_ADD: add, ca.OP_SUB: sub, ca.OP_MUL: mul, ca.OP_DIV: truediv, ca.OP_NEG: neg,
    ca.OP_EXP: ca.exp, ca.OP_LOG: ca.log, ca.OP_POW: lambda a, b: a**b, ca.OP_CONSTPOW: lambda a, b: a**b,
    ca.OP_SQRT: ca.sqrt, ca.OP_SQ: lambda a: a * a, ca.OP_TWICE: lambda a: a + a, ca.OP_INV: lambda a: 1 / a,
    ca.OP_SIN: ca.sin, ca.OP_COS: ca.cos, ca.OP_TAN: ca.tan, ca.OP_ASIN: ca.asin, ca.OP_ACOS: ca.acos,
    ca.OP_ATAN: ca.atan, ca.OP_ATAN2: ca.atan2, ca.OP_SINH: ca.sinh, ca.OP_COSH: ca.cosh, ca.OP_TANH: ca.tanh,
    ca.OP_ASINH: ca.asinh, ca.OP_ACOSH: ca.acosh, ca.OP_ATANH: ca.atanh, ca.OP_LT: lt, ca.OP_LE: le, ca.OP_EQ: eq,
    ca.OP_NE: ne, ca.OP_NOT: ca.logic_not, ca.OP_AND: ca.logic_and, ca.OP_OR: ca.logic_or, ca.OP_FLOOR: ca.floor,
    ca.OP_CEIL: ca.ceil, ca.OP_FMOD: ca.fmod, ca.OP_FABS: ca.fabs, ca.OP_SIGN: ca.sign, ca.OP_COPYSIGN: ca.copysign,
    ca.OP_FMIN: ca.fmin, ca.OP_FMAX: ca.fmax, ca.OP_ERF: ca.erf, ca.OP_LOG1P: ca.log1p, ca.OP_EXPM1: ca.expm1,
    ca.OP_HYPOT: ca.hypot, ca.OP_IF_ELSE_ZERO: lambda a, b: ca.if_else(a, b, 0), ca.OP_REMAINDER: ca.remainder,
}  # fmt: skip

UNARY = {  # operations of one argument
    ca.OP_ASSIGN, ca.OP_NEG, ca.OP_EXP, ca.OP_LOG, ca.OP_SQRT, ca.OP_SQ, ca.OP_TWICE, ca.OP_INV, ca.OP_SIN, ca.OP_COS,
    ca.OP_TAN, ca.OP_ASIN, ca.OP_ACOS, ca.OP_ATAN, ca.OP_SINH, ca.OP_COSH, ca.OP_TANH, ca.OP_ASINH, ca.OP_ACOSH,
    ca.OP_ATANH, ca.OP_NOT, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_FABS, ca.OP_SIGN, ca.OP_ERF, ca.OP_LOG1P, ca.OP_EXPM1,
}  # fmt: skip


def written(function: ca.Function) -> dict[str, np.ndarray]:
    """``rows`` (n, 4) and ``constants`` (n,) of a function.

    Raises DeclarationError for an operation that is none of scalars.
    """
    symbols = [ca.SX.sym(function.name_in(i), function.size1_in(i)) for i in range(function.n_in())]
    dense = [ca.densify(part) for part in function.call(symbols)]
    function = ca.Function(function.name(), symbols, dense)
    count = function.n_instructions()
    rows, constants = np.zeros((count, COLUMNS), dtype=np.int64), np.zeros(count)
    for k in range(len(rows)):
        code, given, answer = (getattr(function, f"instruction_{what}")(k) for what in ("id", "input", "output"))
        if code == ca.OP_CONST:
            constants[k] = function.instruction_constant(k)
        elif code not in (ca.OP_INPUT, ca.OP_OUTPUT, *OPERATIONS):
            raise DeclarationError(
                f"{function.name()}: operation {code} has no place in a file. Write that part of the model with "
                "arithmetic and the functions of CasADi on scalars."
            )
        at = answer if code == ca.OP_OUTPUT else answer[:1]
        values = [code, *at[:1], *(given if code != ca.OP_OUTPUT else (at[1], given[0]))]
        rows[k, : len(values)] = values
    return {"rows": rows, "constants": constants}


def rebuilt(
    name: str,
    tape: Mapping[str, np.ndarray],
    sizes: Sequence[Sequence[int]],
    names: Sequence[Sequence[str]],
    where: str,
) -> ca.Function:
    """The function of a tape; sizes and names : of its inputs and of its outputs.

    Raises DataError where the tape is not one.
    """
    inputs = [ca.SX.sym(n, size) for n, size in zip(names[0], sizes[0], strict=True)]
    outputs = [[ca.SX(0)] * size for size in sizes[1]]
    places: dict[int, ca.SX] = {}
    try:
        rows, constants = np.asarray(tape["rows"]), np.asarray(tape["constants"], dtype=float)
        for (code, at, *given), constant in zip(rows.tolist(), constants.tolist(), strict=True):
            if code == ca.OP_CONST:
                places[at] = ca.SX(constant)
            elif code == ca.OP_INPUT:
                places[at] = inputs[given[0]][given[1]]
            elif code == ca.OP_OUTPUT:
                outputs[at][given[0]] = places[given[1]]
            else:
                places[at] = OPERATIONS[code](*(places[k] for k in (given[:1] if code in UNARY else given)))
    except (KeyError, IndexError, TypeError, ValueError, RuntimeError) as error:
        raise DataError(f"{where}: not the equations of a model ({error!r}). Copy the file again.") from None
    return ca.Function(name, inputs, [ca.vertcat(*o) for o in outputs], *(list(n) for n in names))
