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

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import BSpline
from scipy.linalg import cho_factor, cho_solve, cholesky, eigh, lstsq, qr, solve_triangular

from .kernel_block import BYTES_OF_CONSTANT, LARGEST_C

JITTER = 1e-10  # of the prior variance, on the diagonal of K_ZZ
MEAN_POINTS = (100, 150, 200, 300, 400, 800)  # tried in turn
SD_POINTS = (100, 150, 200)
UNSEEN = 1e-3  # of the noise variance: what the rows' variance may grow by for a smaller factor
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


def compressed(
    exact: Posterior, places: np.ndarray, known: tuple[np.ndarray, np.ndarray], compress: int | str | None, bound: float
) -> SmallPosterior:
    """The posterior on ``compress`` inducing points; "auto" takes the fewest that keep ``bound``, None the exact mean.

    places (m, d), known: where the exact mean and deviation (m,) are known, to compare with. The mean costs little per
    point and takes as many as it needs, in the end all rows where 5 MB of C allow it; the deviation costs the square of
    its points and takes 200 at most. What they miss makes it too large, hardly ever too small.
    """
    X, at = exact.features / exact.lengths, places / exact.lengths
    fixed, small_enough = compress not in (None, "auto"), X.size * BYTES_OF_CONSTANT < 0.7 * LARGEST_C
    most = min(compress, SD_POINTS[-1]) if fixed else SD_POINTS[-1]
    for Z in _growing(X, (*(count for count in SD_POINTS if count < most), most), exact.kernel):
        small = SmallPosterior(Z, np.zeros(len(Z)), Z, _factor(exact, X, Z), exact.constant, exact.prior_variance)
        if np.abs(small.at(at, exact.kernel)[1] - known[1]).max() <= bound:
            break
    for Z in () if compress is None else _growing(X, (compress,) if fixed else MEAN_POINTS, exact.kernel):
        small = replace(small, points=Z, weights=_weights(exact, X, Z))
        if fixed or np.abs(small.at(at, exact.kernel)[0] - known[0]).max() <= bound:
            return small
    if compress == "auto" and not small_enough:
        return small
    return replace(small, points=X, weights=exact.prior_variance * exact.weights)


def _growing(X: np.ndarray, counts: tuple[int, ...], kernel: str) -> Iterator[np.ndarray]:
    """The first ``counts`` inducing points in turn; ends where they explain all rows."""
    first = min(counts[-1], SD_POINTS[-1])
    chosen = inducing_points(X, first, kernel)
    for count in counts:
        if count > first == len(chosen):
            chosen = inducing_points(X, counts[-1], kernel)
        yield chosen[:count]
        if len(chosen) < count:
            return


def _weights(exact: Posterior, X: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Weights (M,) of the mean for correlations with ``Z``."""
    L, A, B = _whitened(exact, X, Z)
    alpha = cho_solve(cho_factor(B), A @ (exact.targets - exact.constant) / exact.noise_variance)
    return exact.prior_variance * solve_triangular(L.T, alpha)


def _factor(exact: Posterior, X: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """Upper trapezoidal factor (rank, M) of the variance explained, for correlations with ``Z``.

    The variance explained is |(1 - B^-1)^1/2 L^-1 k(Z, z)|^2, where |L^-1 k|^2 is never more than the prior variance:
    directions in which 1 - B^-1 is small can be left out for any z.
    """
    L, _, B = _whitened(exact, X, Z)
    scale, V = eigh(B)
    told = np.maximum(1.0 - 1.0 / scale, 0.0)
    kept = told > min(NEGLIGIBLE, told.max() / 2)
    R = solve_triangular(L, V[:, kept] * np.sqrt(told[kept]), lower=True, trans="T").T
    return np.triu(qr(_seen(exact, exact.prior_variance * R, X, Z), mode="economic")[1])


def _seen(exact: Posterior, R: np.ndarray, X: np.ndarray, Z: np.ndarray) -> np.ndarray:
    """The fewest directions of ``R`` (rank, M) without which no row's variance grows by more than `UNSEEN` noise."""
    shown = R @ correlation(Z, X, exact.kernel)
    V = eigh(shown @ shown.T)[1][:, ::-1]
    left = np.cumsum(((V.T @ shown) ** 2)[::-1], axis=0)[::-1].max(axis=1)  # without this direction and all after it
    kept = max(int(np.sum(left > UNSEEN * exact.noise_variance)), 1)
    return V[:, :kept].T @ R


def uncertain(exact: Posterior, Z: np.ndarray) -> np.ndarray:
    """Root (M, M) of the covariance of the posterior's weights for correlations with ``Z`` (M, d)."""
    L, _, B = _whitened(exact, exact.features / exact.lengths, Z)
    scale, V = eigh(B)
    return exact.prior_variance * solve_triangular(L, V / np.sqrt(scale), lower=True, trans="T")


def _whitened(exact: Posterior, X: np.ndarray, Z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """L with L L' = K_ZZ, A = L^-1 K_ZX and B = 1 + A A' / noise."""
    s2 = exact.prior_variance
    L = cholesky(s2 * (correlation(Z, Z, exact.kernel) + JITTER * np.eye(len(Z))), lower=True)
    A = solve_triangular(L, s2 * correlation(Z, X, exact.kernel), lower=True)
    return L, A, np.eye(len(Z)) + A @ A.T / exact.noise_variance


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
