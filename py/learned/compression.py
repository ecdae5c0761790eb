"""A Gaussian process's posterior made small enough for a controller: inducing points, or a spline in one dimension.

With inducing points Z the data enter through two small matrices (deterministic training conditional; Seeger et al.
2003, Titsias 2009, with the hyper-parameters of the exact process):

    S = K_ZZ + K_ZX K_XZ / noise
    mean(z) = c + k(z, Z) S^-1 K_ZX (y - c) / noise
    var(z)  = s2 - k(z, Z) (K_ZZ^-1 - S^-1) k(Z, z)

The points are rows of the data, chosen greedily (pivoted Cholesky; Burt, Rasmussen, van der Wilk, JMLR 21 (2020)). At
150 points the largest deviation from the exact mean was 2 to 100 times smaller than with the centres of k-means: those
crowd where samples do, and miss the few transients that a process of little noise remembers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve, cholesky, eigh, lstsq, qr, solve_triangular

JITTER = 1e-10  # of the prior variance, on the diagonal of K_ZZ
NEGLIGIBLE = 1e-8  # of the prior variance: a direction the data say less about is dropped from the deviation


@dataclass(frozen=True, eq=False)
class Posterior:
    """An exact posterior, in normalised units.

    features (n, d), targets (n,): the data. weights (n,): K^-1 (targets - constant). lengths (d,).
    """

    kernel: str
    features: np.ndarray
    targets: np.ndarray
    weights: np.ndarray
    lengths: np.ndarray
    prior_variance: float
    noise_variance: float
    constant: float


@dataclass(frozen=True, eq=False)
class SmallPosterior:
    """What is deployed, normalised: mean = constant + weights' k(points), var = prior - |sd_factor k(sd_points)|^2.

    points (P, d) and sd_points (M, d) are over the length scales; k is the correlation, one at distance zero.
    """

    points: np.ndarray
    weights: np.ndarray
    sd_points: np.ndarray
    sd_factor: np.ndarray
    constant: float
    prior_variance: float

    def at(self, points: np.ndarray, kernel: str) -> tuple[np.ndarray, np.ndarray]:
        """Mean and standard deviation at ``points`` (n, d) over the length scales, each (n,)."""
        mean = self.constant + self.weights @ correlation(self.points, points, kernel)
        explained = self.sd_factor @ correlation(self.sd_points, points, kernel)
        return mean, np.sqrt(np.maximum(self.prior_variance - np.sum(explained**2, axis=0), 0.0))


def correlation(a: np.ndarray, b: np.ndarray, kernel: str) -> np.ndarray:
    """k(a, b) over the prior variance, (n, m), for points over the length scales."""
    squares = np.sum(a**2, axis=1)[:, None] + np.sum(b**2, axis=1)[None] - 2.0 * (a @ b.T)
    np.maximum(squares, 0.0, out=squares)
    if kernel == "rbf":
        return np.exp(-0.5 * squares)
    r = np.sqrt(3.0 * squares)
    return (1.0 + r) * np.exp(-r)


def inducing_points(points: np.ndarray, count: int, kernel: str) -> np.ndarray:
    """At most ``count`` of the rows of ``points`` (n, d), each the one that those before it explain least.

    This is the pivoting of a Cholesky factorization, stopped early. Ends before ``count`` when all rows are explained.
    """
    unexplained, L, chosen = np.ones(len(points)), np.zeros((len(points), count)), []
    for j in range(count):
        i = int(np.argmax(unexplained))
        if unexplained[i] <= JITTER:
            break
        column = correlation(points, points[i : i + 1], kernel)[:, 0] - L[:, :j] @ L[i, :j]
        L[:, j] = column / np.sqrt(unexplained[i])
        unexplained = np.maximum(unexplained - L[:, j] ** 2, 0.0)
        chosen.append(i)
    return points[chosen]


def small_posterior(exact: Posterior, count: int, exact_mean: bool) -> SmallPosterior:
    """The posterior on ``count`` inducing points; the mean on all training points where ``exact_mean`` asks for it."""
    X = exact.features / exact.lengths
    Z = inducing_points(X, count, exact.kernel)
    weights, factor = _condition(exact, X, Z)
    points = X if exact_mean else Z
    weights = exact.weights * exact.prior_variance if exact_mean else weights
    return SmallPosterior(points, weights, Z, factor, exact.constant, exact.prior_variance)


def _condition(exact: Posterior, X: np.ndarray, Z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights (M,) and upper trapezoidal factor (rank, M) for correlations with ``Z``.

    With L L' = K_ZZ the variance explained is |(1 - B^-1)^1/2 L^-1 k(Z, z)|^2, where |L^-1 k|^2 is never more than the
    prior variance: directions in which 1 - B^-1 is small can be left out for any z.
    """
    s2, noise = exact.prior_variance, exact.noise_variance
    K = s2 * (correlation(Z, Z, exact.kernel) + JITTER * np.eye(len(Z)))
    L = cholesky(K, lower=True)
    A = solve_triangular(L, s2 * correlation(Z, X, exact.kernel), lower=True)
    B = np.eye(len(Z)) + A @ A.T / noise
    alpha = cho_solve(cho_factor(B), A @ (exact.targets - exact.constant) / noise)
    weights = s2 * solve_triangular(L.T, alpha)
    scale, V = eigh(B)
    told = np.maximum(1.0 - 1.0 / scale, 0.0)
    told, V = (told[told > NEGLIGIBLE], V[:, told > NEGLIGIBLE]) if told.max() > NEGLIGIBLE else (told[-1:], V[:, -1:])
    R = s2 * solve_triangular(L, V * np.sqrt(told), lower=True, trans="T").T
    return weights, np.triu(qr(R, mode="economic")[1])


def spline_coefficients(values, lower: float, upper: float, count: int, oversampling: int = 20) -> np.ndarray:
    """Least-squares coefficients (count,) of a cubic spline on evenly spaced knots over [lower, upper].

    values : a function of (n,) places, sampled ``oversampling`` times between two knots. `dual_block.spline` evaluates.
    """
    x = np.linspace(lower, upper, oversampling * (count - 3) + 1)
    basis = BSpline.design_matrix(x, spline_knots(lower, upper, count), 3, extrapolate=True).toarray()  # ends round
    return lstsq(basis, values(x))[0]


def spline_knots(lower: float, upper: float, count: int) -> np.ndarray:
    """Knots (count + 4,) of ``count`` cubic B-splines of one shape over [lower, upper]."""
    step = (upper - lower) / (count - 3)
    return lower + step * np.arange(-3, count + 1)
