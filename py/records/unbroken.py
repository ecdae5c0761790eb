"""A recording with holes is the unbroken parts between them: what its inputs did in a hole nobody knows.

A hole is a stretch of time without samples (`steps`), or without values of a signal that must be known throughout:
longer than the steps of that signal's own raster. Whoever learns from recordings, or judges by them, takes the parts
from here, so that all cut in the same places. A part begins where the recording goes on, most likely in motion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from hydrotwin.models.language.errors import DataError

from .record import Record, Whole
from .steps import few_lost, holes_at, missing_at, usual

ENOUGH = 0.5  # of the samples: cut at every one that is missing, a recording would lose more
FEWEST = 50  # samples of a part that tells more than where it starts
OWN_STEP = 1.5  # of its own usual steps: a longer stretch without a sample is a gap in an input, not its slower raster
SHOWN = 3  # holes that a sentence names


def unbroken(record: Record, known: Iterable[str], every: bool = False) -> tuple[Record, ...]:
    """The parts of a recording between its holes; the recording itself where it has none.

    known : signals that must have values throughout; of others, samples may be unknown.
    every : cut, too, where one sample is missing, or few: what follows the noise sees them. Where that would leave less
        than half of the samples, it is not done, and told.

    Parts of fewer than `FEWEST` samples are left out. Raises DataError where no other is left.
    """
    if record.part_of is not None:
        return (record,)
    lost, known = few_lost(record.time), tuple(known)
    parts = _between(record, known, missing_at(record.time) if every else holes_at(record.time))
    if every and lost and _samples(_long(parts)) < ENOUGH * len(record):
        every, parts = False, _between(record, known, holes_at(record.time))
    holes = _holes(record, parts)
    kept = _long(parts) if holes else parts
    told = [_cut(record, holes, parts, kept)] if holes else []
    told += [_carried(record, lost)] if lost and not every else []
    if not told:
        return (record,)
    if not kept:
        raise DataError(
            f"{record.source or record.name}: nothing to learn from or to judge by between its holes "
            f"({_named(holes)}): the longest part has {max(p.stop - p.start for p in parts)} samples, and it takes "
            f"{FEWEST}. Record it again."
        )
    whole = Whole(record.name, float(record.time[0]), _named(holes), " ".join(told))
    names = [record.name] if len(kept) == 1 else [f"{record.name} (part {k + 1})" for k in range(len(kept))]
    return tuple(_part(record, at, name, whole) for at, name in zip(kept, names, strict=True))


def all_unbroken(records: Sequence[Record], known: Iterable[str], every: bool = False) -> list[Record]:
    """`unbroken` of all recordings."""
    known = tuple(known)
    return [part for record in records for part in unbroken(record, known, every)]


def joined(parts: Sequence[Record]) -> Record:
    """Parts of one recording, or runs through them, as one again, without what is between them."""
    if len(parts) == 1:
        return parts[0]
    signals = {n: np.concatenate([part[n] for part in parts]) for n in parts[0].names}
    time = np.concatenate([part.time for part in parts])
    return dataclasses.replace(parts[0], time=time, signals=signals, name=parts[0].whole, part_of=None)


def cuts(records: Iterable[Record]) -> list[str]:
    """Of recordings that were cut at their holes, what was made of them: a sentence for each."""
    return list(dict.fromkeys(r.part_of.told for r in records if r.part_of is not None))


def unknown_stretches(time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Samples (n,) of a signal that are unknown for longer than the steps of its own raster: nobody can tell them."""
    known = np.isfinite(values)
    if known.all():
        return ~known
    own = time[known]
    if len(own) < 2:
        return ~known
    edges = np.concatenate([time[:1], own, time[-1:]])
    after = np.searchsorted(own, time, side="right")
    steps = usual(np.diff(own))
    longer = np.diff(edges) > OWN_STEP * np.concatenate([steps[:1], steps, steps[-1:]])
    return ~known & longer[after]


def _part(record: Record, at: slice, name: str, whole: Whole) -> Record:
    signals = {n: values[at] for n, values in record.signals.items()}
    return dataclasses.replace(record, time=record.time[at], signals=signals, name=name, part_of=whole)


def _between(record: Record, known: Sequence[str], after: np.ndarray) -> list[slice]:
    """Samples of every part, the short ones too; ``after`` : samples behind which there is a hole."""
    lost = np.zeros(len(record), dtype=bool)
    for name in dict.fromkeys(known):
        if name in record.signals:
            lost |= unknown_stretches(record.time, record[name])
    if lost.all():  # a signal that is never known is no hole: who needs it says so
        return [slice(0, len(record))]
    begins = np.zeros(len(record) + 1, dtype=bool)
    begins[[0, *(after + 1), len(record)]] = True
    begins[1:-1] |= lost[1:] != lost[:-1]
    return [slice(int(a), int(b)) for a, b in pairwise(np.flatnonzero(begins)) if not lost[a]]


def _long(parts: Sequence[slice]) -> list[slice]:
    return [part for part in parts if part.stop - part.start >= FEWEST]


def _samples(parts: Sequence[slice]) -> int:
    return sum(part.stop - part.start for part in parts)


def _holes(record: Record, parts: Sequence[slice]) -> list[tuple[float, float]]:
    """From when to when [s] nothing is known."""
    time, holes = record.time, []
    if parts and parts[0].start > 0:
        holes.append((float(time[0]), float(time[parts[0].start])))
    holes += [(float(time[a.stop - 1]), float(time[b.start])) for a, b in pairwise(parts)]
    if parts and parts[-1].stop < len(time):
        holes.append((float(time[parts[-1].stop - 1]), float(time[-1])))
    return holes


def _named(holes: Sequence[tuple[float, float]]) -> str:
    more = f" and {len(holes) - SHOWN} more" if len(holes) > SHOWN else ""
    return ", ".join(f"{a:.6g} s to {b:.6g} s" for a, b in holes[:SHOWN]) + more


def _cut(record: Record, holes: Sequence, parts: Sequence[slice], kept: Sequence[slice]) -> str:
    """What was made of a recording with holes, in a sentence."""
    if len(kept) == 1:
        first, last = record.time[kept[0].start], record.time[kept[0].stop - 1]
        made = f"it is taken from {first:.6g} s to {last:.6g} s"
    else:
        made = f"it was cut into {len(kept)} parts"
    if any(part.start > 0 for part in kept):
        made += ", with a start of its own where it goes on"
    few = _samples(parts) - _samples(kept)
    left = f"; {few} samples beside them are left out, for a part of fewer than {FEWEST} tells little" if few else ""
    return (
        f"{record.name} has {'holes' if len(holes) > 1 else 'a hole'} ({_named(holes)}), and what its inputs did there "
        f"nobody knows: {made}{left}."
    )


def _carried(record: Record, lost: int) -> str:
    """That samples are missing where a recording is not cut, in a sentence."""
    count = "1 sample" if lost == 1 else f"{lost} samples, one or few at a time"
    return f"{record.name} lacks {count}; inputs are carried on there, which may look like an error of a model."
