"""Recordings as a network trains on them: at its period, over its scales, in parts of which some are held out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..substeps import at_period
from ..training_data import LIMIT_OVER_SEEN, free_run_bounds, increment_spread, smoothed
from .free_run import Run, Scales, Stretches, cut, free_run, gather
from .narx import NarxShape

PARTS = 4  # of the recordings, each of which may be held out
MARGIN = 0.3  # of the range seen in training: how far the hidden layer extrapolates
MOST = 20_000  # samples of stretches in one iteration
SHORTEST = 8  # samples of a piece, beyond its lags, that is trained or judged on


@dataclass(frozen=True, eq=False)
class Piece:
    """A part of a recording: times (n,), inputs (n, nu), outputs (n, ny), and the recording itself at its own times.

    outputs, targets : over the scales. first : it begins where its recording does, and a run starts as a block does.
    """

    time: np.ndarray
    inputs: np.ndarray
    outputs: np.ndarray
    times: np.ndarray
    targets: np.ndarray
    first: bool

    @cached_property
    def quiet(self) -> np.ndarray:
        """The outputs, smoothed: candidates by the hundred start from them."""
        return smoothed(self.outputs)

    def part(self, begin: int, end: int) -> Piece:
        """Samples ``begin`` to ``end``."""
        times = (self.times >= self.time[begin]) & (self.times <= self.time[end - 1])
        rows = slice(begin, end)
        return Piece(
            self.time[rows], self.inputs[rows], self.outputs[rows], self.times[times], self.targets[times],
            self.first and begin == 0,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Series:
    """All recordings at one period, in pieces, and the scales that are written into the block."""

    arrays: dict[str, np.ndarray]
    pieces: list[Piece]
    selection: list[Piece]

    def folds(self, most: int) -> list[tuple[list[Piece], list[Piece]]]:
        """(to train on, to judge on), at most ``most`` times: recordings given for selection, or parts in turn.

        Parts of every recording rather than whole ones: who recorded steps, ramps and sines wants a model of all three.
        """
        if self.selection:
            return [(self.pieces, self.selection)]
        order = [PARTS - 1 - k for k in range(PARTS)]  # the end first: it is what comes after
        return [_by_part(self.pieces, k) for k in order[:most]]

    def feature_range(self, shape: NarxShape) -> dict[str, np.ndarray]:
        """The range of every feature over the training samples, widened; normalised."""
        u, y = (np.concatenate([getattr(p, part) for p in self.pieces]) for part in ("inputs", "outputs"))
        moved = np.tile(self.arrays["increment_limit"], shape.output_lags) / LIMIT_OVER_SEEN
        sides = {}
        for side, extreme, sign in (("lower", np.min, -1), ("upper", np.max, 1)):
            outputs = extreme(y, axis=0) + sign * MARGIN * np.ptp(y, axis=0)
            inputs = np.tile(extreme(u, axis=0) + sign * MARGIN * np.ptp(u, axis=0), shape.input_lags)
            sides[f"feature_{side}"] = np.concatenate([outputs, sign * (1 + 2 * MARGIN) * moved, inputs])
        return sides

    def scales(self, shape: NarxShape) -> Scales:
        """What a free run needs besides weights."""
        return Scales.of(self.arrays | self.feature_range(shape))


def series(
    records: Sequence[Record],
    select: Sequence[Record],
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    period: float,
    steps: int = 1,
) -> Series:
    """Recordings at ``period`` [s], normalised; the scales are those of ``records``.

    steps : of a period, over which inputs are means (`substeps`).
    """
    even, judged = ([at_period(r, period, inputs, steps) for r in part] for part in (records, select))
    u, y = ([r.array([s.name for s in part]) for r in even] for part in (inputs, outputs))
    arrays = _scales(np.concatenate(u), np.concatenate(y), y)

    def piece(own: Record, at: Record) -> Piece:
        columns = (at, inputs), (at, outputs), (own, outputs)
        seen, values, targets = (r.array([s.name for s in part]) for r, part in columns)
        scaled = (values - arrays["output_centre"]) / arrays["output_scale"]
        targets = (targets - arrays["output_centre"]) / arrays["output_scale"]
        return Piece(at.time, (seen - arrays["input_centre"]) / arrays["input_scale"], scaled, own.time, targets, True)

    return Series(arrays, *([piece(own, at) for own, at in zip(*both, strict=True)]
                            for both in ((records, even), (select, judged))))  # fmt: skip


def _scales(u: np.ndarray, y: np.ndarray, runs: Sequence[np.ndarray]) -> dict[str, np.ndarray]:
    """Centres, spreads and the bounds of a free run, from the training samples; SI."""
    return {
        "input_centre": u.mean(axis=0),
        "input_scale": np.where(u.std(axis=0) > 0, u.std(axis=0), 1.0),
        "output_centre": y.mean(axis=0),
        "output_scale": np.where(y.std(axis=0) > 0, y.std(axis=0), 1.0),
        **free_run_bounds(runs, increment_spread(runs)),
    }


def _by_part(pieces: Sequence[Piece], k: int) -> tuple[list[Piece], list[Piece]]:
    """Part ``k`` of every recording held out, what stands before and after it to train on."""
    fit, held = [], []
    for piece in pieces:
        ends = np.linspace(0, len(piece.time), PARTS + 1).astype(int)
        held.append(piece.part(ends[k], ends[k + 1]))
        fit += [piece.part(a, b) for a, b in ((0, ends[k]), (ends[k + 1], ends[-1])) if b > a]
    return fit, held


def stretches(pieces: Sequence[Piece], horizon: int | None, shape: NarxShape, scales: Scales) -> list[Stretches]:
    """Stretches of ``horizon`` samples in batches of one length, evenly chosen where they are more than `MOST` samples.

    Pieces that are shorter than the lags are left out; whole pieces all take part.
    """
    least = max(shape.output_lags, shape.input_lags - 1) + SHORTEST
    found = [
        one
        for p in pieces
        if len(p.time) > least
        for one in cut(p.inputs, p.outputs, horizon, shape, scales.increment, rest=False, quiet=p.quiet)
    ]
    thin = 1 if horizon is None else max(1, sum(len(one[2]) for one in found) // MOST)
    return gather(found[::thin])


def squares(weights: np.ndarray, pieces: Sequence[Piece], shape: NarxShape, scales: Scales) -> tuple[np.ndarray, int]:
    """Sum over free runs of the squared error (ny,), over the scales, at the recordings' own times, and their number.

    The first piece of a recording starts as a block does; between samples outputs are linear, as in `simulate`.
    """
    total, count = np.zeros(shape.outputs), 0
    for piece in pieces:
        begin = max(shape.output_lags, shape.input_lags - 1)
        if not piece.first and len(piece.time) <= begin + SHORTEST:
            continue
        given = piece.inputs, piece.outputs, None, shape, scales.increment
        (one,) = cut(*given, rest=piece.first, quiet=None if piece.first else piece.quiet)
        begin = 0 if piece.first else begin
        run: Run = free_run(weights, shape, scales, *gather([one]))
        found = np.concatenate([one[0][None], run.outputs[:, 0]])
        time = piece.time[begin : begin + len(found)]
        inside = (piece.times >= time[0]) & (piece.times <= time[-1])
        for j in range(shape.outputs):
            miss = np.interp(piece.times[inside], time, found[:, j]) - piece.targets[inside, j]
            total[j] += float(miss @ miss)
        count += int(inside.sum())
    return total, count


def one_step(pieces: Sequence[Piece], shape: NarxShape, increment: np.ndarray, quiet: bool):
    """Rows (n, nf + 1) of features and 1, and the increments (n, ny) that follow; ``quiet``: of smoothed outputs."""
    rows, targets = [], []
    begin = max(shape.output_lags, shape.input_lags - 1)
    for p in (p for p in pieces if len(p.time) > begin + 2):
        y = p.quiet if quiet else p.outputs
        d, k = np.diff(y, axis=0) / increment, np.arange(begin, len(y) - 1)
        past = [d[k - 1 - i] for i in range(shape.output_lags)] + [p.inputs[k - i] for i in range(shape.input_lags)]
        rows.append(np.hstack([y[k], *past, np.ones((len(k), 1))]))
        targets.append(d[k])
    return np.vstack(rows), np.vstack(targets)
