"""The compiled driver with one model, called through ctypes: the GIL is released while it runs."""

from __future__ import annotations

import ctypes

import numpy as np

from .tables import Tables

_ARRAY, _COUNT = ctypes.c_void_p, ctypes.c_longlong


class _Task(ctypes.Structure):
    """`Task` as the driver takes it."""

    _fields_ = (
        *((name, _ARRAY) for name in ("model", "time", "u", "p")),
        *((name, ctypes.c_double) for name in ("step", "tolerance", "trials")),
    )


class _Loaded:
    """The driver and a model."""

    def __init__(self, driver: ctypes.CDLL, tables: Tables, outputs: int):
        self._driver, self._tables, self._outputs = driver, tables, outputs

    def _task(self, time, u, p, control):
        return ctypes.byref(_Task(self._tables.address, *map(_address, (time, u, p)), *control))


class Library(_Loaded):
    """The runs of one model; safe to call from several threads."""

    def __init__(self, driver: ctypes.CDLL, tables: Tables, outputs: int):
        super().__init__(driver, tables, outputs)
        arrays = {"propagate": 5, "propagate_tangent": 7, "propagate_costs": 6, "propagate_expansions": 8}
        for name, many in arrays.items():
            getattr(driver, name).argtypes = [_ARRAY, _COUNT, *[_ARRAY] * many]

    def propagate(self, time, u, p, control, x0, restart=None):
        """``(status, where, y, x)``; status as in ``driver.c``, where: time and last finite state of a stop."""
        n, nx = len(time), len(x0)
        y, x, where = np.empty((n, self._outputs)), np.full((n, nx), np.nan), np.empty(nx + 1)
        arrays = (x0, restart, y, x, where)
        status = self._driver.propagate(self._task(time, u, p, control), n, *map(_address, arrays))
        return status, where, y, x

    def propagate_tangent(self, time, u, p, control, x0, dx0, with_states=True):
        """``(status, where, y, dy, x, dx)``; dx is None without ``with_states``."""
        n, (nx, nt) = len(time), dx0.shape
        y, dy, x = np.empty((n, self._outputs)), np.empty((n, self._outputs, nt)), np.empty((n, nx))
        dx, where = np.empty((n, nx, nt)) if with_states else None, np.empty(nx + 1)
        arrays = (x0, dx0, y, dy, x, dx, where)
        status = self._driver.propagate_tangent(self._task(time, u, p, control), n, *map(_address, arrays))
        return status, where, y, dy, x, dx

    def costs(self, cuts, time, u, p, control, x0, measured, weights, limits=None):
        """What runs over segments cost, (segments,): nan where one stopped or passed its limit, inf where dear."""
        cost = np.empty(len(cuts))
        arrays = (cuts, x0, measured, weights, limits, cost)
        self._driver.propagate_costs(self._task(time, u, p, control), len(cuts), *map(_address, arrays))
        return cost

    def expansions(self, cuts, time, u, p, control, x0, dx0, measured, limits=None):
        """By output: squares (segments, ny), half their gradient (.., nt) and Gauss-Newton Hessian (.., nt, nt).

        Squares are nan where a run stopped or one passed its limit, inf where it became dear.
        """
        (n, _, nt), ny = dx0.shape, self._outputs
        squares, gradient, hessian = np.zeros((n, ny)), np.zeros((n, ny, nt)), np.zeros((n, ny, nt, nt))
        arrays = (cuts, x0, dx0, measured, limits, squares, gradient, hessian)
        self._driver.propagate_expansions(self._task(time, u, p, control), n, *map(_address, arrays))
        return squares, gradient, hessian


class LanesLibrary(_Loaded):
    """Explicit runs of many parameter sets of one model side by side; safe to call from several threads."""

    def __init__(self, driver: ctypes.CDLL, tables: Tables, outputs: int, side_by_side: int):
        """side_by_side : address of its functions for lanes."""
        super().__init__(driver, tables, outputs)
        self._side_by_side = side_by_side
        driver.propagate_lanes.argtypes = [_ARRAY, _ARRAY, _COUNT, _COUNT, *[_ARRAY] * 7]

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
        task, functions = self._task(time, u, p, control), self._side_by_side
        self._driver.propagate_lanes(task, functions, sets, len(time), *map(_address, (*arrays, where, status)))
        return status, where


def _address(array):
    return None if array is None else array.__array_interface__["data"][0]  # `ctypes.data` takes ten times as long
