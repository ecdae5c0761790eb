"""Recordings made ready for a formula: over scales short enough to print, with smoothed features and increments."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..network.narx import NarxShape
from ..substeps import at_period
from ..training_data import HELD_OUT, choose_input_lags, free_run_bounds, increment_spread, smoothed
from .block import Formula
from .refit import Bounds, FreeRun, Piece, Run, Runs, Series, StaticRun, laid_out
from .static_block import StaticShape

LEAST_SAMPLES = 50
KEPT = ("input_centre", "input_scale", "output_centre", "output_scale")  # of a block whose constants are fitted again
CENTRE_FROM = 10.0  # spreads: a mean beyond this is taken out of a static signal, so that single precision suffices
PLAIN = (0.1, 100.0)  # spreads of a static signal that need no scale: its formula reads in the unit itself
FOLDS = 5  # at least: recordings, in so many groups where they are more, or parts of fewer ones, that judge constants
# fitted to the others. What another recording shows is what is asked for; of three folds chance tells nothing


@dataclass(frozen=True)
class Prepared:
    """Series with the pieces to fit, the scales of the block, the lags (static: none), and the steps of a period.

    folds : pairs of pieces, those on which constants are fitted and those on which they are judged. Both run from the
    first sample of a recording, as a block does: what an output that integrates drifts by counts for as long as that.
    """

    shape: NarxShape | StaticShape
    scales: dict[str, np.ndarray]
    series: list[Series]
    fit: list[Piece]
    folds: list[tuple[list[Piece], list[Piece]]]
    steps: int = 1

    @property
    def judged(self) -> list[Piece]:
        """What some fold judges on."""
        return [piece for _, pieces in self.folds for piece in pieces]

    @property
    def static(self) -> bool:
        """Whether the outputs are functions of the inputs alone."""
        return isinstance(self.shape, StaticShape)

    def run(self, formula: Formula, own: Sequence[int]) -> Run:
        """The run of the outputs ``own`` under ``formula``, free where there are dynamics."""
        if self.static:
            return StaticRun(formula, self.shape.features)
        return FreeRun(formula, own, self.shape, self.bounds)

    def laid_out(self, pieces: Sequence[Piece], own: Sequence[int]) -> Runs:
        """Some pieces for a run of the outputs ``own``."""
        return laid_out(self.series, pieces, own, self.shape)

    @property
    def bounds(self) -> Bounds:
        """The bounds of a free run, normalised."""
        s = self.scales
        lower, upper = ((s[f"output_{side}"] - s["output_centre"]) / s["output_scale"] for side in ("lower", "upper"))
        return Bounds(s["increment_scale"] / s["output_scale"], s["increment_limit"], lower, upper)

    def pairs(self, pieces: Sequence[Piece]) -> tuple[np.ndarray, np.ndarray]:
        """Features (n, nf) and targets (n, ny) of some pieces.

        Targets: increments to the next sample, over the increment scale; of static outputs these themselves.
        """
        parts = [(self.series[p.series], slice(*counted)) for p in pieces for counted in p.ranges]
        if self.static:
            return tuple(np.concatenate([getattr(s, name)[k] for s, k in parts]) for name in ("z", "y"))
        ratio, y = self.bounds.ratio, range(self.shape.outputs)
        z = [s.z[k] for s, k in parts]
        return np.concatenate([v[:-1] for v in z]), np.concatenate([np.diff(v[:, y], axis=0) for v in z]) / ratio


def prepare(
    records: Sequence[Record],
    select: Sequence[Record],
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    period: float,
    lags: tuple[int, int | None],
    next_value: bool,
    smooth: bool = True,
    steps: int = 1,
    scales: Mapping[str, np.ndarray] | None = None,
) -> Prepared:
    """Bring recordings onto one period and scale them.

    select : recordings to judge on; none: the training recordings or parts of them, each judged apart (`FOLDS`).
    next_value : features as measured and the next value as target, as in the C-EHA paper; else smoothed features
    (a local parabola over 7 samples), unless ``smooth`` is False, and increments.
    steps : of a period, over which inputs are means (`substeps`). scales : those of a block, which are kept.
    """
    u, y = zip(*(_columns(r, inputs, outputs, period, steps) for r in records), strict=True)
    judged = [_columns(r, inputs, outputs, period, steps) for r in select]
    both = [np.concatenate([_array(r, part) for r in records]) for part in (inputs, outputs)]
    scales = _scales(both, y, next_value, scales)

    def normal(part: str, values: np.ndarray) -> np.ndarray:
        return (values - scales[f"{part}_centre"]) / scales[f"{part}_scale"]

    m = lags[1] or choose_input_lags([normal("input", v) for v in u], [normal("output", v) for v in y], lags[0])
    shape = NarxShape(len(inputs), len(outputs), int(lags[0]), int(m), 0)
    ratio = scales["increment_scale"] / scales["output_scale"]
    all_runs = [*zip(u, y, strict=True), *judged]
    as_it_is = next_value or not smooth
    series = [_series(normal("input", a), normal("output", b), shape, ratio, as_it_is) for a, b in all_runs]
    whole = [Piece(i, 0, len(s.y), True) for i, s in enumerate(series)]
    return Prepared(shape, scales, series, *_pieces(whole[: len(u)], whole[len(u) :], next_value), steps)


def _pieces(fit: list[Piece], select: list[Piece], ends: bool) -> tuple[list[Piece], list]:
    """Pieces to fit, and folds, from the training recordings and those to select on.

    ends : without ``select``, only the end of every recording is held out and judges together with the whole.
    """
    if select:
        return fit, [(fit, select)]
    if ends:
        cuts = [round((1 - HELD_OUT) * p.last) for p in fit]
        begun = [replace(p, last=k) for p, k in zip(fit, cuts, strict=True)]
        return begun, [(begun, [*(replace(p, first=k, rest=False) for p, k in zip(fit, cuts, strict=True)), *fit])]
    if len(fit) >= FOLDS:
        groups = [fit[k::FOLDS] for k in range(FOLDS)]
        return fit, [([p for p in fit if p not in group], group) for group in groups]
    count, folds = -(-FOLDS // len(fit)), []
    for j, piece in enumerate(fit):
        for k in range(count):
            without, part = _apart(piece, k, count)
            folds.append(([*fit[:j], without, *fit[j + 1 :]], [part]))
    return fit, folds


def _apart(piece: Piece, k: int, count: int) -> tuple[Piece, Piece]:
    """A recording without its part ``k`` of ``count``, and that part, both run from the first sample on."""
    cuts = [round(share * piece.last / count) for share in range(count + 1)]
    begin, end = cuts[k], cuts[k + 1]
    others = tuple((a, b) for a, b in ((0, begin), (end, piece.last)) if b > a)
    return replace(piece, last=others[-1][1], counted=others), replace(piece, last=end, counted=((begin, end),))


def prepare_static(
    records: Sequence[Record], select: Sequence[Record], inputs: Sequence[Signal], outputs: Sequence[Signal]
) -> Prepared:
    """Samples as they were recorded, scaled, whose order means nothing; without ``select`` every fifth one judges."""
    for record in (*records, *select):
        _enough(record, len(record), record.period)
    u, y = (np.concatenate([_array(r, part) for r in records]) for part in (inputs, outputs))
    parts = [(u, y), *((_array(r, inputs), _array(r, outputs)) for r in select)]
    if not select:
        every = round(1 / HELD_OUT)
        last = np.arange(len(u)) % every == every - 1
        parts = [(u[~last], y[~last]), (u[last], y[last])]
    scales = {}
    for name, values in (("input", u), ("output", y)):
        scales[f"{name}_centre"], scales[f"{name}_scale"] = _plain(values)

    def normal(name: str, values: np.ndarray) -> np.ndarray:
        return (values - scales[f"{name}_centre"]) / scales[f"{name}_scale"]

    series = [Series(normal("input", a), normal("output", b)) for a, b in parts]
    pieces = [Piece(i, 0, len(s.y), True) for i, s in enumerate(series)]
    return Prepared(StaticShape(len(inputs), len(outputs)), scales, series, pieces[:1], [(pieces[:1], pieces[1:])])


def _array(record: Record, signals: Sequence[Signal]) -> np.ndarray:
    return record.array([s.name for s in signals])


def _plain(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and scale of static columns: a power of ten where the unit does not suit; no centre unless far away."""
    spread, mean = np.where(values.std(axis=0) > 0, values.std(axis=0), 1.0), values.mean(axis=0)
    suits = (spread >= PLAIN[0]) & (spread <= PLAIN[1])
    scale = np.where(suits, 1.0, 10.0 ** np.floor(np.log10(spread)))
    centre = np.where(np.abs(mean) > CENTRE_FROM * spread, scale * np.round(mean / scale), 0.0)
    return np.array([float(f"{c:.6g}") for c in centre]), np.array([float(f"{s:.6g}") for s in scale])


def _columns(record: Record, inputs, outputs, period: float, steps: int) -> tuple[np.ndarray, np.ndarray]:
    even = at_period(record, period, inputs, steps)
    _enough(record, len(even), period)
    return _array(even, inputs), _array(even, outputs)


def _enough(record: Record, samples: int, period: float) -> None:
    if samples < LEAST_SAMPLES:
        raise DataError(
            f"{record.source or record.name}: too few samples (got {samples} at {period:g} s). "
            f"At least {LEAST_SAMPLES} are needed. Record longer, leave the recording out, or choose a shorter period."
        )


def _scales(
    recorded: Sequence[np.ndarray], runs: Sequence[np.ndarray], next_value: bool, kept: Mapping | None
) -> dict[str, np.ndarray]:
    """From the inputs and outputs as recorded, the same at every period, and from the outputs at the period.

    kept : scales in place of those; the bounds of free runs are of the recordings.
    """
    if kept is not None:
        return {name: kept[name] for name in KEPT} | free_run_bounds(runs, kept["increment_scale"])
    (input_centre, input_scale), (output_centre, output_scale) = (_readable(part) for part in recorded)
    return {
        "input_centre": input_centre,
        "input_scale": input_scale,
        "output_centre": output_centre,
        "output_scale": output_scale,
        **free_run_bounds(runs, output_scale if next_value else _one_digit(increment_spread(runs))),
    }


def _readable(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Centre and scale of each column: one digit of the spread; no centre unless the mean is beyond the spread."""
    scale = _one_digit(np.where(values.std(axis=0) > 0, values.std(axis=0), 1.0))
    mean = values.mean(axis=0)
    centre = np.where(np.abs(mean) > scale, scale * np.round(mean / scale), 0.0)
    return np.array([float(f"{c:.6g}") for c in centre]), scale


def _one_digit(values: np.ndarray) -> np.ndarray:
    return np.array([float(f"{v:.0e}") for v in values])


def _series(u: np.ndarray, y: np.ndarray, shape: NarxShape, ratio: np.ndarray, as_it_is: bool) -> Series:
    """Features at every sample; before the first one the machine stands and the input is what it is there."""
    seen = y if as_it_is else smoothed(y)
    d = np.vstack([np.zeros((1, seen.shape[1])), np.diff(seen, axis=0)]) / ratio
    lagged = [_delayed(d, lag, 0.0) for lag in range(shape.output_lags)]
    return Series(np.hstack([seen, *lagged, *(_delayed(u, lag, u[0]) for lag in range(shape.input_lags))]), y)


def _delayed(values: np.ndarray, lag: int, before) -> np.ndarray:
    return np.vstack([np.broadcast_to(before, (lag, values.shape[1])), values[: len(values) - lag]])
