"""Exact Gaussian-process regression with GPyTorch: hyper-parameters by marginal likelihood, then all the data.

    log p(y | X) = -1/2 y' K^-1 y - 1/2 log |K| - n/2 log 2 pi,   K = k(X, X) + noise

Everything in float64 and by Cholesky: GPyTorch would go over to conjugate gradients above 800 points, and its float32
loses the noise. Inputs and targets are normalised by the caller. Source: Gardner et al., NeurIPS 2018 (GPyTorch).
"""

from __future__ import annotations

import contextlib
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import gpytorch
import numpy as np
import torch
from gpytorch.constraints import Positive
from scipy.optimize import minimize

from hydrotwin.models.language.errors import SolveError

from ..device import array, tensor
from ..interruption import INTERRUPTED, CtrlC
from .compression import Posterior

BOUNDS = {"lengthscale": (1e-2, 1e3), "outputscale": (1e-3, 1e3), "noise": (1e-8, 10.0), "constant": (-5.0, 5.0)}
EVALUATIONS = 200
PAPER_STEPS, PAPER_RATE = 100, 1e-2
HURRIED = 100  # rows for the hyper-parameters of a process whose turn comes after Ctrl-C: a fraction of a second


@dataclass(frozen=True)
class GaussianProcessProgress:
    """One evaluation of the marginal likelihood: the loss is -log p(y | X) per sample, of normalised data."""

    process: str
    iteration: int
    loss: float
    best: float


@dataclass(frozen=True, eq=False)
class TrainedProcess:
    """What was found, and GPyTorch's model to compare with; all in normalised units.

    lengths (d,), prior_variance, noise_variance, constant: hyper-parameters. posterior: of all the data.
    """

    posterior: Posterior
    noise_variance: float
    loss: float
    iterations: int
    seconds: float
    stopped: str
    model: gpytorch.models.ExactGP

    def predict(self, features: np.ndarray, deviation: bool = True) -> tuple[np.ndarray, np.ndarray | None]:
        """GPyTorch's own mean and latent standard deviation (when asked) at ``features`` (n, d), each (n,)."""
        with torch.no_grad(), _exact():
            answer = self.model(tensor(features))
            return array(answer.mean), array(answer.variance.clamp_min(0.0).sqrt()) if deviation else None


class _Exact(gpytorch.models.ExactGP):
    """A constant mean and one scaled ARD kernel."""

    def __init__(self, X, y, likelihood, kernel):
        super().__init__(X, y, likelihood)
        self.mean_module = gpytorch.means.ConstantMean()
        self.covar_module = gpytorch.kernels.ScaleKernel(kernel)

    def forward(self, x):
        return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))


def train(
    X: np.ndarray,
    y: np.ndarray,
    *,
    kernel: str,
    fit: str,
    points: int | None,
    rng: np.random.Generator,
    process: str = "",
    progress: Callable | None = None,
    ctrl_c: CtrlC | None = None,
) -> TrainedProcess:
    """Fit the hyper-parameters on ``points`` random rows of X (n, d), y (n,), then condition on all of them.

    fit : "default", L-BFGS on the logarithms within bounds; "paper", 100 Adam steps of 1e-2 from GPyTorch's defaults.
    ctrl_c : ends the fit between two evaluations with the best hyper-parameters so far; where it came before the fit,
    `HURRIED` rows give them. A KeyboardInterrupt out of ``progress`` is taken as Ctrl-C.
    """
    began, ctrl_c = time.perf_counter(), ctrl_c or CtrlC()
    hurried = ctrl_c.came
    points = HURRIED if hurried else points
    chosen = np.arange(len(X)) if points is None or points >= len(X) else np.sort(rng.permutation(len(X))[:points])
    model = _model(tensor(X[chosen]), tensor(y[chosen]), kernel, softplus=fit == "paper")
    search = _Search(model, process, progress, CtrlC() if hurried else ctrl_c)
    with _exact():
        try:
            stopped = (search.adam if fit == "paper" else search.lbfgs)()
        except _Ended:
            stopped = INTERRUPTED
        except KeyboardInterrupt:
            if ctrl_c.came or not search.iteration:
                raise
            stopped, ctrl_c.came = INTERRUPTED, True
        search.take_best()
        posterior = _condition(model, X, y, kernel)
    seconds = time.perf_counter() - began
    noise = float(model.likelihood.noise.detach())
    stopped = INTERRUPTED if hurried else stopped
    return TrainedProcess(posterior, noise, search.best, search.iteration, seconds, stopped, model)


def _model(X, y, kernel: str, softplus: bool) -> _Exact:
    """GPyTorch's model in float64; parameters kept as logarithms unless its own transform is asked for."""

    def positive():
        return Positive() if softplus else Positive(transform=torch.exp, inv_transform=torch.log)

    options = {"ard_num_dims": X.shape[1], "lengthscale_constraint": positive()}
    if kernel == "rbf":
        part = gpytorch.kernels.RBFKernel(**options)
    else:
        part = gpytorch.kernels.MaternKernel(nu=1.5, **options)
    noise = gpytorch.constraints.GreaterThan(1e-4) if softplus else positive()
    likelihood = gpytorch.likelihoods.GaussianLikelihood(noise_constraint=noise)
    model = _Exact(X, y, likelihood, part)
    model.covar_module.raw_outputscale_constraint = positive()
    model = model.to(X)
    if not softplus:
        model.initialize(**{"covar_module.outputscale": 1.0, "likelihood.noise": 0.1})
        part.lengthscale = 2.0
    return model


class _Ended(Exception):
    """Ctrl-C came."""


class _Search:
    """The marginal likelihood of a model as a function of its parameters, and the best of them so far."""

    def __init__(self, model: _Exact, process: str, progress: Callable | None, ctrl_c: CtrlC):
        self.model, self.process, self.progress, self.ctrl_c = model, process, progress, ctrl_c
        self.likelihood = gpytorch.mlls.ExactMarginalLogLikelihood(model.likelihood, model)
        self.parameters = list(model.named_parameters())
        self.best, self.kept, self.iteration = np.inf, self._values(), 0
        model.train()

    def lbfgs(self) -> str:
        """L-BFGS-B within `BOUNDS`, on logarithms where the parameter is positive."""
        bounds = [b for name, p in self.parameters for b in [_bounds(name)] * p.numel()]
        with np.errstate(all="ignore"):
            found = minimize(
                self._loss_and_gradient, self._values(), jac=True, bounds=bounds, method="L-BFGS-B",
                options={"maxfun": EVALUATIONS, "maxiter": EVALUATIONS, "ftol": 1e-7, "gtol": 1e-4},
            )  # fmt: skip
        return "finished" if found.success else f"{found.message}".lower()

    def adam(self) -> str:
        """The paper's optimizer and rate."""
        optimizer = torch.optim.Adam([p for _, p in self.parameters], lr=PAPER_RATE)
        for _ in range(PAPER_STEPS):
            optimizer.zero_grad()
            self._backward()
            optimizer.step()
        return "finished"

    def take_best(self) -> None:
        """Put the best parameters into the model."""
        if not np.isfinite(self.best):
            raise SolveError(
                f"{self.process}: the marginal likelihood was never finite (after {self.iteration} evaluations). "
                "Check the recordings for outliers."
            )
        self._set(self.kept)

    def _loss_and_gradient(self, values: np.ndarray) -> tuple[float, np.ndarray]:
        self._set(values)
        self.model.zero_grad()
        try:
            loss = self._backward()
        except (RuntimeError, ValueError):  # not positive definite; the line search steps back
            return 1e10, np.zeros(len(values))
        return loss, np.concatenate([array(p.grad).ravel() for _, p in self.parameters])

    def _backward(self) -> float:
        at = self._values()
        loss = -self.likelihood(self.model(*self.model.train_inputs), self.model.train_targets)
        loss.backward()
        value = float(loss.detach())
        self.iteration += 1
        if value < self.best:
            self.best, self.kept = value, at
        if self.progress:
            self.progress(GaussianProcessProgress(self.process, self.iteration, value, self.best))
        if self.ctrl_c.came:
            raise _Ended
        return value

    def _values(self) -> np.ndarray:
        return np.concatenate([array(p).ravel() for _, p in self.parameters])

    def _set(self, values: np.ndarray) -> None:
        with torch.no_grad():
            for (_, p), part in zip(self.parameters, np.split(values, self._ends()), strict=True):
                p.copy_(tensor(part).reshape(p.shape))

    def _ends(self) -> np.ndarray:
        return np.cumsum([p.numel() for _, p in self.parameters])[:-1]


def _bounds(name: str) -> tuple[float, float]:
    key, (low, high) = next(item for item in BOUNDS.items() if item[0] in name)
    return (low, high) if key == "constant" else (float(np.log(low)), float(np.log(high)))


def _condition(model: _Exact, X: np.ndarray, y: np.ndarray, kernel: str) -> Posterior:
    """GPyTorch's posterior of all the data: K^-1 (y - constant) is its own ``mean_cache``."""
    model.set_train_data(tensor(X), tensor(y), strict=False)
    model.eval()
    with torch.no_grad():
        model(tensor(X[:1]))  # builds the prediction strategy
        weights = array(model.prediction_strategy.mean_cache).ravel()
        return Posterior(
            kernel,
            X,
            y,
            weights,
            lengths=array(model.covar_module.base_kernel.lengthscale).ravel().copy(),
            prior_variance=float(model.covar_module.outputscale),
            noise_variance=float(model.likelihood.noise),
            constant=float(model.mean_module.constant),
        )


@contextlib.contextmanager
def _exact():
    """Cholesky whatever the size, and quiet about the jitter that it adds where it must."""
    with gpytorch.settings.max_cholesky_size(10**9), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield
