"""Where an expression jumps: its slope is zero on both sides, and no derivative tells that it depends on anything."""

from __future__ import annotations

import casadi as ca

_JUMP = {ca.OP_SIGN, ca.OP_FLOOR, ca.OP_CEIL, ca.OP_LT, ca.OP_LE, ca.OP_EQ, ca.OP_NE, ca.OP_NOT, ca.OP_AND, ca.OP_OR}
_JUMP |= {ca.OP_FMOD, ca.OP_REMAINDER}
_JUMP_BY = {ca.OP_IF_ELSE_ZERO: 0, ca.OP_COPYSIGN: 1}  # which argument makes it jump


def jumps(expression: ca.SX, symbols: ca.SX) -> bool:
    """Whether a sign, a comparison, a rounding or a case distinction in ``expression`` depends on ``symbols``."""
    sought = {s.element_hash() for s in ca.vertsplit(ca.SX(symbols))}
    given = [s for s in ca.symvar(expression) if s.element_hash() not in sought]
    f = ca.Function("sides", [symbols, ca.vertcat(ca.SX(0, 1), *given)], [expression], {"allow_free": True})
    moves: dict[int, bool] = {}  # place in the work vector -> whether what stands there depends on the symbols
    for k in range(f.n_instructions()):
        op, read, written = f.instruction_id(k), f.instruction_input(k), f.instruction_output(k)
        if op == ca.OP_OUTPUT:
            continue
        if op in (ca.OP_INPUT, ca.OP_CONST, ca.OP_PARAMETER):
            moves[written[0]] = op == ca.OP_INPUT and read[0] == 0
            continue
        arguments = [moves.get(i, False) for i in read]
        if (op in _JUMP and any(arguments)) or (op in _JUMP_BY and arguments[_JUMP_BY[op]]):
            return True
        for place in written:
            moves[place] = any(arguments)
    return False
