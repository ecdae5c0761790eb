"""Learn a Gaussian process that feeds its outputs back; numpy and SciPy train it, numpy and CasADi run it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from importlib import metadata

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .. import held_out
from ..bands import calibrated
from ..block_file import Certificate, LearnedBlock, assemble
from ..training_data import checked_recordings, choose_period, named, training_box
from .feedback_band import directions, first_increments, unexplained
from .feedback_block import FEEDBACK, feedback_frame
from .feedback_run import Lags
from .feedback_training import Data, Effort, Form, Trained, at_period, prepared, stages
from .kernels import Kernel, parsed

VERB = "learn gp"
TOLERANCE = 1e-9  # of the outputs' scale: deployed against trained; K_ZZ is nearly singular, rounding shows
PERIODS = (1, 2, 3, 5, 10, 20, 40)  # times the recorded one, that are tried
FEWEST = 60  # samples of a recording at a period
FIRST = ((1, 1, 3), (0, 1, 3))  # (level, increments, samples of the inputs) that periods are tried with
LAGS = ((1, 0, 2), (1, 1, 2), (0, 1, 2), (1, 2, 3), (0, 2, 3), (1, 2, 6), (0, 0, 5), (0, 1, 6))
PERIODS_KEPT, FORMS_KEPT = 2, 3  # of those tried: to try other lags with, to fit to free runs
SCREENING = Effort(points=30, rows=800, evaluations=40)


@dataclass(frozen=True)
class FeedbackProgress:
    """One form tried: its free run over what was held out, RMS over holding the first value."""

    process: str
    iteration: int
    loss: float
    best: float


@dataclass(frozen=True, eq=False)
class Judge:
    """Scores forms by their free runs over what was held out: RMS by output over the spread there, worst output."""

    fit: Sequence[Record]
    held: Sequence[Record]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]

    def score(self, trained: Trained) -> float:
        """Infinite where a run diverged."""
        runs = at_period(self.held, self.inputs, self.outputs, trained.form.period)
        misses = np.concatenate(trained.misses(runs))
        spread = np.sqrt(np.mean(np.concatenate([y - y[0] for _, y in runs]) ** 2, axis=0))
        error = np.sqrt(np.mean(misses**2, axis=0)) / np.maximum(spread, 1e-300)
        return float(error.max()) if np.isfinite(error).all() else np.inf


def learn_feedback_gp(
    records: Sequence[Record],
    inputs: Sequence[Signal | str],
    outputs: Sequence[Signal | str],
    *,
    kernel: str = "linear+rbf",
    period: float | None = None,
    lags: tuple[int, int, int] | None = None,
    points: int = 60,
    samples: int = 6000,
    evaluations: int = 80,
    validate: Sequence[Record] = (),
    seed: int = 0,
    name: str = "gaussian_process",
    progress: Callable | None = None,
) -> LearnedBlock:
    """Train a Gaussian process of the outputs' increments that runs on its own outputs; answer it as a Block.

    Period, lags and how far the weights are fitted to free runs are chosen by the free run over the end of every
    recording, which is held out for that; then all recordings are trained on. See `feedback_block` for the equations
    and the band: each output has ``<output>.sd``, the standard deviation of its measured value, scaled where the part
    held out shows it to be wrong (``provenance["band"]``).

    Args:
        records: training recordings, without gaps.
        inputs, outputs: Signals, or names that take the unit of the recording.
        kernel: a sum of products of linear, rbf, matern32, matern52, as "linear+rbf".
        period: s between steps; None: chosen. lags: whether the output itself is seen (1, 0: it only integrates), past
            increments, samples of the inputs; None: chosen.
        points: inducing points. samples: rows of the fit of the hyper-parameters; the weights take all rows.
        evaluations: of the likelihood's bound, at most.
        validate: recordings for ``provenance["validation"]``; nothing is chosen on them.
        progress: called with a `FeedbackProgress` for every form tried.

    The same seed and data give the same block.

    Raises:
        DataError: too few samples, NaN, gaps, signals that never move. DeclarationError: impossible options.
        SolveError: the likelihood was never finite.
    """
    _check(points, samples, evaluations, period, lags)
    formula = parsed(kernel, VERB)
    inputs, outputs, records, validate = checked_recordings(VERB, records, inputs, outputs, validate)
    split = held_out.split(records, *([s.name for s in part] for part in (inputs, outputs)))
    judge = Judge(split.fit, split.held_out or split.fit, inputs, outputs)
    search = _Search(judge, formula, Effort(points, samples, evaluations), seed, progress)
    chosen = search.chosen(_periods(records, period), lags)
    final = _on_all(search, chosen, records)
    inner = _block(chosen, judge, name, seed)
    scales = calibrated(inner, split.held_out)
    block = _block(final, Judge(records, judge.held, inputs, outputs), name, seed, scales.arrays)
    told = {
        "trained_on": named(records),
        "held_out": split.told() or split.why,
        "tried": search.told(),
        "free_run_held_out": search.best,
        "kernel": str(formula),
        "band": scales.provenance["band"],
    }
    block = replace(block, domain=training_box(records, (*inputs, *outputs)), provenance=block.provenance | told)
    from .single import free_run_errors

    return replace(block, provenance=block.provenance | {"validation": free_run_errors(block, validate, outputs)})


class _Search:
    """The forms tried, and the best process so far."""

    def __init__(self, judge: Judge, kernel: Kernel, effort: Effort, seed: int, progress: Callable | None):
        self.judge, self.kernel, self.effort, self.seed, self.progress = judge, kernel, effort, seed, progress
        self.best, self.tried, self.data = np.inf, [], {}

    def chosen(self, periods: Sequence[float], lags: tuple[int, int, int] | None) -> Trained:
        """Periods with usual lags, lags with the best periods, and the best of both fitted to free runs."""
        forms = [self.form(p, part) for p in periods for part in ([lags] if lags else FIRST)]
        found = self.screened(forms)
        if not lags:
            best = list(dict.fromkeys(form.period for _, form in found))[:PERIODS_KEPT]
            found += self.screened([self.form(p, part) for p in best for part in LAGS])
        found = [f for _, f in sorted(found, key=lambda pair: pair[0])[:FORMS_KEPT]]
        kept, self.best = None, np.inf
        for form in found:
            for trained in stages(self.at(form.period), form, self.kernel, self.effort, self.seed):
                score = self.noted(trained, "fitted")
                if score < self.best or kept is None:
                    kept, self.best = trained, score
        return kept

    def screened(self, forms: Sequence[Form]) -> list[tuple[float, Form]]:
        """Forms with the score of a quick fit, the best first."""
        found = []
        for form in forms:
            trained = next(stages(self.at(form.period), form, self.kernel, SCREENING, self.seed))
            found.append((self.noted(trained, "screened"), form))
        return sorted(found, key=lambda pair: pair[0])

    def noted(self, trained: Trained, how: str) -> float:
        score = self.judge.score(trained)
        self.tried.append({"how": how, **trained.form.told(), "score": score if np.isfinite(score) else "diverged"})
        if self.progress:
            self.progress(FeedbackProgress(how, len(self.tried), score, min(score, self.best)))
        return score

    def told(self) -> list[dict]:
        return self.tried

    def at(self, period: float) -> Data:
        if period not in self.data:
            self.data[period] = prepared(self.judge.fit, self.judge.inputs, self.judge.outputs, period)
        return self.data[period]

    def form(self, period: float, lags: tuple[int, int, int]) -> Form:
        return Form(period, Lags(len(self.judge.inputs), len(self.judge.outputs), *lags))


def _periods(records: Sequence[Record], period: float | None) -> list[float]:
    if period:
        return [float(period)]
    recorded = max(r.period for r in records) if all(r.uniform for r in records) else choose_period(records)
    periods = [float(f"{k * recorded:.9g}") for k in PERIODS]
    kept = [p for p in periods if min(r.duration for r in records) >= FEWEST * p]
    if not kept:
        short = min(records, key=lambda r: r.duration)
        raise DataError(
            f"{short.source or short.name}: too few samples to train on (got {len(short)}). At least {FEWEST} are "
            "needed. Leave the recording out or record longer."
        )
    return kept


def _on_all(search: _Search, chosen: Trained, records: Sequence[Record]) -> Trained:
    """The chosen form trained on all recordings; the one that was chosen where that runs worse on them."""
    judge = search.judge
    data = prepared(records, judge.inputs, judge.outputs, chosen.form.period)
    whole = chosen
    for trained in stages(data, replace(chosen.form, stages=0), search.kernel, search.effort, search.seed):
        if trained.form.stages <= chosen.form.stages:
            whole = trained
    everywhere = Judge(records, records, judge.inputs, judge.outputs)
    return whole if everywhere.score(whole) <= everywhere.score(chosen) else chosen


def _block(trained: Trained, judge: Judge, name: str, seed: int, scales=None) -> LearnedBlock:
    """The block of a process; ``scales``: arrays with the factors of its deviations."""
    data, lags, model = trained.data, trained.form.lags, trained.model
    starts = data.runs + at_period(judge.held, judge.inputs, judge.outputs, data.period)
    spread, share = directions(trained, data.runs)
    output_scale = data.arrays["output_scale"]
    misses = np.concatenate(trained.misses(data.runs))
    misses = misses[np.isfinite(misses).all(axis=1)]
    ones = np.ones(len(output_scale))
    arrays = data.arrays | {
        "feature_lower": model.feature_bounds[0],
        "feature_upper": model.feature_bounds[1],
        "kernel": model.bases[0].hyper.kernel.table(),
        "variances": np.stack([b.hyper.variances for b in model.bases]),
        "lengths": np.stack([b.hyper.lengths for b in model.bases]),
        "points": model.bases[0].points,
        "whitening": np.stack([b.inverse for b in model.bases]),
        "weights": np.stack([b.inverse.T @ v for b, v in zip(model.bases, trained.weights, strict=True)]),
        "directions": spread,
        "unexplained": unexplained(trained),
        "start_noise": data.floor / output_scale,
        "start_increment": first_increments(starts, data.arrays["increment_scale"]),
        "run_noise": np.sqrt(np.mean(misses**2, axis=0)) / output_scale,
        "step_noise": trained.step_noise,
        "run_scale": ones if scales is None else scales["run_scale"],
        "step_scale": ones if scales is None else scales["step_scale"],
    }
    M, R = spread.shape[1:]
    kernel = model.bases[0].hyper.kernel
    structure = lags.structure() | {"points": M, "directions": R, "factors": len(kernel.factors), "terms": len(kernel.terms)}
    block = assemble(
        FEEDBACK, arrays, structure, name=name,
        **feedback_frame(lags, R + 3 * lags.outputs, judge.inputs, judge.outputs),
        period=data.period,
        description=f"Gaussian process with output feedback, {kernel}, {lags.increments} increments, {lags.samples} input "
        f"samples, {M} points",
        provenance={
            "kind": "gaussian_feedback",
            "seed": seed,
            **trained.form.told(),
            "points": M,
            "directions": R,
            "share_of_directions": share,
            "loss": trained.loss,
            "stopped": "finished",
            "versions": {package: metadata.version(package) for package in ("numpy", "scipy", "casadi")},
        },
    )  # fmt: skip
    return replace(block, certificate=certify(block, trained))


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


def _check(points, samples, evaluations, period, lags) -> None:
    for option, value, least in (("points", points, 5), ("samples", samples, 50), ("evaluations", evaluations, 1)):
        if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < least:
            raise DeclarationError(f"{VERB}: {option} must be a whole number from {least} up (got {value}).")
    if period is not None and not (np.isfinite(period) and period > 0):
        raise DeclarationError(f"{VERB}: period must be positive (got {period}).")
    if lags is not None and (
        len(tuple(lags)) != 3 or lags[0] not in (0, 1) or lags[1] < 0 or lags[2] < 1 or any(int(v) != v for v in lags)
    ):
        raise DeclarationError(
            f"{VERB}: lags are (level 0 or 1, past increments, input samples) (got {lags}). Give lags=1,1,3."
        )
