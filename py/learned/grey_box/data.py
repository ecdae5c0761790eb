"""Recordings as a sampled block sees them, and what is left of them made white; for blocks fitted by least squares."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, tidy
from hydrotwin.records.resampling import hold
from hydrotwin.simulation import simulate

from ..block_file import Certificate, LearnedBlock
from ..options import check_positive
from ..training_data import as_signals, check_excitation, choose_period, recorded_period, usable

FINER = 5  # block samples over the longest period that loses nothing
TOLERANCE = 1e-9  # of the output's range: deployed against fitted
LEAST = 100  # samples of the output over all recordings
MOST = 40_000  # samples of the block over all recordings, unless a period is given
FEW = 12_000  # samples of the block to start a fit with
RATIOS = np.geomspace(1e-5, 1e5, 21)


@dataclass(frozen=True, eq=False)
class Run:
    """One recording: the input at the samples of the block, the output at its own times, whatever their spacing.

    input : (m,) at t0 + k period. time, output : (n,). before, share : (n,), output k was taken ``share`` of a period
    after sample ``before[k]`` of the block.
    """

    input: np.ndarray
    time: np.ndarray
    output: np.ndarray
    before: np.ndarray
    share: np.ndarray

    def sampled(self, columns: np.ndarray) -> np.ndarray:
        """What runs on the block's samples, (m, ...), at the times of the output, (n, ...)."""
        share = self.share.reshape(-1, *[1] * (columns.ndim - 1))
        return columns[self.before] * (1 - share) + columns[self.before + 1] * share


@dataclass(frozen=True, eq=False)
class Whitening:
    """Increments d of an integrating output as the sum of a random walk and white sensor noise, made white.

        cov(d) = r tridiag(-1, 2 + ratio dt_k/T, -1) = r L L',     w = L^-1 d

    ``ratio`` = q T / r: variance of the walk in a usual interval T over that of the sensor. A large ratio fits the
    rates, a small one the positions of the whole run.
    """

    time: np.ndarray
    ratio: float

    @cached_property
    def factor(self) -> np.ndarray:
        """L in banded form, (2, n - 1)."""
        from scipy.linalg import cholesky_banded

        steps = np.diff(self.time)
        return cholesky_banded(
            np.vstack([2 + self.ratio * steps / np.median(steps), np.full(len(steps), -1.0)]), lower=True
        )

    def __call__(self, increments: np.ndarray) -> np.ndarray:
        """L^-1 d for columns of increments, (n - 1, ...)."""
        from scipy.linalg import solve_banded

        return solve_banded((1, 0), self.factor, increments, check_finite=False)


def best_ratio(runs: Sequence[Run], misses: Sequence[np.ndarray]) -> float:
    """The ratio of `Whitening` under which the increments of what is left, (n - 1,) per run, are most likely."""
    scores = []
    for ratio in RATIOS:
        parts = [Whitening(run.time, ratio) for run in runs]
        white = np.concatenate([part(miss) for part, miss in zip(parts, misses, strict=True)])
        volume = sum(2 * np.log(part.factor[0]).sum() for part in parts)
        scores.append(len(white) * np.log(np.mean(white**2)) + volume)
    return float(RATIOS[int(np.argmin(scores))])


def weighing(runs: Sequence[Run], ratio: float | None) -> list[Callable[[np.ndarray], np.ndarray]]:
    """Per run, the linear map from what the output is made of, (n, ...), to rows of equal weight.

    ratio : of `Whitening`, None for an output that does not integrate, whose samples count as they are.
    """
    if ratio is None:
        return [lambda columns: columns for _ in runs]

    def of_increments(run):
        white = Whitening(run.time, ratio)
        return lambda columns: white(np.diff(columns, axis=0))

    return [of_increments(run) for run in runs]


def one_in_one_out(verb: str, records, inputs, outputs, validate, select) -> tuple:
    """The recordings, those that choose, and the one input and output, checked; raises `DataError` with a sentence."""
    records, validate, select = list(records), list(validate), list(select)
    if not records:
        raise DataError(f"{verb}: no recordings (got an empty list). Give at least one Record.")
    inputs, outputs = as_signals(inputs, records[0], "inputs"), as_signals(outputs, records[0], "outputs")
    _only_one(verb, inputs, outputs)
    columns = (*inputs, *outputs)
    records, validate, select = (usable(part, columns) if part else [] for part in (records, validate, select))
    check_excitation(records, columns)
    for record in (*records, *validate, *select):
        if len(record) < 3:
            raise DataError(f"{record.source or record.name}: too few samples (got {len(record)}). Leave it out.")
    if sum(len(r) for r in records) < LEAST:
        raise DataError(
            f"{verb}: too few samples to train on (got {sum(len(r) for r in records)}). At least {LEAST} are needed. "
            "Record longer."
        )
    return records, select, inputs[0], outputs[0]


def _only_one(verb: str, inputs: Sequence[Signal], outputs: Sequence[Signal]) -> None:
    for role, given in {"input": inputs, "output": outputs}.items():
        if len(given) != 1:
            raise DataError(
                f"{verb}: one {role} is needed (got {', '.join(s.name for s in given)}). "
                "Learn a block for each, or take nn, gp, narx or state_nn, which have several."
            )
    if inputs[0].name == outputs[0].name:
        raise DataError(f"{verb}: '{inputs[0].name}' named both as input and output. A signal is one of the two.")


def block_period(verb: str, records: Sequence[Record], period: float | None) -> float:
    """The period given [s], or one so fine that a dead time falls between samples.

    That is a fifth of the longest that loses nothing (`choose_period`), and a fifth of an uneven recording's, because
    a held command then changes between samples of the block; a multiple or a part of an even recording's.
    """
    if period is None:
        return _fine_period(records)
    check_positive(verb, period=period)
    longest = min(r.duration for r in records) / 50
    if period > longest:
        raise DataError(
            f"{verb}: too few samples to train on (50 periods of {period:g} s are longer than a recording). "
            f"Choose a period up to {longest:.2g} s."
        )
    return float(period)


def _fine_period(records: Sequence[Record]) -> float:
    longest, recorded = choose_period(records), recorded_period(records)
    wanted = max(longest / FINER, min(longest, sum(r.duration for r in records) / MOST))
    if not all(r.on_grid(recorded) for r in records):
        return float(f"{min(wanted, min(r.period for r in records) / FINER):.6g}")
    steps = np.floor(wanted / recorded * (1 + 1e-9))
    return tidy(recorded * steps) if steps else recorded / float(np.ceil(recorded / wanted * (1 - 1e-9)))


def coarser(records: Sequence[Record], period: float) -> float:
    """A multiple of the period, up to the longest that loses nothing, that keeps a first fit quick [s].

    Only of recordings much denser than the block: otherwise held inputs would change between its samples.
    """
    if max(r.period for r in records) > 1.01 * period:
        return period
    return period * min(FINER, max(1, round(sum(r.duration for r in records) / period / FEW)))


def seen_late(records: Sequence[Record], period: float, input_: Signal) -> float:
    """How much later than it changes a held input is seen at the block's samples, on average over the changes [s]."""
    if not input_.held:
        return 0.0
    late = total = 0.0
    for record in records:
        changes = np.abs(np.diff(record[input_.name]))
        place = (record.time[1:] - record.time[0]) / period
        late += float(changes @ np.maximum(np.ceil(place - 1e-5) - place, 0.0)) * period
        total += float(changes.sum())
    return late / total


def run_of(record: Record, period: float, input_: Signal, output: Signal) -> Run:
    """The recording for a block of that period; outputs much denser than the block are thinned out to its samples."""
    time, u = record.time, record[input_.name]
    samples = int(np.ceil((time[-1] - time[0]) / period - 1e-6)) + 1
    grid = time[0] + period * np.arange(samples)
    at_grid = hold(time, u, grid) if input_.held else np.interp(grid, time, u)
    if record.period < 0.75 * period:
        inside = grid <= time[-1]
        time, y = grid[inside], np.interp(grid[inside], time, record[output.name])
    else:
        y = record[output.name]
    place = (time - grid[0]) / period
    before = np.clip(np.floor(place + 1e-9).astype(int), 0, samples - 2)
    return Run(at_grid, time, y, before, np.clip(place - before, 0.0, 1.0))


@dataclass(frozen=True)
class FitProgress:
    """After every evaluation: how many, the loss and the best so far (mean square of weighed misses)."""

    evaluation: int
    loss: float
    best: float


class Watch:
    """Counts evaluations, tells of them and keeps the best, so that an interrupted fit has an answer."""

    def __init__(self, progress: Callable[[FitProgress], None] | None):
        self.evaluations, self.best, self.stopped = 0, None, ""
        self._progress, self._anew = progress, True

    def anew(self):
        """Losses from here on are not comparable with those before: the next evaluation is the best so far."""
        self._anew = True

    def __call__(self, fitted):
        self.evaluations += 1
        if self._anew or fitted.loss < self.best.loss:
            self.best, self._anew = fitted, False
        if self._progress is not None:
            self._progress(FitProgress(self.evaluations, fitted.loss, self.best.loss))


def falls(runs: Sequence[Run], integrating: bool) -> bool:
    """Whether the output (its rate, where it integrates) is low where the input is high."""
    moved, pushed = [], []
    for run in runs:
        moved.append(np.diff(run.output) / np.diff(run.time) if integrating else run.output[1:])
        pushed.append(run.sampled(run.input)[:-1])
    return bool(np.cov(np.concatenate(moved), np.concatenate(pushed))[0, 1] < 0)


def certify(block: LearnedBlock, runs: Sequence[Run], expected: Sequence[np.ndarray]) -> Certificate:
    """The largest |block - fit| over free runs with the inputs of ``runs``, relative to the range of the output.

    expected : per run, the output of the fit at the block's samples (m,), SI.
    """
    (input_,), (output,), worst = block.inputs, block.outputs, 0.0
    for run, truth in zip(runs, expected, strict=True):
        drive = Record(
            block.period * np.arange(len(run.input)),
            {input_.name: run.input, output.name: np.full(len(run.input), truth[0])},
            {input_.name: input_.unit, output.name: output.unit},
        )
        found = simulate(block, drive)[output.name]
        worst = max(worst, float(np.abs(found - truth).max() / max(np.ptp(truth), 1e-300)))
    points = sum(len(run.input) for run in runs)
    return Certificate(worst, TOLERANCE, points, f"numpy {np.__version__} float64, the fit's own run")
