"""Levenberg-Marquardt on the free run over sections that grow from a few samples to whole recordings.

    minimise  mean |y_sim - y|^2 + decay |w|^2

The sections are drawn anew, from random places, for every length; each starts from what the encoder sees before it.
Of all iterates the one with the smallest free-run error on held-out data is kept. Sources: Marquardt, SIAM J. Appl.
Math. 11 (1963) 431-441; Forgione, Piga, European J. Control 59 (2021) 69-81 (truncated simulation error).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..training_data import smoothed
from .equations import StateShape
from .sensitivities import Network, Sections, errors, normal_equations
from .subspace import encoder_features

MOST_SAMPLES = 30_000  # steps simulated in one iteration; more sections than that are a random choice
TRIES = 7  # of a step, with more and more damping
SETTLED = 1e-4  # relative decrease of the cost, below which a length has nothing more to give
LINEAR_DECAY = 1e-3  # of the decay of the tanh part: the linear part is hardly held back


@dataclass(frozen=True)
class Stage:
    """Sections of ``horizon`` samples, whole recordings from their first sample alone if ``whole``, and iterations."""

    horizon: int
    iterations: int
    whole: bool = False


@dataclass(frozen=True)
class Judged:
    """A network and its free-run error on held-out data: RMS over outputs, each over its spread."""

    error: float
    net: Network


@dataclass(frozen=True)
class Progress:
    """One accepted iteration; errors are RMS over outputs, each over its spread; ``best`` is on held-out data."""

    seed: int
    horizon: int
    iteration: int
    train_error: float
    held_out_error: float
    best: float


def section_at(u, y, quiet, at: np.ndarray, span: int, net_past: int, rates, *, still: bool) -> Sections:
    """Sections of ``span`` steps that start at the samples ``at``; those that end before are padded.

    still : the encoder takes the first sample for the whole past, as a deployed block does.
    """
    steps = at[None, :] + np.arange(span)[:, None]
    last = len(u) - 1
    inside = steps < last
    if still:
        one = encoder_features(u[at], y[at], np.arange(len(at)), 0, rates)
        ny = y.shape[1]
        encoder = np.hstack([one[:, :ny], np.zeros((len(at), ny * net_past)), np.tile(u[at], net_past + 1)])
    else:
        encoder = encoder_features(u, quiet, at, net_past, rates)
    first = y[at] if still else quiet[at]
    return Sections(encoder, first, u[np.minimum(steps, last)], y[np.minimum(steps + 1, last)], inside.astype(float))


def joined(sections: Sequence[Sections]) -> Sections:
    """Several as one, padded to the longest."""
    longest = max(len(s.inputs) for s in sections)

    def padded(values):
        return np.concatenate([values, np.zeros((longest - len(values), *values.shape[1:]))])

    parts = {name: np.concatenate([getattr(s, name) for s in sections]) for name in ("encoder", "first")}
    for name in ("inputs", "targets", "weights"):
        parts[name] = np.concatenate([padded(getattr(s, name)) for s in sections], axis=1)
    return Sections(**parts)


@dataclass(frozen=True, eq=False)
class Run:
    """A normalised recording: inputs (n, nu), outputs (n, ny), and whether each sample is trained on (n,)."""

    u: np.ndarray
    y: np.ndarray
    used: np.ndarray

    def held_out(self) -> list[tuple[int, int]]:
        """(first, last) of every stretch that is not trained on."""
        edges = np.flatnonzero(np.diff(np.concatenate([[True], self.used, [True]]).astype(int)))
        return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


@dataclass(frozen=True, eq=False)
class Course:
    """What is trained on: recordings, shape, decay, which weights are free (P,), samples per iteration, callbacks."""

    runs: Sequence[Run]
    shape: StateShape
    decay: float
    free: np.ndarray
    most_samples: int = MOST_SAMPLES
    progress: Callable[[Progress], None] | None = None
    stop: Callable[[], bool] = lambda: False

    def sections(self, stage: Stage, rates: np.ndarray, rng: np.random.Generator) -> list[Sections]:
        """Sections of the training recordings, those of one length together."""
        short, whole = [], []
        for run in (run for run in self.runs if run.used.any()):
            n, past, horizon = len(run.u), self.shape.past, stage.horizon
            fits = n > horizon + past + 1
            if stage.whole or not fits:
                whole.append(self._cut(run, np.array([0]), n - 1, rates, still=True))
            if fits:
                even = np.linspace(past, n - 1 - horizon, max(1, round((n - past) / horizon)))
                at = np.clip(even + rng.uniform(-0.5, 0.5, len(even)) * horizon, past, n - 1 - horizon)
                short.append(self._cut(run, np.unique(at.astype(int)), horizon, rates, still=False))
        return [self._thinned(joined(part), rng) for part in (short, whole) if part]

    def _cut(self, run: Run, at: np.ndarray, span: int, rates: np.ndarray, *, still: bool) -> Sections:
        s = section_at(run.u, run.y, smoothed(run.y), at, span, self.shape.past, rates, still=still)
        return replace(s, weights=s.weights * _at(run.used, at, span))

    def _thinned(self, s: Sections, rng: np.random.Generator) -> Sections:
        count = s.weights.shape[1]
        most = max(1, self.most_samples // len(s.inputs))
        if count <= most:
            return s
        kept = np.sort(rng.choice(count, most, replace=False))
        return Sections(s.encoder[kept], s.first[kept], s.inputs[:, kept], s.targets[:, kept], s.weights[:, kept])

    def judging(self, rates: np.ndarray) -> list[Sections]:
        """What is not trained on: run from the sample it begins at, and as a part of a run from the first."""
        found = []
        for run in self.runs:
            quiet, past = smoothed(run.y), self.shape.past
            for first, last in run.held_out():
                if first >= past and last > first:
                    at = np.array([first])
                    found.append(section_at(run.u, run.y, quiet, at, last - first, past, rates, still=False))
            if not run.used.all():
                at, span = np.array([0]), len(run.u) - 1
                s = section_at(run.u, run.y, quiet, at, span, past, rates, still=True)
                found.append(replace(s, weights=s.weights * ~_at(run.used, at, span)))
        return found


def _at(used: np.ndarray, at: np.ndarray, span: int) -> np.ndarray:
    """Whether the targets of sections are used (span, B)."""
    return used[np.minimum(at[None, :] + np.arange(1, span + 1)[:, None], len(used) - 1)]


class Climb:
    """One network on its way through the stages."""

    def __init__(self, course: Course, net: Network, seed: int):
        self.course, self.net, self.seed = course, net, seed
        self.rng = np.random.default_rng(seed)
        self.rates = net.rate[: course.shape.outputs]
        self.judges = course.judging(self.rates)
        self.judged = sum(float(s.weights.sum()) for s in self.judges) * course.shape.outputs
        self.best = Judged(self.judge(net), net)
        self.iterations = 0
        self.now = self.best.error

    def judge(self, net: Network) -> float:
        """Free-run error on the held-out data."""
        misses = [errors(net, s) for s in self.judges]
        error = np.sqrt(sum(float((m**2).sum()) for m in misses) / self.judged) if misses else 0.0
        return float(error) if np.isfinite(error) else np.inf

    def through(self, stages: Sequence[Stage]) -> Climb:
        """Each stage in turn, from the best so far: short sections may lead away from what runs well for long."""
        for stage in stages:
            if self.judges:
                self.net = self.best.net
            self._stage(stage)
        return self

    def _stage(self, stage: Stage) -> None:
        sections = self.course.sections(stage, self.rates, self.rng)
        count = sum(float(s.weights.sum()) for s in sections) * self.course.shape.outputs
        damping, decay = 1e-2, self._decay()
        for iteration in range(stage.iterations):
            if self.course.stop():
                return
            sums = zip(*(normal_equations(self.net, s) for s in sections), strict=True)
            JJ, Je, ee = (sum(part) / count for part in sums)
            if not np.isfinite(JJ).all():
                return
            cost = ee + decay @ self.net.flat**2
            found = self._step(sections, JJ + np.diag(decay), Je + decay * self.net.flat, cost, damping)
            if found is None:
                return
            self.net, after, damping = found
            self.iterations += 1
            self._look(stage, iteration, after)
            if cost - after < SETTLED * cost:
                return

    def _decay(self) -> np.ndarray:
        shape, decay = self.course.shape, self.course.decay
        tanh = ("hidden_weights", "output_weights", "encoder_hidden_weights", "encoder_output_weights")
        sizes = [(name, int(np.prod(size))) for name, size in shape.weights.items()]
        return np.concatenate([np.full(n, decay * (1.0 if name in tanh else LINEAR_DECAY)) for name, n in sizes])

    def _step(self, sections: Sequence[Sections], A: np.ndarray, g: np.ndarray, cost: float, damping: float):
        """The first damped step that lowers the cost: (network, cost, damping for the next)."""
        count = sum(float(s.weights.sum()) for s in sections) * self.course.shape.outputs
        decay, free = self._decay(), np.flatnonzero(self.course.free)
        for _ in range(TRIES):
            step = np.zeros(len(g))
            step[free] = -np.linalg.solve((A + damping * np.diag(np.diag(A) + 1e-12))[np.ix_(free, free)], g[free])
            trial = replace(self.net, flat=self.net.flat + step)
            after = sum(float((errors(trial, s) ** 2).sum()) for s in sections) / count + decay @ trial.flat**2
            if after < cost:
                return trial, after, max(damping / 8, 1e-9)
            damping *= 5
        return None

    def _look(self, stage: Stage, iteration: int, cost: float) -> None:
        self.now = self.judge(self.net)
        if self.now < self.best.error:
            self.best = Judged(self.now, self.net)
        if self.course.progress:
            told = self.seed, stage.horizon, iteration, float(np.sqrt(cost)), self.now, self.best.error
            self.course.progress(Progress(*told))
