"""Where every model starts on every recording: as the first samples say, or as the first part of it does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from hydrotwin.identification.beginning import FREE, MEASURED, StartEstimate, check_initial_states
from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.records import Record

from .contender import Contender


@dataclass(frozen=True)
class Started:
    """How one model starts on one recording."""

    model: str
    estimate: StartEstimate

    def __str__(self) -> str:
        """In a sentence."""
        told = self.estimate
        if told.note:
            return f"{self.model} on {told.record} starts as without an estimate: {told.note}"
        if not told.states:
            return f"{self.model} on {told.record}: nothing to estimate at the start."
        first, last = told.seconds
        return (
            f"{self.model} on {told.record}: start of {', '.join(s.name for s in told.states)} estimated from "
            f"{first:.4g} s to {last:.4g} s ({told.samples} samples), which is scored too."
        )


def not_estimated(record: str) -> StartEstimate:
    """Of what has no equations: an FMU, a learned block, a loop."""
    return StartEstimate(record, note="only the start states of a model with equations are estimated.")


def with_starts(
    contenders: Sequence[Contender], records: Sequence[Record], how: str
) -> tuple[list[Contender], tuple[Started, ...]]:
    """The contenders with their start states estimated as ``how`` says, and how each starts on each recording.

    A model whose start cannot be estimated starts as it does without, and says why. Raises DeclarationError for a
    ``how`` that does not exist.
    """
    how = check_initial_states(how, "compare")
    if how == MEASURED:
        return list(contenders), ()
    rows: list[Started] = []
    for contender in contenders:
        if hasattr(contender, "estimate_start"):
            rows += [Started(contender.name, _estimate(contender, r, how)) for r in records]
        elif how == FREE and contender.kind != "yardstick":
            rows += [Started(contender.name, not_estimated(r.name)) for r in records]
    of = {c.name: [row.estimate for row in rows if row.model == c.name] for c in contenders}
    return [c.with_starts(of[c.name]) if hasattr(c, "with_starts") else c for c in contenders], tuple(rows)


def _estimate(contender, record: Record, how: str) -> StartEstimate:
    try:
        return contender.estimate_start(record, how)
    except HydrotwinError as error:
        return StartEstimate(record.name, note=str(error))
