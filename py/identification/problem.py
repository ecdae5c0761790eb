"""What is asked: which parameters are free between which bounds, and what the recordings measured."""

from __future__ import annotations

import dataclasses
import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import Record, as_needed, known_inputs, require, row_of, unbroken
from hydrotwin.records.noise import recorded_step
from hydrotwin.simulation.inputs import as_seen

LATE = 0.5  # of a part that begins in motion: more of it is not left out for what a late input may have done before


@dataclass(frozen=True, eq=False)
class FreeParameters:
    """The free parameters and the scaled coordinate q in which the solver moves.

    q = ln p where the lower bound is positive, q = p / unit otherwise: steps are relative, signs are kept.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    index: np.ndarray
    start: np.ndarray
    lower: np.ndarray
    upper: np.ndarray
    logarithmic: np.ndarray
    unit: np.ndarray
    all_values: np.ndarray
    nominal: np.ndarray

    @property
    def sizes(self) -> np.ndarray:
        """How much q changes when a parameter changes by its own size: of one with a sign that is its start or its
        nominal value, whatever is larger, for a start that happens to be near zero is no measure of anything.
        """
        return np.where(self.logarithmic, 1.0, np.maximum(1.0, self.nominal / self.unit))

    def scaled(self, p: np.ndarray) -> np.ndarray:
        """q of free values p (SI)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.logarithmic, np.log(np.where(self.logarithmic, p, 1.0)), p / self.unit)

    def values(self, q: np.ndarray) -> np.ndarray:
        """Free values p (SI) of q; exp(ln(bound)) may miss the bound by a digit, p does not."""
        p = np.where(self.logarithmic, np.exp(np.where(self.logarithmic, q, 0.0)), q * self.unit)
        return np.clip(p, self.lower, self.upper)

    def slope(self, q: np.ndarray) -> np.ndarray:
        """dp/dq."""
        return np.where(self.logarithmic, self.values(q), self.unit)

    def vector(self, q: np.ndarray) -> np.ndarray:
        """The model's whole parameter vector at q."""
        p = self.all_values.copy()
        p[self.index] = self.values(q)
        return p


@dataclass(frozen=True, eq=False)
class Prior:
    """What is known of the scaled parameters q (np,) beforehand: costs ``1/2 sum weight (q - centre)^2``."""

    centre: np.ndarray
    weight: np.ndarray

    def cost(self, q: np.ndarray) -> float:
        return 0.5 * float(self.weight @ (q - self.centre) ** 2)


@dataclass(frozen=True, eq=False)
class Recording:
    """One recording as the solver sees it: u (n, nu) and y (n, ny) in SI, nan where an output was not measured.

    time (n,) counts from where the recording begins, as a drift does; a logger's clock may begin anywhere.
    in_motion : it begins where a recording goes on, and no equilibrium tells how. row : by what it is known again, of
    `records.row_of`.
    """

    name: str
    digest: str | None
    time: np.ndarray
    u: np.ndarray
    y: np.ndarray
    in_motion: bool = False
    row: Mapping = field(default_factory=dict)

    @cached_property
    def steps(self) -> np.ndarray:
        """Step (ny,) in which every output is recorded, by its sensor or by the digits of a file, SI; 0: none."""
        return np.array([recorded_step(column[np.isfinite(column)]) for column in self.y.T])


def free_parameters(
    flat: FlatModel,
    free: Sequence[str] | None,
    start: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
) -> FreeParameters:
    """The parameters that match the globs in ``free`` (default: those the model declares free), in model order."""
    chosen = matching(flat, free)
    values = flat.parameter_vector(start)
    bounds = dict(bounds or {})
    for name in bounds:
        flat.index_of(name)
        if name not in chosen:
            raise DeclarationError(f"{flat.name}.{name}: bounds were given, but it is not free. Free it as well.")
    rows = [p for p in flat.parameters if p.name in chosen]
    index = np.array([flat.index_of(p.name) for p in rows], dtype=int)
    limits = [bounds.get(p.name, p.bounds) for p in rows]
    lower, upper = (np.array([float(limit[side]) for limit in limits]) for side in (0, 1))
    for p, low, high in zip(rows, lower, upper, strict=True):
        value = values[flat.index_of(p.name)]
        if not low <= value <= high:
            raise DeclarationError(
                f"{flat.name}.{p.name}: the start lies outside its bounds (got {value:g} {p.unit}). It must lie in "
                f"[{low:g}, {high:g}] {p.unit}. Change the start or the bounds."
            )
    nominal = np.abs([p.nominal for p in rows])
    return FreeParameters(
        names=tuple(p.name for p in rows),
        units=tuple(p.unit for p in rows),
        index=index,
        start=values[index],
        lower=lower,
        upper=upper,
        logarithmic=lower > 0,
        unit=np.where(values[index] != 0, np.abs(values[index]), nominal),
        all_values=values,
        nominal=nominal,
    )


def matching(flat: FlatModel, globs: Sequence[str] | None, argument: str = "free", option: str = "--free") -> set[str]:
    """Names of the parameters that match the globs (default: those declared free); how they are given, for errors.

    Raises DeclarationError for a glob that matches nothing, and where there is nothing.
    """
    known = [p.name for p in flat.parameters]
    if globs is None:
        chosen = {p.name for p in flat.parameters if p.free}
        if not chosen:
            example = known[0] if known else "PATH"
            raise DeclarationError(
                f"{flat.name}: no parameter is declared free. Name some: {argument}=['{example}'] ({option} {example})."
            )
        return chosen
    patterns = [globs] if isinstance(globs, str) else list(globs)
    if not patterns and not flat.black_box:
        raise DeclarationError(f"{flat.name}: nothing to identify (got an empty list of free parameters). Name some.")
    chosen = set()
    for pattern in patterns:
        hits = fnmatch.filter(known, pattern)
        if not hits:
            raise DeclarationError(f"{flat.name}: no parameter matches '{pattern}'. {nearest(pattern, known)}")
        chosen.update(hits)
    return chosen


def recordings(flat: FlatModel, records: Sequence, outputs: Sequence[str] | None, role: str) -> tuple[Recording, ...]:
    """Records as arrays, cut at their holes (`unbroken_for`); the outputs to fit are those of the model that a record
    holds (or those in ``outputs``).
    """
    known = [s.name for s in flat.outputs]
    for name in outputs or ():
        if name not in known:
            raise DeclarationError(f"{flat.name}: no output '{name}'. {nearest(name, known)}")
    wanted = [n for n in known if outputs is None or n in outputs]
    return tuple(_recording(flat, record, wanted, role) for record in unbroken_for(flat, records))


def unbroken_for(flat, records: Sequence[Record]) -> list[Record]:
    """The parts of recordings between their holes, for a model or block. What cannot start in the middle of a
    recording, as an FMU cannot, takes the part before the first hole.

    Raises DataError for a recording of which no part is long enough, or not the one that is needed.
    """
    names = [s.name for s in flat.inputs]
    if getattr(flat, "black_box", False):
        return [_before_holes(record, names, flat.name) for record in records]
    return [part for record in records for part in _that_tell(flat, unbroken(record, names, every=True))]


def _that_tell(flat, parts: Sequence[Record]) -> list[Record]:
    """Parts in which a sensor of the model said anything; all where none did."""
    telling = [p for p in parts if any(np.isfinite(p[s.name]).any() for s in flat.outputs if s.name in p.signals)]
    return telling or list(parts)


def _before_holes(record: Record, names: Sequence[str], model: str) -> Record:
    first, *others = unbroken(record, names)
    if first.in_motion:
        raise DataError(
            f"{record.source or record.name}: {model} cannot start behind a hole, and there are too few samples before "
            f"the first. {first.part_of.told} Give a recording that begins as the machine does."
        )
    if not others:
        return first
    until = f"{model} cannot start behind a hole, so {record.name} is taken until {first.time[-1]:.6g} s alone"
    whole = dataclasses.replace(first.part_of, told=f"{first.part_of.told} {until}.")
    return dataclasses.replace(first, name=record.name, part_of=whole)


def _recording(flat: FlatModel, record, wanted: Sequence[str], role: str) -> Recording:
    name, begins = record.name or role, record.begins
    time = np.asarray(record.time, dtype=float)
    if len(time) < 2 or np.any(np.diff(time) <= 0):
        raise DataError(f"{name}: time must increase over at least two samples (got {len(time)}). Sort or trim it.")
    needed = [s for s in (*flat.inputs, *flat.outputs) if s.name in record.signals]
    require(record, [s for s in needed if s.name in wanted or s in flat.inputs], flat.name)
    columns, record = [], known_inputs(as_needed(record, needed), flat.inputs, flat.name)
    for signal in flat.inputs:
        if signal.name not in record.signals:
            raise DataError(
                f"{name}: input '{signal.name}' [{signal.unit}] of {flat.name} is not recorded. "
                f"{nearest(signal.name, list(record.signals))}"
            )
        column = np.asarray(record[signal.name], dtype=float)
        if not np.isfinite(column).all():
            raise DataError(
                f"{name}: input '{signal.name}' has {np.sum(~np.isfinite(column))} missing values. An input must be "
                "known at every sample. Cut the recording there."
            )
        columns.append(as_seen(signal, time, column))
    y = np.full((len(time), len(flat.outputs)), np.nan)
    for j, signal in enumerate(flat.outputs):
        if signal.name in wanted and signal.name in record.signals:
            y[:, j] = record[signal.name]
            if np.isinf(y[:, j]).any():
                raise DataError(
                    f"{name}: output '{signal.name}' is infinite in {np.isinf(y[:, j]).sum()} samples, the first at "
                    f"{time[np.isinf(y[:, j])][0]:.6g} s. Put nan where nothing was measured."
                )
    if not np.isfinite(y).any():
        raise DataError(
            f"{name}: none of the outputs of {flat.name} is recorded (got {', '.join(record.signals) or 'nothing'}). "
            f"At least one of {', '.join(wanted)} is needed."
        )
    known = row_of(record, [s.name for s in needed])
    u = np.column_stack(columns) if columns else np.zeros((len(time), 0))
    return delays_filled(flat, Recording(name, record.digest, time - begins, u, y, record.in_motion, known))


def delays_filled(flat: FlatModel, recording: Recording) -> Recording:
    """The recording without what it measured as long as late inputs act that came before it, and nobody knows.

    Where a recording begins a machine rests, and nothing acts late; a part of it begins in motion.
    """
    late = [s.dead_time for s in flat.inputs if s.dead_time]
    if not (recording.in_motion and late):
        return recording
    value, bound = flat.parameter_vector(), {p.name: p.bounds[1] for p in flat.parameters}
    longest = max(bound[n] if np.isfinite(bound[n]) else value[flat.index_of(n)] for n in late)
    since = recording.time - recording.time[0]
    unknown = since < min(longest, LATE * since[-1])
    return dataclasses.replace(recording, y=np.where(unknown[:, None], np.nan, recording.y))
