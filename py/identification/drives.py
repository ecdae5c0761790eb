"""Inputs to drive an experiment with, within what recordings saw: triangles, steps, holds, sweeps, multisines, ramps.

Amplitude and rate of an input are those that were seen, and outputs may leave their range by a quarter of it.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.amounts import amount
from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import Signal

from .problem import Recording

SHORTEST, LONGEST = 10.0, 60.0  # s
SLOW = 1200  # samples that an experiment on a slow machine may have, where they last longer than LONGEST
SAMPLES = 4000  # of an experiment, at most
SWEPT, SUMMED = (
    0.05,
    0.1,
)  # of the sampling rate: frequencies of sweep and multisine stay below, so that samples show them
PAUSE = 0.05  # of the experiment at rest before it begins
LEVELS = (1.0, 0.7, 0.4, 0.15)  # of the largest amplitude seen
PIECES = 20  # of an experiment that are run one after the other, until one leaves the range
OUTSIDE = 0.25  # of the range of an output, by which it may be left


@dataclass(frozen=True, eq=False)
class Candidate:
    """One input (n,) with what it is called and told like."""

    kind: str
    words: str
    values: np.ndarray


@dataclass(frozen=True, eq=False)
class Limits:
    """What the recordings saw of the input: middle, amplitude, rate [1/s]; the time axis of the experiment."""

    middle: float
    amplitude: float
    rate: float
    time: np.ndarray


def varied(inputs: Sequence[Signal], recordings: Sequence[Recording]) -> int | None:
    """The first command (held between samples) that was varied, else the first input that was."""
    moved = [
        j for j in range(len(inputs)) if recordings and np.ptp(np.concatenate([r.u[:, j] for r in recordings])) > 0
    ]
    held = [j for j in moved if inputs[j].held]
    return (held or moved or [None])[0]


def seen_limits(recordings: Sequence[Recording], j: int) -> Limits:
    """Amplitude and rate of input j in the recordings, and a time axis like theirs.

    The middle is zero when the input was seen on either side of it.
    """
    u = np.concatenate([r.u[:, j] for r in recordings])
    low, high = float(u.min()), float(u.max())
    balanced = min(-low, high) > 0.1 * max(-low, high)
    middle = 0.0 if balanced else 0.5 * (low + high)
    amplitude = min(-low, high) if balanced else 0.5 * (high - low)
    rate = max(float(np.max(np.abs(np.diff(r.u[:, j]) / np.diff(r.time)))) for r in recordings)
    period = float(np.median(np.concatenate([np.diff(r.time) for r in recordings])))
    longest = max(LONGEST, SLOW * period)
    length = float(np.clip(max(r.time[-1] - r.time[0] for r in recordings), SHORTEST, longest))
    period = max(period, length / SAMPLES)
    return Limits(middle, amplitude, rate, np.arange(0.0, length, period))


def candidates(limits: Limits, unit: str) -> Iterator[Candidate]:
    """Triangles, steps, holds, sweeps, multisines and ramps within the limits of amplitude and rate."""
    time = limits.time
    length = float(time[-1])
    begin, rate = PAUSE * length, 1.0 / float(np.median(np.diff(time)))
    t = np.maximum(time - begin, 0.0)
    room = length - begin
    about = " through zero" if limits.middle == 0.0 else f" around {amount(limits.middle, unit)}"
    for part in LEVELS:
        size = _readable(part * limits.amplitude)
        around = f"of ±{amount(size, unit)}{about}"
        for count in (1, 2, 5):
            period = room / count
            words = f"a {'slow ' if count < 5 else ''}triangle {around} with a period of {seconds(period)}"
            yield _limited("triangle", words, size * _triangle(t / period), limits)
        for count in (3, 8):
            words = f"steps {around} with pauses between them, {seconds(room / (4 * count))} each"
            yield _limited("steps with pauses", words, size * _steps(t / room * count), limits)
        words = f"levels up to ±{amount(size, unit)}{about}, each held for {seconds(room / 6)}"
        yield _limited("holding levels", words, size * _levels(t / room), limits)
        high = min(10.0, SWEPT * rate)
        words = f"a sweep {around} from {1 / room:.2g} to {high:.2g} Hz"
        if high > 1.0 / room:
            yield _limited("sweep", words, size * _sweep(t, room, 1.0 / room, high), limits)
        for top in dict.fromkeys(top for f in (0.5, 4.0) if (top := min(f, SUMMED * rate)) > 2.0 / room):
            words = f"a multisine {around} up to {top:.2g} Hz"
            yield _limited("multisine", words, size * _multisine(t, room, top), limits)
        words = f"a slow ramp over ±{amount(size, unit)}{about} and back"
        yield _limited("slow ramp", words, size * _ramp(t / room), limits)


def seconds(time: float) -> str:
    """A time [s] in two digits.

    >>> seconds(9.34), seconds(189.7), seconds(0.0512)
    ('9.3 s', '190 s', '0.051 s')
    """
    return amount(float(f"{time:.2g}"), "s")


def _readable(size: float) -> float:
    """The next smaller number of two digits."""
    digit = 10.0 ** (np.floor(np.log10(size)) - 1)
    return float(np.floor(size / digit * (1 + 1e-9)) * digit)


def _limited(kind: str, words: str, shape: np.ndarray, limits: Limits) -> Candidate:
    """The shape around the middle, moved no faster than the recordings did."""
    values, steps = shape.copy(), limits.rate * np.diff(limits.time) * 1.000001
    for k in np.flatnonzero(np.abs(np.diff(shape)) > steps):
        i = k
        while i < len(steps) and abs(shape[i + 1] - values[i]) > steps[i]:
            values[i + 1] = values[i] + np.sign(shape[i + 1] - values[i]) * steps[i]
            i += 1
    return Candidate(kind, words, limits.middle + values)


def _triangle(phase: np.ndarray) -> np.ndarray:
    return 2.0 / np.pi * np.arcsin(np.sin(2.0 * np.pi * phase))


def _steps(phase: np.ndarray) -> np.ndarray:
    """Rest, up, rest, down; rounds of different sizes."""
    quarter = np.floor(4.0 * phase).astype(int)
    sign = np.array([0.0, 1.0, 0.0, -1.0])[quarter % 4]
    return sign * np.array([1.0, 0.5, 0.75])[quarter // 4 % 3]


def _levels(phase: np.ndarray) -> np.ndarray:
    return np.array([0.0, 0.5, 1.0, 0.0, -0.5, -1.0])[np.minimum((6.0 * phase).astype(int), 5)]


def _sweep(t: np.ndarray, room: float, low: float, high: float) -> np.ndarray:
    growth = np.log(high / low) / room
    return np.sin(2.0 * np.pi * low * (np.exp(growth * t) - 1.0) / growth)


def _multisine(t: np.ndarray, room: float, top: float) -> np.ndarray:
    """Eight sines of logarithmic frequencies with Schroeder's phases, largest value 1."""
    f = np.geomspace(2.0 / room, top, 8)
    k = np.arange(8)
    x = np.sin(2.0 * np.pi * f * t[:, None] - np.pi * k**2 / 8.0).sum(axis=1)
    return (x - x[0]) / np.abs(x - x[0]).max()


def _ramp(phase: np.ndarray) -> np.ndarray:
    return np.interp(phase, [0.0, 0.1, 0.55, 1.0], [0.0, -1.0, 1.0, -1.0])


def span_of(recordings: Sequence[Recording]) -> np.ndarray:
    """Least and largest value of every output, (2, ny), infinite where it was not measured."""
    y = np.concatenate([r.y for r in recordings])
    seen = np.isfinite(y)
    return np.stack([np.where(seen, y, np.inf).min(axis=0), np.where(seen, y, -np.inf).max(axis=0)])


def leaves(y: np.ndarray, span: np.ndarray) -> float:
    """By how much of its range the output that goes furthest leaves it."""
    low, high = span
    known = high > low
    size = np.where(known, high - low, 1.0)
    out = np.maximum(y.max(axis=0) - high, low - y.min(axis=0)) / size
    return float(np.max(np.where(known, out, 0.0), initial=0.0))


def stays_inside(propagator, time: np.ndarray, u: np.ndarray, p: np.ndarray, x0: np.ndarray, span: np.ndarray) -> bool:
    """Whether a run, u (n, nu) from x0 (nx,), keeps its outputs in their range ``span`` (2, ny), or nearly.

    It ends where it leaves: far outside, a model may be so stiff that a run to the end takes seconds.
    """
    edges = np.unique(np.linspace(0, len(time) - 1, PIECES + 1).astype(int))
    for first, last in itertools.pairwise(edges):
        piece = slice(first, last + 1)
        try:
            y, x = propagator.run(time[piece], u[piece], p, x0)
        except SolveError:
            return False
        if not leaves(y, span) <= OUTSIDE:
            return False
        x0 = x[-1]
    return True
