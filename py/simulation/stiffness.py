"""Explicit or implicit? Decided by the eigenvalues of df/dx met along a first run."""

from __future__ import annotations

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import FlatModel

from . import equations

LOOKS = 1000  # states along the run at which eigenvalues are taken
FOLLOWED = 2.0  # |h lambda| of a mode that swings: R is then within 0.3 of exp(h lambda)


def growth(z: np.ndarray) -> np.ndarray:
    """|R(z)| of the classical Runge-Kutta step, ``R = 1 + z + z^2/2 + z^3/6 + z^4/24`` with ``z = h lambda``.

    A decaying mode must not grow: |R| <= 1. That is enough for runs, not for their derivatives: where a mode that
    swings comes and goes, as when bristles stick and slip, wrong phases add up until a gradient is lost in them while
    the run itself is right. Such a mode is also to be followed, |z| <= `FOLLOWED`.

    >>> [round(float(growth(np.array(z))), 3) for z in (-1.0, -2.7, -3.0, 2.8j)]
    [0.375, 0.879, 1.375, 0.931]
    """
    with np.errstate(over="ignore", invalid="ignore"):
        return np.nan_to_num(np.abs(1 + z * (1 + z / 2 * (1 + z / 3 * (1 + z / 4)))), nan=np.inf)


def explicit_will_do(flat: FlatModel, step: float, time, u, p, x0, x) -> bool:
    """Whether the RK4 step keeps every decaying mode at the states ``x`` (n, nx) of a first run, as far as it came."""
    if len(time) < 2 or not flat.states:
        return True
    x = x0[None, :] if x is None else x
    chosen = np.unique(np.linspace(0, len(x) - 1, min(len(x), LOOKS)).astype(int))
    chosen = chosen[np.isfinite(x[chosen]).all(axis=1)]
    h = min(step, np.diff(time).max())
    matrices = h * _jacobians(flat, time[chosen], x[chosen], u[chosen], p)
    if (_radius_bound(matrices) <= FOLLOWED).all():  # there every decaying mode is kept and followed
        return True
    z = _decaying(matrices)
    return bool(np.all((growth(z) <= 1 + 1e-9) & ((z.imag == 0) | (np.abs(z) <= FOLLOWED))))


def decaying_modes(flat: FlatModel, time, x, u, p) -> np.ndarray:
    """Eigenvalues (m, nx), 1/s, of df/dx at every given point (m,), 0 for those that do not decay; rounding apart."""
    return _decaying(_jacobians(flat, time, x, u, p))


@equations.alone
def _jacobians(flat: FlatModel, time, x, u, p) -> np.ndarray:
    """df/dx (m, nx, nx) in nominal units; zeros where it is not finite."""
    arguments = equations.symbols(flat)
    by_state = ca.jacobian(equations.rate(flat, *arguments), arguments[1])
    jacobian = ca.Function("jacobian", arguments, [ca.densify(by_state)])
    nx = len(flat.states)
    scale = np.array([s.nominal for s in flat.states])
    columns = jacobian(time[None, :], x.T, u.T, p).full().reshape(nx, len(time), nx)
    matrices = columns.transpose(1, 0, 2) * scale[None, None, :] / scale[None, :, None]
    usable = np.isfinite(matrices).all(axis=(1, 2))
    return np.where(usable[:, None, None], matrices, 0.0)


def _decaying(matrices: np.ndarray) -> np.ndarray:
    modes = np.linalg.eigvals(matrices)
    rounding = 1e-9 * np.abs(modes).max(axis=1, keepdims=True)
    return np.where(modes.real < -rounding, modes, 0.0)


def _radius_bound(matrices: np.ndarray) -> np.ndarray:
    """No eigenvalue is larger than this (m,), and it takes a third of their time: ``|A^32|^(1/32)``."""
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(5):
            matrices = matrices @ matrices
        return np.nan_to_num(np.linalg.norm(matrices, axis=(1, 2)), nan=np.inf) ** (1 / 32)
