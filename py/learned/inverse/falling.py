"""Where a characteristic falls as its command rises: it has no inverse there, whatever is made of it.

A monotone curve through what falls is a mean of it, and agrees with another monotone curve through the same machine. So
the fall is looked for in points that nothing has made monotone, beyond their scatter.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DataError

BINS = 20  # over the range of the command, in which scattered points are taken together
SURE = 4.0  # standard deviations of a difference, from which on it is none of scatter
LEAST = 0.03  # of the span of the rates: a smaller fall is not worth words


@dataclass(frozen=True)
class Fall:
    """From one command to a higher one the rate falls by ``by``, ``share`` of the span of the rates; SI."""

    begin: float
    end: float
    by: float
    share: float


def largest_fall(commands: np.ndarray, rates: np.ndarray, sd: np.ndarray) -> Fall | None:
    """The largest fall beyond scatter of rates (n,) with standard deviations (n,) at rising commands (n,)."""
    span = float(np.ptp(rates)) if len(rates) else 0.0
    if not span > 0:
        return None
    top = np.maximum.accumulate(rates)
    of = np.maximum.accumulate(np.where(rates == top, np.arange(len(rates)), 0))
    fall = top - rates
    fall[(fall <= SURE * np.hypot(sd, sd[of])) | (fall <= LEAST * span)] = 0.0
    at = int(np.argmax(fall))
    if not fall[at] > 0:
        return None
    return Fall(float(commands[of[at]]), float(commands[at]), float(fall[at]), float(fall[at]) / span)


def fall_of_points(commands: np.ndarray, rates: np.ndarray, sigma: float) -> Fall | None:
    """The same of scattered points (n,), each known to ``sigma``, taken together in `BINS` of the commands."""
    edges = np.linspace(commands.min(), commands.max(), BINS + 1)[1:-1]
    which = np.searchsorted(edges, commands)
    some = [np.flatnonzero(which == k) for k in range(BINS)]
    some = [k for k in some if len(k)]
    u, r = (np.array([part[k].mean() for k in some]) for part in (commands, rates))
    sd = np.array([max(sigma, rates[k].std(ddof=1) if len(k) > 1 else 0.0) / np.sqrt(len(k)) for k in some])
    return largest_fall(u, r, sd)


def refuse_what_falls(output: str, input_: str, fall: Fall | None, rises: float) -> None:
    """Raises DataError where rates fall by more than a monotone curve through them ``rises``; SI."""
    if fall is not None and fall.by > rises:
        raise DataError(
            f"characteristic of {output}: it falls as '{input_}' rises (by {fall.by:.3g} from {fall.begin:.3g} to "
            f"{fall.end:.3g}, SI). What falls has no rising inverse. Turn the sign of one of the two, or give "
            "recordings of commands over which it rises, without stretches at an end stop."
        )
