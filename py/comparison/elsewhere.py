"""What may put a right model far off on one recording: a start that nothing tells, also behind a hole."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from hydrotwin.records import Record, unbroken
from hydrotwin.records.unbroken import unknown_stretches

from .contender import Contender
from .criteria import some_of
from .starts import Started


def other_reasons(contender: Contender, record: Record, starts: Sequence[Started], models: Sequence[Contender]) -> str:
    """Reasons other than the model and its sensors, in words that follow those; "" where there are none.

    models : all that are compared: runs of each begin anew behind the holes of their inputs.
    """
    estimated = {state.name for s in starts if (s.model, s.of) == (contender.name, record.name)
                 for state in s.estimate.states}  # fmt: skip
    untold = contender.untold_starts(record) if hasattr(contender, "untold_starts") else []
    left, reasons = [name for name in untold if name not in estimated], []
    if left:
        auto = "" if estimated else " (initial_states auto estimates it)"
        reasons.append(f"it starts elsewhere, for no sample there tells {some_of(left)}{auto}")
    if holes := holes_of([record], models):
        reasons.append(f"it starts elsewhere behind a hole ({holes})")
    return "".join(f", or {reason}" for reason in reasons)


def holes_of(records: Sequence[Record], models: Iterable) -> str:
    """Holes of recordings behind which models start anew, in words; "" without any. models : whatever has inputs."""
    known = input_names(models)
    wholes = [whole for r in records if (whole := unbroken(r, known)[-1].part_of) and unbroken(r, known)[-1].in_motion]
    return some_of([w.holes if len(records) == 1 else f"{w.holes} of {w.name}" for w in wholes])


def unknown_of(records: Sequence[Record], output: str) -> str:
    """Samples that say nothing of an output, in words; "" without any: its sensor was silent for longer than the steps
    of its own raster, or nothing was run there, for which a comparison leaves it unknown (`run.measured_in`)."""
    lost = [(r, int(unknown_stretches(r.time, r[output]).sum())) for r in records]
    return some_of([f"{count} of {len(r)} samples of {r.name}" for r, count in lost if count])


def slower(record: Record, name: str) -> bool:
    """Whether a column has a raster of its own, so that it is not known in the row before: nothing sets it there."""
    known = np.flatnonzero(np.isfinite(record[name])) if name in record.signals else ()
    return len(known) > 1 and bool(np.median(np.diff(known)) > 1)


def input_names(models: Iterable) -> tuple[str, ...]:
    """What must be known throughout a recording so that models can run through it: the inputs of all of them."""
    return tuple(dict.fromkeys(s.name for m in models for s in m.inputs))
