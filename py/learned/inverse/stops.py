"""Stretches in which an output stands at an end stop: what it does there says nothing of the command.

It is a stop where the output stays at an end of its range under commands that move it on elsewhere, for much longer
than its usual speed would leave it there.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hydrotwin.records import Record

EXACT, NOISY = 1e-6, 6.0  # of the range of the output, and of its noise: as near to an end it is there
LONG, FAR = 0.1, 10.0  # s, and times that width at its usual speed: a shorter stay is a turn
USUAL = 0.75  # quantile of the speeds
BINS, PUSHED = 20, 0.3  # of the commands, and of the usual speed: as fast outwards it would go on elsewhere
LEFT = 0.3  # of the time that must be left, or nothing is cut
LEAST = 50  # samples of a part


def between_stops(records: Sequence[Record], input_: str, output: str) -> list[Record]:
    """The parts of recordings in which the output does not stand at an end; they themselves where it never does."""
    y, u = (np.concatenate([r[name] for r in records]) for name in (output, input_))
    noise = np.median([np.std(np.diff(r[output], 2)) for r in records]) / np.sqrt(6)  # of what bends little
    near = max(EXACT * float(np.ptp(y)), NOISY * float(noise))
    usual = float(np.quantile(np.concatenate([_speeds(r, output) for r in records]), USUAL))
    if not usual > 0:
        return list(records)
    long = max(LONG, FAR * near / usual)
    edges = np.linspace(u.min(), u.max(), BINS + 1)[1:-1]
    there = {sign: [sign * r[output] >= (sign * y).max() - near for r in records] for sign in (-1, 1)}
    speed = _by_command(records, input_, output, edges, [a | b for a, b in zip(*there.values(), strict=True)])
    stands = [np.zeros(len(r), bool) for r in records]
    for sign, places in there.items():
        for k, (record, place) in enumerate(zip(records, places, strict=True)):
            outwards = sign * speed[np.searchsorted(edges, record[input_])]
            for begin, end in _runs(place):
                stays = record.time[end - 1] - record.time[begin] >= long
                stands[k][begin:end] |= stays and np.nanmean([*outwards[begin:end], 0.0]) > PUSHED * usual
    if not any(s.any() for s in stands):
        return list(records)
    parts = [part for r, s in zip(records, stands, strict=True) for part in _moving(r, s)]
    return parts if sum(p.duration for p in parts) >= LEFT * sum(r.duration for r in records) else list(records)


def _by_command(records, input_: str, output: str, edges: np.ndarray, at_ends: Sequence[np.ndarray]) -> np.ndarray:
    """Mean speed (bins,) by command, away from the ends; nan where there is none."""
    bins, speeds = [], []
    for record, end in zip(records, at_ends, strict=True):
        step = max(1, round(LONG / record.period))
        moved = (record[output][step:] - record[output][:-step]) / (step * record.period)
        away = ~(end[step:] | end[:-step])
        bins.append(np.searchsorted(edges, record[input_][:-step][away]))
        speeds.append(moved[away])
    which, moved = np.concatenate(bins), np.concatenate(speeds)
    return np.array([moved[which == k].mean() if (which == k).any() else np.nan for k in range(len(edges) + 1)])


def _speeds(record: Record, output: str) -> np.ndarray:
    """How fast it moves, over `LONG`, (n,)."""
    step = max(1, round(LONG / record.period))
    return np.abs(record[output][step:] - record[output][:-step]) / (step * record.period)


def _moving(record: Record, stands: np.ndarray) -> list[Record]:
    runs = [run for run in _runs(~stands) if run[1] - run[0] >= LEAST]
    return [record.window(record.time[begin], record.time[end - 1]) for begin, end in runs]


def _runs(where: np.ndarray) -> list[tuple[int, int]]:
    """First sample and that after the last of every run of true ones."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
    return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))
