"""A step walked along recordings in CasADi: where few runs stand side by side, the interpreter costs more than they.

A step is a `casadi.Function` (x, w, c) -> (x one sample later, what is seen now): states x, what is known at a sample
w, constants c. Formulas are always walked; networks and processes where few runs stand side by side.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

NARROW = 8  # runs of a network side by side: beyond these, one step of NumPy over all of them is quicker


class Walk:
    """Steps in a row."""

    def __init__(self, step: ca.Function):
        self.step, self._made = step, {}

    def __call__(self, start: np.ndarray, known: np.ndarray, constants: np.ndarray) -> np.ndarray:
        """What is seen (s, n, ns) from starts (s, nx) along what is known (s, n, nw) with constants (nc,)."""
        count, length, _ = known.shape
        if (count, length) not in self._made:
            self._made[count, length] = self.step.mapaccum("walk", length, 1).map(count)
        given = (start, known, np.tile(constants, count * length))
        return _called(self._made[count, length], given, 1).reshape(count, length, -1)


def _called(function: ca.Function, arguments: Sequence[np.ndarray], result: int) -> np.ndarray:
    """One dense result as a flat array, by columns; arguments by columns. Nothing is copied through lists."""
    held = [np.ascontiguousarray(a, dtype=float) for a in arguments]
    answer = np.empty(function.numel_out(result))
    buffer, call = function.buffer()
    for k, a in enumerate(held):
        if a.size:
            buffer.set_arg(k, memoryview(a))
    buffer.set_res(result, memoryview(answer))
    call()
    return answer
