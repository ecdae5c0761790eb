"""Training of the network on its own free run, in PyTorch.

The network is run from a measured start over a stretch of recording, feeding back its own outputs. The derivatives of
every simulated sample with respect to every weight are carried along (real-time recurrent learning), so that each
iteration is a Levenberg-Marquardt step on the simulation error of all stretches at once:

    minimise  mean |y_sim - y|^2 + decay |w|^2

Stretches grow from a few samples, which is one-step training, to whole recordings. Sources: Williams, Zipser, Neural
Computation 1 (1989) 270-280; Hagan, Menhaj, IEEE Trans. Neural Networks 5 (1994) 989-993.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch

from hydrotwin.models.language.errors import SolveError

from ..device import REAL, array, tensor
from ..interruption import INTERRUPTED
from ..training_data import smoothed
from .narx import NarxShape

MEMORY = 2.5e7  # numbers held at a time while derivatives are carried along


@dataclass(frozen=True)
class Stage:
    """Stretches of ``horizon`` samples (None: whole recordings), compared at every ``every``-th sample.

    The network is judged on the held-out data every ``judge``-th iteration and at the end.
    """

    horizon: int | None
    iterations: int
    every: int = 1
    judge: int = 1


@dataclass(frozen=True)
class TrainingProgress:
    """One accepted iteration. Errors are RMS over outputs, each divided by its spread; ``best`` is on held-out data."""

    seed: int
    horizon: int
    iteration: int
    train_error: float
    held_out_error: float
    best: float
    seconds: float


@dataclass(frozen=True)
class Trained:
    """The weights with the smallest free-run error on held-out data."""

    weights: np.ndarray
    seed: int
    held_out_error: float
    seconds: float
    iterations: int
    stopped: str


@dataclass(frozen=True)
class Stretches:
    """B stretches, time first: start outputs (B, ny), start increments (B, nd ny), inputs (T, B, nu m), targets."""

    y: torch.Tensor
    d: torch.Tensor
    u: torch.Tensor
    target: torch.Tensor


@dataclass(frozen=True)
class Scales:
    """What the free run needs besides weights, normalised.

    Per output: increment per output unit, bounds of increment and output. Per feature: the range seen in training.
    """

    increment: torch.Tensor
    limit: torch.Tensor
    lower: torch.Tensor
    upper: torch.Tensor
    feature_lower: torch.Tensor
    feature_upper: torch.Tensor

    @classmethod
    def of(cls, arrays: Mapping[str, np.ndarray]) -> Scales:
        """From the arrays of a block (`narx.array_shapes`), SI."""
        centre, spread = arrays["output_centre"], arrays["output_scale"]
        lower, upper = ((arrays[f"output_{side}"] - centre) / spread for side in ("lower", "upper"))
        parts = arrays["increment_scale"] / spread, arrays["increment_limit"], lower, upper
        return cls(*(tensor(v) for v in (*parts, arrays["feature_lower"], arrays["feature_upper"])))


class _OutOfTime(Exception):
    """The time budget is spent."""


def weight_arrays(weights: torch.Tensor, shape: NarxShape) -> list[torch.Tensor]:
    """The flat weight vector as matrices, in the order of `NarxShape.weights`."""
    sizes = [int(np.prod(s)) for s in shape.weights.values()]
    return [w.view(s) for w, s in zip(torch.split(weights, sizes), shape.weights.values(), strict=True)]


def first_weights(shape: NarxShape, seed: int) -> torch.Tensor:
    """Random hidden layer, small output layer, no linear part; reproducible by seed."""
    generator = torch.Generator().manual_seed(seed)
    weights = torch.zeros(shape.size, dtype=REAL)
    W1, b1, W2, _, _ = weight_arrays(weights, shape)
    for part, spread in ((W1, 1.0 / np.sqrt(shape.features / 4)), (b1, 0.3), (W2, 0.03)):
        part.copy_(spread * torch.randn(part.shape, generator=generator, dtype=REAL))
    return tensor(weights)


def cut(inputs: np.ndarray, outputs: np.ndarray, horizon: int | None, shape: NarxShape, increment: np.ndarray, *, rest):
    """Stretches of one recording, (inputs (n, nu), outputs (n, ny), normalised), as a list of numpy tuples.

    ``rest``: one stretch that starts as a deployed block does, from the first output with nothing moving.
    """
    n, ny = outputs.shape
    lines = np.concatenate([inputs[np.maximum(np.arange(n) - i, 0)] for i in range(shape.input_lags)], axis=1)
    if rest:
        return [(outputs[0], np.zeros(ny * shape.output_lags), lines[:-1], outputs[1:])]
    quiet = smoothed(outputs)
    first = max(shape.output_lags, shape.input_lags - 1)
    span = min(horizon or n, n - 1 - first)
    starts = range(first, n - span, span)
    past = [[(quiet[k - i] - quiet[k - i - 1]) / increment for i in range(shape.output_lags)] for k in starts]
    return [
        (quiet[k], np.ravel(d), lines[k : k + span], outputs[k + 1 : k + 1 + span])
        for k, d in zip(starts, past, strict=True)
    ]


def gather(pieces: Sequence[tuple], most: int, seed: int) -> list[Stretches]:
    """Pieces of equal length in batches; a random choice of ``most`` when there are more."""
    if len(pieces) > most:
        chosen = np.random.default_rng(seed).choice(len(pieces), most, replace=False)
        pieces = [pieces[k] for k in sorted(chosen)]
    batches = []
    for length in sorted({len(p[2]) for p in pieces}):
        y, d, u, target = (np.array(part) for part in zip(*(p for p in pieces if len(p[2]) == length), strict=True))
        tensors = [tensor(a) for a in (y, d, u.transpose(1, 0, 2), target.transpose(1, 0, 2))]
        batches.append(Stretches(*(t.contiguous() for t in tensors)))
    return batches


def advance(parts: list[torch.Tensor], scales: Scales, y: torch.Tensor, d: torch.Tensor, u: torch.Tensor):
    """One period: next outputs and this period's increments (B, ny), and what the derivatives need."""
    W1, b1, W2, W, b = parts
    z = torch.cat([y, d, u], dim=1)
    seen = torch.clamp(z, scales.feature_lower, scales.feature_upper)
    h = torch.tanh(seen @ W1.T + b1)
    free = h @ W2.T + z @ W.T + b
    o = torch.clamp(free, -scales.limit, scales.limit)
    y_free = y + scales.increment * o
    y_next = torch.clamp(y_free, scales.lower, scales.upper)
    return y_next, o, (z, seen, h, o == free, y_next == y_free)


def next_step(weights: np.ndarray, shape: NarxShape, scales: Scales, features: np.ndarray):
    """Outputs one period later (n, ny) and increments over the outputs' scale (n, ny) at ``features`` z (n, nf)."""
    y, d, u = torch.tensor_split(tensor(features), (shape.outputs, shape.fed_back), dim=1)
    y_next, o, _ = advance(weight_arrays(tensor(weights), shape), scales, y, d, u)
    return array(y_next), array(scales.increment * o)


def free_run(weights: torch.Tensor, shape: NarxShape, scales: Scales, s: Stretches) -> torch.Tensor:
    """Simulated outputs (T, B, ny)."""
    parts, y, d = weight_arrays(weights, shape), s.y, s.d
    kept = d.shape[1] - y.shape[1]
    outputs = []
    for u in s.u:
        y, o, _ = advance(parts, scales, y, d, u)
        d = torch.cat([o, d[:, :kept]], dim=1) if shape.output_lags else d
        outputs.append(y)
    return torch.stack(outputs)


def normal_equations(weights: torch.Tensor, shape: NarxShape, scales: Scales, s: Stretches, every: int):
    """Sums over every ``every``-th sample: ``J'J`` (P, P), ``J'e`` (P,), ``e'e`` (), number of residuals."""
    parts, y, d = weight_arrays(weights, shape), s.y, s.d
    ny, fed_back = shape.outputs, shape.fed_back
    S = weights.new_zeros(len(y), fed_back, shape.size)
    JJ, Je, ee = (weights.new_zeros(size) for size in ((shape.size, shape.size), shape.size, ()))
    count, rows, errors = 0, [], []
    for k, u in enumerate(s.u):
        y, o, (z, seen, h, moving, inside) = advance(parts, scales, y, d, u)
        So = _increment_derivatives(parts, z, seen, h, S) * moving.unsqueeze(2)
        Sy = (S[:, :ny] + scales.increment[:, None] * So) * inside.unsqueeze(2)
        if shape.output_lags:
            d = torch.cat([o, d[:, : fed_back - 2 * ny]], dim=1)
            S = torch.cat([Sy, So, S[:, ny : fed_back - ny]], dim=1)
        else:
            S = Sy
        if (k + 1) % every == 0:
            rows.append(Sy.reshape(-1, shape.size))
            errors.append((y - s.target[k]).reshape(-1))
        if rows and (len(rows) * len(rows[0]) > 2000 or k == len(s.u) - 1):
            J, e = torch.cat(rows), torch.cat(errors)
            JJ, Je, ee, count = JJ + J.T @ J, Je + J.T @ e, ee + e @ e, count + len(e)
            rows, errors = [], []
    return JJ, Je, ee, count


def _increment_derivatives(parts, z, seen, h, S) -> torch.Tensor:
    """d(increments)/d(weights) (B, ny, P), through the fed-back features (S) and directly."""
    W1, _, W2, W, _ = parts
    ny, fed_back = len(W2), S.shape[1]
    slope = W2 * (1.0 - h * h).unsqueeze(1)  # (B, ny, hidden)
    eye = torch.eye(ny, dtype=REAL, device=W2.device)
    direct = torch.cat(
        [
            (slope.unsqueeze(3) * seen[:, None, None, :]).flatten(2),
            slope,
            (eye[None, :, :, None] * h[:, None, None, :]).flatten(2),
            (eye[None, :, :, None] * z[:, None, None, :]).flatten(2),
            eye.expand(len(z), ny, ny),
        ],
        dim=2,
    )
    open_ = (seen == z)[:, None, :fed_back]
    return torch.baddbmm(direct, (slope @ W1[:, :fed_back]) * open_ + W[:, :fed_back], S)


def train(
    recordings: Sequence[tuple[np.ndarray, np.ndarray]],
    held_out: Sequence[tuple[np.ndarray, np.ndarray, bool]],
    shape: NarxShape,
    scales: Scales,
    *,
    seeds: Sequence[int],
    trial: Sequence[Stage],
    final: Sequence[Stage],
    decay: float,
    budget: float,
    progress: Callable[[TrainingProgress], None] | None = None,
) -> Trained:
    """Train from each seed through the ``trial`` stages, the best of them on through the ``final`` ones.

    recordings, held_out : normalised (inputs, outputs), held_out with whether it starts as a deployed block does.
    decay : of the squared weights, in units of the mean squared error.
    Ctrl-C and the end of ``budget`` [s] return the best network so far; Ctrl-C before there is one is raised.
    """
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    search = _Search(recordings, held_out, shape, scales, decay, budget, progress)
    stopped = ""
    try:
        ends = [search.climb(seed, first_weights(shape, seed), trial) for seed in seeds]
        _, seed, weights = min(ends, key=lambda end: end[0])
        search.climb(seed, weights, final)
    except _OutOfTime:
        stopped = f"time budget of {budget:g} s"
    except KeyboardInterrupt:
        if not search.iterations:
            raise
        stopped = INTERRUPTED
    finally:
        torch.set_num_threads(threads)
    if not search.iterations:
        raise SolveError(
            "train_network: no step lowered the simulation error (got 0 accepted iterations). "
            "A recording that moves more helps. Try another seed or fewer hidden units."
        )
    error, seed, weights = search.best
    return Trained(array(weights), seed, error, search.seconds, search.iterations, stopped)


class _Search:
    """The state of one training: the data, the clock and the best network so far."""

    def __init__(self, recordings, held_out, shape, scales, decay, budget, progress):
        self.recordings, self.shape, self.scales = recordings, shape, scales
        self.decay, self.budget, self.progress = decay, budget, progress
        self.increment = array(scales.increment)
        self.held_out = gather([self._cut(u, y, None, rest)[0] for u, y, rest in held_out], len(held_out), 0)
        self.best, self.iterations, self.began = None, 0, time.monotonic()

    @property
    def seconds(self) -> float:
        """Time since the training began [s]."""
        return time.monotonic() - self.began

    def climb(self, seed: int, weights: torch.Tensor, stages: Sequence[Stage]):
        """Through the stages in turn; answers (held-out error at the end, seed, weights)."""
        error = self._judge(seed, weights)
        for stage in stages:
            pieces = [piece for u, y in self.recordings for piece in self._cut(u, y, stage.horizon, False)]
            most = max(1, int(MEMORY / (self.shape.size * (2 * self.shape.fed_back + 4 * self.shape.outputs))))
            error, weights = self._levenberg_marquardt(seed, weights, stage, gather(pieces, most, seed), error)
        return error, seed, weights

    def _cut(self, u, y, horizon, rest):
        return cut(u, y, horizon, self.shape, self.increment, rest=rest)

    def _levenberg_marquardt(self, seed, weights, stage: Stage, batches: list[Stretches], error: float):
        damping = 1e-3
        for iteration in range(stage.iterations):
            if self.seconds > self.budget and self.iterations:
                raise _OutOfTime
            JJ, Je, before, count = self._normal_equations(weights, batches, stage.every)
            if not torch.isfinite(JJ).all():
                break
            step, after, damping = self._step(weights, batches, stage.every, JJ, Je, before, count, damping)
            if step is None:
                break
            weights, self.iterations = weights + step, self.iterations + 1
            settled = before - after < 3e-3 * before or iteration == stage.iterations - 1
            if settled or iteration % stage.judge == 0:
                error = self._judge(seed, weights)
            if self.progress:
                horizon = max(len(b.u) for b in batches)
                errors = float(np.sqrt(after / count)), error, self.best[0]
                self.progress(TrainingProgress(seed, horizon, iteration, *errors, self.seconds))
            if settled:
                break
        return error, weights

    def _normal_equations(self, weights, batches, every):
        sums = [normal_equations(weights, self.shape, self.scales, b, every) for b in batches]
        JJ, Je, ee, count = (sum(part) for part in zip(*sums, strict=True))
        ridge = self.decay * torch.eye(len(weights), dtype=REAL, device=weights.device)
        return JJ / count + ridge, Je / count + self.decay * weights, float(ee), count

    def _step(self, weights, batches, every, A, g, before, count, damping):
        """The first damped step that lowers the cost: (step, sum of squares after it, damping for the next)."""
        decay = self.decay * count
        for _ in range(8):
            step = -torch.linalg.solve(A + damping * torch.diag(torch.diagonal(A)), g)
            trial = weights + step
            errors = [free_run(trial, self.shape, self.scales, b) - b.target for b in batches]
            after = sum(float(e[every - 1 :: every].square().sum()) for e in errors)
            if after + decay * float(trial @ trial) < before + decay * float(weights @ weights):
                return step, after, max(damping / 6, 1e-9)
            damping *= 6
        return None, before, damping

    def _judge(self, seed: int, weights: torch.Tensor) -> float:
        """Free-run error on the held-out data; remembers the best."""
        squares = [(free_run(weights, self.shape, self.scales, s) - s.target).square() for s in self.held_out]
        error = float(np.sqrt(sum(float(q.sum()) for q in squares) / sum(q.numel() for q in squares)))
        if np.isfinite(error) and (self.best is None or error < self.best[0]):
            self.best = (error, seed, weights.clone())
        return error if np.isfinite(error) else np.inf
