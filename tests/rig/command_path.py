"""What happens to a command between the recorder and the motor or spool, exact for held samples.

A ``Signal`` is piecewise linear: from ``times[i]`` on it is ``values[i] + slopes[i] (t - times[i])``; before the
first time it is ``values[0]``. All stages but the rate limit keep the slopes at zero.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class Signal:
    """A piecewise linear signal of time."""

    times: np.ndarray
    values: np.ndarray
    slopes: np.ndarray

    @classmethod
    def held(cls, times, values) -> Signal:
        return cls(np.array(times, dtype=float), np.array(values, dtype=float), np.zeros(len(times)))

    def on(self, times):
        """Value and slope from each of ``times`` on (which must contain the corners within the span)."""
        index = np.searchsorted(self.times, times + 5e-11, side="right") - 1
        inside = np.clip(index, 0, None)
        values = self.values[inside] + self.slopes[inside] * np.where(index < 0, 0.0, times - self.times[inside])
        return values, np.where(index < 0, 0.0, self.slopes[inside])


def dead_time(signal, *, seconds):
    """Exact delay line."""
    return replace(signal, times=signal.times + seconds)


def packet_loss(signal, *, share, seed):
    """Some samples never arrive; the last one is held."""
    lost = np.random.default_rng(seed).random(len(signal.times)) < share
    lost[0] = False
    last = np.maximum.accumulate(np.where(lost, 0, np.arange(len(lost))))
    return replace(signal, values=signal.values[last])


def command_quantisation(signal, *, step):
    """A converter with few bits."""
    return replace(signal, values=step * np.round(signal.values / step))


def command_saturation(signal, *, limit):
    return replace(signal, values=np.clip(signal.values, -limit, limit))


def direction_asymmetry(signal, *, ratio):
    """Negative commands act ``ratio`` times as strongly."""
    return replace(signal, values=np.where(signal.values < 0, ratio, 1.0) * signal.values)


def command_deadband(signal, *, width):
    """Nothing within +-width; beyond it the command less the width."""
    u = signal.values
    return replace(signal, values=np.sign(u) * np.maximum(np.abs(u) - width, 0.0))


def null_bias(signal, *, value):
    return replace(signal, values=signal.values + value)


def spool_hysteresis(signal, *, width):
    """Play of full width ``width``: the output follows only when pushed (magnetic hysteresis of the solenoid)."""
    output, half, answer = signal.values[0], width / 2, np.empty(len(signal.values))
    for i, u in enumerate(signal.values):
        output = min(max(output, u - half), u + half)
        answer[i] = output
    return replace(signal, values=answer)


def rate_limit(signal, *, rate):
    """Follow the held samples no faster than ``rate``: ramps with exact corners."""
    ends = np.append(signal.times[1:], np.inf)
    times, values, slopes, y = [], [], [], signal.values[0]
    for start, end, target in zip(signal.times, ends, signal.values, strict=True):
        gap = target - y
        arrival = start + abs(gap) / rate
        if gap:
            times.append(start), values.append(y), slopes.append(np.sign(gap) * rate)
        if arrival < end:
            times.append(arrival), values.append(target), slopes.append(0.0)
            y = target
        else:
            y += np.sign(gap) * rate * (end - start)
    return Signal(np.array(times), np.array(values), np.array(slopes))


STAGES = (
    (dead_time, {"seconds": 0.03}),
    (packet_loss, {"share": 0.05, "seed": 0}),
    (command_quantisation, {"step": 0.02}),
    (command_saturation, {"limit": 3.0}),
    (direction_asymmetry, {"ratio": 0.9}),
    (command_deadband, {"width": 0.05}),
    (null_bias, {"value": 0.02}),
    (spool_hysteresis, {"width": 0.04}),
    (rate_limit, {"rate": 5.0}),
)
