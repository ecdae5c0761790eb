"""Locate: how far each output is off, whether noise is all that is left, where it is off and what it follows.

The readable "where" is a regression tree of at most two questions about what was seen. It splits the residual itself
(so that "too high here, too low there" is found), or its square when the sign changes too fast to have a pattern:

    split q < a where   D = SSE - SSE_left - SSE_right   is largest,   D > (2 ln m + 10) tau SSE_after / n

m is the number of splits tried, tau the correlation time in samples: neighbours are not counted twice.
Source: Breiman et al., Classification and Regression Trees, 1984, ch. 8; Box, Jenkins, Time Series Analysis, ch. 12
(the variance of a cross-correlation).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft

from hydrotwin.identification.problem import Recording
from hydrotwin.models.language.amounts import amount
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records.whiteness import SIGNIFICANCE, ljung_box

from ..answer.discovery import Location
from .regions import Quantity, autocorrelation, bin_edges, bins_of, finite, has_gap, quantities

SPLITS = 24  # values tried of every quantity
DEPTH = 2
SMALLEST = 0.03  # share of the samples on one side of a split
WORTH = 0.05  # share of what is there that a split must take away
SIGNED = 0.3  # share of the squared residual from which its sign has a pattern worth telling
SMALL = 0.3  # of the largest mean: a place not worth telling
LONGEST_LAG = 2.0  # s
GRID = 4096  # samples of a recording that drivers are looked for on
DRIVERS = 3


@dataclass(frozen=True)
class Leaf:
    """One place: conditions (quantity, below, threshold), mean of the target there, root mean square residual."""

    conditions: tuple[tuple[int, bool, float], ...]
    mean: float
    rms: float
    samples: int


def locations(
    flat: FlatModel, recordings: Sequence[Recording], residuals: Sequence[np.ndarray], noise: np.ndarray
) -> tuple[Location, ...]:
    """One `Location` for every output that was measured.

    residuals : (n, ny) per recording, simulated minus measured, SI, nan where not measured; noise : (ny,) SI.
    """
    residuals = finite(residuals)
    seen = np.any([np.isfinite(r).any(axis=0) for r in residuals], axis=0)
    measured = np.flatnonzero(seen & np.isfinite(noise))
    off = [has_gap(residuals, j, noise[j]) for j in measured]
    forest = _Forest(quantities(flat, recordings, noise, residuals)) if any(off) else None
    driving = _Driving(flat, recordings)
    found = []
    for j, gap in zip(measured, off, strict=True):
        series = [r[:, j] for r in residuals]
        rmse = float(np.sqrt(np.nanmean(np.concatenate(series) ** 2)))
        white = _is_white(series)
        times = rmse / noise[j] if noise[j] > 0 else (np.inf if rmse > 0 else 0.0)
        where = forest.where(flat.outputs[j], series, noise[j], times) if gap else ""
        drivers = driving.of(series) if gap or not white else ()
        found.append(Location(flat.outputs[j].name, float(times), white, where, drivers))
    return tuple(found)


def _is_white(series: Sequence[np.ndarray]) -> bool:
    """Ljung-Box over all recordings: none of them coloured, counted together."""
    smallest = min((ljung_box(s)[1] for s in series), default=1.0)
    return smallest * len(series) > SIGNIFICANCE


# -- where -------------------------------------------------------------------------------------------------------------
class _Forest:
    """Trees over the same quantities for every output."""

    def __init__(self, seen: Sequence[Quantity]):
        self.seen = sorted(seen, key=lambda q: q.kind != "direction")  # the simpler of two that split alike
        self.edges = [bin_edges(q, SPLITS) for q in self.seen]
        self.labels = [np.concatenate(bins_of(q, e)) for q, e in zip(self.seen, self.edges, strict=True)]
        self.tried = sum(len(e) - 2 for e in self.edges)

    def where(self, signal, series: Sequence[np.ndarray], noise: float, times: float) -> str:
        """The sentence that tells where one output is off."""
        r = np.concatenate(series)
        signed = self.grow(series)
        energy = float(np.nansum(r**2))
        told = sum(leaf.samples * leaf.mean**2 for leaf in signed) / energy
        if told >= SIGNED:
            return self._signed_words(signal, signed, noise)
        size = [np.minimum(s**2, np.nanquantile(r**2, 0.99)) for s in series]
        sized = self.grow(size, r)
        if len(sized) > 1:
            return self._sized_words(signal, sized, noise)
        if len(signed) > 1:
            return self._signed_words(signal, signed, noise)
        return f"{signal.name} is {_times(times)} off, and no recorded quantity tells where"

    def grow(self, series: Sequence[np.ndarray], residual: np.ndarray | None = None) -> list[Leaf]:
        """Leaves of the tree of a target, (n,) per recording; ``residual`` (sum of n,) where the target is another."""
        target = np.concatenate(series)
        residual = target if residual is None else residual
        centre = float(np.nanmean(target))
        tau = max(1.0, correlation_time([s - centre for s in series]))
        return self._grown(target, residual, np.isfinite(target), tau, (), int(np.isfinite(target).sum()))

    def _grown(self, target, residual, here, tau, conditions, total) -> list[Leaf]:
        best = self._split(target, here, tau, total) if len(conditions) < DEPTH else None
        if best is None:
            mean, rms = float(target[here].mean()), float(np.sqrt(np.mean(residual[here] ** 2)))
            return [Leaf(conditions, mean, rms, int(here.sum()))]
        i, k = best
        threshold, below, known = float(self.edges[i][k]), self.labels[i] < k, self.labels[i] >= 0
        leaves = []
        for side, low in ((here & known & below, True), (here & known & ~below, False)):
            leaves += self._grown(target, residual, side, tau, (*conditions, (i, low, threshold)), total)
        return leaves

    def _split(self, target, here, tau, total) -> tuple[int, int] | None:
        """Quantity and edge that take most away, when that is more than chance."""
        best, answer = 0.0, None
        for i, label in enumerate(self.labels):
            use = here & (label >= 0)
            count = len(self.edges[i]) - 1
            at, value = label[use], target[use]
            n, s = (np.cumsum(np.bincount(at, w, minlength=count))[:-1] for w in (None, value))
            size, whole = len(at), float(value.sum())
            if size < 8:
                continue
            inside = (n >= max(4, SMALLEST * total)) & (size - n >= max(4, SMALLEST * total))
            if not inside.any():
                continue
            n_left = np.where(inside, n, 1.0)
            n_right = np.where(inside, size - n, 1.0)
            gain = s**2 / n_left + (whole - s) ** 2 / n_right - whole**2 / size
            k = int(np.argmax(np.where(inside, gain, -np.inf)))
            spread = float(np.sum((value - whole / size) ** 2))
            taken, left = float(gain[k]), max(spread - float(gain[k]), 1e-300)
            if not spread > 1e-12 * float(value @ value):  # it is the same everywhere
                continue
            if taken < WORTH * spread or taken < (2.0 * np.log(self.tried) + 10.0) * tau * left / size:
                continue
            share = taken / spread * self.seen[i].weight
            if share > 1.02 * best:
                best, answer = share, (i, k + 1)
        return answer

    def _signed_words(self, signal, leaves: Sequence[Leaf], noise: float) -> str:
        ranked = sorted(leaves, key=lambda leaf: -(leaf.mean**2) * leaf.samples)
        largest = max(abs(leaf.mean) for leaf in leaves)
        told = [leaf for leaf in ranked if abs(leaf.mean) >= SMALL * largest][:2]
        words = []
        for leaf in told:
            side = "too high" if leaf.mean > 0 else "too low"
            words.append(
                f"{amount(abs(leaf.mean), signal.unit)} {side} ({_times(_over(leaf.mean, noise))}) {self._place(leaf)}"
            )
        return f"{signal.name} is simulated {' and '.join(words)}"

    def _sized_words(self, signal, leaves: Sequence[Leaf], noise: float) -> str:
        most = max(leaves, key=lambda leaf: leaf.rms)
        rest = [leaf for leaf in leaves if leaf is not most]
        elsewhere = np.sqrt(sum(o.rms**2 * o.samples for o in rest) / sum(o.samples for o in rest))
        here = f"{signal.name} is {_times(_over(most.rms, noise))} off {self._place(most)}"
        return f"{here}, {_times(_over(elsewhere, noise))} elsewhere"

    def _place(self, leaf: Leaf) -> str:
        """Conditions of a leaf in words; two of one quantity become an interval."""
        if not leaf.conditions:
            return "everywhere"
        limits: dict[int, list] = {}
        for i, below, threshold in leaf.conditions:
            low, high = limits.get(i, (None, None))
            limits[i] = (low, threshold) if below else (threshold, high)
        return "where " + " and ".join(_limits(self.seen[i], *pair) for i, pair in limits.items())


def _limits(q: Quantity, low: float | None, high: float | None) -> str:
    if q.kind == "direction":
        words = {(None, -0.5): "falls", (-0.5, None): "rests or rises", (None, 0.5): "rests or falls"}
        words |= {(0.5, None): "rises", (-0.5, 0.5): "rests"}
        if np.nanmean(np.concatenate(q.values) == 0) < 0.1:  # it hardly ever rests
            words = {key: w.removeprefix("rests or ") for key, w in words.items()}
        if q.name.startswith("sign"):
            words = {key: _SIGNS[w] for key, w in words.items()}
        return f"{q.of} {words[low, high]}"
    peak = float(np.nanmax(np.abs(np.concatenate(q.values))))
    low, high = (None if v is None else amount(v, q.unit, peak) for v in (low, high))
    if low is not None and high is not None:
        return f"{low} < {q.name} < {high}"
    return f"{q.name} < {high}" if low is None else f"{q.name} > {low}"


_SIGNS = {
    "falls": "is negative",
    "rests": "is zero",
    "rises": "is positive",
    "rests or rises": "is not negative",
    "rests or falls": "is not positive",
}


def _over(value: float, noise: float) -> float:
    return abs(value) / noise if noise > 0 else np.inf


def _times(value: float) -> str:
    return f"{value:.2g} noise" if value < 100 else f"{value:.0f} noise"


def correlation_time(series: Sequence[np.ndarray]) -> float:
    """Samples that count as one: 1 + 2 sum of the autocorrelation."""
    return float(2.0 * autocorrelation(series).sum() - 1.0)


# -- what it follows ---------------------------------------------------------------------------------------------------
class _Driving:
    """Inputs and their rates on uniform grids of one period, ready to be correlated with any residual."""

    def __init__(self, flat: FlatModel, recordings: Sequence[Recording]):
        self.times = [r.time for r in recordings]
        spans = [r.time[-1] - r.time[0] for r in recordings]
        periods = [np.median(np.diff(t)) for t in self.times if len(t) > 1]
        self.period = max(float(min(periods, default=1.0)), max(spans, default=0.0) / GRID)
        self.grids = [np.arange(t[0], t[-1] + 0.5 * self.period, self.period) for t in self.times]
        self.reach = max(1, min(int(LONGEST_LAG / self.period), min((len(g) for g in self.grids), default=1) // 4) + 1)
        self.signals = []
        for j, signal in enumerate(flat.inputs):
            values = [np.interp(g, r.time, r.u[:, j]) for g, r in zip(self.grids, recordings, strict=True)]
            rates = [np.gradient(v, self.period) if len(v) > 1 else np.zeros_like(v) for v in values]
            self.signals += [(signal.name, _centred(values)), (f"rate of {signal.name}", _centred(rates))]
        self.signals = [(name, values) for name, values in self.signals if any(np.any(v) for v in values)]

    def of(self, series: Sequence[np.ndarray]) -> tuple[tuple[str, float, float], ...]:
        """The signals that a residual follows, strongest first, each beyond what chance gives."""
        e = []
        for grid, time, s in zip(self.grids, self.times, series, strict=True):
            seen = np.isfinite(s)
            e.append(np.interp(grid, time[seen], s[seen]) if seen.sum() > 3 else np.zeros(len(grid)))
        e = _centred(e)
        energy = sum(float(x @ x) for x in e)
        found = []
        for name, signal in self.signals if energy > 0 else ():
            scale = np.sqrt(energy * sum(float(x @ x) for x in signal))
            r = sum(_lagged(x, y, self.reach) for x, y in zip(e, signal, strict=True)) / scale
            k = int(np.argmax(np.abs(r)))
            if abs(r[k]) > 4.0 * self._chance(e, signal):
                found.append((name, float(r[k]), float(k * self.period)))
        return tuple(sorted(found, key=lambda row: -abs(row[1]))[:DRIVERS])

    def _chance(self, e, signal) -> float:
        """Standard deviation of the correlation of two series that have nothing to do with each other."""
        one, two = (_whole_autocorrelation(x) for x in (e, signal))
        lags = min(len(one), len(two))
        count = sum(len(x) for x in e)
        return float(np.sqrt(max(1.0, 2.0 * np.sum(one[:lags] * two[:lags]) - 1.0) / count))


def _centred(values: Sequence[np.ndarray]) -> list[np.ndarray]:
    return [v - v.mean() for v in values]


def _lagged(e: np.ndarray, signal: np.ndarray, reach: int) -> np.ndarray:
    """``sum_i e_{i+lag} signal_i`` for lag 0..reach-1: the error comes after the signal."""
    size = next_fast_len(2 * len(e), real=True)
    return irfft(rfft(e, size) * np.conj(rfft(signal, size)), size)[:reach]


def _whole_autocorrelation(series: Sequence[np.ndarray]) -> np.ndarray:
    longest = max(len(s) for s in series)
    total = np.zeros(longest)
    for s in series:
        total[: len(s)] += _lagged(s, s, len(s))
    return total / total[0] if total[0] > 0 else np.zeros(longest)
