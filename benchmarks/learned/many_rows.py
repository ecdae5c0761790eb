"""Many rows for a Gaussian process with output feedback: the collapsed bound of `sparse` beside GPyTorch's minibatches.

    python -m benchmarks.learned.many_rows [--rows 10000 20000 50000] [--points 60] [--scoreboard docs/scoreboard.md]

The rig's C-EHA arm at 100 Hz under the smooth drive command, its angle with noise. Everybody learns the same increments
from the same features with the same kernel and number of inducing points, begun from the same points and
hyper-parameters, and is judged on runs that nobody saw: one step ahead (RMSE over the increments' spread, negative log
density), and in free run of the block's own recursion (degrees), the weights as they come out of the one-step fit.

    collapsed, 2000 rows   hyper-parameters from 2000 random rows, weights from all: what `learn gp` does
    collapsed, all rows    both from all
    minibatch              GPyTorch's whitened variational process, Adam, 1024 rows a step; its points move, too
    exact, 6000 rows       GPyTorch's exact process of 6000 random rows: what the process of delayed inputs does

Each in a process of its own: processor seconds, and the most memory it took beyond what it began with.
"""

from __future__ import annotations

import argparse
import resource
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from benchmarks.learned.page import put_section
from benchmarks.learned.symbolic import recording
from hydrotwin.learned.gaussian.feedback_run import Basis, Lags, stretches
from hydrotwin.learned.gaussian.feedback_training import Effort, Form, Trained, at_period, one_step, prepared
from hydrotwin.learned.gaussian.kernels import Hyper, Kernel
from hydrotwin.learned.gaussian.sparse import FIRST_LENGTH, FIRST_NOISE, Sparse, conditioned, factor_of, spread_points
from hydrotwin.models.language.flat import Signal

RATE, SECONDS = 100.0, 62.5
JUDGES = (500, 501)  # seeds of the runs that judge
INPUT, OUTPUT = Signal("command", "V"), Signal("arm_angle", "rad")
KERNEL = Kernel((("rbf",),))
LAGS = Lags(1, 1, 1, 2, 3)
BATCH, RATE_OF_ADAM, STEPS = 1024, 1e-2, (1000, 3000)
EXACT_ROWS, EXACT_FIT = 6000, 1000
CONTENDERS = ("collapsed, 2000 rows", "collapsed, all rows", *(f"minibatch, {n} steps" for n in STEPS),
              f"exact, {EXACT_ROWS} rows")  # fmt: skip


@dataclass(frozen=True)
class Found:
    """One training: one step ahead, in free run [deg], processor seconds, MB."""

    error: float
    density: float
    free_run: float
    seconds: float
    memory: float


def tried(contender: str, rows: int, points: int) -> Found:
    """Train one contender and judge it."""
    count = -(-rows // round(SECONDS * RATE))
    records = [recording(seed, SECONDS, RATE).select(["command", "arm_angle"]) for seed in range(count)]
    judges = [recording(seed, SECONDS, RATE).select(["command", "arm_angle"]) for seed in JUDGES]
    data = prepared(records, [INPUT], [OUTPUT], 1 / RATE)
    form, effort = Form(1 / RATE, LAGS, KERNEL), Effort(points, 2000, 80)
    X, t = pairs(data, data.runs, rows)
    unseen = pairs(data, at_period(judges, [INPUT], [OUTPUT], 1 / RATE), None)
    begun = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    clock = time.process_time()
    if contender.startswith("exact"):
        process = exact(X, t)
    elif contender.startswith("minibatch"):
        process = minibatch(X, t, points, int(contender.split()[1]))
    else:
        process = collapsed(X, t, points, 2000 if "2000" in contender else len(X))
    seconds = time.process_time() - clock
    memory = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - begun) / 1024
    mean, variance = process.at(unseen[0])
    variance = variance + process.noise
    miss = unseen[1] - mean
    density = float(np.mean(0.5 * np.log(2 * np.pi * variance) + 0.5 * miss**2 / variance))
    free = np.nan
    if isinstance(process, Sparse):
        free = run_of(process, replace(one_step(data, form, replace(effort, evaluations=1)), form=form), judges)
    return Found(float(np.sqrt(np.mean(miss**2))), density, free, seconds, memory)


def pairs(data, runs, most: int | None) -> tuple[np.ndarray, np.ndarray]:
    """Features (n, d) and increments (n,) over scales, as `feedback_training.one_step` makes them."""
    parts = stretches(data.normal(runs), LAGS, data.step, 1)
    X = np.concatenate([np.hstack([s.y, s.d, s.lines[0]]) for s in parts])
    t = np.concatenate([((s.target[0] - s.y) / data.step)[:, 0] for s in parts])
    return X[:most], t[:most]


def collapsed(X, t, points: int, rows: int) -> Sparse:
    from hydrotwin.learned.gaussian.sparse import train_sparse

    rng = np.random.default_rng(0)
    Z = spread_points(X, points, rng)
    some = np.sort(rng.permutation(len(X))[:rows])
    first = train_sparse(X[some], t[some], Z, KERNEL, evaluations=80)
    return conditioned(first.hyper, first.noise, X, t, Z, first.loss, first.evaluations)


def minibatch(X, t, points: int, steps: int) -> Sparse:
    """GPyTorch's whitened variational process (Hensman, Fusi, Lawrence, UAI 2013), as the arrays of `Sparse`."""
    import gpytorch
    import torch

    torch.manual_seed(0)
    torch.set_num_threads(1)
    torch.set_default_dtype(torch.float64)
    Z = torch.tensor(spread_points(X, points, np.random.default_rng(0)))

    class Process(gpytorch.models.ApproximateGP):
        def __init__(self):
            q = gpytorch.variational.CholeskyVariationalDistribution(len(Z))
            super().__init__(gpytorch.variational.VariationalStrategy(self, Z, q, learn_inducing_locations=True))
            self.mean_module = gpytorch.means.ZeroMean()
            self.covar_module = gpytorch.kernels.ScaleKernel(gpytorch.kernels.RBFKernel(ard_num_dims=Z.shape[1]))
            self.covar_module.base_kernel.lengthscale = FIRST_LENGTH
            self.covar_module.outputscale = 1.0

        def forward(self, x):
            return gpytorch.distributions.MultivariateNormal(self.mean_module(x), self.covar_module(x))

    likelihood = gpytorch.likelihoods.GaussianLikelihood(noise_constraint=gpytorch.constraints.GreaterThan(1e-8))
    likelihood.noise = FIRST_NOISE
    model, inputs, targets = Process(), torch.tensor(X), torch.tensor(t)
    bound = gpytorch.mlls.VariationalELBO(likelihood, model, num_data=len(X))
    adam = torch.optim.Adam([*model.parameters(), *likelihood.parameters()], lr=RATE_OF_ADAM)
    model.train(), likelihood.train()
    value, rng = torch.tensor(np.nan), np.random.default_rng(0)
    for _ in range(steps):
        some = rng.integers(len(X), size=min(BATCH, len(X)))
        adam.zero_grad()
        value = -bound(model(inputs[some]), targets[some])
        value.backward()
        adam.step()
    kernel, strategy = model.covar_module, model.variational_strategy
    lengths = kernel.base_kernel.lengthscale.detach().numpy().reshape(1, -1)
    hyper = Hyper(KERNEL, np.array([float(kernel.outputscale)]), lengths)
    points_ = strategy.inducing_points.detach().numpy()
    q = strategy._variational_distribution()
    return Sparse(hyper, points_, factor_of(hyper, points_), q.mean.detach().numpy(),
                  q.covariance_matrix.detach().numpy(), float(likelihood.noise), float(value), steps)  # fmt: skip


class Exact:
    """An exact process with what `tried` asks of one."""

    def __init__(self, trained):
        self.trained, self.noise = trained, trained.noise_variance

    def at(self, z):
        found = [self.trained.predict(part) for part in np.array_split(z, 8)]
        return np.concatenate([m for m, _ in found]), np.concatenate([s for _, s in found]) ** 2


def exact(X, t) -> Exact:
    from hydrotwin.learned.gaussian import exact as exact_gp

    rng = np.random.default_rng(0)
    some = np.sort(rng.permutation(len(X))[:EXACT_ROWS])
    return Exact(exact_gp.train(X[some], t[some], kernel="rbf", fit="default", points=EXACT_FIT, rng=rng))


def run_of(process: Sparse, shell: Trained, judges) -> float:
    """RMS of free runs over the runs that judge, degrees."""
    inverse = np.linalg.inv(process.factor)
    basis = Basis(process.hyper, process.points, process.factor, inverse)
    trained = replace(shell, model=replace(shell.model, bases=(basis,)), weights=[process.mean])
    runs = at_period(judges, [INPUT], [OUTPUT], 1 / RATE)
    miss = np.concatenate([run[:, 0] - y[:, 0] for run, (_, y) in zip(trained.runs(runs), runs, strict=True)])
    return float(np.degrees(np.sqrt(np.mean(miss**2))))


LEAD = (
    "The rig's C-EHA arm at 100 Hz, increments of its angle from the same features, kernel (rbf) and {points} inducing "
    "points; unseen runs: RMSE one step ahead over the spread of the increments, negative log density, free run with "
    "the weights of the one-step fit (`learn gp` fits them to free runs afterwards), processor seconds in one thread, "
    "memory beyond what the process began with. Minibatches are GPyTorch's whitened variational process "
    "(Adam 0.01, 1024 rows a step). `learn gp` takes the first way: one step ahead it is more accurate at a fiftieth "
    "of the time; before their fit, free runs are off by chance."
)
MADE_BY = "Made by `python -m benchmarks.learned.many_rows --scoreboard docs/scoreboard.md`."


def written(page: Path, lines: Sequence[str], points: int) -> None:
    """The section of the page."""
    parts = [LEAD.format(points=points), "", *lines, "", MADE_BY]
    put_section(page, "Many rows for a Gaussian process", "\n".join(parts))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, nargs="+", default=[10_000, 20_000, 50_000])
    parser.add_argument("--points", type=int, default=60)
    parser.add_argument("--scoreboard", type=Path, help="write the section of this page")
    given = parser.parse_args()
    lines = ["| rows | | one step | density | free run [deg] | CPU s | MB |", "|---|---|---|---|---|---|---|"]
    for rows in given.rows:
        for contender in CONTENDERS:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                f = pool.submit(tried, contender, rows, given.points).result()
            free = "" if np.isnan(f.free_run) else f"{f.free_run:.3g}"
            lines.append(f"| {rows} | {contender} | {f.error:.4f} | {f.density:.4f} | {free} | {f.seconds:.1f} | "
                         f"{f.memory:.0f} |")  # fmt: skip
            print(lines[-1], flush=True)
    if given.scoreboard:
        written(given.scoreboard, lines, given.points)


if __name__ == "__main__":
    main()
