"""Which network: hidden states and what they may depend on are chosen by free run on parts that take no training.

Every candidate starts from a linear model (`subspace`), which is refined in free run; tanh units are added that do
nothing yet, so that a candidate is never worse than its linear start on what is held out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from .climbing import Climb, Course, Judged, Run, Stage
from .equations import StateShape
from .sensitivities import Network, free_run, joined_weights, split_weights
from .subspace import linear_start, rescaled

HIDDEN_BOUND = 8.0  # spreads of a hidden state: where it is held, in training and when deployed
SPREAD_OF_WEIGHTS, SPREAD_OF_BIAS = 1.0, 0.5  # of the first tanh units, over the root of what they see
LINEAR_DECAY = 1e-8
SHORTEST = 30  # samples between held-out parts from which a linear start is estimated
HELD_BACK = 10.0  # times the decay, where nothing is left that tells when to stop
WHOLE = 10**9  # a horizon longer than any recording
NEAR = 2.0  # times the error of the best: a network that is worse is in no committee with it


@dataclass(frozen=True)
class Form:
    """A candidate: hidden states, tanh units, whether nothing depends on where the outputs are, decay of the weights.

    decay : of the squared weights, in units of the mean squared error over the spread of the outputs.
    """

    hidden_states: int
    hidden: int
    level_free: bool
    decay: float

    def told(self) -> dict:
        """For the provenance."""
        return asdict(self)

    def with_decay(self, decay: float) -> Form:
        """The same with another decay."""
        return replace(self, decay=decay)


@dataclass(frozen=True)
class Plan:
    """Stages of the linear start, of every trial, of the chosen one, and of it on everything; samples of a trial."""

    linear: Sequence[Stage]
    trial: Sequence[Stage]
    final: Sequence[Stage]
    everything: Sequence[Stage]
    trial_samples: int


@dataclass(frozen=True, eq=False)
class Task:
    """What candidates have in common: recordings, bounds of the outputs (2, ny), samples of the encoder."""

    runs: Sequence[Run]
    bounds: np.ndarray
    past: int
    plan: Plan
    hooks: dict = field(default_factory=dict)

    def shape(self, form: Form, hidden: int) -> StateShape:
        """The shape of a candidate with ``hidden`` tanh units."""
        nu, ny = self.runs[0].u.shape[1], self.runs[0].y.shape[1]
        return StateShape(nu, ny, form.hidden_states, hidden, self.past, 0)

    def course(self, form: Form, shape: StateShape, decay: float, samples: int | None = None) -> Course:
        """The course of a candidate."""
        free = free_weights(shape, level_free=form.level_free)
        more = {} if samples is None else {"most_samples": samples}
        return Course(self.runs, shape, decay, free, **self.hooks, **more)


@dataclass(frozen=True, eq=False)
class Trial:
    """A candidate, its seed, and where its climb has come to."""

    form: Form
    seed: int
    climb: Climb

    @property
    def error(self) -> float:
        """Free-run error on what is held out, of the best so far."""
        return self.climb.best.error


def free_weights(shape: StateShape, *, level_free: bool) -> np.ndarray:
    """Which weights are trained (P,): without those of the outputs' level where nothing depends on it."""
    parts = {name: np.ones(size) for name, size in shape.weights.items()}
    if level_free:
        for name in ("linear_weights", "hidden_weights", "encoder_linear_weights", "encoder_hidden_weights"):
            parts[name][:, : shape.outputs] = 0.0
    return joined_weights(parts, shape) > 0


def linear_network(task: Task, form: Form) -> Judged:
    """The best linear model in free run, its hidden states scaled to unit spread."""
    shape = task.shape(form, 0)
    parts, rate = linear_start(_unbroken(task.runs, task.past), shape)
    course = task.course(form, shape, LINEAR_DECAY, task.plan.trial_samples)
    flat = joined_weights(parts, shape) * course.free
    climb = Climb(course, _bounded(Network(shape, rate, rate, rate, flat), task), 0).through(task.plan.linear)
    s = course.sections(Stage(WHOLE, 1), climb.rates, climb.rng)[0]
    hidden = free_run(climb.best.net, s)[1:, :, shape.outputs : shape.order][s.weights > 0]
    spread = np.maximum(hidden.std(axis=0), 1e-6)
    return replace(climb.best, net=_bounded(rescaled(climb.best.net, spread), task))


def start_trial(task: Task, form: Form, linear: Network, seed: int, samples: int | None = None) -> Trial:
    """A candidate from its linear model, with random tanh units that are not yet heard."""
    rng = np.random.default_rng(seed)
    shape = task.shape(form, form.hidden)
    parts = split_weights(linear.flat, linear.shape)
    parts["hidden_weights"] = SPREAD_OF_WEIGHTS * rng.normal(size=(form.hidden, shape.features)) / shape.features**0.5
    parts["hidden_bias"] = SPREAD_OF_BIAS * rng.normal(size=form.hidden)
    parts["output_weights"] = np.zeros((shape.order, form.hidden))
    course = task.course(form, shape, form.decay, samples)
    flat = joined_weights(parts, shape) * course.free
    return Trial(form, seed, Climb(course, replace(linear, shape=shape, flat=flat), seed))


def choose(
    task: Task, forms: Sequence[Form], decays: Sequence[float], seeds: Sequence[int], members: int
) -> tuple[list[Trial], list[dict]]:
    """The best candidates by free run on what is held out, trained to the end, and what each trial came to.

    Every form is tried from the first seed, the best form with other decays, then from all seeds; of all these trials
    up to ``members`` that are near the best go on, the best first.
    """
    linear = {form: linear_network(task, form) for form in forms}
    trials = [_tried(task, form, linear[form].net, seeds[0]) for form in forms]
    start = linear[_best(trials).form]
    if _best(trials).form.hidden:
        others = [_best(trials).form.with_decay(decay) for decay in decays]
        trials += [_tried(task, form, start.net, seeds[0]) for form in others if form not in forms]
        form = _best(trials).form
        trials += [_tried(task, form, start.net, seed) for seed in seeds[1:]]
    best = _best(trials)
    told = [{**t.form.told(), "seed": t.seed, "held_out_error": t.error} for t in trials]
    near = [t for t in sorted(trials, key=lambda t: t.error) if t is best or t.error <= NEAR * best.error]
    found = [_finished(task, t) for t in near[: members if best.form.hidden else 1]]
    found[0].climb.iterations += sum(t.climb.iterations for t in trials)
    return found, told


def _finished(task: Task, trial: Trial) -> Trial:
    """A trial trained to the end, on all that is trained on."""
    course = task.course(trial.form, trial.climb.course.shape, trial.form.decay)
    return Trial(trial.form, trial.seed, Climb(course, trial.climb.best.net, trial.seed).through(task.plan.final))


def on_everything(task: Task, found: Trial) -> Climb:
    """The chosen network trained some more on all samples of what it was trained on, held back more by its decay.

    Those too that chose it, but for recordings that only choose.

    Nothing is left that could judge: the last iterate is the network.
    """
    runs = [replace(run, used=np.ones(len(run.u), dtype=bool)) for run in task.runs if run.used.any()]
    course = replace(found.climb.course, runs=runs, decay=HELD_BACK * found.form.decay)
    return Climb(course, found.climb.best.net, found.seed).through(task.plan.everything)


def _best(trials: Sequence[Trial]) -> Trial:
    return min(trials, key=lambda t: t.error)


def _tried(task: Task, form: Form, linear: Network, seed: int) -> Trial:
    trial = start_trial(task, form, linear, seed, task.plan.trial_samples)
    if form.hidden:
        trial.climb.through(task.plan.trial)
    return trial


def _bounded(net: Network, task: Task) -> Network:
    far = np.full(net.shape.hidden_states, HIDDEN_BOUND)
    return replace(net, lower=np.append(task.bounds[0], -far), upper=np.append(task.bounds[1], far))


def _unbroken(runs: Sequence[Run], past: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """The stretches that are trained on, long enough to tell something; the longest of them in any case."""
    pieces = []
    for run in runs:
        edges = np.flatnonzero(np.diff(np.concatenate([[0], run.used.astype(int), [0]])))
        pieces += [(run.u[a:b], run.y[a:b]) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    long = [p for p in pieces if len(p[0]) >= past + SHORTEST]
    return long or [max(pieces, key=lambda p: len(p[0]))]
