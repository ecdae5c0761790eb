"""Recordings that judge a block: no trainer sees them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from hydrotwin.models.language.errors import DataError, nearest
from hydrotwin.records import Record, all_unbroken, as_needed, require_unseen
from hydrotwin.simulation import Block, simulate
from hydrotwin.simulation.stops import Diverged

from .bands import WIDE, known_bands
from .leaving import far, leaves, leaves_said
from .report_card import constant, shown
from .training_data import named
from .verdicts import BETTER

ERRORS, RECORDINGS = "validation", "validated_on"  # keys of the provenance
BESIDE, BEYOND, INSIDE = "validation_beside", "validation_beyond", "validation_coverage"
FIRST = "holding the first sample"  # the yardstick of a run that begins where the recording does
FEW_INSIDE = 0.75  # of a 95 % band: less is hardly a draw of a right one, however alike the misses are
Run = Callable[[Record], Record]


def judges(validate: Sequence[Record], records: Sequence[Record], columns: Sequence[str]) -> list[Record]:
    """Recordings to validate, checked before a long training.

    Raises DataError for one that lacks a column, and for one that is trained on.
    """
    for record in validate:
        where = record.source or record.name
        missing = next((name for name in columns if name not in record), None)
        if missing:
            raise DataError(
                f"{where}: no column '{missing}', which the block has. {nearest(missing, record.names)} "
                "Name another recording to validate."
            )
    require_unseen(records, validate)
    return list(validate)


def validated(
    block: Block,
    validate: Sequence[Record],
    rivals: Mapping[str, Run] | None = None,
    *,
    beside: Mapping[str, Mapping[str, float]] | None = None,
) -> Block:
    """The block with what its free runs over recordings come to, in its provenance; see the keys at the top.

    ``ERRORS``: RMS by output, SI; infinite where a run diverges. ``BESIDE``: the same of holding the first sample and
    of every one of ``rivals``, by output and yardstick. ``BEYOND``: the share of the samples outside of what the block
    was trained on, and the signals that leave it. ``INSIDE``: what of every output lies in its 95 % band.

    rivals : yardsticks by name, each with what it answers to a recording. beside : their errors, where they are known.
    """
    if not validate:
        return block
    outputs = [s.name for s in block.outputs if all(s.name in r for r in validate)]
    needed = [as_needed(record, (*block.inputs, *block.outputs)) for record in validate]
    runs = all_unbroken(needed, [s.name for s in block.inputs])
    known: dict[int, Record] = {}

    def run(record: Record) -> Record:
        if id(record) not in known:
            known[id(record)] = simulate(block, record)
        return known[id(record)]

    told = {ERRORS: _errors(run, runs, outputs), RECORDINGS: named(validate)}
    told |= {INSIDE: inside} if (inside := _inside(block, run, runs, outputs)) else {}
    told[BESIDE] = dict(beside or _beside(rivals or {}, runs, outputs))
    own = [run(r) for r in runs] if told[ERRORS] and np.isfinite(list(told[ERRORS].values())).all() else []
    told |= {BEYOND: beyond} if (beyond := leaves(block, runs, own)) else {}
    return replace(block, provenance={**block.provenance, **told})


def beside(block: Block, validate: Sequence[Record]) -> Mapping[str, Mapping[str, float]]:
    """What the yardsticks come to on recordings that this block was validated on; empty where it was not."""
    return block.provenance.get(BESIDE, {}) if block.provenance.get(RECORDINGS) == named(validate) else {}


def _beside(rivals: Mapping[str, Run], records: Sequence[Record], outputs: Sequence[str]) -> dict:
    """RMS error by output and yardstick; a yardstick that cannot run is left out."""
    found = {name: _errors(run, records, outputs) for name, run in {FIRST: _held, **rivals}.items()}
    return {output: {name: errors[output] for name, errors in found.items() if output in errors} for output in outputs}


def _held(record: Record) -> Record:
    """Every signal stays at its first value."""
    known = {n: record[n][np.isfinite(record[n])] for n in record.signals}
    return constant(record, {n: float(values[0]) for n, values in known.items() if len(values)})


def _errors(run: Run, records: Sequence[Record], outputs: Sequence[str]) -> dict[str, float]:
    """RMS error by output, infinite where a run diverges; none of an output that has no answer."""
    try:
        runs = [(run(record), record) for record in records]
    except Diverged:
        return dict.fromkeys(outputs, float("inf"))
    except DataError:
        return {}
    misses = {n: np.concatenate([a[n] - r[n] for a, r in runs]) for n in outputs if all(n in a for a, _ in runs)}
    return {n: float(np.sqrt(np.nanmean(miss**2))) for n, miss in misses.items()}


def _inside(block: Block, run: Run, records: Sequence[Record], outputs: Sequence[str]) -> dict[str, float]:
    """Share of the samples in the 95 % band of a free run, by output that has one; {} where a run diverges."""
    bands, own, found = known_bands(block.provenance), {s.name for s in block.outputs}, {}
    for name in outputs:
        wide = bands[name].half_width if name in bands else None
        if wide is None and f"{name}.sd" not in own:
            continue
        try:
            runs = [(run(r), r) for r in records]
        except Diverged:
            return {}
        inside = [np.abs(a[name] - r[name]) <= (WIDE * a[f"{name}.sd"] if wide is None else wide) for a, r in runs]
        known = np.concatenate([np.isfinite(r[name]) for r in records])
        found[name] = float(np.mean(np.concatenate(inside)[known]))
    return found


def as_card(block: Block) -> dict:
    """RMS error and that of the yardsticks by output, in the form of a report card; {} where nothing was validated."""
    errors, beside_ = block.provenance.get(ERRORS), block.provenance.get(BESIDE, {})
    rows = {n: {"rmse": error, "yardsticks": beside_.get(n, {})} for n, error in (errors or {}).items()}
    return {"outputs": rows} if rows else {}


def no_better_than(block: Block) -> dict[str, list[str]]:
    """By output, the yardsticks that the block does not beat on the recordings to validate with; {} of none."""
    told, errors = block.provenance, block.provenance.get(ERRORS) or {}
    found = {
        output: [name for name, rival in told.get(BESIDE, {}).get(output, {}).items() if not error < BETTER * rival]
        for output, error in errors.items()
    }
    return {output: names for output, names in found.items() if names}


def doubtful(block: Block) -> bool:
    """Whether the recordings to validate with say something against a block."""
    told = block.provenance
    few = any(inside < FEW_INSIDE for inside in told.get(INSIDE, {}).values())
    return bool(no_better_than(block)) or few or far(told.get(BEYOND, {}))


def sentence(block: Block) -> str:
    """What the validation recordings say of a block, what it is no better than first; "" where there were none."""
    told = block.provenance
    errors, count = told.get(ERRORS), len(told.get(RECORDINGS, ()))
    if not errors or not count:
        return ""
    units = {s.name: s.unit for s in block.outputs}
    rows = [_said(name, error, told.get(BESIDE, {}).get(name, {}), units[name]) for name, error in errors.items()]
    where = "recording" if count == 1 else "recordings"
    good = f"Free run over {count} validation {where}, which took no part: RMS error of {', '.join(rows)}."
    bands = [_band_said(name, inside) for name, inside in told.get(INSIDE, {}).items()]
    return " ".join(filter(None, [_worse_said(block), good, *bands, leaves_said(told.get(BEYOND), "that")]))


def _band_said(name: str, inside: float) -> str:
    doubt = ": do not rely on it" if inside < FEW_INSIDE else ""
    return f"The 95 % band of {name} holds {100 * inside:.3g} % of that{doubt}."


def _worse_said(block: Block) -> str:
    words = [
        f"of {name} the block is no better than {' or '.join(than)}" for name, than in no_better_than(block).items()
    ]
    return f"On what it was to be validated with, {', and '.join(words)}." if words else ""


def _said(name: str, error: float, rivals: Mapping[str, float], unit: str) -> str:
    own = f"{name} {shown(error, unit)}" if np.isfinite(error) else f"{name}: a run diverges"
    others = ", ".join(f"{n} {shown(e, unit) if np.isfinite(e) else 'diverges'}" for n, e in rivals.items())
    return f"{own} ({others})" if others else own
