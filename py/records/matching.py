"""Which column is which signal of a model: by name, or as a proposal that a person confirms."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from dataclasses import dataclass

from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.units import compatible

from .record import Record

CLOSE = 0.72  # of 1: likeness of two names from which on one is proposed for the other


@dataclass(frozen=True)
class Match:
    """A signal and its column: ``how`` says why, and is "" where nothing fits. certain : the names are the same.

    problem : why the column cannot be used as it is.
    """

    signal: Signal
    column: str | None
    how: str = ""
    certain: bool = False
    problem: str = ""

    @property
    def said(self) -> str:
        """Why, for a person."""
        if not self.how:
            return "none" if self.column is None else ""
        return self.how if self.certain else f"proposed: {self.how}"


def matched(signals: Sequence[Signal], record: Record) -> list[Match]:
    """The column of every signal; one column serves one signal. Only those with ``certain`` are used unasked."""
    usable = dict.fromkeys(record.names)
    columns = [*usable, *(n for n in record.refused if n not in usable)]
    found: dict[str, Match] = {}
    for signal in signals:
        if signal.name in columns:
            found[signal.name] = Match(signal, signal.name, "by name", True, _problem(record, signal, signal.name))
    for how, fits in (("its name is the same but for spelling", _same), ("its name is close", _close)):
        for signal in signals:
            if signal.name not in found:
                taken = {m.column for m in found.values()}
                likely = [c for c in columns if c not in taken and _may_be(record, signal, c)]
                best = max(likely, key=lambda c: _likeness(signal.name, c), default=None)
                if best is not None and fits(signal.name, best):
                    found[signal.name] = Match(signal, best, how, problem=_problem(record, signal, best))
    return [found.get(s.name) or _only_one(s, signals, columns, found, record) for s in signals]


def _only_one(signal: Signal, signals, columns, found, record: Record) -> Match:
    """The only column left of a signal's dimension, where it is the only signal of it."""
    taken = {m.column for m in found.values()}
    left = [c for c in columns if c not in taken and c in record.units and _may_be(record, signal, c)]
    rivals = [s for s in signals if s.name not in found and compatible(s.unit, signal.unit)]
    if len(left) == 1 and len(rivals) == 1:
        return Match(signal, left[0], f"the only other column in {record.display_units.get(left[0], '')}")
    return Match(signal, None)


def _may_be(record: Record, signal: Signal, column: str) -> bool:
    return column not in record.units or compatible(record.display_units.get(column, record.units[column]), signal.unit)


def _problem(record: Record, signal: Signal, column: str) -> str:
    if column in record.refused:
        return record.refused[column]
    if not _may_be(record, signal, column):
        unit = record.display_units.get(column, record.units[column])
        return f"column '{column}' is in {unit}, the model needs {signal.unit}. Scale it: --scale '{signal.name}=...'."
    return ""


def _plain(name: str) -> str:
    return re.sub(r"[^a-z0-9]", "", name.lower())


def _likeness(a: str, b: str) -> float:
    return difflib.SequenceMatcher(None, _plain(a), _plain(b)).ratio()


def _same(a: str, b: str) -> bool:
    return _plain(a) == _plain(b)


def _close(a: str, b: str) -> bool:
    return _likeness(a, b) >= CLOSE
