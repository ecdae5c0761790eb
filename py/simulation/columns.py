"""Values of a function of scalars for many columns of its arguments at once, by NumPy.

CasADi evaluates a column at a time, and what it does around each costs more than a hundred operations. Here every
operation is one of NumPy's for all columns. Parameters that are the same for all are numbers: what follows of them
alone is worked out once.
"""

from __future__ import annotations

from collections.abc import Callable

import casadi as ca
import numpy as np


def _truth(compare: Callable) -> Callable:
    return lambda *a: np.asarray(compare(*a), dtype=float)


OPERATIONS: dict[int, Callable] = {
    ca.OP_ASSIGN: lambda a: a,
    ca.OP_ADD: np.add,
    ca.OP_SUB: np.subtract,
    ca.OP_MUL: np.multiply,
    ca.OP_DIV: np.divide,
    ca.OP_NEG: np.negative,
    ca.OP_INV: lambda a: 1.0 / a,
    ca.OP_SQ: np.square,
    ca.OP_TWICE: lambda a: a + a,
    ca.OP_POW: np.power,
    ca.OP_CONSTPOW: np.power,
    ca.OP_SQRT: np.sqrt,
    ca.OP_EXP: np.exp,
    ca.OP_LOG: np.log,
    ca.OP_SIN: np.sin,
    ca.OP_COS: np.cos,
    ca.OP_TAN: np.tan,
    ca.OP_ASIN: np.arcsin,
    ca.OP_ACOS: np.arccos,
    ca.OP_ATAN: np.arctan,
    ca.OP_ATAN2: np.arctan2,
    ca.OP_SINH: np.sinh,
    ca.OP_COSH: np.cosh,
    ca.OP_TANH: np.tanh,
    ca.OP_FABS: np.abs,
    ca.OP_SIGN: np.sign,
    ca.OP_FLOOR: np.floor,
    ca.OP_CEIL: np.ceil,
    ca.OP_FMOD: np.fmod,
    ca.OP_FMIN: np.fmin,
    ca.OP_FMAX: np.fmax,
    ca.OP_LT: _truth(np.less),
    ca.OP_LE: _truth(np.less_equal),
    ca.OP_EQ: _truth(np.equal),
    ca.OP_NE: _truth(np.not_equal),
    ca.OP_NOT: _truth(np.logical_not),
    ca.OP_AND: _truth(np.logical_and),
    ca.OP_OR: _truth(np.logical_or),
    ca.OP_IF_ELSE_ZERO: lambda a, b: np.where(a != 0, b, 0.0),
}


def by_columns(function: ca.Function) -> Callable[..., list[np.ndarray]]:
    """``(*arguments) -> values (rows, n)`` of a function: arguments (rows, n), or (rows,) the same for all columns.

    One that NumPy has no operation for, or that is no function of scalars, is evaluated by CasADi.
    """
    if not function.is_a("SXFunction"):
        return lambda *arguments: _by_casadi(function, arguments)
    steps = range(function.n_instructions())
    program = [(function.instruction_id(k), function.instruction_input(k), function.instruction_output(k))
               for k in steps]  # fmt: skip
    constants = [function.instruction_constant(k) if op == ca.OP_CONST else 0.0 for k, (op, *_) in enumerate(program)]
    known = {*OPERATIONS, ca.OP_CONST, ca.OP_INPUT, ca.OP_OUTPUT}
    shapes = [(function.size1_out(i), function.sparsity_out(i).row()) for i in range(function.n_out())]
    dense = all(function.sparsity_in(i).is_dense() for i in range(function.n_in()))
    columns = all(function.size2_out(i) == 1 for i in range(function.n_out()))
    if not (dense and columns and all(op in known for op, *_ in program)):
        return lambda *arguments: _by_casadi(function, arguments)

    def evaluate(*arguments) -> list[np.ndarray]:
        n = max((a.shape[1] for a in arguments if np.ndim(a) == 2), default=1)
        found = [np.zeros((rows, n)) for rows, _ in shapes]
        work = [0.0] * function.sz_w()
        with np.errstate(all="ignore"):
            for (op, read, written), constant in zip(program, constants, strict=True):
                if op == ca.OP_CONST:
                    work[written[0]] = constant
                elif op == ca.OP_INPUT:
                    work[written[0]] = arguments[read[0]][read[1]]
                elif op == ca.OP_OUTPUT:
                    found[written[0]][shapes[written[0]][1][written[1]]] = work[read[0]]
                else:
                    work[written[0]] = OPERATIONS[op](*(work[i] for i in read))
        return found

    return evaluate


def _by_casadi(function: ca.Function, arguments) -> list[np.ndarray]:
    return [value.full() for value in function.call([ca.DM(np.asarray(a)) for a in arguments])]
