"""Least squares by damped Gauss-Newton steps, for fits of whole free runs in which some directions change nothing.

    (J' J + damping I) step = -J' r        over scaled parameters

Source: Levenberg (1944), Marquardt, SIAM J. Appl. Math. 11 (1963) 431-441.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

FIRST, LESS, MORE = 1e-3, 0.2, 8.0  # damping over the largest eigenvalue to begin with; its factors after each try
LEAST_DAMPING = 1e-14
TRIES = 8  # of the damping, before a fit ends
ENOUGH = 1e-5  # of the cost: a step that gains less is the last

Evaluate = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray] | None]


@dataclass(frozen=True, eq=False)
class Minimum:
    """Parameters, the sum of squares there, and how often it was evaluated with its Jacobian, or without."""

    parameters: np.ndarray
    cost: float
    evaluations: int


def minimum(residual: Callable, jacobian: Callable, start: np.ndarray, iterations: int) -> Minimum:
    """The least sum of squares near ``start``.

    residual : parameters -> (m,), or None where there is none (an unstable run). jacobian : parameters -> (m, p).
    """
    at, r = np.array(start, dtype=float), residual(start)
    evaluations, damping = 1, FIRST
    if r is None:
        return Minimum(at, np.inf, evaluations)
    cost = float(r @ r)
    for _ in range(iterations):
        J = jacobian(at)
        scale = np.sqrt(np.einsum("ij,ij->j", J, J))
        scale[scale <= 1e-12 * scale.max(initial=1e-300)] = np.inf
        J /= scale
        eigenvalues, V = np.linalg.eigh(J.T @ J)
        g = V.T @ (J.T @ r)
        gained = 0.0
        for _ in range(TRIES):
            step = -V @ (g / (np.maximum(eigenvalues, 0) + damping * eigenvalues[-1])) / scale
            there = residual(at + step)
            evaluations += 1
            if there is not None and (new := float(there @ there)) < cost:
                gained, at, r, cost = cost - new, at + step, there, new
                damping = max(LESS * damping, LEAST_DAMPING)
                break
            damping *= MORE
        if gained <= ENOUGH * cost:
            break
    return Minimum(at, cost, evaluations)
