"""Where a block has a longer period than its recordings: means of the inputs in place of single samples."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.errors import DeclarationError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .block_file import LearnedBlock, assemble, kind_of
from .substeps_step import STEPS, substep_states
from .training_data import on_period, recorded_period, resolved

KEPT = ("name", "inputs", "outputs", "parameters", "domain", "description", "provenance", "certificate")
EVEN = 1e-3  # of a sampling period: a period that is so near to a whole number of them has that many


def chosen_substeps(asked: int | None, period: float | None, records, inputs: Sequence[Signal], at: float) -> int:
    """Steps of the period ``at``: as asked; where a period was asked for, that is the step; else `substeps_of`.

    Raises DeclarationError where as many samples of the recordings as were asked for are not the period.
    """
    if asked is not None:
        recorded = recorded_period(records)
        if asked > 1 and abs(at - asked * recorded) > EVEN * recorded:
            raise DeclarationError(
                f"learn: substeps={asked} are {asked * recorded:.6g} s of the recordings, the period is {at:.6g} s. "
                "Steps are their samples: give a period of whole samples and their number, or neither."
            )
        return int(asked)
    return 1 if period else substeps_of(records, inputs, at)


def substeps_of(records: Sequence[Record], inputs: Sequence[Signal], period: float) -> int:
    """Into how many steps a period is parted: 1 where its samples show what the inputs do in between, else all.

    They show it where linear interpolation loses nothing worth having (`resolved`). Recordings that are not even, or
    not whole parts of the period, have one step.
    """
    recorded = recorded_period(records)
    steps = round(period / recorded)
    alike = all(r.uniform and abs(r.period - recorded) <= EVEN * recorded for r in records)
    if steps < 2 or not alike or abs(period - steps * recorded) > EVEN * recorded:
        return 1
    names = [s.name for s in inputs]
    return 1 if all(resolved(r.select(names), period) for r in records) else steps


def at_period(record: Record, period: float, inputs: Sequence[Signal], steps: int) -> Record:
    """The recording at a period, the inputs as means over the period that a sample begins."""
    even = on_period(record, period, inputs)
    if steps == 1:
        return even
    begins = np.minimum(steps * np.arange(len(even)), len(record) - 1)
    counts = np.diff(begins, append=max(len(record), begins[-1] + 1))
    means = {s.name: np.add.reduceat(record[s.name], begins) / counts for s in inputs}
    return even.with_signals(means)


def with_steps(block: LearnedBlock, steps: int) -> LearnedBlock:
    """A block that was trained on means, with so many steps in its period; as it is where they are one."""
    if steps == 1:
        return block
    frame = {name: getattr(block, name) for name in KEPT}
    frame |= {"states": substep_states(block.states, block.inputs), "period": block.period / steps}
    return assemble(kind_of(block), block.arrays, {**block.structure, STEPS: steps}, **frame)
