"""By what the samples of a recording are known again, in whatever file they lie: marks, which tell none of them.

A file of the same samples may have other bytes: other line ends, compressed, in another format or unit, its columns in
another order, with more of them, its rows cut. So who keeps which recordings a model was made from keeps, beside the
SHA-256 of the file, at `MARKS` places of each column that moves there a hash of `TAPS` samples in `DIGITS` digits of
SI. Where all columns that both have, two at least, have the same hashes in one row, the samples are those. A second run
of the same commands differs by the noise of its sensors: commands alone tell nothing, so each column counts by its own
marks, and one that a sensor measured must be among them. A resampled or filtered copy is another recording, and so is
one of fewer digits.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

import numpy as np

from hydrotwin.models.language.provenance import MARKED, SAMPLES

from .record import Record

MARKS = 48  # places of a column, evenly over where two columns or more move
TRIED = 16 * MARKS  # rows that are tried for them
TAPS = np.array([0, 1, 2, 4, 8, 16, 32])  # own samples of a column from a row on: what is fast shows, and what slow
DIGITS = 5
NEAR = 0.1  # of the last digit: nearer to where it is rounded up, a copy of few digits more may be rounded otherwise
COLUMNS = 8  # of a recording of which nobody says which columns count; those that move in most places
FEWEST, SHARE = 3, 0.5  # marks that are met; share of those that a copy of so many samples would meet
HASH = 8  # hexadecimal digits; 0 where a column does not move
_PRIME, _MIX, _HALF = np.uint64(1099511628211), np.uint64(0xFF51AFD7ED558CCD), np.uint64(32)


def row_of(record: Record, names: Iterable[str] | None = None, role: str = "") -> dict:
    """Name, SHA-256 and marks of a recording that a model is made from, as a row of its provenance.

    names : the columns that count; by default those that move most. role : of the row, "" for none.
    """
    row = {"name": record.name, "sha256": record.digest or ""} | ({"role": role} if role else {})
    marks = marks_of(record, names)
    return row | ({SAMPLES: len(record), MARKED: marks} if marks else {})


def marks_of(record: Record, names: Iterable[str] | None = None) -> dict[str, str]:
    """The marks of its columns, one behind the other; none of what is too short or where fewer than two move."""
    rows = np.unique(np.linspace(0, len(record) - 1, TRIED).astype(int))
    own = set(record.names)  # one that cannot be used need not be one that is needed
    chosen = [n for n in (record.names if names is None else dict.fromkeys(names)) if n in own]
    found = {name: _hashes(record[name], rows) for name in chosen}
    found = dict(sorted(found.items(), key=lambda one: -np.count_nonzero(one[1]))) if names is None else found
    found = {name: found[name] for name in list(found)[: COLUMNS if names is None else None] if found[name].any()}
    if len(found) < 2:
        return {}
    told = np.flatnonzero(sum((h > 0).astype(int) for h in found.values()) > 1)
    at = told[np.unique(np.linspace(0, len(told) - 1, MARKS).astype(int))] if len(told) else told
    return {name: "".join(f"{h:0{HASH}x}" for h in found[name][at]) for name in sorted(found)} if len(at) else {}


def follows(rows: Sequence[Mapping], record: Record, measured: Collection[str] | None = None) -> bool:
    """Whether a recording, or the part of it that counts, is one of ``rows``: by its SHA-256, or by its samples.

    measured : columns of which one must be among those that both have, for commands may be repeated; None for any.
    """
    if record.digest and any(row.get("sha256") == record.digest for row in rows):
        return True
    every: dict[str, np.ndarray] = {}
    return any(_met(row, record, every, measured) for row in rows)


def _met(row: Mapping, record: Record, every: dict[str, np.ndarray], measured: Collection[str] | None) -> bool:
    """Whether enough of its marks are met; every : hashes at all samples of the recording, by column, as they are
    asked for."""
    marks, samples = row.get(MARKED), row.get(SAMPLES)
    if not isinstance(marks, Mapping) or type(samples) is not int:
        return False
    own = set(record.names)
    told = {n: _numbers(text) for n, text in marks.items() if n in own and isinstance(text, str)}
    count = min(map(len, told.values()), default=0)
    least = max(FEWEST, SHARE * count * min(1.0, len(record) / max(samples, 1)))
    left = {k: None for k in range(count) if sum(h[k] > 0 for h in told.values()) > 1}  # of each the rows that have it
    for name, hashes in told.items():
        if len(left) < least:  # most others are by their first column
            return False
        if name not in every:
            every[name] = _every_hash(record[name])
        there = {k: _having(every[name], hashes[k], at) for k, at in left.items() if hashes[k]}
        left = {k: there.get(k, at) for k, at in left.items() if k not in there or len(there[k])}
    met = {name: sum(hashes[k] > 0 for k in left) for name, hashes in told.items()}
    if len(left) < least or (measured is not None and not any(met.get(name) for name in measured)):
        return False
    return all(met[name] >= _fewest(hashes, count, samples, every[name]) for name, hashes in told.items())


def _fewest(hashes: Sequence[int], count: int, samples: int, every: np.ndarray) -> int:
    """How many of the marks of one column must be met: of those of a recording of so many samples the share that a copy
    would meet in which it moves as often as in this one."""
    moves = np.count_nonzero(every[0]) / max(samples, 1)
    return int(SHARE * min(sum(h > 0 for h in hashes), count * moves))


def _having(hashes: np.ndarray, wanted: int, rows: np.ndarray | None) -> np.ndarray:
    """Which of ``rows``, of all for None, have a hash among theirs, (4, n)."""
    if rows is None:
        return np.unique(np.nonzero(hashes == np.uint64(wanted))[1])
    return rows[(hashes[:, rows] == np.uint64(wanted)).any(axis=0)]


def _numbers(text: str) -> list[int]:
    try:
        return [int(text[k : k + HASH], 16) for k in range(0, len(text), HASH)]
    except ValueError:  # no marks of ours
        return []


def _hashes(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """(k,) a hash of 32 bits of the samples of a column from each of ``rows`` on; 0 where they do not tell."""
    found, (there, taps) = np.zeros(len(rows), dtype=np.uint64), _windows(values, rows)
    whole, power, _ = _digits(taps)
    moves = np.ptp(whole, axis=1) > 0
    found[there[moves]] = _mixed(whole[moves], power[moves])
    return found


def _every_hash(values: np.ndarray) -> np.ndarray:
    """(4, n) the hash at every sample, and those where one or both of the samples that are nearest to where a digit is
    rounded up are rounded the other way; 0 where there are too few."""
    found, (there, taps) = np.zeros((4, len(values)), dtype=np.uint64), _windows(values, np.arange(len(values)))
    whole, power, rest = _digits(taps)
    room, at = 0.5 - np.abs(rest), np.arange(len(whole))
    first, second = np.argpartition(room, 1, axis=1)[:, :2].T if len(whole) else (at, at)
    for way, turned in enumerate(((), (first,), (second,), (first, second))):
        other = whole.copy()
        for tap in turned:
            other[at, tap] += np.where(room[at, tap] < NEAR, np.sign(rest[at, tap]), 0.0).astype(np.int64)
        found[way, there] = _mixed(other, power)
    return found


def _windows(values: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of ``rows`` have enough own samples of a column behind them, (m,), and these samples, (m, taps)."""
    known = np.flatnonzero(np.isfinite(values))
    first = np.searchsorted(known, rows)
    there = np.flatnonzero(first + TAPS[-1] < len(known))
    return there, values[known][first[there][:, None] + TAPS] if len(there) else np.zeros((0, len(TAPS)))


def _digits(taps: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of samples (m, taps) the digits as whole numbers, the power of ten of the largest (m, 1), and what is left."""
    size = np.abs(taps).max(axis=1, keepdims=True, initial=0.0)
    power = np.floor(np.log10(np.where(size > 0, size, 1.0)))
    scaled = taps * 10.0 ** (DIGITS - 1 - power)
    whole = np.rint(scaled)
    return whole.astype(np.int64), power.astype(np.int64), scaled - whole


def _mixed(whole: np.ndarray, power: np.ndarray) -> np.ndarray:
    """(k,) 32 bits of each row of (k, taps) and its power (k, 1); never 0."""
    state = np.full(len(whole), 14695981039346656037, dtype=np.uint64)
    for column in np.column_stack([whole, power]).view(np.uint64).T:
        state = (state ^ column) * _PRIME
        state = (state ^ (state >> _HALF)) * _MIX
    return np.maximum(state >> _HALF, np.uint64(1))
