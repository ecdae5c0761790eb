"""What a free run leaves: does it follow an input, is it white? Correlations with bounds that know its colour.

    r(l) = sum_k e[k] u[k-l] / sqrt(sum e^2 sum u^2),    l = 0, 1, ...
    var r = 1/N sum_t rho_e(t) rho_u(t)                  where e and u have nothing to do with each other

What is left of a slow machine is slow, and so are its inputs: 1/N alone would call any two such signals alike.
Source: Bartlett, J. Royal Statistical Society B 8 (1946) 27-41; Ljung, System Identification (1999), section 16.6.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from hydrotwin.records import Record
from hydrotwin.records.whiteness import ljung_box

CERTAIN = 0.99  # probability that an input that is not followed stays within the bound, over all lags together
LAGS, PART = 100, 10  # samples that are looked back, and one in this many of a recording at most
COLOUR = 4  # one in this many lags of a recording, over which its own correlation is summed
WORTH = 0.2  # a correlation that is worth a sentence: 4 % of what is left
MOST = 5000  # samples of a recording; denser ones are thinned


@dataclass(frozen=True)
class Follows:
    """The strongest correlation of what is left with an input, at a lag [s, samples], and its 99 % bound."""

    input: str
    correlation: float
    bound: float
    lag: float
    samples: int

    @property
    def says(self) -> bool:
        """Whether it is beyond chance and worth saying."""
        return abs(self.correlation) > max(self.bound, WORTH)

    def told(self) -> dict:
        """For the provenance."""
        return {"correlation": self.correlation, "bound": self.bound, "lag": self.lag, "samples": self.samples}


@dataclass(frozen=True)
class LeftOver:
    """What is left of an output: correlation of neighbours, p-value of "white", what it follows by input."""

    neighbours: float
    white: float
    follows: Sequence[Follows] = ()

    def told(self) -> dict:
        """For the provenance."""
        answer = {"neighbours": self.neighbours, "white": self.white}
        return answer | ({"follows": {f.input: f.told() for f in self.follows}} if self.follows else {})

    def said(self, output: str) -> str:
        """A sentence where it says something, else empty."""
        found = max((f for f in self.follows if f.says), key=lambda f: abs(f.correlation), default=None)
        if found is None:
            return ""
        later = f"{found.samples} samples later" if found.samples else "at once"
        return f"What is left of {output} follows '{found.input}' {later}: more lags or a richer kind may help."


def left_over(misses: Sequence[np.ndarray], records: Sequence[Record], inputs: Sequence[str]) -> LeftOver:
    """What is left (n,) per recording, at its times, beside the ``inputs`` that it has."""
    period = max(r.period for r in records)
    step = period * max(1, int(np.ceil(max(r.duration for r in records) / period / MOST)))
    runs = [_even(r, e, inputs, step) for r, e in zip(records, misses, strict=True)]
    neighbours, white = _whiteness([e for e, _ in runs])
    follows = [_follows(name, [(e, u[name]) for e, u in runs], step, period) for name in inputs]
    return LeftOver(neighbours, white, [f for f in follows if f is not None])


def _whiteness(misses: Sequence[np.ndarray]) -> tuple[float, float]:
    """Of the longest recording: pieces joined would be one more colour."""
    return ljung_box(max(misses, key=len))


def _even(record: Record, e: np.ndarray, inputs: Sequence[str], step: float) -> tuple[np.ndarray, Mapping]:
    grid = np.arange(record.time[0], record.time[-1] + 1e-9 * step, step)
    return np.interp(grid, record.time, e), {n: np.interp(grid, record.time, record[n]) for n in inputs}


def _follows(name: str, pairs: Sequence[tuple[np.ndarray, np.ndarray]], step: float, period: float) -> Follows | None:
    """None where the input does not move, or the recordings are too short."""
    from scipy.signal import fftconvolve

    lags = min(LAGS, min(len(e) for e, _ in pairs) // PART)
    pairs = [(e - e.mean(), u - u.mean()) for e, u in pairs]
    energy = np.array([(e @ e, u @ u) for e, u in pairs]).sum(axis=0)
    if lags < 1 or not (energy > 1e-300).all():
        return None
    crossed = sum(fftconvolve(e, u[::-1])[len(e) - 1 : len(e) + lags] for e, u in pairs) / np.sqrt(energy.prod())
    samples = sum(len(e) for e, _ in pairs)
    bound = float(-ndtri((1 - CERTAIN) / 2 / (lags + 1)) * np.sqrt(_variance(pairs, energy) / samples))
    k = int(np.argmax(np.abs(crossed)))
    return Follows(name, float(crossed[k]), bound, k * step, round(k * step / period))


def _variance(pairs, energy: np.ndarray) -> float:
    """N times the variance of the correlation of two signals that have nothing to do with each other."""
    from scipy.signal import fftconvolve

    reach = max(1, min(len(e) for e, _ in pairs) // COLOUR)
    own = [sum(fftconvolve(p[i], p[i][::-1])[len(p[i]) - 1 :][:reach] for p in pairs) / energy[i] for i in (0, 1)]
    taper = 1 - np.arange(reach) / reach
    return max(1.0, float(2 * np.sum(taper * own[0] * own[1]) - 1))
