"""What may put a right model far off on one recording: a start that nothing tells, a hole in time."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from hydrotwin.records import Record

from .contender import Contender
from .criteria import some_of
from .starts import Started


def other_reasons(contender: Contender, record: Record, starts: Sequence[Started]) -> str:
    """Reasons other than the model and its sensors, in words that follow those; "" where there are none."""
    estimated = {state.name for s in starts if (s.model, s.estimate.record) == (contender.name, record.name)
                 for state in s.estimate.states}  # fmt: skip
    untold = contender.untold_starts(record) if hasattr(contender, "untold_starts") else []
    left, reasons = [name for name in untold if name not in estimated], []
    if left:
        auto = "" if estimated else " (initial_states auto estimates it)"
        reasons.append(f"it starts elsewhere, for no sample there tells {some_of(left)}{auto}")
    if record.gaps:
        reasons.append(f"its inputs moved while there are {holes_of([record])}")
    return "".join(f", or {reason}" for reason in reasons)


def holes_of(records: Iterable[Record]) -> str:
    """Holes in the time of recordings over which inputs are only carried on, in words; "" without any."""
    records = list(records)
    alone = len(records) == 1
    return some_of([str(gap) if alone else f"{gap} of {r.name}" for r in records for gap in r.gaps])
