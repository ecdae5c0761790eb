"""What keeps a block from drifting where its outputs integrate: see `steady_step` for what it does.

A rate that is learnt one step ahead may be right to a thousandth, and its integral wrong by more than its range. What a
free run over the training recordings is off by, is taken out as a curve of the inputs, where that helps on parts held
out of its fit; and where the recordings show that the machine rests, the block rests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record
from hydrotwin.simulation import simulate
from hydrotwin.simulation.stops import Diverged

from .block_file import LearnedBlock
from .integrating import Part, cross_validated, integration, kinks_of, parts_of, rate_fit, told_forms
from .resting import Rests, rests
from .steady_step import (
    CURVE,
    INCREMENT,
    KINKS,
    LEVELS,
    RATES,
    REST,
    WIDTH,
    bent,
    measured_states,
    near_rest,
    steadied,
)
from .substeps_step import STEPS as SUBSTEPS

STEPS = 200  # of a block at a held command, over which its drift is looked at
PLACES = 9  # of each output's range, at which the drift is looked at
ROOM = 1.5  # times the largest drift seen is what the block is held against
LARGEST = 0.1  # of the fastest rate: a block that drifts faster at rest is not to be mended by holding it
COSTS = 1.1  # times the error in free run without being held at rest: more than that is not worth it
REPAYS = 0.9  # of the error without a curve: what it must come to with one, where it was not fitted
MOST = 4000  # samples that a curve is fitted on, over all recordings


@dataclass(frozen=True)
class Steady:
    """What is done about drift.

    outputs : those that integrate. commands : names of the inputs that let the machine rest; None: all.
    curve : whether the rates may be corrected by a curve; not where they are what the block is said to be.
    """

    outputs: tuple[Signal, ...]
    commands: Sequence[str] | None = None
    curve: bool = False


def steady_block(block: LearnedBlock, records: Sequence[Record], what: Steady) -> LearnedBlock:
    """The block without the drift of its integrating outputs; what was done is in its provenance ("drift", "rest")."""
    own = {block.states[j].measured_by for j in measured_states(block.states)}
    kept = [s for s in what.outputs if s.name in own]
    if not kept:
        return block
    deciding = [s for s in block.inputs if what.commands is None or s.name in what.commands]
    slow = block.period * block.structure.get(SUBSTEPS, 1)
    found = rests(records, deciding, kept, slow)
    held = _held(block, found, kept, deciding)
    if held.step is not block.step and not _as_exact(held, block, records, [s.name for s in kept]):
        told = {**held.provenance["rest"], "held": []}
        held = replace(block, provenance={**block.provenance, "rest": told})
    return _curved(held, records, kept, block.step) if what.curve else held


def _as_exact(held: LearnedBlock, block: LearnedBlock, records: Sequence[Record], names: Sequence[str]) -> bool:
    """Whether the block that is held at rest runs as well over the recordings as without.

    Slow motion through the commands of a rest is held, too, and what a trained block loses there is not made up for.
    """
    try:
        errors = [_rms(np.concatenate([simulate(b, r).array(names) - r.array(names) for r in records]))
                  for b in (held, block)]  # fmt: skip
    except Diverged:
        return True
    return bool(np.all(errors[0] <= COSTS * errors[1]))


def _rms(miss: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(miss**2, axis=0))


def steady_where_it_integrates(
    block: LearnedBlock, records: Sequence[Record], outputs: Sequence[Signal], *, published: bool = False, **what
) -> LearnedBlock:
    """`steady_block` for those of ``outputs`` that are found to integrate, which the provenance tells.

    published : told, and left as it is. what : commands and curve of `Steady`.
    """
    forms = integration(records, block.inputs, outputs)
    block = replace(block, provenance={**block.provenance, "integration": told_forms(forms)})
    integrating = () if published else tuple(f.output for f in forms if f.found)
    return steady_block(block, records, Steady(integrating, **what))


def _with(block: LearnedBlock, arrays: dict[str, np.ndarray], told: dict, trained: ca.Function) -> LearnedBlock:
    """The block with ``arrays`` of `steady_step` around its ``trained`` step."""
    kept = {n: a for n, a in block.arrays.items() if n in (*CURVE, *REST)} | arrays
    step = steadied(trained, kept, block.inputs, block.outputs, block.states, block.period)
    return replace(block, step=step, arrays={**block.arrays, **arrays}, provenance={**block.provenance, **told})


# -- the curve ---------------------------------------------------------------------------------------------------------
def _curved(block: LearnedBlock, records: Sequence[Record], outputs: Sequence[Signal], trained) -> LearnedBlock:
    """With a curve on the rates of the outputs where that helps; it does not act where the machine rests."""
    names, inputs = [s.name for s in outputs], [s.name for s in block.inputs]
    kinks = kinks_of([r.array(inputs) for r in records])
    try:
        parts = _parts(block, records, names, kinks)
        before, after = cross_validated(parts)
        helps = after < REPAYS * before
        if not helps.any():
            return block
        measured = [block.states[j].measured_by for j in measured_states(block.states)]
        found, rates = rate_fit(parts), np.zeros((parts[0].causes.shape[1], len(measured)))
        for k in np.flatnonzero(helps):
            rates[:, measured.index(names[k])] = found[:, k]
        told = {n: {"before": float(a), "after": float(b)} for n, a, b in zip(names, before, after, strict=True)}
        curved = _with(block, {KINKS: kinks, RATES: rates}, {"drift": told}, trained)
        better = _run_error(_parts(curved, records, names, kinks))[helps] < _run_error(parts)[helps]
    except Diverged:
        return block
    return curved if better.all() else block


def _parts(block: LearnedBlock, records: Sequence[Record], names: Sequence[str], kinks: np.ndarray) -> list[Part]:
    """What free runs over the recordings are off by, in parts."""
    thin = max(1, sum(len(r) for r in records) // MOST)
    answer = []
    for record in records:
        u = record.array([s.name for s in block.inputs])
        columns = np.column_stack(bent(list(u.T), kinks)) * ~near_rest(block.arrays, u)[:, None]
        passed = np.diff(record.time, append=record.time[-1])[:, None] * columns
        integral = np.cumsum(passed, axis=0) - passed
        miss = record.array(names) - simulate(block, record).array(names)
        answer += parts_of(columns[::thin], integral[::thin], miss[::thin])
    return answer


def _run_error(parts: Sequence[Part]) -> np.ndarray:
    return np.sqrt(np.mean(np.concatenate([p.outputs - p.outputs[0] for p in parts]) ** 2, axis=0))


# -- rest --------------------------------------------------------------------------------------------------------------
def _held(block: LearnedBlock, found: Rests, outputs: Sequence[Signal], commands: Sequence[Signal]) -> LearnedBlock:
    """Held where the machine rests, if it does not drift there by so much that this would hide a bad block."""
    if not len(found.levels):
        return block
    arrays = _arrays_of(block, found, commands)
    drift = drift_at_rest(block, arrays[LEVELS])
    fastest = {s.name: rate for s, rate in zip(outputs, found.fastest, strict=True)}
    names = [block.states[j].measured_by for j in measured_states(block.states)]
    holds = (drift > 0) & (drift <= [LARGEST * fastest.get(name, 0.0) for name in names])
    told = {"at": found.levels.tolist(), "commands": [s.name for s in commands]}
    told["drift"] = {n: float(d) for n, d in zip(names, drift, strict=True) if n in fastest}
    told["held"] = [n for n, h in zip(names, holds, strict=True) if h]
    if not holds.any():
        return replace(block, provenance={**block.provenance, "rest": told})
    arrays[INCREMENT] = np.where(holds, ROOM * drift * block.period, 0.0)
    return _with(block, arrays, {"rest": told}, block.step)


def drift_at_rest(block, levels: np.ndarray) -> np.ndarray:
    """The fastest rate [SI/s] of each measured state at held inputs (n, nu), from standing still anywhere."""
    places = np.array([_places(block, s.name) for s in block.outputs])
    count, worst = len(levels) * PLACES, 0.0
    u = np.repeat(levels, PLACES, axis=0).T
    y = np.tile(places, len(levels))
    x, none = block.start.map(count)(u, y, np.zeros((0, count))).full(), np.zeros((0, count))
    step, own = block.step.map(count), measured_states(block.states)
    for _ in range(STEPS):
        following = step(x, u, none)[0].full()
        moved, x = following[own] - x[own], following
        worst = np.maximum(worst, np.abs(moved).max(axis=1))
    return np.where(np.isfinite(worst), worst, np.inf) / block.period


def _places(block, name: str) -> np.ndarray:
    """Even places over the training range of an output."""
    if name not in block.domain.names:
        return np.zeros(PLACES)
    k = block.domain.names.index(name)
    return np.linspace(block.domain.lower[k], block.domain.upper[k], PLACES)


def _arrays_of(block, found: Rests, commands: Sequence[Signal]) -> dict[str, np.ndarray]:
    """The levels and widths for all inputs of the block; those that do not matter are anywhere."""
    names = [s.name for s in block.inputs]
    levels, width = np.zeros((len(found.levels), len(names))), np.full(len(names), np.finfo(float).max / 4)
    for k, s in enumerate(commands):
        levels[:, names.index(s.name)], width[names.index(s.name)] = found.levels[:, k], found.width[k]
    return {LEVELS: levels, WIDTH: width}
