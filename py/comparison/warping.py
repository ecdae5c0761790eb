"""Dynamic time warping within a band: compiled, and by numpy where there is no compiler, to the same path."""

from __future__ import annotations

import ctypes
from functools import cache
from pathlib import Path

import numpy as np

from hydrotwin.models.language.errors import SolveError
from hydrotwin.simulation.compiler import compile_library

FIRST, SECOND, BOTH = 0, 1, 2  # what moved one sample on; of equal ways the first is taken
_SOURCE = Path(__file__).with_name("warping.c")


def warped(first: np.ndarray, second: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """Indices into both curves (n,) along the path of least summed squares, at most ``reach`` samples apart.

    Dynamic time warping with steps of one sample in one curve or both, all of weight 1.
    Source: Sakoe, Chiba, IEEE Trans. ASSP 26 (1978) 43-49.
    """
    compiled = _compiled()
    first, second = (np.ascontiguousarray(curve, dtype=float) for curve in (first, second))
    return interpreted(first, second, reach) if compiled is None else _called(compiled, first, second, reach)


def _called(compiled, first: np.ndarray, second: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    n = len(first)
    sums, ways = np.empty((2, n + 1)), np.empty((n, 2 * reach + 1), dtype=np.int8)
    path = np.empty((2, 2 * n), dtype=np.int64)
    length = compiled(n, reach, *(a.ctypes.data for a in (first, second, sums, ways, path[0], path[1])))
    return path[0, :length][::-1], path[1, :length][::-1]


@cache
def _compiled():
    """The function ``warp`` of warping.c; None where it cannot be compiled."""
    try:
        path = compile_library(_SOURCE.read_text(encoding="utf-8"), "warping")
        warp = None if path is None else ctypes.CDLL(str(path)).warp
    except (SolveError, OSError):
        return None
    if warp is not None:
        warp.restype, warp.argtypes = ctypes.c_longlong, [ctypes.c_longlong] * 2 + [ctypes.c_void_p] * 6
    return warp


def interpreted(first: np.ndarray, second: np.ndarray, reach: int) -> tuple[np.ndarray, np.ndarray]:
    """`warped`, one antidiagonal after the other."""
    n, lows, steps = len(first), [], []
    before, last = np.full(n + 3, np.inf), np.full(n + 3, np.inf)  # sums, one place after the index in ``first``
    turned = second[::-1]
    for d in range(2 * n - 1):
        low, high = max(0, d - n + 1, (d - reach + 1) // 2), min(n - 1, d, (d + reach) // 2)
        cost = (first[low : high + 1] - turned[n - 1 - d + low : n - d + high]) ** 2
        ways = np.stack((last[low : high + 1], last[low + 1 : high + 2], before[low : high + 1]))
        if d == 0:
            ways[BOTH] = 0.0
        step = ways.argmin(axis=0)
        now = before  # its sums are used
        now[low], now[high + 2] = np.inf, np.inf
        now[low + 1 : high + 2] = cost + ways.min(axis=0)
        before, last = last, now
        lows.append(low)
        steps.append(step)
    return _path(lows, steps, n)


def _path(lows: list[int], steps: list[np.ndarray], n: int) -> tuple[np.ndarray, np.ndarray]:
    i = j = n - 1
    path = [(i, j)]
    while i or j:
        way = steps[i + j][i - lows[i + j]]
        i, j = i - (way != SECOND), j - (way != FIRST)
        path.append((i, j))
    first, second = np.array(path[::-1]).T
    return first, second
