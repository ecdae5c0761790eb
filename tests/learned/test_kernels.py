"""Composable kernels: read, evaluated in numpy and in CasADi alike, with right derivatives; the collapsed bound."""

from __future__ import annotations

import casadi as ca
import numpy as np
import pytest
from scipy.stats import multivariate_normal

from hydrotwin.learned.gaussian import sparse
from hydrotwin.learned.gaussian.kernels import Hyper, Kernel, diagonal_in_casadi, in_casadi, parsed
from hydrotwin.models.language.errors import DeclarationError

FORMULAS = ["rbf", "linear+rbf", "matern32*linear", "linear*(matern32+matern52)+rbf"]
SMALL = 1e-6


def hyper(text: str, d: int = 3) -> Hyper:
    kernel, rng = parsed(text, "test"), np.random.default_rng(1)
    return Hyper(kernel, rng.uniform(0.5, 2, len(kernel.terms)), rng.uniform(0.5, 2, (len(kernel.factors), d)))


def moved(h: Hyper) -> list[Hyper]:
    """Every variance, then every length, a little larger."""
    larger = []
    for name, array in (("variances", h.variances), ("lengths", h.lengths)):
        for k in np.ndindex(array.shape):
            changed = array.copy()
            changed[k] *= np.exp(SMALL)
            larger.append(Hyper(h.kernel, **{"variances": h.variances, "lengths": h.lengths} | {name: changed}))
    return larger


def test_products_are_multiplied_out_and_come_back_from_numbers():
    kernel = parsed(" linear * (matern32 + matern52) + rbf", "test")
    assert kernel.terms == (("linear", "matern32"), ("linear", "matern52"), ("rbf",))
    assert Kernel.of_table(kernel.table()) == kernel and str(kernel) == "linear*matern32+linear*matern52+rbf"


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("rfb", "Did you mean 'rbf'"),
        ("rbf+", "no sum of products"),
        ("(rbf", "no sum of products"),
        ("rbf rbf", "no sum of products"),
        ("", "no sum of products"),
        ("rbf-linear", "has '-' in it"),
        ("__import__('os')", "has '_' in it"),
        ("*".join(["(rbf+linear)"] * 4), "multiplied out"),
    ],
)
def test_what_is_no_kernel_is_refused_in_a_sentence(text, sentence):
    with pytest.raises(DeclarationError, match=sentence):
        parsed(text, "test")


@pytest.mark.parametrize("text", FORMULAS)
def test_numpy_and_casadi_agree_and_all_derivatives_are_those_of_differences(text):
    h, rng = hyper(text), np.random.default_rng(2)
    a, b, G, w = rng.normal(size=(5, 3)), rng.normal(size=(4, 3)), rng.normal(size=(5, 4)), rng.normal(size=5)
    z = ca.MX.sym("z", 3)
    function = ca.Function("k", [z], [in_casadi(h, a, z), diagonal_in_casadi(h, z)])
    for k, row in enumerate(b):
        values, diagonal = (part.full().ravel() for part in function(row))
        assert np.allclose(values, h.values(a, b)[:, k], rtol=1e-9) and np.allclose(diagonal, h.diagonal(b)[k])
    found = np.concatenate([part.ravel() for part in h.gradient(a, b, G)])
    expected = [np.sum(G * (m.values(a, b) - h.values(a, b))) / SMALL for m in moved(h)]
    assert np.allclose(found, expected, atol=1e-4)
    found = np.concatenate([part.ravel() for part in h.diagonal_gradient(a, 0.7)])
    assert np.allclose(found, [0.7 * (m.diagonal(a) - h.diagonal(a)).sum() / SMALL for m in moved(h)], atol=1e-4)
    slopes = h.slopes(a, b, w, 2)
    for j in range(2):
        further = b + SMALL * (np.arange(3) == j)
        assert np.allclose((w @ h.values(a, further) - w @ h.values(a, b)) / SMALL, slopes[:, j], atol=1e-4)


def test_the_bound_is_titsias_and_its_gradient_that_of_differences_in_chunks_too(monkeypatch):
    h, rng, noise = hyper("linear+rbf*matern32"), np.random.default_rng(3), 0.05
    X = rng.normal(size=(40, 3))
    y, Z = np.sin(X[:, 0]) + 0.1 * rng.normal(size=40), X[:7]
    value, gradient = sparse.bound(h, noise, X, y, Z)
    Q = h.values(X, Z) @ np.linalg.solve(h.values(Z, Z), h.values(Z, X))
    likelihood = multivariate_normal(np.zeros(40), Q + noise * np.eye(40)).logpdf(y)
    assert -40 * value == pytest.approx(likelihood - 0.5 * (h.diagonal(X).sum() - np.trace(Q)) / noise, rel=1e-5)
    moves = [sparse.bound(m, noise, X, y, Z)[0] for m in moved(h)]
    moves.append(sparse.bound(h, noise * np.exp(SMALL), X, y, Z)[0])
    assert np.allclose(gradient, (np.array(moves) - value) / SMALL, atol=1e-4)
    monkeypatch.setattr(sparse, "CHUNK", 16)
    assert np.allclose(sparse.bound(h, noise, X, y, Z)[1], gradient, rtol=1e-9)


def test_with_every_row_as_a_point_the_posterior_is_the_exact_one():
    h, rng, noise = hyper("rbf+linear"), np.random.default_rng(4), 0.1
    X = rng.normal(size=(25, 3))
    y, at = rng.normal(size=25), rng.normal(size=(6, 3))
    mean, variance = sparse.conditioned(h, noise, X, y, X).at(at)
    K, k = h.values(X, X) + noise * np.eye(25), h.values(X, at)
    assert np.allclose(mean, k.T @ np.linalg.solve(K, y), atol=1e-5)
    assert np.allclose(variance, h.diagonal(at) - np.sum(k * np.linalg.solve(K, k), axis=0), atol=1e-5)


def test_training_finds_the_noise_and_leaves_out_a_feature_that_says_nothing():
    rng = np.random.default_rng(5)
    X = rng.uniform(-2, 2, (400, 2))
    y = np.sin(2 * X[:, 0]) + 0.1 * rng.normal(size=400)
    found = sparse.train_sparse(X, y, sparse.spread_points(X, 40, rng), parsed("rbf", "test"))
    assert found.noise**0.5 == pytest.approx(0.1, rel=0.15)
    assert found.hyper.lengths[0, 1] > 10 * found.hyper.lengths[0, 0]
