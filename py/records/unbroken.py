"""A recording with holes is the unbroken parts between them: what its inputs did in a hole nobody knows.

A hole is a stretch of time without samples (`gaps_of`), or without values of a signal that must be known throughout:
longer than the steps of that signal's own raster. Whoever learns from recordings, or judges by them, takes the parts
from here, so that all cut in the same places. A part begins where the recording goes on, most likely in motion.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np

from hydrotwin.models.language.errors import DataError

from .record import Record, Whole, gaps_of

FEWEST = 50  # samples of a part that tells more than where it starts
OWN_STEP = 1.5  # of its own median steps: a longer stretch without a sample is a gap in an input, not its slower raster
SHOWN = 3  # holes that a sentence names


def unbroken(record: Record, known: Iterable[str]) -> tuple[Record, ...]:
    """The parts of a recording between its holes; the recording itself where it has none.

    known : signals that must have values throughout; of others, samples may be unknown.

    Parts of fewer than `FEWEST` samples are left out. Raises DataError where no other is left.
    """
    every = _between_holes(record, known)
    if every == [slice(0, len(record))] or record.part_of is not None:
        return (record,)
    kept = [part for part in every if part.stop - part.start >= FEWEST]
    if not kept:
        raise DataError(
            f"{record.source or record.name}: nothing to learn from or to judge by between its holes "
            f"({_named(_holes(record, every))}): the longest part has {max(p.stop - p.start for p in every)} samples, "
            f"and it takes {FEWEST}. Record it again."
        )
    holes = _named(_holes(record, every))
    whole = Whole(record.name, float(record.time[0]), holes, _told(record, holes, every, kept))
    names = [record.name] if len(kept) == 1 else [f"{record.name} (part {k + 1})" for k in range(len(kept))]
    return tuple(_part(record, at, name, whole) for at, name in zip(kept, names, strict=True))


def all_unbroken(records: Sequence[Record], known: Iterable[str]) -> list[Record]:
    """`unbroken` of all recordings."""
    known = tuple(known)
    return [part for record in records for part in unbroken(record, known)]


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
    longer = edges[after + 1] - edges[after] > OWN_STEP * np.median(np.diff(own))
    return ~known & longer


def _part(record: Record, at: slice, name: str, whole: Whole) -> Record:
    signals = {n: values[at] for n, values in record.signals.items()}
    return dataclasses.replace(record, time=record.time[at], signals=signals, name=name, part_of=whole)


def _between_holes(record: Record, known: Iterable[str]) -> list[slice]:
    """Samples of every part, the short ones too."""
    lost = np.zeros(len(record), dtype=bool)
    for name in dict.fromkeys(known):
        if name in record.signals:
            lost |= unknown_stretches(record.time, record[name])
    if lost.all():  # a signal that is never known is no hole: who needs it says so
        return [slice(0, len(record))]
    begins = np.zeros(len(record) + 1, dtype=bool)
    begins[[0, *(gap.index + 1 for gap in gaps_of(record.time)), len(record)]] = True
    begins[1:-1] |= lost[1:] != lost[:-1]
    return [slice(int(a), int(b)) for a, b in pairwise(np.flatnonzero(begins)) if not lost[a]]


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


def _told(record: Record, holes: str, every: Sequence[slice], kept: Sequence[slice]) -> str:
    """What was made of a recording with these holes, in a sentence."""
    if len(kept) == 1:
        first, last = record.time[kept[0].start], record.time[kept[0].stop - 1]
        made = f"it is taken from {first:.6g} s to {last:.6g} s"
    else:
        made = f"it was cut into {len(kept)} parts"
    if any(part.start > 0 for part in kept):
        made += ", with a start of its own where it goes on"
    few = sum(part.stop - part.start for part in every) - sum(part.stop - part.start for part in kept)
    left = f"; {few} samples beside them are left out, for a part of fewer than {FEWEST} tells nothing" if few else ""
    return (
        f"{record.name} has {'holes' if ',' in holes or ' and ' in holes else 'a hole'} ({holes}), and what its inputs "
        f"did there nobody knows: {made}{left}."
    )
