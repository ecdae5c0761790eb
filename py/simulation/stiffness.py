"""Explicit or implicit? Decided by the eigenvalues of df/dx met along a first run."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import FlatModel

from . import equations

LOOKS = 1000  # states along the run at which eigenvalues are taken


def growth(z: np.ndarray) -> np.ndarray:
    """|R(z)| of the classical Runge-Kutta step, ``R = 1 + z + z^2/2 + z^3/6 + z^4/24`` with ``z = h lambda``.

    A decaying mode must not grow: |R| <= 1.

    >>> [round(float(growth(np.array(z))), 3) for z in (-1.0, -2.7, -3.0, 2.8j)]
    [0.375, 0.879, 1.375, 0.931]
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return np.nan_to_num(np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))), nan=np.inf)


def explicit_is_stable(flat: FlatModel, step: float, time, u, p, x0, x) -> bool:
    """Whether the RK4 step damps every decaying mode at the states ``x`` (n, nx) of a first run, as far as it came."""
    if len(time) < 2 or not flat.states:
        return True
    x = x0[None, :] if x is None else x
    chosen = np.unique(np.linspace(0, len(x) - 1, min(len(x), LOOKS)).astype(int))
    chosen = chosen[np.isfinite(x[chosen]).all(axis=1)]
    h = min(step, np.diff(time).max())
    return bool((fastest_growth(flat, h, time[chosen], x[chosen], u[chosen], p) <= 1).all())


def fastest_growth(flat: FlatModel, h: float, time, x, u, p) -> np.ndarray:
    """Largest |R(h lambda)| over the decaying modes at every given point (m,); rounding apart."""
    arguments = equations.symbols(flat)
    by_state = ca.jacobian(equations.rate(flat, *arguments), arguments[1])
    jacobian = ca.Function("jacobian", arguments, [ca.densify(by_state)])
    nx = len(flat.states)
    scale = np.array([s.nominal for s in flat.states])
    columns = jacobian(time[None, :], x.T, u.T, p).full().reshape(nx, len(time), nx)
    matrices = columns.transpose(1, 0, 2) * scale[None, None, :] / scale[None, :, None]
    usable = np.isfinite(matrices).all(axis=(1, 2))
    modes = np.linalg.eigvals(np.where(usable[:, None, None], matrices, 0.0))
    rounding = 1e-9 * np.abs(modes).max(axis=1, keepdims=True)
    return np.where(modes.real < -rounding, growth(h * modes) - 1e-9, 0.0).max(axis=1)
