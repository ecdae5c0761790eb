"""What the model sees of sampled inputs: held or linear in between, delayed, averaged over each substep.

With U(t) the integral of an input from the first sample, the mean over a substep h delayed by Td is

    u_mean = (U(t + h - Td) - U(t - Td)) / h

exact for held and for linear inputs, without half a sample of delay, and differentiable in Td. Substeps end where a
delayed input that is held jumps: what follows from the mean of two values is not the mean of what follows from each.
Before the first sample an input has its first value, after the last sample its last. The same rules are in
``driver.c``, for one substep at a time; here they are for whole arrays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.flat import Signal

SNAP = 1e-9  # a delayed instant this close to a sample, in intervals, is that sample


@dataclass(frozen=True, eq=False)
class Substeps:
    """All substeps of a recording in order: start time and length (m,), mean input (m, nu) and its rate by Td.

    ``first`` and ``last`` (n - 1,) are the positions of the first and last substep of every interval, ``interval`` (m,)
    is where each lies.
    """

    time: np.ndarray
    length: np.ndarray
    mean: np.ndarray
    mean_rate: np.ndarray
    first: np.ndarray
    last: np.ndarray
    interval: np.ndarray


def substeps(
    time: np.ndarray, u: np.ndarray, step: float, linear: list[bool], dead_time: list[float | None]
) -> Substeps:
    """Every interval of ``time`` (n,) in ceil(dt / step) substeps, cut at jumps, with the mean of ``u`` (n, nu)."""
    dt = np.diff(time)
    counts = np.maximum(np.ceil(dt / step - 1e-6), 1.0).astype(int)
    interval = np.repeat(np.arange(len(dt)), counts)
    within = np.arange(len(interval)) - np.repeat(np.cumsum(counts) - counts, counts)
    h = (dt / counts)[interval]
    owner, start, h = _cut(time[interval] + within * h, h, *_jumps(time, u, linear, dead_time))
    interval = interval[owner]
    mean, rate = means(time, u, interval, start, h, linear, dead_time)
    ends = np.cumsum(np.bincount(interval, minlength=len(dt)))
    return Substeps(start, h, mean, rate, np.append(0, ends[:-1]), ends - 1, interval)


def _jumps(time, u, linear, dead_time) -> tuple[np.ndarray, np.ndarray]:
    """Where inputs that are delayed and held jump, in order, and how near to each another instant is the same."""
    at, near = [np.empty(0)], [np.empty(0)]
    for j, Td in enumerate(dead_time):
        if Td is not None and not linear[j]:
            k = np.flatnonzero(np.diff(u[:, j]))
            at.append(time[k + 1] + Td)
            near.append(SNAP * (time[k + 1] - time[k]))
    at, near = np.concatenate(at), np.concatenate(near)
    order = np.argsort(at, kind="stable")
    at, near = at[order], near[order]
    own = np.diff(at, prepend=-np.inf) > near
    return at[own], near[own]


def _cut(start, h, at, near) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Substeps cut ``at`` instants inside them: of which each is a piece, its start and its length."""
    i = np.searchsorted(start, at, side="right") - 1
    inside = (i >= 0) & (at > start[i] + near) & (at < start[i] + h[i] - near) if len(start) else i > i
    begin, owner = np.concatenate([start, at[inside]]), np.concatenate([np.arange(len(start)), i[inside]])
    order = np.argsort(begin, kind="stable")
    begin, owner = begin[order], owner[order]
    last = np.append(owner[1:] != owner[:-1], True)
    end = np.where(last, start[owner] + h[owner], np.append(begin[1:], 0.0))
    whole = np.bincount(owner)[owner] == 1
    return owner, begin, np.where(whole, h[owner], end - begin)


def behind(time, u, interval, start, linear, dead_time) -> np.ndarray:
    """Inputs (m, nu) just behind ``start`` (m,) of substeps in ``interval`` (m,)."""
    seen = u[interval]
    for j, Td in enumerate(dead_time):
        if Td is not None or linear[j]:
            seen[:, j] = at(time, u[:, j], start - (Td or 0.0), linear[j], "right")
    return seen


def means(time, u, interval, start, h, linear, dead_time) -> tuple[np.ndarray, np.ndarray]:
    """Mean input and its rate by Td (m, nu) of windows in ``interval`` (m,), from ``start`` (m,), ``h`` (m,) long."""
    mean, rate = np.empty((len(h), u.shape[1])), np.zeros((len(h), u.shape[1]))
    for j, Td in enumerate(dead_time):
        if Td is None and not linear[j]:
            mean[:, j] = u[interval, j]
            continue
        a = start - (Td or 0.0)
        mean[:, j] = mean_over(time, u[:, j], a, a + h, linear[j])
        if Td is not None and linear[j]:
            rate[:, j] = (at(time, u[:, j], a, linear[j], "left") - at(time, u[:, j], a + h, linear[j], "left")) / h
    return mean, rate


def mean_over(time: np.ndarray, u: np.ndarray, a: np.ndarray, b: np.ndarray, linear: bool) -> np.ndarray:
    """Mean of one input (n,) over the windows from ``a`` to ``b`` (m,)."""
    pieces = np.diff(time) * (0.5 * (u[1:] + u[:-1]) if linear else u[:-1])
    integral = np.concatenate([[0.0], np.cumsum(pieces)])

    def upto(instant):
        i = np.clip(np.searchsorted(time, instant, side="right") - 1, 0, len(time) - 1)
        past = instant - time[i]
        return integral[i] + past * u[i] + 0.5 * past**2 * _slope(time, u, i, instant, linear)

    length = np.where(b > a, b - a, 1.0)
    return np.where(b > a, (upto(b) - upto(a)) / length, at(time, u, a, linear, "right"))


def as_seen(signal: Signal, time: np.ndarray, column: np.ndarray) -> np.ndarray:
    """A recorded input (n,) as ``signal`` has it, at the same samples.

    Taken for ``signal.shift`` seconds later than it is stamped; where it is smooth, moved so that straight lines
    between the samples have the means of the curve through those recorded.
    """
    if len(time) < 2:
        return column
    if not signal.held:
        moved = np.interp(time - signal.shift, time, column) if signal.shift else column
        return moved - _bulge(time, moved) if signal.interpolation == "smooth" else moved
    if not signal.shift:
        return column
    ends = np.append(time[1:], 2 * time[-1] - time[-2])
    return mean_over(time, column, time - signal.shift, ends - signal.shift, False)


def _bulge(time: np.ndarray, u: np.ndarray) -> np.ndarray:
    """``h^2 u'' / 12`` (n,), u'' from three samples: how far the mean of a chord lies above that of its curve."""
    if len(time) < 3:
        return np.zeros(len(time))
    h = np.diff(time)
    bend = 2 * np.diff(np.diff(u) / h) / (h[1:] + h[:-1])
    return np.pad(h[1:] * h[:-1] * bend / 12, 1, mode="edge")


def at(time: np.ndarray, u: np.ndarray, instant: np.ndarray, linear: bool, side: str) -> np.ndarray:
    """Value of one input (n,) at instants (m,), from the "left" or the "right" of a sample."""
    i = _piece(time, instant, side)
    return u[i] + _slope(time, u, i, instant, linear) * (instant - time[i])


def slope_at(time: np.ndarray, u: np.ndarray, instant: np.ndarray, linear: bool) -> np.ndarray:
    """Slope of one input (n,) just before instants (m,)."""
    slope = _slope(time, u, _piece(time, instant, "left"), instant, linear)
    first = SNAP * (time[1] - time[0]) if len(time) > 1 else 0.0
    return np.where(instant - time[0] < first, 0.0, slope)


def _piece(time, instant, side):
    gap = np.diff(time, append=time[-1] + 1.0)
    i = np.clip(np.searchsorted(time, instant, side="right") - 1, 0, len(time) - 1)
    if side == "right":
        following = np.minimum(i + 1, len(time) - 1)
        return np.where((following > i) & (time[following] - instant < SNAP * gap[i]), following, i)
    return np.where((i > 0) & (instant - time[i] < SNAP * gap[np.maximum(i - 1, 0)]), i - 1, i)


def _slope(time, u, i, instant, linear):
    if not linear or len(time) < 2:
        return np.zeros(np.shape(instant))
    slopes = np.append(np.diff(u) / np.diff(time), 0.0)
    return np.where(instant < time[0], 0.0, slopes[i])
