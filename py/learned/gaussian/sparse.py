"""A sparse Gaussian process in numpy: hyper-parameters by the collapsed bound of all rows, in chunks.

    log p(y | X) >= log N(y | c, K_XZ K_ZZ^-1 K_ZX + noise) - tr(K_XX - K_XZ K_ZZ^-1 K_ZX) / (2 noise)

The best Gaussian over the inducing values is in the bound (collapsed), so that nothing is drawn and no rate of a
stochastic search is chosen; a step costs rows * points^2, whatever the number of rows. Its gradient by the
hyper-parameters is written out.

Minibatches of a variational process (Hensman, Fusi, Lawrence, UAI 2013; GPyTorch's, whitened) search for the same
Gaussian. They were measured beside it on 10 000 to 50 000 rows (``benchmarks/learned/many_rows``, 60 points): one step
ahead their RMSE was 2 to 5 % larger after 20 to 35 s of the processor than after 0.4 s with hyper-parameters of 2000
rows and weights of all. Hyper-parameters of all rows (4 s) changed the RMSE by less than 0.2 %. So there are none here.

Source: Titsias, Variational Learning of Inducing Variables in Sparse Gaussian Processes, AISTATS 2009; chunks: Gal,
van der Wilk, Rasmussen, NeurIPS 2014.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize

from hydrotwin.models.language.errors import SolveError

from .kernels import Hyper, Kernel

JITTER = 1e-8  # of the mean prior variance, on the diagonal of K_ZZ
CHUNK = 4000  # rows at a time
BOUNDS = {"variance": (1e-6, 1e3), "length": (2e-2, 1e3), "noise": (1e-8, 10.0)}  # of normalised data
FIRST_LENGTH, FIRST_NOISE = 2.0, 0.1


@dataclass(frozen=True, eq=False)
class Sparse:
    """A trained process, normalised: f(z) = v' L^-1 k(Z, z) with v ~ N(mean, covariance); noise variance.

    points (M, d). factor (M, M): lower L with L L' = K_ZZ. mean (M,), covariance (M, M) of the whitened values v,
    whose prior is N(0, 1). loss: -bound per row. evaluations: of the bound.
    """

    hyper: Hyper
    points: np.ndarray
    factor: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    noise: float
    loss: float
    evaluations: int

    def features(self, z: np.ndarray) -> np.ndarray:
        """L^-1 k(Z, z), (M, n)."""
        return solve_triangular(self.factor, self.hyper.values(self.points, z), lower=True)

    def at(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Mean and variance of the latent function at z (n, d), each (n,)."""
        A = self.features(z)
        left = np.maximum(self.hyper.diagonal(z) - np.sum(A**2, axis=0), 0.0)
        return self.mean @ A, left + np.sum(A * (self.covariance @ A), axis=0)


def spread_points(X: np.ndarray, count: int, rng: np.random.Generator, most: int = 3000) -> np.ndarray:
    """At most ``count`` rows of X (n, d), each the farthest from those before it (of ``most`` random rows)."""
    pool = X if len(X) <= most else X[np.sort(rng.permutation(len(X))[:most])]
    chosen = [int(np.argmin(np.sum((pool - pool.mean(axis=0)) ** 2, axis=1)))]
    apart = np.sum((pool - pool[chosen[0]]) ** 2, axis=1)
    while len(chosen) < count and apart.max() > 1e-12:
        chosen.append(int(np.argmax(apart)))
        apart = np.minimum(apart, np.sum((pool - pool[chosen[-1]]) ** 2, axis=1))
    return pool[chosen]


def train_sparse(
    X: np.ndarray,
    y: np.ndarray,
    Z: np.ndarray,
    kernel: Kernel,
    *,
    evaluations: int = 100,
    first: tuple[Hyper, float] | None = None,
    progress: Callable[[int, float], None] | None = None,
) -> Sparse:
    """Fit variances, lengths and noise on all rows X (n, d), y (n,) with inducing points Z (M, d).

    first : hyper-parameters and noise to begin with. progress : called with the number of the evaluation and the loss.

    Raises `SolveError` when the bound was never finite.
    """
    terms, factors, d = len(kernel.terms), len(kernel.factors), X.shape[1]
    if first is None:
        first = Hyper(kernel, np.full(terms, 1.0 / terms), np.full((factors, d), FIRST_LENGTH)), FIRST_NOISE
    packed = np.log(np.concatenate([first[0].variances, first[0].lengths.ravel(), [first[1]]]))
    limits = [*["variance"] * terms, *["length"] * (factors * d), "noise"]
    best, count = [np.inf, packed], 0

    def unpacked(values):
        parts = np.exp(values)
        return Hyper(kernel, parts[:terms], parts[terms:-1].reshape(factors, d)), float(parts[-1])

    def loss(values):
        nonlocal count
        count += 1
        try:
            value, slope = bound(*unpacked(values), X, y, Z)
        except LinAlgError:  # not positive definite; the line search steps back
            return 1e10, np.zeros(len(values))
        if value < best[0]:
            best[:] = value, values.copy()
        if progress:
            progress(count, value)
        return value, slope

    minimize(
        loss, packed, jac=True, method="L-BFGS-B", bounds=[tuple(np.log(BOUNDS[kind])) for kind in limits],
        options={"maxfun": evaluations, "maxiter": evaluations, "ftol": 1e-7, "gtol": 1e-4},
    )  # fmt: skip
    if not np.isfinite(best[0]):
        raise SolveError(
            f"learn gp: the bound of the likelihood was never finite (after {count} evaluations). "
            "Check the recordings for outliers."
        )
    hyper, noise = unpacked(best[1])
    return conditioned(hyper, noise, X, y, Z, best[0], count)


def conditioned(hyper: Hyper, noise: float, X, y, Z, loss: float = np.nan, evaluations: int = 0) -> Sparse:
    """The posterior of all rows with these hyper-parameters."""
    L = factor_of(hyper, Z)
    AA, Ay = np.zeros((len(Z), len(Z))), np.zeros(len(Z))
    for rows in _chunks(len(X)):
        A = solve_triangular(L, hyper.values(Z, X[rows]), lower=True)
        AA, Ay = AA + A @ A.T, Ay + A @ y[rows]
    B = cholesky(np.eye(len(Z)) + AA / noise, lower=True)
    covariance = cho_solve((B, True), np.eye(len(Z)))
    return Sparse(hyper, Z, L, covariance @ Ay / noise, covariance, noise, loss, evaluations)


def factor_of(hyper: Hyper, Z: np.ndarray) -> np.ndarray:
    """Lower Cholesky factor of K_ZZ."""
    K = hyper.values(Z, Z)
    K[np.diag_indices_from(K)] += JITTER * max(float(np.mean(np.diag(K))), 1e-12)
    return cholesky(K, lower=True)


def bound(hyper: Hyper, noise: float, X, y, Z) -> tuple[float, np.ndarray]:
    """-bound per row, and its gradient by the logarithms of variances, lengths and noise.

    With S = K_ZZ + K_ZX K_XZ / noise and m = S^-1 K_ZX y / noise, the bound's derivatives are

        by K_ZX:  (K_ZZ^-1 - S^-1) K_ZX / noise + m (y - K_XZ m)' / noise
        by K_ZZ:  (K_ZZ^-1 - S^-1 - m m' - K_ZZ^-1 K_ZX K_XZ K_ZZ^-1 / noise) / 2
    """
    n, M = len(X), len(Z)
    L = factor_of(hyper, Z)
    AA, Ay, yy, trace = np.zeros((M, M)), np.zeros(M), float(y @ y), 0.0
    crosses = []
    for rows in _chunks(n):
        K = hyper.values(Z, X[rows])
        A = solve_triangular(L, K, lower=True)
        AA, Ay, trace = AA + A @ A.T, Ay + A @ y[rows], trace + float(hyper.diagonal(X[rows]).sum())
        crosses.append(K if n <= CHUNK else None)
    B = cholesky(np.eye(M) + AA / noise, lower=True)
    c = solve_triangular(B, Ay, lower=True) / noise
    explained = float(np.trace(AA))
    fit = -0.5 * n * np.log(2 * np.pi * noise) - np.log(np.diag(B)).sum() - 0.5 * yy / noise + 0.5 * c @ c
    value = fit - 0.5 * (trace - explained) / noise
    one = np.eye(M)
    L_inverse, B_inverse = solve_triangular(L, one, lower=True), solve_triangular(B, one, lower=True)
    K_inverse, T = L_inverse.T @ L_inverse, B_inverse @ L_inverse
    S_inverse, m = T.T @ T, T.T @ c
    outer = 0.5 * (K_inverse - S_inverse - np.outer(m, m) - L_inverse.T @ AA @ L_inverse / noise)
    slopes, fitted = [hyper.gradient(Z, Z, outer)], 0.0
    for rows, K in zip(_chunks(n), crosses, strict=True):
        K = hyper.values(Z, X[rows]) if K is None else K
        run = K.T @ m
        G = ((K_inverse - S_inverse) @ K + np.outer(m, y[rows] - run)) / noise
        slopes += [hyper.gradient(Z, X[rows], G), hyper.diagonal_gradient(X[rows], -0.5 / noise)]
        fitted += run @ run
    in_noise = -n * noise + np.sum((B_inverse @ AA) * B_inverse) + yy - 2 * m @ (L @ Ay) + fitted + trace - explained
    by_variance, by_length = (sum(part) for part in zip(*slopes, strict=True))
    return -value / n, -np.concatenate([by_variance, by_length.ravel(), [0.5 * in_noise / noise]]) / n


def _chunks(n: int) -> list[slice]:
    return [slice(k, min(k + CHUNK, n)) for k in range(0, n, CHUNK)]
