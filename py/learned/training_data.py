"""Recordings made ready for training: checked, on one period, with the box of what they cover."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.provenance import MADE_FROM, SAMPLES
from hydrotwin.records import Record, noise_floor, require, row_of, tidy
from hydrotwin.simulation.block import ON_THE_EDGE, Block, TrainingDomain

RESOLUTION = 2e-3  # of a signal's range: what linear interpolation at the chosen period may lose
MANY = 20_000  # samples over all recordings that are run over for every candidate; more cost minutes for each
ALIKE = 1e-3  # of a period: sampling periods that differ by no more are one, whose times are rounded
TYPED = 3  # digits of a period, from which on it may stand for a longer number
HELD_OUT = 0.2  # of every recording, when no recordings are given for selection
LIMIT_OVER_SEEN = 2.0  # bound of an increment over the largest seen in training
ROOM = 0.5  # of the range seen in training: how far a free run may leave it on either side


@dataclass(frozen=True)
class DomainShare:
    """How a recording lies to a block's training box: share of samples inside, largest distance in box widths.

    ``beyond`` names the signals that leave the box.
    """

    inside: float
    farthest: float
    beyond: tuple[str, ...]


def domain_share(block: Block, record: Record) -> DomainShare:
    """How much of ``record`` (its columns, measured or simulated) lies where ``block`` was trained.

    Boxed signals that the record lacks are left out. Raises `DataError` when the block has no box or none is recorded.
    """
    if block.domain is None:
        raise DataError(f"{block.name}: has no training domain. Only learned blocks carry one.")
    known = [k for k, name in enumerate(block.domain.names) if name in record]
    if not known:
        raise DataError(
            f"{record.source or record.name}: holds none of the signals of the training domain of {block.name}. "
            f"It needs one of {', '.join(block.domain.names)}."
        )
    box = TrainingDomain(*(tuple(part[k] for k in known) for part in _parts(block.domain)))
    values = record.array(box.names)
    values = values[np.isfinite(values).all(axis=1)]
    if not len(values):
        raise DataError(f"{record.source or record.name}: no sample is finite in {', '.join(box.names)}.")
    apart = {name: _one(box, k).distance(values[:, [k]]) for k, name in enumerate(box.names)}
    distance = box.distance(values)
    beyond = tuple(name for name, d in apart.items() if d.max() > ON_THE_EDGE)
    return DomainShare(float(np.mean(distance <= ON_THE_EDGE)), float(distance.max()), beyond)


def _parts(box: TrainingDomain):
    return box.names, box.lower, box.upper


def _one(box: TrainingDomain, k: int) -> TrainingDomain:
    return TrainingDomain(*((part[k],) for part in _parts(box)))


def training_box(records: Sequence[Record], signals: Sequence[Signal]) -> TrainingDomain:
    """The range of each signal over the recordings."""
    names = tuple(s.name for s in signals)
    seen = np.concatenate([r.array(names) for r in records])
    return TrainingDomain(names, tuple(seen.min(axis=0).tolist()), tuple(seen.max(axis=0).tolist()))


def as_signals(wanted: Sequence[Signal | str], record: Record, role: str) -> tuple[Signal, ...]:
    """Signals by name or as they are; a bare name takes the unit it has in the recording."""
    if isinstance(wanted, (str, Signal)) or not wanted:
        raise DataError(f"learn: {role} must be a list of signals (got {wanted!r}). Name at least one.")
    named = []
    for item in wanted:
        if isinstance(item, str):
            record[item]
            unit, shown = record.units[item], record.display_units.get(item, "")
            item = Signal(item, unit, written_in=shown if shown != unit else "")
        named.append(item)
    return tuple(named)


def usable(records: Sequence[Record], signals: Sequence[Signal]) -> list[Record]:
    """The recordings with just these columns, at the times of their even grids where they have one.

    Raises `DataError` for what nothing can be learnt from.
    """
    if not records:
        raise DataError("learn: no recordings (got an empty list). Give at least one Record.")
    checked = []
    for record in records:
        where = record.source or record.name
        wanted = require(record, signals, "the block")
        for name in wanted.names:
            bad = np.flatnonzero(~np.isfinite(wanted[name]))
            if len(bad):
                raise DataError(
                    f"{where}: column '{name}' has {len(bad)} values that are not numbers, the first at "
                    f"{wanted.time[bad[0]]:g} s. Training needs every sample. Cut the record with window()."
                )
        if wanted.gaps:
            raise DataError(
                f"{where}: {wanted.gaps[0]}. Training needs an unbroken recording. Cut it in two with window()."
            )
        checked.append(wanted.evenly())
    return checked


def checked_recordings(verb: str, records, inputs, outputs, validate) -> tuple:
    """Inputs, outputs, recordings and validation recordings, checked; raises `DataError` with a sentence."""
    records, validate = list(records), list(validate)
    if not records:
        raise DataError(f"{verb}: no recordings (got an empty list). Give at least one Record.")
    inputs, outputs = as_signals(inputs, records[0], "inputs"), as_signals(outputs, records[0], "outputs")
    both = {s.name for s in inputs} & {s.name for s in outputs}
    if both:
        raise DataError(f"{verb}: {sorted(both)} named both as input and output. A signal is one of the two.")
    records, validate = (usable(part, (*inputs, *outputs)) if part else [] for part in (records, validate))
    check_excitation(records, (*inputs, *outputs))
    return inputs, outputs, records, validate


def check_excitation(records: Sequence[Record], signals: Sequence[Signal]) -> None:
    """Raise `DataError` for a signal that never moves in any of the recordings."""
    box = training_box(records, signals)
    units = {s.name: "" if s.unit == "1" else f" {s.unit}" for s in signals}
    for name, low, high in zip(box.names, box.lower, box.upper, strict=True):
        if high - low <= 1e-12 * max(abs(low), abs(high), 1e-300):
            raise DataError(
                f"learn: '{name}' never changes in the training recordings (got {low:g}{units[name]} throughout). "
                "Only signals that move can be learnt. Leave it out or add a recording that moves it."
            )


def recorded_period(records: Sequence[Record]) -> float:
    """The sampling period [s] of recordings: of all together where they are even and alike, else the longest.

    The longer the time, the less it matters that its ends are rounded.
    """
    longest = max(r.period for r in records)
    if not all(r.uniform and longest - r.period <= ALIKE * longest for r in records):
        return longest
    return tidy(sum(r.period * (len(r) - 1) for r in records) / sum(len(r) - 1 for r in records))


def typed_period(typed: float, records: Sequence[Record]) -> float:
    """The whole number of sampling periods [s] that a period stands for, where it is one of those, written shorter."""
    recorded = recorded_period(records)
    if not (isinstance(typed, int | float) and np.isfinite(recorded) and typed >= 0.5 * recorded > 0):
        return typed
    whole = tidy(recorded * round(typed / recorded))
    digits = len(f"{typed:.15g}".lower().split("e")[0].replace(".", "").strip("0"))
    written = digits >= TYPED and float(f"{whole:.{digits}g}") == typed
    return whole if written or abs(whole - typed) <= ALIKE * whole else typed


def choose_period(records: Sequence[Record]) -> float:
    """The longest period [s], a whole number of sampling periods, that loses nothing worth having.

    Linear interpolation between the samples kept must stay within twice the noise floor, or within 0.2 % of the
    range of each signal (RMS), whichever is more.
    """
    recorded = recorded_period(records)
    chosen = recorded
    for factor in (2, 3, 4, 5, 8, 10, 16, 20, 32, 50):
        if not all(resolved(r, factor * recorded) for r in records):
            break
        chosen = factor * recorded
    return tidy(chosen)


def finest_period(records: Sequence[Record], recorded: float) -> float:
    """The shortest whole multiple of ``recorded`` [s] at which the recordings are no more than `MANY` samples."""
    total = sum(r.duration for r in records)
    return tidy(recorded * max(1, int(np.ceil(total / recorded / MANY))))


def resolved(record: Record, period: float) -> bool:
    """Whether every signal of a recording is found again between samples that are ``period`` apart."""
    if record.duration < 50 * period:
        return False
    floors = noise_floor(record)
    coarse = record.resample(period)
    inside = record.time <= coarse.time[-1]
    for name in record.names:
        x = record[name][inside]
        lost = np.sqrt(np.mean((np.interp(record.time[inside], coarse.time, coarse[name]) - x) ** 2))
        if lost > max(2.0 * floors[name].sigma, RESOLUTION * np.ptp(x)):
            return False
    return True


def on_period(record: Record, period: float, inputs: Sequence[Signal]) -> Record:
    """The recording at the block's period, as a run of the block sees it (held inputs held)."""
    if record.on_grid(period):
        return record
    return record.resample(period, hold=[s.name for s in inputs if s.held])


def split_tail(record: Record, share: float) -> tuple[Record, Record]:
    """The recording's first part for fitting and its last ``share`` for selection."""
    at = record.time[round(len(record.time) * (1.0 - share))]
    return record.window(None, at), record.window(at, None)


def free_run_bounds(runs: Sequence[np.ndarray], increment: np.ndarray) -> dict[str, np.ndarray]:
    """What a free run may not leave, from the measured outputs (n, ny) of the training recordings, SI.

    increment : scale (ny,) of the increments, over which their limit is given.
    """
    y, steps = np.concatenate(runs), np.concatenate([np.diff(smoothed(run), axis=0) for run in runs])
    room = ROOM * np.ptp(y, axis=0)
    return {
        "increment_scale": increment,
        "increment_limit": LIMIT_OVER_SEEN * np.abs(steps).max(axis=0) / increment,
        "output_lower": y.min(axis=0) - room,
        "output_upper": y.max(axis=0) + room,
    }


def increment_spread(runs: Sequence[np.ndarray]) -> np.ndarray:
    """Standard deviation (ny,) of the increments of smoothed outputs; never zero where the outputs move."""
    steps = np.concatenate([np.diff(smoothed(run), axis=0) for run in runs])
    return np.maximum(steps.std(axis=0), 1e-9 * np.concatenate(runs).std(axis=0))


def named(records: Sequence[Record]) -> list[dict]:
    """Recordings by name, digest, length and marks, for the provenance."""
    return [{**row_of(r), "sha256": r.digest, SAMPLES: len(r)} for r in records]


def with_marks(block: Block, records: Sequence[Record]) -> Block:
    """The block with the marks of what it was made from by the columns that it is about, of however many there are."""
    names, own = [s.name for s in (*block.inputs, *block.outputs)], {(r.name, len(r)): r for r in records}
    told = dict(block.provenance)
    for key in (key for key in MADE_FROM if isinstance(told.get(key), list | tuple)):
        known = [(row, own.get((row.get("name"), row.get(SAMPLES)))) for row in told[key]]
        told[key] = [row if r is None else {**row, **row_of(r, names), "sha256": r.digest} for row, r in known]
    return replace(block, provenance=told)


def smoothed(values: np.ndarray) -> np.ndarray:
    """(n, k) measured outputs with their noise lowered by a local parabola over 7 samples; for start values only.

    Source: Savitzky, Golay, Analytical Chemistry 36 (1964) 1627-1639.
    """
    from scipy.signal import savgol_filter

    return savgol_filter(values, 7, 2, axis=0) if len(values) >= 7 else values


def choose_input_lags(
    inputs: Sequence[np.ndarray], outputs: Sequence[np.ndarray], output_lags: int, choices=(2, 3, 4, 6, 9, 13, 19)
) -> int:
    """The fewest input samples with which a linear model of the increments is within 2 % of the best (RMS).

    inputs, outputs : per recording (n, nu) and (n, ny), at the network's period. A dead time needs more of them.
    """
    choices = [m for m in choices if min(len(u) for u in inputs) > 8 * m] or [2]
    first = max(choices[-1], output_lags + 1)
    errors = [_linear_error(inputs, outputs, output_lags, m, first) for m in choices]
    return next(m for m, e in zip(choices, errors, strict=True) if e <= 1.02 * min(errors))


def _linear_error(inputs, outputs, output_lags: int, input_lags: int, first: int) -> float:
    """RMS of one-step linear least squares on the increments, each output over its spread."""
    rows, targets = [], []
    for u, y in zip(inputs, outputs, strict=True):
        d = np.diff(y, axis=0)
        k = np.arange(first, len(d))
        past = [d[k - i] for i in range(1, output_lags + 1)] + [u[k - i] for i in range(input_lags)]
        rows.append(np.hstack([np.ones((len(k), 1)), y[k], *past]))
        targets.append(d[k])
    A, D = np.vstack(rows), np.vstack(targets)
    miss = D - A @ np.linalg.lstsq(A, D, rcond=None)[0]
    return float(np.sqrt(np.mean((miss / np.maximum(D.std(axis=0), 1e-300)) ** 2)))


def slope_and_error(time: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Slope of values over time (n,) by least squares, and its standard error."""
    x = time - time.mean()
    slope = float(x @ values / (x @ x))
    left = values - values.mean() - slope * x
    return slope, float(np.sqrt(left @ left / max(len(time) - 2, 1) / (x @ x)))


def level_and_error(time: np.ndarray, values: np.ndarray) -> tuple[float, float]:
    """Mean of values (n,) and its standard error, their noise taken about a straight line over time."""
    noise = slope_and_error(time, values)[1] * float(np.sqrt(np.sum((time - time.mean()) ** 2)))
    return float(values.mean()), noise / float(np.sqrt(len(time)))
