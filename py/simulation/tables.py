"""A model as the driver takes it: `Model` of ``model.h``, with the tables that it points to."""

from __future__ import annotations

import ctypes
from collections.abc import Collection, Mapping, Sequence

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import FlatModel

from . import equations
from .equations import Directions

_POINTER, _INT, _INTEGER = ctypes.c_void_p, ctypes.c_int, ctypes.c_longlong


class _Sparse(ctypes.Structure):
    _fields_ = (("nonzeros", _INT), *((name, _POINTER) for name in ("first", "at", "column")))


class _Linear(ctypes.Structure):
    _fields_ = (("function", _POINTER), *((name, _Sparse) for name in "xpu"))


class _Model(ctypes.Structure):
    _fields_ = (
        *((name, _INT) for name in ("nx", "ns", "nu", "np", "ny", "nt", "ld", "nd", "nz", "cut", "implicit")),
        *((name, _INTEGER) for name in ("arguments", "results", "reals", "integers")),
        *((name, _POINTER) for name in ("nominal", "nominal_free", "free", "delay", "linear", "kept", "zero")),
        *((name, _POINTER) for name in ("dead_input", "dead_column", "slopes", "output")),
        *((name, _Linear) for name in ("rate", "seen")),
    )


class Tables:
    """One model for the driver; ``address`` is where it lies, as long as this lives.

    functions : what it consists of, by their names in `Model`; library : those compiled, see `model_source`.
    """

    def __init__(
        self,
        flat: FlatModel,
        to: Directions,
        implicit: bool,
        functions: Mapping[str, ca.Function],
        library: ctypes.CDLL,
    ):
        self._library = library
        compiled = dict(zip(functions, (_POINTER * len(functions)).in_dll(library, "hydrotwin_functions"), strict=True))
        kept = list(range(len(flat.states))) if implicit else equations.states_with_rows(flat, to)
        row = {i: position for position, i in enumerate(kept)}
        rows = {"rate": row, "seen": {i: i for i in range(len(flat.outputs))}}
        self._arrays: list[np.ndarray] = []
        self._model = _Model(
            **_sizes(flat, to, kept, implicit),
            **_room(functions.values()),
            **{name: self._address(values, float) for name, values in _nominals(flat, to).items()},
            **{name: self._address(values, np.intc) for name, values in _tables(flat, to, kept).items()},
            **{name: compiled[name] for name in ("slopes", "output") if name in compiled},
            **{n: self._linear(functions[n], compiled[n], rows[n], row) for n in rows if n in compiled},
        )
        self.address = ctypes.addressof(self._model)

    def _address(self, values: Sequence, kind) -> int:
        self._arrays.append(np.array([*values, 0], dtype=kind))  # none is empty
        return self._arrays[-1].ctypes.data

    def _linear(self, function: ca.Function, at: int, row: Mapping[int, int], seed: Mapping[int, int]) -> _Linear:
        """A function and its derivatives to states, free values and dead times.

        ``row`` and ``seed`` are where the rows of the matrices and of the seeds are kept; others are left out.
        """
        found = [self._sparse(function.sparsity_out(which), row, seed if which == 1 else None) for which in (1, 2, 3)]
        return _Linear(at, *found)

    def _sparse(self, matrix: ca.Sparsity, row: Mapping[int, int], column: Mapping[int, int] | None) -> _Sparse:
        entries = enumerate(zip(*matrix.get_triplet(), strict=True))
        by_row = sorted((row[i], e, j if column is None else column[j]) for e, (i, j) in entries if i in row)
        first = np.searchsorted([i for i, _, _ in by_row], range(len(row) + 1))
        lists = first, [e for _, e, _ in by_row], [j for _, _, j in by_row]
        return _Sparse(matrix.nnz(), *(self._address(values, np.intc) for values in lists))


def _sizes(flat: FlatModel, to: Directions, kept: Sequence[int], implicit: bool) -> dict[str, int]:
    return {
        "nx": len(flat.states),
        "ns": len(kept),
        "nu": len(flat.inputs),
        "np": len(flat.parameters),
        "ny": len(flat.outputs),
        "nt": to.count,
        "ld": -(-to.count // 2) * 2,
        "nd": len(to.dead),
        "nz": len(to.zero),
        "cut": int(any(s.dead_time and (s.held or implicit) for s in flat.inputs)),
        "implicit": int(implicit),
    }


def _room(functions: Collection[ca.Function]) -> dict[str, int]:
    """What the functions need."""
    return {
        "arguments": max(f.sz_arg() for f in functions),
        "results": max(f.sz_res() for f in functions),
        "reals": max(f.sz_w() for f in functions),
        "integers": max(f.sz_iw() for f in functions),
    }


def _nominals(flat: FlatModel, to: Directions) -> dict[str, list[float]]:
    free = *(flat.parameters[i] for i in to.parameters), *(flat.states[i] for i in to.states)
    return {"nominal": [s.nominal for s in flat.states], "nominal_free": [one.nominal for one in free]}


def _tables(flat: FlatModel, to: Directions, kept: Sequence[int]) -> dict[str, Sequence[int]]:
    return {
        "free": [*to.parameters, *(-1 for _ in to.states)],
        "delay": [-1 if d is None else d for d in equations.delays(flat)],
        "linear": [not s.held for s in flat.inputs],
        "kept": kept,
        "zero": to.zero,
        "dead_input": [j for j, _ in to.dead],
        "dead_column": [column for _, column in to.dead],
    }
