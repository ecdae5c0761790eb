"""The compiled driver of one model, called through ctypes: the GIL is released while it runs."""

from __future__ import annotations

import ctypes
from pathlib import Path

import numpy as np

_ARRAY, _COUNT = ctypes.c_void_p, ctypes.c_longlong


class _Control(ctypes.Structure):
    """`Control` as the driver takes it."""

    _fields_ = tuple((name, ctypes.c_double) for name in ("step", "tolerance", "trials"))


class Library:
    """The runs of one shared library; safe to call from several threads."""

    def __init__(self, path: Path, outputs: int):
        self._outputs = outputs
        loaded = ctypes.CDLL(str(path))
        self._propagate = loaded.propagate
        self._propagate.argtypes = [_COUNT, *[_ARRAY] * 3, _Control, *[_ARRAY] * 5]
        self._tangent = getattr(loaded, "propagate_tangent", None)
        if self._tangent is not None:
            self._tangent.argtypes = [_COUNT, *[_ARRAY] * 3, _Control, *[_ARRAY] * 7]
            self._expansions = loaded.propagate_expansions
            self._expansions.argtypes = [_COUNT, *[_ARRAY] * 4, _Control, *[_ARRAY] * 7]
        self._costs = loaded.propagate_costs
        self._costs.argtypes = [_COUNT, *[_ARRAY] * 4, _Control, *[_ARRAY] * 5]

    def propagate(self, time, u, p, control, x0, restart=None):
        """``(status, where, y, x)``; status as in ``driver.c``, where: time and last finite state of a stop."""
        n, nx = len(time), len(x0)
        y, x, where = np.empty((n, self._outputs)), np.full((n, nx), np.nan), np.empty(nx + 1)
        arrays = (x0, restart, y, x, where)
        status = self._propagate(n, *map(_address, (time, u, p)), _Control(*control), *map(_address, arrays))
        return status, where, y, x

    def propagate_tangent(self, time, u, p, control, x0, dx0, with_states=True):
        """``(status, where, y, dy, x, dx)``; dx is None without ``with_states``."""
        n, (nx, nt) = len(time), dx0.shape
        y, dy, x = np.empty((n, self._outputs)), np.empty((n, self._outputs, nt)), np.empty((n, nx))
        dx, where = np.empty((n, nx, nt)) if with_states else None, np.empty(nx + 1)
        arrays = (x0, dx0, y, dy, x, dx, where)
        status = self._tangent(n, *map(_address, (time, u, p)), _Control(*control), *map(_address, arrays))
        return status, where, y, dy, x, dx

    def costs(self, cuts, time, u, p, control, x0, measured, weights, limits=None):
        """What runs over segments cost, (segments,): nan where one stopped or passed its limit, inf where dear."""
        cost = np.empty(len(cuts))
        arrays = (x0, measured, weights, limits, cost)
        self._costs(len(cuts), *map(_address, (cuts, time, u, p)), _Control(*control), *map(_address, arrays))
        return cost

    def expansions(self, cuts, time, u, p, control, x0, dx0, measured, limits=None):
        """By output: squares (segments, ny), half their gradient (.., nt) and Gauss-Newton Hessian (.., nt, nt).

        Squares are nan where a run stopped or one passed its limit, inf where it became dear.
        """
        (n, _, nt), ny = dx0.shape, self._outputs
        squares, gradient, hessian = np.zeros((n, ny)), np.zeros((n, ny, nt)), np.zeros((n, ny, nt, nt))
        arrays = (x0, dx0, measured, limits, squares, gradient, hessian)
        self._expansions(n, *map(_address, (cuts, time, u, p)), _Control(*control), *map(_address, arrays))
        return squares, gradient, hessian


class LanesLibrary:
    """Explicit runs of many parameter sets side by side, by one shared library; safe to call from several threads."""

    def __init__(self, path: Path, outputs: int):
        self._outputs = outputs
        self._propagate = ctypes.CDLL(str(path)).propagate_lanes
        self._propagate.argtypes = [_COUNT, _COUNT, *[_ARRAY] * 3, _Control, *[_ARRAY] * 7]

    def propagate(self, time, u, p, control, x0, with_states=True):
        """``(status (sets,), where (sets, nx + 1), y (sets, n, ny), x (sets, n, nx) or None)``; p (sets, np).

        Outputs of a run that stopped are nan, its states from there on.
        """
        (sets, nx), n = x0.shape, len(time)
        y, x = np.empty((sets, n, self._outputs)), np.full((sets, n, nx), np.nan) if with_states else None
        status, where = self._walk(time, u, p, control, (x0, None, y, x, None))
        y[status != 0] = np.nan
        return status, where, y, x

    def squares(self, time, u, p, control, x0, measured):
        """``(status (sets,), squares (sets, ny))`` of what is left of ``measured`` (n, ny); nan where a run stopped."""
        squares = np.empty((len(x0), self._outputs))
        status, _ = self._walk(time, u, p, control, (x0, measured, None, None, squares))
        squares[status != 0] = np.nan
        return status, squares

    def _walk(self, time, u, p, control, arrays):
        sets, nx = arrays[0].shape
        status, where = np.empty(sets, dtype=np.int32), np.empty((sets, nx + 1))
        given = map(_address, (time, u, p))
        self._propagate(sets, len(time), *given, _Control(*control), *map(_address, (*arrays, where, status)))
        return status, where


def _address(array):
    return None if array is None else array.__array_interface__["data"][0]  # `ctypes.data` takes ten times as long
