"""Learn a Gaussian process that feeds its outputs back; numpy and SciPy train it, numpy and CasADi run it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from importlib import metadata

import numpy as np

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..bands import calibrated
from ..block_file import Certificate, LearnedBlock, assemble
from ..options import check_counts, check_positive
from ..training_data import checked_recordings, named, training_box, usable
from .feedback_band import directions, first_increments, unexplained
from .feedback_block import FEEDBACK, feedback_frame
from .feedback_search import KERNELS, Search, Task, folds, periods_of
from .feedback_training import Data, Effort, Trained, stages
from .kernels import parsed
from .single import free_run_errors

VERB = "learn gp"
STARTS = 3  # seeds that the chosen form is trained from: its runs differ by them more than by its kernel
TOLERANCE = 1e-9  # of the outputs' scale: deployed against trained; K_ZZ is nearly singular, rounding shows


def learn_feedback_gp(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    kernel: str | None = None,
    period: float | None = None,
    lags: tuple[int, int, int] | None = None,
    points: int = 60,
    samples: int = 2000,
    evaluations: int = 80,
    validate: Sequence[Record] = (),
    select: Sequence[Record] = (),
    seed: int = 0,
    starts: int = STARTS,
    name: str = "gaussian_process",
    progress: Callable | None = None,
) -> LearnedBlock:
    """Train a Gaussian process of the outputs' increments that runs on its own outputs; answer it as a Block.

    Period, lags, kernel and how far the weights are fitted to free runs are chosen by free runs over parts of every
    recording, held out in turn (`feedback_search`); then all recordings are trained on. See `feedback_block` for the
    equations and the band: each output has ``<output>.sd``, the standard deviation of its measured value, scaled to
    what the parts held out show (``provenance["band"]``).

    Args:
        records: training recordings, without gaps.
        inputs, outputs: Signals, or names that take the unit of the recording.
        kernel: a sum of products of linear, rbf, matern32, matern52, as "linear+rbf"; None: chosen from `KERNELS`.
        period: s between steps; None: chosen. lags: whether the output itself is seen (1, 0: it only integrates), past
            increments, samples of the inputs; None: chosen.
        points: inducing points. samples: rows of the fit of the hyper-parameters; the weights take all rows, in chunks:
            50 000 rows cost 0.4 s of the processor, and are no reason for minibatches (see `sparse`). All of a training
            on 20 000 rows, forms and free runs: 56 s and 190 MB, in one thread.
        evaluations: of the likelihood's bound, at most.
        validate: recordings for ``provenance["validation"]``; nothing is chosen on them. select: recordings that choose
            in place of the parts, and scale the band; no weight is fitted to them.
        seed, starts: the chosen form is trained from the seeds ``seed ... seed + starts - 1``; the one whose free runs
            over the parts held out are best is kept. ``provenance["seeds"]`` has what each comes to.
        progress: called with a `FeedbackProgress` for every form tried.

    The same seed and data give the same block.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options.
        SolveError: the likelihood was never finite.
    """
    _check(points, samples, evaluations, starts, period, lags)
    kernels = [parsed(text, VERB) for text in ([kernel] if kernel else KERNELS)]
    inputs, outputs, records, validate = checked_recordings(VERB, records, inputs, outputs, validate)
    task, effort = Task(records, inputs, outputs), Effort(points, samples, evaluations)
    select = usable(select, (*inputs, *outputs)) if select else []
    search = Search(folds(task, select), kernels, effort, range(seed, seed + starts), progress)
    chosen = search.chosen(periods_of(records, period), lags)
    judged = [(_block(t, f.fit, name, seed), f.held) for t, f in zip(chosen, search.folds, strict=True)]
    block = calibrated(_block(_on_all(task, chosen, effort, search.seeds), task, name, seed), judged)
    told = {"tried": search.tried, "free_run_held_out": search.best, "seeds": search.of_seeds}
    told |= {"selected_on": named(select) or "parts of every training recording, held out in turn"}
    told |= {"validation": free_run_errors(block, validate, outputs)}
    return replace(block, provenance=block.provenance | told)


def _on_all(task: Task, chosen: Sequence[Trained], effort: Effort, seeds: Sequence[int]) -> Trained:
    """The chosen form trained on all recordings from all seeds, and that of the last fold: what runs best over them."""
    form, data = chosen[-1].form, task.at(chosen[-1].form.period)
    from_seeds = (stages(data, replace(form, stages=0, seed=seed), effort) for seed in seeds)
    whole = [[t for t in reached if t.form.stages <= form.stages][-1] for reached in from_seeds]
    return min((*whole, chosen[-1]), key=lambda t: _error(t, data))


def _error(trained: Trained, data: Data) -> float:
    misses = np.concatenate([run - y for run, (_, y) in zip(trained.runs(data.runs), data.runs, strict=True)])
    error = float(np.mean((misses / data.arrays["output_scale"]) ** 2))
    return error if np.isfinite(error) else np.inf


def _block(trained: Trained, task: Task, name: str, seed: int) -> LearnedBlock:
    """The block of a process; its deviations as the process has them."""
    data, lags = trained.data, trained.form.lags
    spread, share = directions(trained, data.runs)
    arrays = _arrays(trained) | {"directions": spread}
    M, R = spread.shape[1:]
    kernel = trained.form.kernel
    counts = {"points": M, "directions": R, "factors": len(kernel.factors), "terms": len(kernel.terms)}
    seen = f"{lags.increments} increments, {lags.samples} input samples, {M} points"
    block = assemble(
        FEEDBACK,
        arrays,
        lags.structure() | counts,
        name=name,
        **feedback_frame(lags, R + 3 * lags.outputs, task.inputs, task.outputs),
        period=data.period,
        domain=training_box(task.records, (*task.inputs, *task.outputs)),
        description=f"Gaussian process with output feedback, {kernel}, {seen}",
        provenance={
            "kind": "gaussian_feedback",
            "trained_on": named(task.records),
            "seed": seed,
            **trained.form.told(),
            "points": M,
            "directions": R,
            "share_of_directions": share,
            "loss": trained.loss,
            "stopped": "finished",
            "versions": {package: metadata.version(package) for package in ("numpy", "scipy", "casadi")},
        },
    )
    return replace(block, certificate=certify(block, trained))


def _arrays(trained: Trained) -> dict[str, np.ndarray]:
    """The arrays of the block but the directions."""
    data, model, bases = trained.data, trained.model, trained.model.bases
    scale, ones = data.arrays["output_scale"], np.ones(len(data.step))
    misses = np.concatenate([run - y for run, (_, y) in zip(trained.runs(data.runs), data.runs, strict=True)])
    misses = misses[np.isfinite(misses).all(axis=1)]
    return data.arrays | {
        "feature_lower": model.feature_bounds[0],
        "feature_upper": model.feature_bounds[1],
        "kernel": trained.form.kernel.table(),
        "variances": np.stack([b.hyper.variances for b in bases]),
        "lengths": np.stack([b.hyper.lengths for b in bases]),
        "points": bases[0].points,
        "whitening": np.stack([b.inverse for b in bases]),
        "weights": np.stack([b.inverse.T @ v for b, v in zip(bases, trained.weights, strict=True)]),
        "unexplained": unexplained(trained),
        "start_noise": data.floor / scale,
        "start_increment": first_increments(data.runs, data.arrays["increment_scale"]),
        "run_noise": np.sqrt(np.mean(misses**2, axis=0)) / scale,
        "step_noise": trained.step_noise,
        "run_scale": ones,
        "step_scale": ones,
    }


def certify(block: LearnedBlock, trained: Trained, points: int = 2000) -> Certificate:
    """The largest |deployed - trained| of the next outputs over random states and inputs, over the outputs' scale."""
    a, lags, rng = block.arrays, trained.form.lags, np.random.default_rng(0)
    ny, nu = lags.outputs, lags.inputs
    y = rng.uniform(a["output_lower"], a["output_upper"], (points, ny))
    d = rng.uniform(-1, 1, (points, lags.increments, ny)) * a["increment_limit"]
    u = a["input_centre"] + 3 * a["input_scale"] * rng.uniform(-1, 1, (points, lags.samples, nu))
    level = (y - a["output_centre"]) / a["output_scale"]
    line = ((u - a["input_centre"]) / a["input_scale"]).reshape(points, -1)
    past = d.reshape(points, -1)
    z = np.hstack([[level, past], [past]][1 - lags.level] + [line])
    seen = np.clip(z, *trained.model.feature_bounds)
    o = np.column_stack([v @ b.values(seen) for b, v in zip(trained.model.bases, trained.weights, strict=True)])
    o = np.clip(o, -trained.model.limit, trained.model.limit)
    expected = np.clip(level + trained.model.step * o, *trained.model.output_bounds)
    x = np.zeros((points, len(block.states)))
    x[:, :ny], x[:, ny : ny + past.shape[1]] = y, (d * a["increment_scale"]).reshape(points, -1)
    x[:, ny + past.shape[1] : ny + past.shape[1] + nu * (lags.samples - 1)] = u[:, 1:].reshape(points, -1)
    found = block.step.map(points)(x.T, u[:, 0].T, np.zeros((0, points)))[0].full().T[:, :ny]
    apart = np.abs((found - a["output_centre"]) / a["output_scale"] - expected).max()
    return Certificate(float(apart), TOLERANCE, points, f"numpy {metadata.version('numpy')} float64")


def _check(points, samples, evaluations, starts, period, lags) -> None:
    counts = {"points": (points, 5), "samples": (samples, 50), "evaluations": (evaluations, 1), "starts": (starts, 1)}
    check_counts(VERB, counts)
    check_positive(VERB, period=period)
    if lags is not None and (
        len(tuple(lags)) != 3 or lags[0] not in (0, 1) or lags[1] < 0 or lags[2] < 1 or any(int(v) != v for v in lags)
    ):
        raise DeclarationError(
            f"{VERB}: lags are (level 0 or 1, past increments, input samples) (got {lags}). Give lags=1,1,3."
        )
