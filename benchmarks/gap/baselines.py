"""What the workflow is held against: residuals of the identified base, and a Gaussian process on them."""

from __future__ import annotations

import time

import numpy as np

from .refits import Bench
from .score import Answer

POINTS = 500  # of the Gaussian process
LAGS = (0.0, 0.02, 0.05, 0.1, 0.3)  # of the command [s]


def free_runs(bench: Bench):
    """Free runs of the identified base model: per recording (record, simulated outputs by name), fit then held out."""
    names = [s.name for s in bench.model.flat.outputs]
    residual = (*bench.base.residuals_fit, *bench.base.residuals_report)
    records = (*bench.made.fit, *bench.made.held_out)
    return [
        (record, {n: record[n] + r[:, names.index(n)] for n in bench.made.noise})
        for record, r in zip(records, residual, strict=True)
    ]


def features(bench: Bench, record, run) -> np.ndarray:
    """What the residual may depend on, (n, features): late commands, simulated outputs and their rates."""
    command = record[bench.model.flat.inputs[0].name]
    time_axis = record.time
    columns = [np.interp(time_axis - lag, time_axis, command) for lag in LAGS]
    for values in run.values():
        columns += [values, np.gradient(values, time_axis)]
    return np.column_stack(columns)


def residuals(bench: Bench) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Measured minus simulated over the noise, (n, outputs), of the fit and of the held-out recordings."""
    sigma = np.array([bench.made.noise[n] for n in bench.made.noise])
    names = [s.name for s in bench.model.flat.outputs]
    kept = [names.index(n) for n in bench.made.noise]
    groups = (bench.base.residuals_fit, bench.base.residuals_report)
    return tuple([-r[:, kept] / sigma for r in group] for group in groups)


def gaussian_process(bench: Bench) -> Answer:
    """A Gaussian process per output from command and base model to the residual: predicts, but names nothing."""
    began = time.perf_counter()
    runs = free_runs(bench)
    fit, held_out = residuals(bench)
    X = [features(bench, record, run) for record, run in runs]
    count = len(fit)
    train, sigma = np.concatenate(X[:count]), list(bench.made.noise.values())
    mean, spread = train.mean(axis=0), train.std(axis=0) + 1e-300
    pick = np.random.default_rng(0).choice(len(train), min(POINTS, len(train)), replace=False)
    y = np.concatenate(fit)[pick]
    predict = _trained((train[pick] - mean) / spread, y)
    left = [r - predict((x - mean) / spread) for r, x in zip(held_out, X[count:], strict=True)]
    rmse = np.sqrt(np.mean(np.concatenate(left) ** 2, axis=0)) * sigma
    after = dict(zip(bench.made.noise, rmse.tolist(), strict=True))
    return Answer("unknown", (), bench.rmse(bench.base), after, time.perf_counter() - began)


def _trained(X: np.ndarray, Y: np.ndarray, rounds: int = 60):
    """Hyperparameters by marginal likelihood, one set per output; answers the predictive mean."""
    import gpytorch
    import torch

    torch.manual_seed(0)
    torch.set_num_threads(1)

    class Process(gpytorch.models.ExactGP):
        def __init__(self, x, y, likelihood):
            super().__init__(x, y, likelihood)
            self.mean_module = gpytorch.means.ConstantMean()
            self.covar_module = gpytorch.kernels.ScaleKernel(gpytorch.kernels.RBFKernel(ard_num_dims=x.shape[1]))

        def forward(self, x):
            return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))

    def one(y):
        scale = float(np.std(y)) or 1.0
        x, t = torch.tensor(X), torch.tensor(y / scale)
        likelihood = gpytorch.likelihoods.GaussianLikelihood().double()
        process = Process(x, t, likelihood).double()
        likelihood.noise = min(0.5, 1 / scale**2)
        optimiser = torch.optim.Adam(process.parameters(), lr=0.1)
        loss = gpytorch.mlls.ExactMarginalLogLikelihood(likelihood, process)
        process.train(), likelihood.train()
        for _ in range(rounds):
            optimiser.zero_grad()
            value = -loss(process(x), t)
            value.backward()
            optimiser.step()
        process.eval()

        def mean(points):
            with torch.no_grad():
                return process(torch.tensor(points)).mean.numpy() * scale

        return mean

    means = [one(y) for y in Y.T]
    return lambda points: np.column_stack([mean(points) for mean in means])
