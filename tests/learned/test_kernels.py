"""Composable kernels: read, evaluated in numpy and in CasADi alike, with right derivatives; the collapsed bound."""

from __future__ import annotations

import time
import tracemalloc

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


def rows(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Features (n, 2) and a smooth function of them with noise."""
    rng = np.random.default_rng(5)
    X = rng.normal(size=(n, 2))
    return X, np.sin(2 * X[:, 0]) + 0.3 * X[:, 1] + 0.1 * rng.normal(size=n)


def test_what_minibatches_search_for_is_known_in_closed_form():
    """GPyTorch's whitened variational bound of all rows is `bound` at our Gaussian, and level there in its mean."""
    gpytorch, torch = pytest.importorskip("gpytorch"), pytest.importorskip("torch")
    X, y = rows(300)
    Z = sparse.spread_points(X, 15, np.random.default_rng(0))
    found = sparse.train_sparse(X, y, Z, parsed("rbf", "test"), evaluations=30)

    class Process(gpytorch.models.ApproximateGP):
        def __init__(self):
            q = gpytorch.variational.CholeskyVariationalDistribution(len(Z))
            jitter = sparse.JITTER * float(found.hyper.variances.sum())
            super().__init__(gpytorch.variational.VariationalStrategy(self, torch.tensor(Z), q, jitter_val=jitter))
            self.kernel = gpytorch.kernels.ScaleKernel(gpytorch.kernels.RBFKernel(ard_num_dims=2))

        def forward(self, x):
            return gpytorch.distributions.MultivariateNormal(torch.zeros(len(x), dtype=x.dtype), self.kernel(x))

    likelihood = gpytorch.likelihoods.GaussianLikelihood(noise_constraint=gpytorch.constraints.GreaterThan(1e-8))
    model, likelihood = Process().double(), likelihood.double()
    likelihood.noise, model.kernel.outputscale = found.noise, float(found.hyper.variances[0])
    model.kernel.base_kernel.lengthscale = torch.tensor(found.hyper.lengths)
    q = model.variational_strategy._variational_distribution
    model.variational_strategy.variational_params_initialized.fill_(1)
    with torch.no_grad():
        q.variational_mean.copy_(torch.tensor(found.mean))
        q.chol_variational_covar.copy_(torch.tensor(np.linalg.cholesky(found.covariance)))
    mll = gpytorch.mlls.VariationalELBO(likelihood, model, num_data=len(X))
    value = mll(model(torch.tensor(X)), torch.tensor(y))
    value.backward()
    assert -float(value.detach()) == pytest.approx(found.loss, abs=1e-4)
    assert float(q.variational_mean.grad.abs().max()) < 1e-4


def test_weights_of_twenty_thousand_rows_take_seconds_and_little_memory_and_are_those_of_an_exact_process():
    X, y = rows(20_000)
    Z = sparse.spread_points(X, 60, np.random.default_rng(0))
    first = sparse.train_sparse(X[:1000], y[:1000], Z, parsed("rbf", "test"), evaluations=40)
    tracemalloc.start()
    began = time.process_time()
    found = sparse.conditioned(first.hyper, first.noise, X, y, Z)
    spent, peak = time.process_time() - began, tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert spent < 2.0 and peak < 50e6, "0.2 s on a quiet core, and never rows^2 numbers"
    at = np.random.default_rng(1).uniform(-2, 2, (200, 2))
    truth = np.sin(2 * at[:, 0]) + 0.3 * at[:, 1]
    assert np.sqrt(np.mean((found.at(at)[0] - truth) ** 2)) < 0.02
    few = sparse.conditioned(first.hyper, first.noise, X[:1000], y[:1000], Z).at(at)
    exact = sparse.conditioned(first.hyper, first.noise, X[:1000], y[:1000], X[:1000]).at(at)
    assert np.abs(few[0] - exact[0]).max() < 0.02, "of a spread of 0.8"
