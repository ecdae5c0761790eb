"""A linear state space from recordings without iteration, to begin a fit with: past outputs as instruments.

    [U_f; W_p; Y_f] = L Q',   L_32 = U S V',   observability = U_n S_n^1/2,   A from its shift, C its first rows

U_f, Y_f: future inputs and outputs, W_p: past ones, in block Hankel matrices. B, D, e then follow by linear least
squares from the free run. Source: Verhaegen, Automatica 30 (1994) 61-74 (PO-MOESP); Verhaegen, Varga (1994), DLR
IB 515-94-13 (B and D from the whole run); own implementation.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .regressors import CUTOFF

INSIDE = 0.9995  # radius that eigenvalues outside the unit circle are put to, all in one


def hankel_factor(runs: Sequence[tuple[np.ndarray, np.ndarray]], depth: int) -> np.ndarray:
    """Triangular factor of the rows (1, future inputs, past, future outputs) of all runs (u, w) of samples."""
    rows = [_rows(u, w, depth) for u, w in runs if len(u) >= 2 * depth]
    size = 1 + depth * 2 * sum(part.shape[1] for part in runs[0])
    return np.linalg.qr(np.concatenate([np.zeros((1, size)), *rows]), mode="r")


def _rows(u: np.ndarray, w: np.ndarray, depth: int) -> np.ndarray:
    count = len(u) - 2 * depth + 1
    future, past = ([a + np.arange(count) for a in range(b, b + depth)] for b in (depth, 0))
    blocks = [u[k] for k in future] + [u[k] for k in past] + [w[k] for k in past] + [w[k] for k in future]
    return np.hstack([np.ones((count, 1)), *blocks])


def observability(factors: Sequence[np.ndarray], inputs: int, outputs: int, depth: int) -> np.ndarray:
    """Extended observability matrix (depth ny, depth ny), the directions that matter most first."""
    R = np.linalg.qr(np.concatenate(factors), mode="r")
    a, b = 1 + depth * inputs, 1 + depth * (2 * inputs + outputs)
    U, S, _ = np.linalg.svd(R[a:b, b:].T, full_matrices=False)
    return U * np.sqrt(S)


def dynamics(O: np.ndarray, order: int, outputs: int) -> tuple[np.ndarray, np.ndarray]:  # noqa: E741
    """A and C of an order; A made stable where it is not."""
    On = O[:, :order]
    A = np.linalg.lstsq(On[:-outputs], On[outputs:], rcond=CUTOFF)[0]
    radius = float(np.abs(np.linalg.eigvals(A)).max(initial=0.0))
    return (A * (INSIDE / radius) if radius > INSIDE else A), On[:outputs]
