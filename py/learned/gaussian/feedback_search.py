"""Which period, lags, kernel and fit a Gaussian process with output feedback takes: by free runs on parts held out."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, tidy

from ..training_data import choose_period, finest_period, recorded_period
from .feedback_run import Lags
from .feedback_training import Data, Effort, Form, Trained, at_period, prepared, stages
from .kernels import Kernel

PERIODS = (1, 2, 3, 5, 10, 20, 40)  # times the recorded one, or `finest_period`, that are tried
FEWEST = 60  # samples of a recording at a period
FIRST = ((1, 1, 3), (0, 1, 3))  # (level, increments, samples of the inputs) that periods are tried with
LAGS = ((1, 0, 2), (1, 1, 2), (0, 1, 2), (1, 2, 3), (0, 2, 3), (1, 2, 6), (0, 0, 5), (0, 1, 6))
KERNELS = ("linear+rbf", "linear+matern32")  # smooth or with bends, tried where none is asked for
PERIODS_KEPT, FORMS_KEPT = 2, 3  # of those tried: to try other lags with, to fit to free runs
SCREENING = Effort(points=30, rows=800, evaluations=30)
FOLDS = ((3000, ((0.0, 0.3), (0.35, 0.65), (0.7, 1.0))), (10_000, ((0.0, 0.3), (0.7, 1.0))), (np.inf, ((0.7, 1.0),)))
# up to so many samples, these parts of every recording are held out in turn: a search in fewer is misled by chance
AROUND, BEFORE = 0.04, 0.01  # of a recording: how far a cut may be moved to a quiet place, over what it is quiet
PLACES = 40  # of a cut that are tried


@dataclass(frozen=True)
class FeedbackProgress:
    """One form tried: the RMS of its free runs over parts held out, over that of holding the first value."""

    process: str
    iteration: int
    loss: float
    best: float


@dataclass(frozen=True, eq=False)
class Task:
    """What is learnt from what: recordings and signals."""

    records: Sequence[Record]
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]

    @property
    def names(self) -> list[str]:
        return [s.name for s in (*self.inputs, *self.outputs)]

    def at(self, period: float) -> Data:
        """The recordings at a period, with their scales."""
        return prepared(self.records, self.inputs, self.outputs, period)


@dataclass(frozen=True, eq=False)
class Fold:
    """What is trained on and what is held out."""

    fit: Task
    held: Sequence[Record]

    def misses(self, trained: Trained) -> tuple[np.ndarray, np.ndarray]:
        """What free runs over the part held out miss by, and what holding the first value does; (n, ny) each, SI."""
        task, period = self.fit, trained.form.period
        names, missed, moved = [s.name for s in task.outputs], [], []
        runs = trained.runs(at_period(self.held, task.inputs, task.outputs, period))
        for record, run in zip(self.held, runs, strict=True):
            since, grid = record.time - record.time[0], period * np.arange(len(run))
            seen = since <= grid[-1]
            measured = record.array(names)[seen]
            missed.append(np.column_stack([np.interp(since[seen], grid, column) for column in run.T]) - measured)
            moved.append(measured - measured[0])
        return np.concatenate(missed), np.concatenate(moved)


def folds(task: Task, select: Sequence[Record] = ()) -> list[Fold]:
    """Parts of every recording held out in turn, cut where the signals are quiet; or the recordings that choose."""
    if select:
        return [Fold(task, list(select))]
    parts = next(parts for most, parts in FOLDS if sum(map(len, task.records)) <= most)
    ranges = np.maximum(np.ptp(np.concatenate([r.array(task.names) for r in task.records]), axis=0), 1e-300)
    answer = []
    for low, high in parts:
        fit, held = [], []
        for r in task.records:
            a, b = (_quiet(r.array(task.names) / ranges, share) for share in (low, high))
            held.append(r.window(r.time[a], r.time[b]))
            fit += [r.window(r.time[i], r.time[j]) for i, j in ((0, a), (b, len(r) - 1)) if j - i > len(r) // 10]
        answer.append(Fold(replace(task, records=fit), held))
    return answer


def _quiet(values: np.ndarray, share: float) -> int:
    """The sample near ``share`` of a recording before which the signals (n, k), over their ranges, moved least."""
    n, before = len(values), max(int(BEFORE * len(values)), 5)
    if share in (0.0, 1.0):
        return int(share * (n - 1))
    places = np.unique(np.linspace(n * (share - AROUND), n * (share + AROUND), PLACES).astype(int))
    return int(min(places, key=lambda k: np.ptp(values[max(k - before, 0) : k + 1], axis=0).sum()))


class Search:
    """The forms tried, with their scores, and the processes of the best one, one for each fold."""

    def __init__(self, folds_: Sequence[Fold], kernels: Sequence[Kernel], effort: Effort, seeds: Sequence[int],
                 progress: Callable | None):  # fmt: skip
        self.folds, self.kernels, self.effort, self.seeds, self.progress = folds_, kernels, effort, seeds, progress
        self.best, self.tried, self.of_seeds, self._data = np.inf, [], [], {}

    def chosen(self, periods: Sequence[float], lags: tuple[int, int, int] | None) -> list[Trained]:
        """Periods with usual lags, lags with the best periods, the best of both fitted to free runs, from all seeds."""
        found = self.screened([self.form(p, part) for p in periods for part in ([lags] if lags else FIRST)])
        if not lags:
            best = list(dict.fromkeys(form.period for _, form in found))[:PERIODS_KEPT]
            found += self.screened([self.form(p, part) for p in best for part in LAGS])
        found = [f for _, f in sorted(found, key=lambda pair: pair[0])[:FORMS_KEPT]]
        self.best = np.inf
        best = min((self.best_stage(replace(f, kernel=k)) for f in found for k in self.kernels), key=_score)
        form = replace(best[1][0].form, stages=0)
        all_seeds = [best, *(self.best_stage(replace(form, seed=seed)) for seed in self.seeds[1:])]
        self.of_seeds = [{"seed": trained[0].form.seed, "held_out_error": score} for score, trained in all_seeds]
        return min(all_seeds, key=_score)[1]

    def best_stage(self, form: Form) -> tuple[float, list[Trained]]:
        """The processes of all folds after the stage of the fit that runs best, with their score."""
        found = [(self.noted(trained, "fitted"), trained) for trained in self.fitted(form, self.effort)]
        score, kept = min(found, key=_score)
        self.best = min(self.best, score)
        return score, kept

    def screened(self, forms: Sequence[Form]) -> list[tuple[float, Form]]:
        """Forms with the score of a quick fit, the best first."""
        found = [(self.noted(next(self.fitted(form, SCREENING)), "screened"), form) for form in forms]
        return sorted(found, key=lambda pair: pair[0])

    def fitted(self, form: Form, effort: Effort) -> Iterator[list[Trained]]:
        """The processes of all folds after every stage that all of them have."""
        runs = [stages(self.at(n, form.period), form, effort) for n in range(len(self.folds))]
        yield from (list(together) for together in zip(*runs, strict=False))

    def noted(self, trained: Sequence[Trained], how: str) -> float:
        """The RMS of free runs over all parts held out, over that of holding the first value; the worst output's."""
        misses, moved = zip(*(fold.misses(t) for fold, t in zip(self.folds, trained, strict=True)), strict=True)
        error, spread = (np.sqrt(np.mean(np.concatenate(part) ** 2, axis=0)) for part in (misses, moved))
        error = error / np.maximum(spread, 1e-300)
        score = float(error.max()) if np.isfinite(error).all() else np.inf
        told = {"how": how, **trained[0].form.told(), "score": score if np.isfinite(score) else "diverged"}
        self.tried.append(told)
        if self.progress:
            self.progress(FeedbackProgress(how, len(self.tried), score, min(score, self.best)))
        return score

    def at(self, fold: int, period: float) -> Data:
        """The recordings of a fold at a period, made once."""
        if (fold, period) not in self._data:
            self._data[fold, period] = self.folds[fold].fit.at(period)
        return self._data[fold, period]

    def form(self, period: float, lags: tuple[int, int, int]) -> Form:
        """A form with these lags and the first kernel."""
        task = self.folds[0].fit
        return Form(period, Lags(len(task.inputs), len(task.outputs), *lags), self.kernels[0], seed=self.seeds[0])


def _score(scored: tuple[float, list[Trained]]) -> float:
    return scored[0]


def periods_of(records: Sequence[Record], period: float | None) -> list[float]:
    """The periods that are tried; raises `DataError` where the recordings are too short for the shortest."""
    recorded = recorded_period(records) if all(r.uniform for r in records) else choose_period(records)
    finest = finest_period(records, recorded)
    periods = [float(period)] if period else [tidy(k * finest) for k in PERIODS]
    kept = [p for p in periods if min(r.duration for r in records) >= FEWEST * p]
    if not kept:
        short = min(records, key=lambda r: r.duration)
        raise DataError(
            f"{short.source or short.name}: too few samples to train on (got {len(short)} in {short.duration:g} s, the "
            f"period is {periods[0]:g} s). At least {FEWEST} periods are needed. Record longer or leave it out."
        )
    return kept
