"""Whether recordings are of a static law: the samples before tell nothing about an output beside its inputs now.

Least squares of every output on curves and products of the inputs, without and with all signals one sample before;
errors on the last fifth. The curves bend often enough for what is held or swept slowly through a bent law: what they
missed there, the sample before would know. Where commands are held no curve is needed: what is static is right at the
first sample of a hold.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..steady_step import bent
from ..training_data import HELD_OUT

KINKS, ROWS_PER_KINK = 40, 10  # of the curve of an input: at most, and what each needs of all rows
HELPS = 0.95  # of the error without: what the sample before must leave, where an output has dynamics
FOLLOWS, WORTH = 0.9, 0.05  # autocorrelation of errors, and their share of the spread, which is no noise
ROWS_PER_COLUMN = 5  # fewer samples tell nothing
MOST = 20000  # samples that are looked at, evenly among all
HELD_FOR, HOLDS = 4, 6  # samples of a hold, and holds, at least, in which inputs are held
LATE, SURE = 0.01, 3.0  # share of the way that may be missing at the first sample, and standard errors beside it
RIDGE = 1e-8  # of the mean information of a coefficient


def is_static(records: Sequence[Record], inputs: Sequence[Signal], outputs: Sequence[Signal]) -> bool:
    """Whether every output is a function of the inputs of its own moment, as far as the recordings tell."""
    u, y = (_normal([r.array([s.name for s in part]) for r in records]) for part in (inputs, outputs))
    if (at_once := _at_once(u, y)) is not None:
        return at_once
    step = -(-sum(map(len, u)) // MOST)
    looked_at = [np.arange(1, len(one), step) for one in u]
    now, past = (
        [np.concatenate([one[at - late] for one, at in zip(part, looked_at, strict=True)]) for part in (u, y)]
        for late in (0, 1)
    )
    last = np.concatenate([at >= (1 - HELD_OUT) * len(one) for one, at in zip(u, looked_at, strict=True)])
    kinks = _kinks(np.concatenate(u), len(last))
    alone, before = _features(now[0], kinks), np.hstack(past)
    if ROWS_PER_COLUMN * (alone.shape[1] + before.shape[1]) > len(last):
        return False
    curve = _least_squares(alone[~last], now[1][~last])
    missed = now[1][last] - alone[last] @ curve
    with_past = np.hstack([alone, before])
    helped = now[1][last] - with_past[last] @ _least_squares(with_past[~last], now[1][~last])
    missed_before = past[1][last] - _features(past[0][last], kinks) @ curve
    return not (np.any(_rms(helped) <= HELPS * _rms(missed)) or np.any(_follow(missed, missed_before)))


def _at_once(u: Sequence[np.ndarray], y: Sequence[np.ndarray]) -> bool | None:
    """Whether outputs have moved all the way at the first sample of a hold; None where inputs are not held enough.

    The share that is missing there of the way from one hold to the next, by least squares over all holds.
    """
    moved, missing = [], []
    for inputs, outputs in zip(u, y, strict=True):
        begins = np.flatnonzero(np.any(np.diff(inputs, axis=0) != 0, axis=1)) + 1
        edges = np.concatenate([[0], begins, [len(inputs)]])
        if len(edges) * HELD_FOR > len(inputs):
            return None
        rests = [outputs[a + 1 : b].mean(axis=0) if b - a > HELD_FOR else None for a, b in itertools.pairwise(edges)]
        for k in range(1, len(rests)):
            if rests[k] is not None and rests[k - 1] is not None:
                moved.append(rests[k] - rests[k - 1])
                missing.append(rests[k] - outputs[edges[k]])
    if len(moved) < HOLDS:
        return None
    way, missing = np.array(moved), np.array(missing)
    share = (way * missing).sum(axis=0) / np.maximum((way**2).sum(axis=0), 1e-300)
    spread = np.sqrt(((missing - share * way) ** 2).mean(axis=0) / np.maximum((way**2).sum(axis=0), 1e-300))
    return bool(np.all(np.abs(share) <= LATE + SURE * spread))


def _normal(parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Signals (n, m) about their means over all parts, in spreads."""
    every = np.concatenate(parts)
    spread = np.where(every.std(axis=0) > 0, every.std(axis=0), 1.0)
    return [(part - every.mean(axis=0)) / spread for part in parts]


def _kinks(u: np.ndarray, rows: int) -> np.ndarray:
    """Where the curves of the inputs (n, nu) bend, (k, nu): even quantiles of their different values."""
    different = [np.unique(column) for column in u.T]
    count = min(KINKS, min(map(len, different)) // 2, rows // (ROWS_PER_KINK * u.shape[1]))
    return np.column_stack([np.quantile(values, np.linspace(0, 1, count + 2)[1:-1]) for values in different])


def _features(u: np.ndarray, kinks: np.ndarray) -> np.ndarray:
    products = [u[:, [i]] * u[:, [j]] for i in range(u.shape[1]) for j in range(i, u.shape[1])]
    return np.hstack([np.column_stack(bent(list(u.T), kinks)), *products])


def _least_squares(rows: np.ndarray, targets: np.ndarray) -> np.ndarray:
    gram = rows.T @ rows
    gram[np.diag_indices_from(gram)] += RIDGE * np.trace(gram) / len(gram)
    return np.linalg.solve(gram, rows.T @ targets)


def _follow(missed: np.ndarray, before: np.ndarray) -> np.ndarray:
    """By output, whether errors (n, ny) that are worth something follow those one sample before."""
    both = np.sqrt((missed**2).mean(axis=0) * (before**2).mean(axis=0))
    return ((missed * before).mean(axis=0) > FOLLOWS * both) & (_rms(missed) > WORTH)


def _rms(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(values**2, axis=0))
