"""Excitations. All are functions of a time axis (any spacing) and a seed; amplitudes in command units."""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d


def jittered_time(duration: float, rate: float, jitter: float, seed: int = 0) -> np.ndarray:
    """Sample times with a spread: each off its place by at most ``jitter`` of a period (< 0.5), from zero on."""
    ticks = np.arange(round(duration * rate) + 1, dtype=float)
    ticks[1:] += np.random.default_rng(seed).uniform(-jitter, jitter, len(ticks) - 1)
    return ticks / rate


def multisine(time, low: float, high: float, seed: int = 0, tones: int = 24, tilt: float = 0.0) -> np.ndarray:
    """Sum of sines of random phase, frequencies log-spaced with a spread, amplitude ~ f^-tilt, rms 1."""
    random = np.random.default_rng(seed)
    frequencies = np.geomspace(low, high, tones) * random.uniform(0.95, 1.05, tones)
    amplitudes = frequencies**-tilt
    phases = random.uniform(0, 2 * np.pi, tones)
    waves = amplitudes * np.sin(2 * np.pi * frequencies * np.asarray(time)[:, None] + phases)
    return waves.sum(axis=1) / np.sqrt(0.5 * np.sum(amplitudes**2))


def pauses(time, seed: int = 0, *, every: float = 9.0, rest: float = 1.2, taper: float = 0.4) -> np.ndarray:
    """A gate between 0 (at rest) and 1, smooth; at rest for the first half second and about every ``every`` s."""
    time = np.asarray(time, dtype=float)
    random = np.random.default_rng(seed)
    closed, t = [(time[0] - 1.0, time[0] + 0.5)], time[0]
    while t < time[-1]:
        t += every * random.uniform(0.7, 1.3)
        closed.append((t, t + rest * random.uniform(0.6, 1.4)))
    gate = np.ones_like(time)
    for begin, end in closed:
        away = np.maximum(np.maximum(begin - time, time - end), 0.0)
        gate *= np.where(away < taper, 0.5 - 0.5 * np.cos(np.pi * away / taper), 1.0)
    return gate


def path(time, first, span, fastest: float, band, seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A smooth position from ``first`` on, in ``span``, about as fast as ``fastest``; its gate; a quick part of rms 1.

    The path stands still where the gate is closed. ``band``: (low, high) of its frequencies [Hz].
    """
    gate = pauses(time, seed)
    warped = np.concatenate([[0.0], np.cumsum(0.5 * (gate[1:] + gate[:-1]) * np.diff(time))])
    slow = multisine(warped, *band, seed + 1, tones=9, tilt=0.5)
    half = 0.5 * (span[1] - span[0]) / np.max(np.abs(slow))
    half = min(half, fastest / np.max(np.abs(np.gradient(slow, time))))
    quick = multisine(time, 0.5, 12.0, seed + 2, tones=24, tilt=0.5)
    position = 0.5 * (span[0] + span[1]) + half * slow
    return position + (first - position[0]) * np.exp(-warped / 5.0), gate, quick


def smoothed(values, samples: float) -> np.ndarray:
    """Gaussian, zero phase."""
    return gaussian_filter1d(values, samples, mode="nearest")


def steps(time, amplitude: float, seed: int = 0, *, hold=(0.4, 2.0), speed=(0.0, 0.0), room=None) -> np.ndarray:
    """Hard steps to random levels, each held for ``hold`` (least, most) seconds.

    With ``speed`` (out, in) [m/s per unit] and ``room`` (low, high) [m from the start] the path stays in the room.
    """
    return _levels(time, amplitude, seed, hold, speed, room)[0]


def ramps(time, amplitude: float, seed: int = 0, *, hold=(0.4, 2.0), speed=(0.0, 0.0), room=None) -> np.ndarray:
    """The levels of ``steps``, each reached by a ramp over the first half of its hold."""
    levels, corners = _levels(time, amplitude, seed, hold, speed, room)
    reached = np.concatenate([[0.0], levels[np.searchsorted(time, corners[1:]).clip(max=len(time) - 1)]])
    index = np.searchsorted(corners, time, side="right") - 1
    ends = np.append(corners[1:], 2 * time[-1])
    share = np.clip((time - corners[index]) / (0.5 * (ends[index] - corners[index])), 0, 1)
    before = reached[np.maximum(index - 1, 0)]
    return before + share * (reached[index] - before)


def _levels(time, amplitude, seed, hold, speed, room, dwell=None):
    """Levels, and where each begins; ``dwell``: least and most seconds at zero after each."""
    random, time = np.random.default_rng(seed), np.asarray(time, dtype=float)
    levels, x, t, corners = np.zeros_like(time), 0.0, time[0] + 0.5, [time[0]]
    while t < time[-1]:
        length, level = random.uniform(*hold), amplitude * random.uniform(-1, 1)
        if room is not None:
            gain = speed[0] if level > 0 else speed[1]
            if not room[0] < x + gain * level * length < room[1]:
                level = -level
            move = np.clip(x + gain * level * length, *room) - x
            level = float(np.clip(move / (gain * length), -amplitude, amplitude))
            x += gain * level * length
        levels[time >= t] = level
        corners.append(t)
        t += length
        if dwell:
            levels[time >= t] = 0.0
            t += random.uniform(*dwell)
    return levels, np.array(corners)


def strokes(time, amplitude: float, seed: int = 0, *, speed, room, ramp: float = 0.15) -> np.ndarray:
    """Strokes at constant speeds out and in, each with a dwell after it; the corners are ramps of ``ramp`` seconds.

    ``speed`` and ``room`` as for `steps`.
    """
    levels = _levels(time, amplitude, seed, (0.8, 4.0), speed, room, dwell=(0.4, 2.5))[0]
    width = max(round(ramp / np.median(np.diff(time))), 1)
    return np.convolve(np.concatenate([np.zeros(width - 1), levels]), np.full(width, 1 / width), "valid")


def sines(time, amplitude: float, seed: int = 0, *, speed, room, band=(0.1, 6.0), length=(3.0, 8.0)) -> np.ndarray:
    """Sines of several sizes and frequencies one after the other, whole periods each, a pause between them.

    ``band`` [Hz]; ``length``: about so many seconds each. The path of each takes at most half of the ``room``.
    """
    random, time = np.random.default_rng(seed), np.asarray(time, dtype=float)
    wave, t = np.zeros_like(time), time[0] + 0.5
    while t < time[-1]:
        frequency = np.exp(random.uniform(*np.log(band)))
        span = max(round(random.uniform(*length) * frequency), 1) / frequency
        side = room[1] if random.random() < 0.5 else room[0]
        most = 0.5 * abs(side) * np.pi * frequency / max(speed)
        here = (time >= t) & (time < t + span)
        size = np.sign(side) * min(amplitude * random.uniform(0.2, 1.0), most)
        wave[here] = size * np.sin(2 * np.pi * frequency * (time[here] - t))
        t += span + random.uniform(0.3, 1.0)
    return wave


def chirp(time, amplitude: float, seed: int = 0, *, speed, room, band=(0.1, 8.0)) -> np.ndarray:
    """A sine whose frequency rises linearly through the ``band`` [Hz] and falls again, a tenth of the time at rest.

    Where it is slow it is made smaller, so that its path takes at most half of the ``room``. Seeds differ in where
    the band ends and in sign.
    """
    random, t = np.random.default_rng(seed), np.asarray(time, dtype=float) - time[0]
    low, high = band[0] * random.uniform(0.8, 1.5), band[1] * random.uniform(0.4, 1.0)
    begin, end = 0.05 * t[-1], 0.95 * t[-1]
    along = np.clip((t - begin) / (end - begin), 0, 1)
    frequency = low + (high - low) * (1 - np.abs(2 * along - 1))
    phase = 2 * np.pi * np.concatenate([[0.0], np.cumsum(np.diff(t) * 0.5 * (frequency[1:] + frequency[:-1]))])
    most = 0.5 * min(abs(room[0]), abs(room[1])) * np.pi * frequency / max(speed)
    fade = np.clip(np.minimum(t - begin, end - t) / (0.05 * t[-1]), 0, 1)
    return random.choice([-1.0, 1.0]) * np.minimum(amplitude, most) * fade * np.sin(phase)


def sweep(time, amplitude: float, low: float = 0.2, high: float = 15.0) -> np.ndarray:
    """Exponential sine sweep from ``low`` to ``high`` Hz, faded in and out over a twentieth of its length."""
    t = np.asarray(time, dtype=float) - time[0]
    rate = np.log(high / low) / t[-1]
    wave = np.sin(2 * np.pi * low * np.expm1(rate * t) / rate)
    fade = np.clip(np.minimum(t, t[-1] - t) / (0.05 * t[-1]), 0, 1)
    return amplitude * wave * fade
