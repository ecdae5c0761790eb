"""Steady stretches of recordings: the commands that were held, and the rates or levels that they led to.

How long to wait before a stretch counts is found from the recordings. Points that were taken too early depend on the
command before, and so scatter about a curve that rises with the command; waiting longer makes them scatter less, until
the machine has settled.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import isotonic_regression

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..training_data import level_and_error, slope_and_error

SETTLE, WINDOW = 0.5, 0.5  # s, to begin with; where commands are held for less than 2 s, a quarter of that
PARTS = 4  # of what a command is held for: one to settle to begin with, one for the window
LONGER = 2**0.5  # from one settle to the next that is tried
STEADY = 0.03  # of the range of the command: it is held where it moves no more
SAME = 1.25  # times the least scatter: less is no reason to wait longer
LEAST_SCATTER = 1e-3  # of the span of the answers: what is below tells nothing
LEAST_POINTS = 12
LEAST_SAMPLES = 4  # in a window
COVERED = 0.8  # of the range of the command by steady stretches, or every sample counts
GOES_ON = 2e-3  # of the span of the answers, from the first half of a window to the second: less is no motion
STILL = 1e-3  # of that range: it stands where it moves no more
ONE_WAY = 0.05  # of its way that a command must go back, at least, or it goes one way
JUMP = 0.01  # of the range of the command, from one sample to the next: no ramp
JUMPING = 0.8  # of the way that a command went, in jumps: it is held in between


@dataclass(frozen=True)
class Reading:
    """How stretches are read. settle, window, delay : s; the first two None where the recordings choose them, the third
    where there is none.

    steady : share of the range of the command within which it counts as held.
    """

    settle: float | None = None
    window: float | None = None
    delay: float | None = None
    steady: float = STEADY


@dataclass(frozen=True, eq=False)
class Steady:
    """Commands, answers and their standard errors (n,), SI; settle, window : s, as they were taken.

    creeping : where commands are not held long enough for the machine to settle, how much the answers scatter about a
    rising curve (RMS, SI) with a shorter settle, and with this one, the longest that there is; empty elsewhere.
    going_on : by how much answers to held commands change from one half of a window to the other (RMS, SI), beyond
    their noise; 0 where that is little. one_way : whether the commands only rise, or only fall: what comes late then
    does so everywhere, and scatters about no curve.
    """

    commands: np.ndarray
    answers: np.ndarray
    errors: np.ndarray
    settle: float
    window: float
    creeping: tuple[float, ...] = ()
    going_on: float = 0.0
    one_way: bool = False


def steady_points(records: Sequence[Record], input_: Signal, output: Signal, rate: bool, reading: Reading) -> Steady:
    """The steady stretches of recordings, read with the shortest settle after which they scatter no less."""
    every = np.concatenate([r[input_.name] for r in records])
    span = max(float(np.ptp(every)), 1e-300)
    held = _held_for(records, input_.name, JUMP * span)
    one_way = _goes_one_way([r[input_.name] for r in records])
    window = reading.window or max(min(WINDOW, held / PARTS), 10 * max(r.period for r in records))

    def read(settle: float) -> Steady:
        points = [p for r in records
                  for p in _stretches(r, (input_, output), rate, replace(reading, settle=settle, window=window),
                                      reading.steady * span)]  # fmt: skip
        found = np.array(points).reshape(-1, 5)
        return Steady(*found[:, :3].T, settle, window, going_on=_going_on(found), one_way=one_way)

    if reading.settle is not None:
        return read(reading.settle)
    tried = [read(min(SETTLE, held / PARTS))]
    while (settle := LONGER * tried[-1].settle) + window <= held and covers((longer := read(settle)).commands, span):
        tried.append(longer)
    return _settled(tried)


def covers(commands: np.ndarray, span: float) -> bool:
    """Whether the commands of steady stretches are enough, and reach over enough of the range."""
    return len(commands) >= LEAST_POINTS and float(np.ptp(commands)) >= COVERED * span


def _settled(tried: Sequence[Steady]) -> Steady:
    """The first whose answers scatter no more than the best do, or than their noise explains."""
    if len(tried) == 1:
        return tried[0]
    scatter = [_scatter(t) for t in tried]
    least = max(SAME * min(scatter), LEAST_SCATTER * float(np.ptp(tried[-1].answers)))
    at = next(k for k, s in enumerate(scatter) if s <= max(least, float(np.median(tried[k].errors))))
    creeping = (scatter[at - 1], scatter[at]) if at and at == len(tried) - 1 else ()
    return replace(tried[at], creeping=creeping)


def _going_on(points: np.ndarray) -> float:
    """RMS change within windows, SI, beyond what noise makes, of points (n, 5) as of `_stretches`."""
    change, error = points[np.isfinite(points[:, 3]), 3:].T
    if len(change) < LEAST_POINTS:
        return 0.0
    chance = 1 + 3 * np.sqrt(2 / len(change))
    beyond = np.sqrt(max(np.mean(change**2) - chance * np.mean(error**2), 0.0))
    return float(beyond) if beyond > GOES_ON * np.ptp(points[:, 1]) else 0.0


def _goes_one_way(commands: Sequence[np.ndarray]) -> bool:
    steps = np.concatenate([np.diff(c) for c in commands])
    ways = sorted((float(steps[steps > 0].sum()), float(-steps[steps < 0].sum())))
    return ways[1] > 0 and ways[0] < ONE_WAY * ways[1]


def _scatter(points: Steady) -> float:
    """RMS of the answers about the rising curve next to them."""
    order = np.lexsort((points.answers, points.commands))
    answers = points.answers[order]
    return float(np.sqrt(np.mean((answers - isotonic_regression(answers).x) ** 2)))


def _held_for(records: Sequence[Record], name: str, jump: float) -> float:
    """Seconds, in the median, for which a command that goes in jumps is held; infinity where it never rests so."""
    steps = [np.abs(np.diff(r[name])) for r in records]
    way, jumps = (sum(float(s[s > least].sum()) for s in steps) for least in (0.0, jump))
    if not jumps > JUMPING * way:
        return float("inf")
    holds = [np.diff(r.time[1:][s > jump]) for r, s in zip(records, steps, strict=True)]
    held = float(np.median(np.concatenate(holds))) if any(map(len, holds)) else float("inf")
    return held if held > PARTS * LEAST_SAMPLES * max(r.period for r in records) else float("inf")


def _stretches(
    record: Record, signals: tuple[Signal, Signal], rate: bool, reading: Reading, allowed: float
) -> Iterator[tuple[float, ...]]:
    """(command, answer, its standard error, its change within the window, that one's) of every steady stretch in turn.

    The last two are nan where the command moves within the window.
    """
    t, u, y = record.time, *(record[s.name] for s in signals)
    window, delay, answer = reading.window, reading.delay or 0.0, slope_and_error if rate else level_and_error
    before = reading.settle + delay
    begin, end = t[0] + before, t[-1] + 1e-9
    while begin + window <= end:
        first, low, high = np.searchsorted(t, np.array([begin - before, begin, begin + window]) - 1e-9)
        wandering = np.flatnonzero(_spread_to_the_end(u[first:high]) > allowed)
        if len(wandering):
            begin = t[first + wandering[-1] + 1] + before
            continue
        begin += window
        if high - low >= LEAST_SAMPLES:
            late = slice(*np.searchsorted(t, np.array([t[low] - delay, t[low] + window - delay]) - 1e-9))
            yield (
                float(u[late].mean()),
                *answer(t[low:high], y[low:high]),
                *_change(t, y, u, (low, high), answer, allowed),
            )


def _change(t, y, u, between: tuple[int, int], answer, allowed: float) -> tuple[float, float]:
    """By how much the answer changes from the first half of a window to the second, and its standard error."""
    low, high = between
    middle = (low + high) // 2
    if high - low < 2 * LEAST_SAMPLES or np.ptp(u[low:high]) > STILL * allowed / STEADY:
        return np.nan, np.nan
    (one, its), (other, own) = (answer(t[a:b], y[a:b]) for a, b in ((low, middle), (middle, high)))
    return other - one, float(np.hypot(its, own))


def _spread_to_the_end(values: np.ndarray) -> np.ndarray:
    """Largest minus smallest of what follows, for every value of (n,)."""
    back = values[::-1]
    return (np.maximum.accumulate(back) - np.minimum.accumulate(back))[::-1]
