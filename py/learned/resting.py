"""The commands at which a machine rests: found in its recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record, noise_floor

from .training_data import slope_and_error

NEAR, NOISY = 0.005, 0.02  # of the range of an input: commands that near are one; at most, where the input is noisy
SHORTEST = 20  # samples of a stretch at one command; its second half is looked at
KNOWN = 0.01  # of the fastest rate: how well (3 sigma) the rate at rest must be known
STILL = 2e-4  # of the fastest rate: slower is rest, however well it is known
MOST = 8  # commands of rest that are kept


@dataclass(frozen=True)
class Rests:
    """Commands (n, nu) at which every output stands still in the recordings; how near counts (nu,); rates (ny,), SI.

    fastest : what each output moves at in the recordings, SI per second.
    """

    levels: np.ndarray
    width: np.ndarray
    fastest: np.ndarray


def rests(
    records: Sequence[Record], commands: Sequence[Signal], outputs: Sequence[Signal], period: float = 0.0
) -> Rests:
    """The commands at which the machine rests, those it rested at for longest first.

    period : s, of the block; where recordings are denser, a stretch is so many of its periods: where a smooth command
    turns, many dense samples are near to each other, and nothing rests.
    """
    width = _width(records, commands)
    stretches: dict[tuple, list] = {}
    fastest = np.zeros(len(outputs))
    for record in records:
        u, y = (record.array([s.name for s in part]) for part in (commands, outputs))
        keys = np.round(u / width).astype(np.int64)
        shortest = SHORTEST * max(1, round(period / record.period))
        for first, last in _runs(keys, shortest):
            part = slice((first + last) // 2, last)
            rates = np.array([slope_and_error(record.time[part], column) for column in y[part].T])
            told = (last - first, u[first:last].mean(axis=0), rates)
            stretches.setdefault(tuple(keys[first]), []).append(told)
        fastest = np.maximum(fastest, _fastest(record.time, y, shortest // 2))
    still = [s for s in stretches.values() if _stands(np.array([rates for *_, rates in s]), fastest)]
    still.sort(key=lambda found: -sum(n for n, *_ in found))
    levels = [np.average([u for _, u, _ in found], axis=0, weights=[n for n, *_ in found]) for found in still[:MOST]]
    return Rests(np.array(levels).reshape(-1, len(commands)), width, fastest)


def _width(records, commands) -> np.ndarray:
    """How near to each other two commands are one: noise of the command, or a small share of its range."""
    names = [s.name for s in commands]
    ranges = np.ptp(np.concatenate([r.array(names) for r in records]), axis=0)
    noise = np.max([[noise_floor(r.select(names))[n].sigma for n in names] for r in records], axis=0)
    return np.clip(4 * noise, NEAR * ranges, NOISY * ranges)


def _runs(keys: np.ndarray, shortest: int):
    """(first, last) of every stretch of equal keys that is long enough."""
    ends = np.flatnonzero(np.any(np.diff(keys, axis=0) != 0, axis=1)) + 1
    for first, last in zip(np.append(0, ends), np.append(ends, len(keys)), strict=True):
        if last - first >= shortest:
            yield int(first), int(last)


def _fastest(time: np.ndarray, y: np.ndarray, n: int) -> np.ndarray:
    """The largest mean rate over ``n`` samples; none where there are not so many."""
    return np.abs((y[n:] - y[:-n]) / (time[n:] - time[:-n])[:, None]).max(axis=0, initial=0.0)


def _stands(rates: np.ndarray, fastest: np.ndarray) -> bool:
    """Whether (rate, error) of several stretches at one command, (n, ny, 2), are none, and known well enough."""
    weights = 1 / (rates[..., 1] ** 2 + (STILL * fastest) ** 2)
    error = 3 / np.sqrt(weights.sum(axis=0))
    mean = (weights * rates[..., 0]).sum(axis=0) / weights.sum(axis=0)
    alone = np.abs(rates[..., 0]) <= 4 * rates[..., 1] + KNOWN * fastest
    return bool(np.all(np.abs(mean) <= error) and np.all(error <= KNOWN * fastest) and alone.all())
