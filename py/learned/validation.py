"""Recordings that judge a block: no trainer sees them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from hydrotwin.models.language.errors import DataError, nearest
from hydrotwin.records import Record, all_unbroken, as_needed, require_unseen
from hydrotwin.simulation import Block, simulate
from hydrotwin.simulation.stops import Diverged

from .report_card import shown
from .training_data import named

ERRORS, RECORDINGS = "validation", "validated_on"  # keys of the provenance


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


def validated(block: Block, validate: Sequence[Record]) -> Block:
    """The block with the RMS errors of its free runs over recordings, by output, SI; infinite where one diverges."""
    if not validate:
        return block
    outputs = [s.name for s in block.outputs if all(s.name in r for r in validate)]
    needed = [as_needed(record, (*block.inputs, *block.outputs)) for record in validate]
    given, validate = validate, all_unbroken(needed, [s.name for s in block.inputs])
    try:
        runs = [(simulate(block, record), record) for record in validate]
        misses = {n: np.concatenate([run[n] - record[n] for run, record in runs]) for n in outputs}
        errors = {n: float(np.sqrt(np.nanmean(miss**2))) for n, miss in misses.items()}
    except Diverged:
        errors = dict.fromkeys(outputs, float("inf"))
    return replace(block, provenance={**block.provenance, ERRORS: errors, RECORDINGS: named(given)})


def sentence(block: Block) -> str:
    """What the validation recordings say of a block; "" where there were none."""
    errors, count = block.provenance.get(ERRORS), len(block.provenance.get(RECORDINGS, ()))
    if not errors or not count:
        return ""
    units = {s.name: s.unit for s in block.outputs}
    told = ", ".join(
        f"{name} {shown(error, units[name])}" if np.isfinite(error) else f"{name}: a run diverges"
        for name, error in errors.items()
    )
    where = "recording" if count == 1 else "recordings"
    return f"Free run over {count} validation {where}, which took no part: RMS error of {told}."
