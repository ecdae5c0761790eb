"""Contenders: whatever can predict the outputs of a recording, seen through one protocol."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence
from itertools import combinations
from typing import Protocol, runtime_checkable

import numpy as np

from hydrotwin.identification.bands import Spread, moves
from hydrotwin.identification.beginning import StartEstimate, estimate_start
from hydrotwin.identification.moved import Moved
from hydrotwin.learned.bands import WIDE, known_bands
from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.provenance import SPREAD
from hydrotwin.records import Record
from hydrotwin.simulation import predict_one_step, simulate
from hydrotwin.simulation.block import Block
from hydrotwin.simulation.propagator import OWN_METHOD
from hydrotwin.work.executor import portable

from .travel import with_changes

_WORDS = ("provenance", "description")  # of a block: no run depends on them


@runtime_checkable
class Contender(Protocol):
    """A model in a comparison.

    Optional attributes: ``parameters`` (tuple of ParameterValue), ``provenance`` (dict of plain values),
    ``domain`` (TrainingDomain), ``modes`` (those it can run, all by default), ``states_set(record)`` (names of what a
    measurement sets one step ahead; where nothing is, that is its free run, and no score), ``content`` (all that its
    runs depend on, as data: they are then kept and made in other processes, to which ``to_travel()`` goes, or it
    itself).
    """

    name: str
    kind: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]

    def free_run(self, record: Record) -> Record:
        """Outputs at ``record.time`` from the inputs and the start alone."""

    def one_step(self, record: Record) -> Record:
        """Outputs at ``record.time``, each predicted from the measurement one sample before."""


class PhysicalContender:
    """A Model or FlatModel, or a fit of one.

    ``start`` fixes start states by name (SI), or by recording and name: ``{"load_3": {"load.force": 4500.0}}``.
    ``parameters`` changes values by path (SI). ``provenance`` is of the model as it runs, by default what it
    says itself.
    """

    def __init__(
        self,
        model,
        name: str | None = None,
        *,
        kind: str = "physical",
        start: Mapping[str, float] | Mapping[str, Mapping[str, float]] | None = None,
        parameters: Mapping[str, float] | None = None,
        provenance: Mapping | None = None,
    ):
        flat = getattr(model, "flat", model).with_parameters(parameters or {})
        self.flat = _saying(flat, provenance)
        self.name, self.kind = name or self.flat.name, kind
        self.inputs, self.outputs, self.parameters = self.flat.inputs, self.flat.outputs, self.flat.parameters
        self.start = dict(start) if start else None
        self.estimated: dict[str, StartEstimate] = {}  # by recording
        self.how: dict[str, float | str] = {}  # step [s] and method of its runs where they are not its own

    @property
    def provenance(self) -> Mapping:
        """What the model says of where its values come from."""
        return self.flat.provenance

    def with_inputs(self, changes: Mapping[str, Mapping]) -> PhysicalContender:
        """The same whose inputs do something else between samples, see `changed`."""
        other = copy.copy(self)
        other.flat = self.flat.with_inputs(changes)
        other.inputs = other.flat.inputs
        return other

    def stepped(self, step: float | None, method: str | None) -> PhysicalContender:
        """The same run with another longest step [s] and another method, see `prepare`; None for its own."""
        own, asked = {"step": float(self.flat.step), "method": OWN_METHOD}, {"step": step, "method": method}
        return with_changes(self, how={k: v for k, v in asked.items() if v not in (None, own[k])})

    def estimate_start(self, record: Record, how: str) -> StartEstimate:
        """Start states from the first part of ``record``, see there; those that ``start`` gives stay."""
        left = Spread.left_by(self.provenance)
        return estimate_start(self.flat, record, how, self.start_of(record), left)

    def unknown_at_first(self, record: Record) -> list[str]:
        """Outputs that say where a state starts, and of which the first sample is not known."""
        given = self._known_start(record) or {}
        told = [s.measured_by for s in self.flat.states if s.measured_by and s.name not in given]
        return [name for name in told if name in record.signals and not np.isfinite(record[name][0])]

    def untold_starts(self, record: Record) -> list[str]:
        """States that start where the model thinks: no first sample says where, and nobody else does."""
        given, known = self._known_start(record) or {}, {n for n, v in record.signals.items() if np.isfinite(v[0])}
        return [s.name for s in self.flat.states if s.name not in given and s.measured_by not in known]

    def with_starts(self, estimates: Sequence[StartEstimate]) -> PhysicalContender:
        """The same that starts, on the recordings of ``estimates``, as they say."""
        return with_changes(self, estimated={e.record: e for e in estimates if e.states})

    @property
    def content(self) -> tuple | None:
        """What its runs depend on."""
        return self.flat, self.start, self.estimated, self.how, self.provenance.get(SPREAD)

    def to_travel(self) -> PhysicalContender:
        """The same with equations that can be pickled."""
        spread = {SPREAD: self.provenance[SPREAD]} if SPREAD in self.provenance else {}
        return with_changes(self, flat=dataclasses.replace(portable(self.flat, self._given()), provenance=spread))

    def states_set(self, record: Record) -> list[str]:
        """States that a measured output of ``record`` sets, one step ahead."""
        return _states_set(self.flat.states, record)

    def free_run(self, record: Record) -> Record:
        """Outputs simulated from the inputs of ``record``."""
        return simulate(self.flat, record, start=self.start_of(record), **self.how)

    def one_step(self, record: Record) -> Record:
        """Outputs predicted from the sample before; measured outputs replace the states they determine."""
        return predict_one_step(self.flat, record, start=self.start_of(record), **self.how)

    def deviations(self, record: Record) -> dict[str, np.ndarray]:
        """Standard deviation (n,), SI, of what sensors read in a free run, where the fit of the model is known."""
        return {name: one.deviation for name, one in self.moves(record).items()}

    def moves(self, record: Record) -> dict[str, Moved]:
        """How far outputs of a free run may be moved by what the fit does not know, where it is known."""
        told = self.provenance.get(SPREAD)
        if not told:
            return {}
        estimated = self.estimated.get(record.name)
        return moves(self.flat, record, Spread.from_told(told), self._known_start(record), estimated)

    def _given(self) -> list[tuple[str, ...]]:
        """States that are given together in a run, beside those that a recording measures."""
        own = [s for s in (self._starts() or {"": self.start or {}}).values() if s]
        own = [{**s, **e} for s in own or [{}] for e in (*(e.values for e in self.estimated.values()), {})]
        measured = [s.name for s in self.flat.states if s.measured_by is not None]
        together = [
            {*s, *some} for s in own if s for n in range(len(measured) + 1) for some in combinations(measured, n)
        ]
        return [tuple(s.name for s in self.flat.states if s.name in names) for names in together]

    def _starts(self) -> Mapping[str, Mapping[str, float]] | None:
        """The start by recording; None where it is the same for all."""
        return self.start if any(isinstance(value, Mapping) for value in (self.start or {}).values()) else None

    def start_of(self, record: Record) -> Mapping[str, float] | None:
        """Start states that are given or estimated, SI by name; None where none are."""
        given, estimated = self._known_start(record), self.estimated.get(record.name)
        return {**(given or {}), **estimated.values} if estimated else given

    def _known_start(self, record: Record) -> Mapping[str, float] | None:
        by_record = self._starts()
        if record.in_motion:  # a start that is given is of where a recording begins
            return None
        return self.start if by_record is None else by_record.get(record.whole)


def _states_set(states, record: Record) -> list[str]:
    known = {name for name, values in record.signals.items() if np.isfinite(values).any()}
    return [s.name for s in states if s.measured_by in known]


def _saying(flat, provenance: Mapping | None):
    """The same model, which says so of where it comes from; as it is where nothing else is said."""
    if not provenance or provenance == flat.provenance:
        return flat
    return dataclasses.replace(flat, provenance=dict(provenance))


class BlockContender:
    """A sampled Block: a trained network, Gaussian process, formula or hybrid.

    half_widths : of the conformal band (SI) in free run, by output, for outputs without own deviations; by default
    what the block's provenance tells of what was held out (`known_bands`), so none where nothing was.
    """

    def __init__(
        self, block: Block, kind: str = "learned", name: str | None = None, half_widths: Mapping | None = None
    ):
        self.block, self.kind, self.name = block, kind, name or block.name
        self.inputs, self.outputs, self.parameters = block.inputs, block.outputs, block.parameters
        self.domain, self.provenance = block.domain, dict(block.provenance)
        self.half_widths = _half_widths(block) if half_widths is None else dict(half_widths)

    def with_inputs(self, changes: Mapping[str, Mapping]) -> BlockContender:
        """The same whose inputs do something else between samples, see `changed`."""
        return BlockContender(self.block.with_inputs(changes), self.kind, self.name, self.half_widths)

    @property
    def content(self) -> tuple:
        """What its runs depend on."""
        own = tuple(getattr(self.block, f.name) for f in dataclasses.fields(Block) if f.name not in _WORDS)
        return (*own, self.half_widths)

    def to_travel(self) -> BlockContender:
        """The same block without what it was made of."""
        own = {f.name: getattr(self.block, f.name) for f in dataclasses.fields(Block) if f.name not in _WORDS}
        return BlockContender(Block(**own), self.kind, self.name, self.half_widths)

    def states_set(self, record: Record) -> list[str]:
        """States that a measured output of ``record`` sets, one step ahead."""
        return _states_set(self.block.states, record)

    def free_run(self, record: Record) -> Record:
        """Outputs of the block run at its own period."""
        return simulate(self.block, record)

    def one_step(self, record: Record) -> Record:
        """Outputs of the block, its measured states set to the measurement at every sample."""
        return predict_one_step(self.block, record)

    def deviations(self, record: Record) -> dict[str, np.ndarray]:
        """Standard deviation (n,), SI, that gives the conformal band of a free run, by output that has one."""
        return {name: np.full(len(record), wide / WIDE) for name, wide in self.half_widths.items()}


def _half_widths(block: Block) -> dict[str, float]:
    """Of the conformal bands, by output."""
    own = {s.name for s in block.outputs}
    told = {n: b.half_width for n, b in known_bands(block.provenance).items() if b.half_width is not None}
    return {n: wide for n, wide in told.items() if n in own and f"{n}.sd" not in own}


class HoldLast:
    """The yardstick: nothing changes. One step ahead it repeats the last sample, in free run the first.

    At kHz sampling this is hard to beat one step ahead, because the machine hardly moves in a millisecond.
    """

    kind = "yardstick"
    inputs: tuple[Signal, ...] = ()

    def __init__(self, outputs: Sequence[Signal], name: str = "hold last sample"):
        self.name, self.outputs, self.provenance = name, tuple(outputs), {}

    @property
    def content(self) -> tuple:
        """What its runs depend on."""
        return self.outputs

    def free_run(self, record: Record) -> Record:
        """Every output stays at its first sample, the first that is known."""
        return self._record(record, {n: np.full(len(record.time), _first(record[n])) for n in self._known(record)})

    def one_step(self, record: Record) -> Record:
        """Every output repeats its last sample, the last that is known."""
        return self._record(record, {n: _last(record[n]) for n in self._known(record)})

    def _known(self, record: Record) -> list[str]:
        return [s.name for s in self.outputs if s.name in record.signals]

    def _record(self, record: Record, signals: dict[str, np.ndarray]) -> Record:
        return Record(record.time, signals, {n: record.units[n] for n in signals}, self.name)


def _first(values: np.ndarray) -> float:
    known = values[np.isfinite(values)]
    return float(known[0]) if len(known) else float("nan")


def _last(values: np.ndarray) -> np.ndarray:
    """(n,) before every sample the last one that is known; before the first of these, that one."""
    before = np.r_[_first(values), values[:-1]]
    at = np.maximum.accumulate(np.where(np.isfinite(before), np.arange(len(before)), 0))
    return before[at]


def as_contender(thing, name: str | None = None) -> Contender:
    """Whatever you have as a contender: a Contender stays, a Block, Model or FlatModel gets its adapter."""
    if isinstance(thing, Contender):
        if name and name != thing.name:
            return _Renamed(thing, name)
        return thing
    if isinstance(thing, Block):
        return BlockContender(thing, kind=str(thing.provenance.get("kind", "learned")), name=name)
    if hasattr(getattr(thing, "flat", thing), "ode"):
        return PhysicalContender(thing, name)
    raise DeclarationError(
        f"comparison: a {type(thing).__name__} cannot take part. It must be a Model, a Block or an FMU read in. "
        "Wrap it in a class with name, kind, inputs, outputs, free_run and one_step."
    )


class _Renamed:
    """Another contender under another name."""

    def __init__(self, contender: Contender, name: str):
        self._contender, self.name = contender, name

    def with_inputs(self, changes: Mapping[str, Mapping]) -> _Renamed:
        return _Renamed(self._contender.with_inputs(changes), self.name)

    def with_starts(self, estimates: Sequence[StartEstimate]) -> _Renamed:
        estimating = hasattr(self._contender, "with_starts")
        return _Renamed(self._contender.with_starts(estimates), self.name) if estimating else self

    def stepped(self, step: float | None, method: str | None) -> _Renamed:
        stepping = hasattr(self._contender, "stepped")
        return _Renamed(self._contender.stepped(step, method), self.name) if stepping else self

    def to_travel(self) -> _Renamed:
        inner = self._contender
        return _Renamed(inner.to_travel() if hasattr(inner, "to_travel") else inner, self.name)

    def __getattr__(self, attribute: str):
        if attribute == "_contender" or attribute.startswith("__"):  # while it is being unpacked
            raise AttributeError(attribute)
        return getattr(self._contender, attribute)
