"""Stretches of steady speed in a recording, each found by its own length; and why the others are none.

A recording is cut where the mean speed changes (binary segmentation by the largest jump of the mean). A piece is a
plateau unless it is a part of a ramp: a line through it and its neighbour fits better than two means, or it is a short
piece between two speeds, too short to tell.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import median_filter

from hydrotwin.records.noise import recorded_step

STEADY = 0.02  # share of the speed (of the largest force) by which the mean may wander within a plateau
ALONE = 8.0  # standard deviations of one sample by which it must leave its neighbours to stand alone
JUMP = 5.0  # standard errors by which two means must differ to be two
SLOPE = 3.0  # standard errors of its slope from which on a stretch is a ramp
BRIDGE = 3.0  # times shorter than a neighbour: then a piece must prove that it is no part of a ramp
SHORTEST = 6  # samples of a plateau
EDGE = 0.1  # share of a plateau left out at either end, where speed and force still settle
AT_REST = 5.0  # standard errors from zero below which a stretch is one of rest
TABLE_ROWS = 100  # rows up to which samples without a plateau may be the rows of a table
TABLE = 0.3  # share of the speed by which the rows of a table scatter about any mean, and jump from row to row
TABLE_STEP = 0.5  # s from row to row from which on rows need not jump: a table in the order of its speeds


@dataclass(frozen=True)
class Stretch:
    """A part of a recording from ``start`` to ``end`` [s], its mean speed [m/s], and why it gives no point.

    fault : samples that are wrong, as against samples of another speed.
    """

    recording: str
    start: float
    end: float
    samples: int
    velocity: float
    reason: str
    fault: bool = False

    def __str__(self) -> str:
        when = f"{self.recording}, {self.start:.4g} s to {self.end:.4g} s"
        return f"{when} ({self.samples} samples, mean {self.velocity:.3g} m/s): {self.reason}"


def plateaus(name: str, time: np.ndarray, v: np.ndarray) -> tuple[list[slice], list[Stretch]]:
    """Sample ranges of steady speed, without their edges; and the stretches that give no point, with reasons.

    time, v : (n,) s, m/s, finite.
    """
    noise = _noise(v)
    pieces = _pieces(v, noise)
    found, dropped = [], []
    for k, (first, last) in enumerate(pieces):
        inner = _inner(first, last)
        reason = _too_short(first, last) or _moving(v, pieces, k, noise)
        if reason := reason or _at_rest(v[inner], noise):
            dropped.append((first, last, reason))
        else:
            found.append(inner)
    return found, list(_told(name, time, v, dropped))


def is_table(time: np.ndarray, v: np.ndarray, found: list[slice]) -> bool:
    """Whether the rows are points already: few, none of a run in time, and no speed is kept."""
    if not 2 < len(v) <= TABLE_ROWS:
        return False
    jumps = np.abs(np.diff(v, 2)).mean() > TABLE * np.std(v)
    if not jumps and np.median(np.diff(time)) < TABLE_STEP:
        return False
    kept = sum(part.stop - part.start for part in found)
    scatter = np.concatenate([v[part] - v[part].mean() for part in found] or [v])
    return kept < 0.5 * len(v) or bool(np.std(scatter) > TABLE * np.sqrt(np.mean(v**2)))


def alone(v: np.ndarray) -> np.ndarray:
    """Which samples, (n,) bool, are one or two that jump away from their neighbours on both sides and back."""
    if len(v) < 5:
        return np.zeros(len(v), dtype=bool)
    middle = median_filter(v, size=5, mode="nearest")
    return np.abs(v - middle) > np.maximum(ALONE * _noise(v), STEADY * np.abs(middle))


def _noise(v: np.ndarray) -> float:
    """Standard deviation of one sample, from the differences of neighbours; at least that between two steps."""
    steps = np.abs(np.diff(v)) if len(v) > 1 else np.zeros(1)
    rounding = max(recorded_step(v) / 2, 1e-9 * float(np.abs(v).max(initial=0.0)), 1e-300)
    return max(float(np.median(steps)) / (0.6745 * np.sqrt(2)), rounding)


def _pieces(v: np.ndarray, noise: float) -> list[tuple[int, int]]:
    """Sample ranges [first, last) within which the mean does not jump."""
    total = np.concatenate([[0.0], np.cumsum(v)])
    todo, done = [(0, len(v))], []
    while todo:
        first, last = todo.pop()
        cut = _jump(total, first, last, noise)
        if cut is None:
            done.append((first, last))
        else:
            todo += [(first, cut), (cut, last)]
    return sorted(done)


def _jump(total: np.ndarray, first: int, last: int, noise: float) -> int | None:
    """Where the means before and behind differ most, if they differ beyond noise and what a plateau may wander."""
    n = last - first
    if n < 2:
        return None
    k = np.arange(1, n)
    before = (total[first + 1 : last] - total[first]) / k
    behind = (total[last] - total[first + 1 : last]) / (n - k)
    weight = np.sqrt(k * (n - k) / n)
    best = int(np.argmax(np.abs(behind - before) * weight))
    jump, level = abs(behind[best] - before[best]), max(abs(behind[best]), abs(before[best]))
    return first + 1 + best if jump * weight[best] > JUMP * noise and jump > STEADY * level else None


def _inner(first: int, last: int) -> slice:
    edge = int(np.ceil(EDGE * (last - first)))
    return slice(first + edge, last - edge)


def _too_short(first: int, last: int) -> str:
    inner = _inner(first, last)
    if last - first >= SHORTEST and inner.stop - inner.start > 1:
        return ""
    return f"the speed is kept for {last - first} samples, at least {SHORTEST} are needed"


def _at_rest(v: np.ndarray, noise: float) -> str:
    """Why samples of one speed, (n,) m/s, are none of sliding; "" if they are."""
    rest = abs(v.mean()) <= AT_REST * max(noise, v.std()) / np.sqrt(len(v))
    return "at rest, or slower than the noise of the velocity shows" if rest else ""


def _moving(v: np.ndarray, pieces: list[tuple[int, int]], k: int, noise: float) -> str:
    """Why a piece is, or may be, a part of a ramp; "" if it is none."""
    neighbours = [pieces[j] for j in (k - 1, k + 1) if 0 <= j < len(pieces)]
    inner = v[_inner(*pieces[k])]
    if _drifts(inner, noise) or any(_line_is_better(v, pieces[k], other) for other in neighbours):
        return "the speed changes all along it"
    n = pieces[k][1] - pieces[k][0]
    if not neighbours or BRIDGE * n > max(last - first for first, last in neighbours):
        return ""
    here = v[slice(*pieces[k])]
    level = [v[slice(*pieces[j])].mean() if 0 <= j < len(pieces) else None for j in (k - 1, k + 1)]
    before, behind = (2 * here.mean() - other if own is None else own for own, other in (level, level[::-1]))
    slope, error = _slope(here, noise)
    ramp = (behind - before) / (2 * n)
    between = min(before, behind) < here.mean() < max(before, behind)
    untold = between and slope * np.sign(ramp) > abs(ramp) - SLOPE * error
    return "the speed is kept too short to be told from a ramp between its neighbours" if untold else ""


def _line_is_better(v: np.ndarray, one: tuple[int, int], two: tuple[int, int]) -> bool:
    """Whether one line through two neighbouring pieces leaves less than their two means: a ramp."""
    first, last = min(one[0], two[0]), max(one[1], two[1])
    both = v[first:last]
    steps = sum(((v[a:b] - v[a:b].mean()) ** 2).sum() for a, b in (one, two))
    t = np.arange(len(both)) - (len(both) - 1) / 2
    line = both - both.mean() - t * (t @ both) / (t @ t)
    return bool(line @ line < steps)


def _drifts(v: np.ndarray, noise: float) -> bool:
    slope, error = _slope(v, noise)
    return bool(abs(slope) > SLOPE * error and abs(slope) * len(v) > STEADY * abs(v.mean()))


def _slope(v: np.ndarray, noise: float) -> tuple[float, float]:
    """Change of speed per sample and its standard error."""
    t = np.arange(len(v)) - (len(v) - 1) / 2
    return float(t @ v / (t @ t)), float(noise / np.sqrt(t @ t))


def _told(name: str, time: np.ndarray, v: np.ndarray, dropped: list[tuple[int, int, str]]) -> Iterator[Stretch]:
    """The dropped pieces as stretches; neighbours that are parts of one change of speed are one stretch."""
    joined: list[tuple[int, int, str]] = []
    for first, last, reason in dropped:
        moving = "the speed" in reason and joined and "the speed" in joined[-1][2]
        if moving and joined[-1][1] == first:
            joined[-1] = (joined[-1][0], last, "the speed changes all along it")
        else:
            joined.append((first, last, reason))
    for first, last, reason in joined:
        start, end = float(time[first]), float(time[last - 1])
        yield Stretch(name, start, end, last - first, float(v[first:last].mean()), reason)
