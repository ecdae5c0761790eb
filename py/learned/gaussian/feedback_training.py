"""One Gaussian process with output feedback from recordings: normalised data, one-step fit, fit to free runs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, noise_floor

from ..training_data import free_run_bounds, increment_spread, on_period
from .feedback_run import Basis, Lags, Model, Stretch, free_run, refined, stretches
from .kernels import Kernel
from .sparse import conditioned, spread_points, train_sparse

MARGIN = 0.3  # of the range seen in training: how far the features of the mean may go beyond it
LEAST_NOISE = 1e-5  # of an output's spread: the least that a free run is taken to miss by
HORIZONS = (16, 64, 256, None)  # samples of the runs that weights are fitted to, in turn; None: whole recordings
ITERATIONS = 8  # of the fit to runs of one length
STEPS = 6000  # samples of the runs of one length, at most
LONGEST = 3000  # samples of a whole recording that weights are still fitted to


@dataclass(frozen=True, eq=False)
class Data:
    """Recordings at one period: inputs (n, nu) and outputs (n, ny) of each, SI; their scales; noise floors (ny,)."""

    period: float
    runs: list[tuple[np.ndarray, np.ndarray]]
    arrays: dict[str, np.ndarray]
    floor: np.ndarray

    def normal(self, runs: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Runs over these scales."""
        a = self.arrays
        return [
            ((u - a["input_centre"]) / a["input_scale"], (y - a["output_centre"]) / a["output_scale"]) for u, y in runs
        ]

    @property
    def step(self) -> np.ndarray:
        """An increment's scale over the output's, (ny,)."""
        return self.arrays["increment_scale"] / self.arrays["output_scale"]


@dataclass(frozen=True)
class Form:
    """What was chosen: seconds between steps, what a step sees, runs that the weights were fitted to (0: one step).

    seed : of the inducing points, and of the rows and runs that take part.
    """

    period: float
    lags: Lags
    kernel: Kernel
    stages: int = 0
    seed: int = 0

    def told(self) -> dict:
        """For the provenance."""
        horizons = ("one step", *("whole recordings" if h is None else f"{h} steps" for h in HORIZONS))
        told = {"period": self.period, **self.lags.structure(), "kernel": str(self.kernel)}
        return told | {"fitted_to": horizons[self.stages]}


@dataclass(frozen=True, eq=False)
class Trained:
    """A process with its weights, their posterior, and how it came about."""

    form: Form
    data: Data
    model: Model
    weights: list[np.ndarray]
    covariance: np.ndarray
    noise: np.ndarray
    step_noise: np.ndarray
    loss: float

    def runs(self, runs: Sequence[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
        """Free runs over recordings (SI) from their first outputs, (n, ny) each, SI; nan from where one diverged."""
        a = self.data.arrays
        parts = [stretches([run], self.form.lags, self.data.step, None)[0] for run in self.data.normal(runs)]
        found = [np.concatenate([s.y, free_run(self.model, self.weights, s)[:, 0]]) for s in parts]
        return [a["output_centre"] + a["output_scale"] * y for y in found]


def at_period(records: Sequence[Record], inputs: Sequence[Signal], outputs: Sequence[Signal], period: float):
    """Inputs (n, nu) and outputs (n, ny) of every recording, SI."""
    names = [[s.name for s in part] for part in (inputs, outputs)]
    even = [on_period(r.select([*names[0], *names[1]]), period, inputs) for r in records]
    return [tuple(r.array(part) for part in names) for r in even]


def prepared(records: Sequence[Record], inputs: Sequence[Signal], outputs: Sequence[Signal], period: float) -> Data:
    """Recordings at a period with the scales that are written into the block."""
    runs = at_period(records, inputs, outputs, period)
    u, y = (np.concatenate(part) for part in zip(*runs, strict=True))
    ys = [y for _, y in runs]
    names = [s.name for s in outputs]
    floors = [noise_floor(r.select(names)) for r in records]
    arrays = {
        "input_centre": u.mean(axis=0),
        "input_scale": np.where(u.std(axis=0) > 0, u.std(axis=0), 1.0),
        "output_centre": y.mean(axis=0),
        "output_scale": np.where(y.std(axis=0) > 0, y.std(axis=0), 1.0),
        **free_run_bounds(ys, increment_spread(ys)),
    }
    return Data(period, runs, arrays, np.array([np.median([f[n].sigma for f in floors]) for n in names]))


@dataclass(frozen=True)
class Effort:
    """How much one training may cost: inducing points, rows and evaluations of the one-step fit."""

    points: int
    rows: int
    evaluations: int


def stages(data: Data, form: Form, effort: Effort) -> Iterator[Trained]:
    """The process after the one-step fit, then after the fit to runs of every length of `HORIZONS` in turn."""
    trained = one_step(data, form, effort)
    yield trained
    least = np.maximum(LEAST_NOISE, data.floor / data.arrays["output_scale"]) ** 2
    longest = max(len(u) for u, _ in data.runs)
    for n, horizon in enumerate(HORIZONS, start=1):
        if longest > LONGEST if horizon is None else longest < 2 * horizon:
            continue
        parts = _thinned(stretches(data.normal(data.runs), form.lags, data.step, horizon), form.seed)
        found = refined(trained.model, trained.weights, parts, ITERATIONS, least_noise=least)
        trained = replace(
            trained, form=replace(form, stages=n), weights=found.weights, covariance=found.covariance, noise=found.noise
        )
        yield trained


def one_step(data: Data, form: Form, effort: Effort) -> Trained:
    """Hyper-parameters and weights from each sample to the next."""
    lags, rng = form.lags, np.random.default_rng(form.seed)
    parts = stretches(data.normal(data.runs), lags, data.step, 1)
    X = _rows(parts, lags)
    T = np.concatenate([(s.target[0] - s.y) / data.step for s in parts])
    Z = spread_points(X, effort.points, rng)
    some = slice(None) if len(X) <= effort.rows else np.sort(rng.permutation(len(X))[: effort.rows])
    bases, weights, noise, losses, blocks = [], [], [], [], []
    for target in T.T:
        first = train_sparse(X[some], target[some], Z, form.kernel, evaluations=effort.evaluations)
        process = conditioned(first.hyper, first.noise, X, target, Z)
        bases.append(Basis(process.hyper, Z, process.factor, np.linalg.inv(process.factor)))
        weights.append(process.mean)
        noise.append(process.noise)
        losses.append(first.loss)
        blocks.append(process.covariance)
    low, high = X.min(axis=0), X.max(axis=0)
    room, a = MARGIN * (high - low), data.arrays
    bounds = tuple((a[f"output_{side}"] - a["output_centre"]) / a["output_scale"] for side in ("lower", "upper"))
    model = Model(lags, tuple(bases), data.step, a["increment_limit"], bounds, (low - room, high + room))
    one = np.sqrt(noise) * data.step
    return Trained(form, data, model, weights, _diagonal(blocks), one**2, one, float(np.mean(losses)))


def _rows(parts: Sequence[Stretch], lags: Lags) -> np.ndarray:
    return np.concatenate([np.hstack([[s.y, s.d], [s.d]][1 - lags.level] + [s.lines[0]]) for s in parts])


def _diagonal(blocks: Sequence[np.ndarray]) -> np.ndarray:
    ends = np.cumsum([0, *map(len, blocks)])
    whole = np.zeros((ends[-1], ends[-1]))
    for block, a, b in zip(blocks, ends[:-1], ends[1:], strict=True):
        whole[a:b, a:b] = block
    return whole


def _thinned(parts: Sequence[Stretch], seed: int) -> list[Stretch]:
    """At most `STEPS` samples, a random choice of the runs."""
    total = sum(s.target.shape[0] * s.target.shape[1] for s in parts)
    if total <= STEPS:
        return list(parts)
    rng, kept = np.random.default_rng(seed), []
    for s in parts:
        most = max(1, int(len(s.y) * STEPS / total))
        k = np.sort(rng.permutation(len(s.y))[:most])
        kept.append(Stretch(s.y[k], s.d[k], s.lines[:, k], s.target[:, k]))
    return kept
