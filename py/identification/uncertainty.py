"""How sure the parameters are: (J^T J)^-1, and the sandwich that allows for coloured residuals.

    C_white = (J^T J)^-1,   C = (J^T J)^-1 M (J^T J)^-1,   M = sum_l w_l sum_k s_k s_{k+l}^T,   s_k = J_k^T r_k

J is weighted by the noise and freed of the start states of each recording. w_l falls linearly to zero at a lag chosen
from the scores' own correlation. A naive interval covers 69-85 % where 95 % are meant when the residual is coloured.
Source: W. Newey & K. West, Econometrica 1987; D. Andrews, Econometrica 1991 (the lag).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

LEAST_SIGHT = 1e-10  # singular values of unit columns below this cannot be told from zero
MOST_LAGS = 200


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariances of q and the singular directions of the unit-column sensitivity.

    ``information`` is J^T J in q; ``undetermined`` marks parameters that belong to a direction the data do not see.
    """

    information: np.ndarray
    white: np.ndarray
    sandwich: np.ndarray
    undetermined: np.ndarray


@dataclass(frozen=True, eq=False)
class Errors:
    """Weighted errors of the runs by recording: the size (m,) of those of the solver, draws (m,) of any other."""

    sizes: Sequence[np.ndarray]
    draws: Sequence[Sequence[np.ndarray]] = ()

    def meat(self, jacobians: Sequence[np.ndarray]) -> np.ndarray:
        """What they add to the covariance of the scores. (np, np)"""
        total = sum((J * size[:, None]).T @ (J * size[:, None]) for J, size in zip(jacobians, self.sizes, strict=True))
        for draw in self.draws:
            for J, error in zip(jacobians, draw, strict=True):
                total = total + np.outer(J.T @ error, J.T @ error) / len(self.draws)
        return total


def without_starts(J: np.ndarray, shared: int) -> np.ndarray:
    """Columns of the shared parameters (m, shared) after the private columns have explained what they can."""
    if J.shape[1] == shared:
        return J
    private = J[:, shared:] / np.maximum(np.linalg.norm(J[:, shared:], axis=0), np.finfo(float).tiny)
    basis, sizes, _ = np.linalg.svd(private, full_matrices=False)
    basis = basis[:, sizes > 1e-9 * sizes.max(initial=0.0)]
    return J[:, :shared] - basis @ (basis.T @ J[:, :shared])


def uncertainty(residuals: Sequence[np.ndarray], jacobians: Sequence[np.ndarray], samples: Sequence[np.ndarray],
                at_bound: np.ndarray, errors: Errors | None = None) -> Uncertainty:  # fmt: skip
    """Covariances from weighted residuals (m,) and projected Jacobians (m, np) of each recording.

    ``samples`` (m,) tells which residuals share a sample instant. Parameters at a bound are taken as known.
    ``errors`` : of the runs themselves, which parameters absorb before a residual shows them.
    """
    information = sum(J.T @ J for J in jacobians)
    n = sum(len(r) for r in residuals)
    inside = ~at_bound
    white, undetermined = _inverse(information, inside)
    inflation = n / max(n - int(inside.sum()), 1)
    meat = inflation * sum(_meat(_scores(r, J, s)) for r, J, s in zip(residuals, jacobians, samples, strict=True))
    meat = meat + (errors.meat(jacobians) if errors else 0.0)
    usable = inside & ~undetermined
    bread = np.where(np.outer(usable, usable), np.nan_to_num(white), 0.0)
    sandwich = np.where(np.outer(usable, usable), bread @ meat @ bread, np.nan)
    return Uncertainty(information, white, _no_smaller(sandwich, white, residuals, n), undetermined)


def _no_smaller(sandwich: np.ndarray, white: np.ndarray, residuals, n: int) -> np.ndarray:
    """A kernel sum over few samples scatters; it may enlarge an interval, not shrink it below the white one."""
    level = sum(float(r @ r) for r in residuals) / max(n, 1)
    with np.errstate(invalid="ignore", divide="ignore"):
        ratio = np.sqrt(np.maximum(1.0, level * np.diag(white) / np.diag(sandwich)))
    ratio = np.where(np.isfinite(ratio), ratio, 1.0)
    return sandwich * np.outer(ratio, ratio)


def _inverse(information: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse over the parameters ``inside``; nan rows for bounds and for directions without information."""
    size = np.sqrt(np.diag(information))
    seen = inside & (size > 0)
    unit = np.where(size > 0, size, 1.0)
    scaled = (information / np.outer(unit, unit))[np.ix_(seen, seen)]
    values, vectors = np.linalg.eigh(scaled) if seen.any() else (np.zeros(0), np.zeros((0, 0)))
    blind = values < LEAST_SIGHT
    lost = (np.abs(vectors[:, blind]) > 0.05).any(axis=1)
    inverse = (vectors[:, ~blind] / values[~blind]) @ vectors[:, ~blind].T
    inverse[lost, :] = inverse[:, lost] = np.nan
    whole = np.full(information.shape, np.nan)
    whole[np.ix_(seen, seen)] = inverse / np.outer(unit[seen], unit[seen])
    undetermined = inside & ~seen
    undetermined[np.flatnonzero(seen)[lost]] = True
    return whole, undetermined


def _scores(r: np.ndarray, J: np.ndarray, sample: np.ndarray) -> np.ndarray:
    """s_k = J_k^T r_k summed over the outputs of a sample. (n, np)"""
    if not len(r):
        return np.zeros((0, J.shape[1]))
    first = np.flatnonzero(np.concatenate([[True], np.diff(sample) > 0]))
    return np.add.reduceat(J * r[:, None], first, axis=0)


def _meat(scores: np.ndarray) -> np.ndarray:
    """Bartlett-weighted sum of the scores' autocovariances. (np, np)"""
    total, lags = scores.T @ scores, _lags(scores)
    for lag in range(1, lags + 1):
        weight = 1 - lag / (lags + 1)
        cross = scores[:-lag].T @ scores[lag:]
        total = total + weight * (cross + cross.T)
    return total


def _lags(scores: np.ndarray) -> int:
    """Andrews' lag for an AR(1): 1.1447 (alpha n)^(1/3), alpha = 4 rho^2/(1 - rho^2)^2, averaged over the scores."""
    n = len(scores)
    energy = np.einsum("nk,nk->k", scores, scores)
    along = np.einsum("nk,nk->k", scores[:-1], scores[1:])
    rho = np.clip(np.divide(along, energy, out=np.zeros_like(along), where=energy > 0), -0.97, 0.97)
    alpha = float(np.mean(4 * rho**2 / (1 - rho**2) ** 2)) if len(rho) else 0.0
    return int(min(np.ceil(1.1447 * (alpha * n) ** (1 / 3)), n // 4, MOST_LAGS))


def correlation(covariance: np.ndarray) -> np.ndarray:
    """Correlation matrix; rows without a variance are nan."""
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma = np.sqrt(np.diag(covariance))
        return np.clip(covariance / np.outer(sigma, sigma), -1.0, 1.0)
