"""Where every model starts on every recording: as the first samples say, or as the first part of it does."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from hydrotwin.identification.beginning import AUTO, FREE, MEASURED, StartEstimate
from hydrotwin.models.language.errors import HydrotwinError
from hydrotwin.models.language.provenance import ASKED
from hydrotwin.records import Record

from .contender import Contender

ESTIMATE = "Estimate the start (initial_states auto)"


@dataclass(frozen=True)
class Started:
    """How one model starts on one recording, or on a part of it: ``of`` is the name of the recording."""

    model: str
    estimate: StartEstimate
    of: str

    def __str__(self) -> str:
        """In a sentence."""
        told = self.estimate
        if told.note:
            return self.noted(told.record)
        if not told.states:
            return f"{self.model} on {told.record}: nothing to estimate at the start."
        first, last = told.seconds
        return (
            f"{self.model} on {told.record}: start of {', '.join(s.name for s in told.states)} estimated from "
            f"{first:.4g} s to {last:.4g} s ({told.samples} samples), which is scored too."
        )

    def noted(self, where: str) -> str:
        """Its note, of the recordings ``where``."""
        there = "" if self.estimate.record == self.of else ", as if it began there"
        return f"{self.model} on {where} starts as without an estimate{there}: {self.estimate.note}"


def not_estimated(record: str) -> StartEstimate:
    """Of what has no equations: an FMU, a learned block, a loop."""
    return StartEstimate(record, note="only the start states of a model with equations are estimated.")


def start_of(contender: Contender, record: Record, how: str) -> tuple[Contender, Started | None]:
    """The contender with its start states on a recording estimated as ``how`` says, and how it starts then.

    A model whose start cannot be estimated starts as it does without, and says why. Behind a hole no machine rests
    because a recording begins there, so that "measured" is "auto".
    """
    how, of = AUTO if how == MEASURED and record.in_motion else how, record.whole
    if how == MEASURED or not hasattr(contender, "estimate_start"):
        others = (how == FREE or record.in_motion) and contender.kind != "yardstick"
        started = Started(contender.name, not_estimated(record.name), of) if others else None
        return contender, _unknown(contender, record) or started
    started = Started(contender.name, _estimate(contender, record, how), of)
    return contender.with_starts([started.estimate]) if hasattr(contender, "with_starts") else contender, started


def _unknown(contender: Contender, record: Record) -> Started | None:
    """What is to be told of a model whose measured start is not in the first sample; None where it is."""
    missing = contender.unknown_at_first(record) if hasattr(contender, "unknown_at_first") else []
    if not missing:
        return _not_as_fitted(contender, record)
    step = ESTIMATE if hasattr(contender, "estimate_start") else "Set the start"
    note = (
        f"the first sample of {' and '.join(missing)} is not known, so that the model starts there as it thinks. "
        f"{step}, or cut the recording to where it is known."
    )
    return Started(contender.name, StartEstimate(record.name, note=note), record.whole)


def _not_as_fitted(contender: Contender, record: Record) -> Started | None:
    """What is to be told of a model whose fit found, or was told to find, every start that no sensor tells."""
    asked = (getattr(contender, "provenance", None) or {}).get(ASKED)
    untold = contender.untold_starts(record) if hasattr(contender, "untold_starts") else []
    if not untold or not isinstance(asked, Mapping) or asked.get("initial_states") != FREE:
        return None
    note = f"its fit estimated where {' and '.join(untold)} began, and here no sample tells it. {ESTIMATE}."
    return Started(contender.name, StartEstimate(record.name, note=note), record.whole)


def _estimate(contender, record: Record, how: str) -> StartEstimate:
    try:
        return contender.estimate_start(record, how)
    except HydrotwinError as error:
        return StartEstimate(record.name, note=str(error))
