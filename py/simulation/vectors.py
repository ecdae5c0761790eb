"""CasADi functions as C in which every number is a vector, one lane for each run; see ``vectors.c``."""

from __future__ import annotations

import math

import casadi as ca

_ONE = (
    *("SQRT", "FLOOR", "CEIL", "FABS", "SIGN", "EXP", "LOG", "LOG1P", "EXPM1", "ERF"),
    *("SIN", "COS", "TAN", "ASIN", "ACOS", "ATAN", "SINH", "COSH", "TANH", "ASINH", "ACOSH", "ATANH"),
)
_TWO = ("POW", "ATAN2", "HYPOT", "FMOD", "REMAINDER", "COPYSIGN", "FMIN", "FMAX")
_AS_C = {
    ca.OP_ASSIGN: "{0}",
    ca.OP_ADD: "{0} + {1}",
    ca.OP_SUB: "{0} - {1}",
    ca.OP_MUL: "{0} * {1}",
    ca.OP_DIV: "{0} / {1}",
    ca.OP_NEG: "-{0}",
    ca.OP_SQ: "{0} * {0}",
    ca.OP_TWICE: "{0} + {0}",
    ca.OP_INV: "1.0 / {0}",
    ca.OP_CONSTPOW: "vector_pow({0}, {1})",
    ca.OP_LT: "where_set({0} < {1}, spread(1))",
    ca.OP_LE: "where_set({0} <= {1}, spread(1))",
    ca.OP_EQ: "where_set({0} == {1}, spread(1))",
    ca.OP_NE: "where_set({0} != {1}, spread(1))",
    ca.OP_NOT: "where_set({0} == 0.0, spread(1))",
    ca.OP_AND: "where_set(({0} != 0.0) & ({1} != 0.0), spread(1))",
    ca.OP_OR: "where_set(({0} != 0.0) | ({1} != 0.0), spread(1))",
    ca.OP_IF_ELSE_ZERO: "where_set({0} != 0.0, {1})",
    **{getattr(ca, f"OP_{name}"): f"vector_{name.lower()}({{0}})" for name in _ONE},
    **{getattr(ca, f"OP_{name}"): f"vector_{name.lower()}({{0}}, {{1}})" for name in _TWO},
}


def vector_text(function: ca.Function, name: str) -> str | None:
    """The C function ``name`` that takes and gives arrays of `Lanes`; None where a step of it has no vector form.

    Every step stands there twice, once for each half of the lanes.
    """
    lines, kept = [], set()
    for k in range(function.n_instructions()):
        made, line = _step(function, k)
        if line is None:
            return None
        kept.update(made)
        lines += [line.replace("~", half) for half in "01"]
    arguments = [f"const Lanes *in{i}" for i in range(function.n_in())]
    arguments += [f"Lanes *to{i}" for i in range(function.n_out())]
    declared = [f"Vector a{i}_0, a{i}_1;" for i in sorted(kept)]
    return "\n".join((f"static void {name}({', '.join(arguments)}) {{", *declared, *lines, "}"))


def _step(function: ca.Function, k: int) -> tuple[list[int], str | None]:
    """What instruction k makes and the line that does, ~ for the half; None when it has no vector form."""
    op, given, made = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
    if op == ca.OP_OUTPUT:
        return [], f"to{made[0]}[{made[1]}].half[~] = a{given[0]}_~;"
    if op == ca.OP_INPUT:
        value = f"in{given[0]}[{given[1]}].half[~]"
    elif op == ca.OP_CONST:
        value = f"spread({_number(function.instruction_constant(k))})"
    elif op in _AS_C:
        value = _AS_C[op].format(*(f"a{i}_~" for i in given))
    else:
        return [], None
    return made, f"a{made[0]}_~ = {value};"


def _number(value: float) -> str:
    if math.isfinite(value):
        return repr(float(value))
    return "NAN" if math.isnan(value) else f"{'-' if value < 0 else ''}INFINITY"
