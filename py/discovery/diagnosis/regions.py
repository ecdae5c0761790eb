"""Region maps: the mean residual over bins of what was seen, before and after, and which bins differ from zero.

    se_b^2 = s^2 / n_b^2 * sum_{i, j in b} rho(|i - j|),   t_b = mean_b / se_b

rho is the autocorrelation of the residual around its bin means, s^2 its variance: neighbours are not counted twice.
Significant: |t| > 3 after Holm over all bins of all outputs. What a residual is mapped over is found by unit, so that
it works for any model: every input and its rate, positions and angles with their velocity and direction, speeds,
pressures and their differences, time.
Source: S. Holm, Scand. J. Statistics 1979 (many tests); Priestley, Spectral Analysis and Time Series, 5.3 (the
variance of a mean of correlated samples).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from scipy.fft import irfft, next_fast_len, rfft
from scipy.integrate import cumulative_trapezoid
from scipy.special import ndtr, stdtr

from hydrotwin.identification.problem import Recording
from hydrotwin.models.language.flat import FlatModel

from ..answer.discovery import Region

BINS = 12
SAMPLES = 10_000  # of a recording that are mapped, at most
KEPT = 4  # quantities told of each output
FAINT = 0.05  # of the best share: not worth a map of its own
ALIKE = 0.97  # correlation from which two quantities tell the same
GAP = 1.02  # squared residual over squared noise from which there is a gap
SIGMAS = 3.0
DIVERGED = 1e100
PERIODS = 3.0  # seen at least, of a wave
CLEAN = 0.1  # noise of a smoothed quantity over its spread that is good enough
WINDOWS = (1, 2, 4, 8, 16, 32, 64, 128)  # samples on either side of a local line


@dataclass(frozen=True, eq=False)
class Quantity:
    """Something seen that a residual may follow: (n,) per recording, SI, nan where unknown.

    kind : "input", "rate", "position", "velocity", "direction", "pressure", "time" or "other".
    of : the measured or given signal it comes from.
    weight : 1, less where the gap itself moves the place: r = simulated - measured makes r follow what was measured.
    """

    name: str
    unit: str
    kind: str
    of: str
    values: tuple[np.ndarray, ...]
    weight: float = 1.0


@dataclass(frozen=True, eq=False)
class Carrier:
    """Something that turns or travels: (n,) per recording in turns, metres or seconds.

    absolute : the same place is the same value in every recording, so that a wave has one phase everywhere; what is
        integrated from a speed has a phase of its own in every window. low, high : frequencies searched.
    """

    name: str
    unit: str
    absolute: bool
    angle: tuple[np.ndarray, ...]
    low: float
    high: float


def quantities(flat: FlatModel, recordings: Sequence[Recording], noise: np.ndarray, residuals=None):
    """Everything that a residual can be mapped over; what never changes is left out.

    Measured quantities are smoothed by local lines that leave the sample itself out: the noise of a sample then is no
    part of the place it is put at, and pure noise shows no pattern. residuals : to weigh by what the gap moves.
    """
    found: list[Quantity] = []
    for j, signal in enumerate(flat.inputs):
        values = tuple(r.u[:, j] for r in recordings)
        rates = tuple(np.gradient(r.u[:, j], r.time) for r in recordings)
        found.append(Quantity(signal.name, signal.unit, "input", signal.name, values))
        if np.mean(np.concatenate(rates) != 0) > 0.1:
            found.append(Quantity(f"rate of {signal.name}", per_second(signal.unit), "rate", signal.name, rates))
    for j, signal in enumerate(flat.outputs):
        if np.isfinite(noise[j]):
            weight = 1.0 if residuals is None else _steadiness(recordings, residuals, j)
            made = _of_output(signal, [(r.time, r.y[:, j]) for r in recordings], noise[j])
            found += [replace(q, weight=weight) for q in made]
    for a, b in list(combinations([q for q in found if q.kind == "pressure"], 2))[:3]:
        difference = tuple(x - y for x, y in zip(a.values, b.values, strict=True))
        both = min(a.weight, b.weight)
        found.append(Quantity(f"{a.name} - {b.name}", a.unit, "pressure", a.name, difference, both))
    found.append(Quantity("time", "s", "time", "time", tuple(r.time - r.time[0] for r in recordings)))
    return tuple(q for q in found if _changes(q.values))


def _steadiness(recordings, residuals, j: int) -> float:
    """1 over 1 + 5 times the residual of an output over its spread."""
    r, y = np.concatenate([r[:, j] for r in residuals]), np.concatenate([r.y[:, j] for r in recordings])
    seen = np.isfinite(r) & np.isfinite(y)
    spread = float(np.std(y[seen])) if seen.any() else 0.0
    return 1.0 / (1.0 + 5.0 * float(np.sqrt(np.mean(r[seen] ** 2))) / spread) if spread > 0 else 1.0


def _of_output(signal, series, noise: float) -> list[Quantity]:
    """A measured output as a quantity, and its velocity and direction where it has any."""
    unit, kinds = signal.unit, {"m": "position", "rad": "position", "Pa": "pressure"}
    kind = "velocity" if unit in ("m/s", "rad/s") else kinds.get(unit, "other")
    smooth = [_smoothed(time, y, noise, slope=False) for time, y in series]
    if not _beyond(smooth, noise):
        return []
    found = [Quantity(signal.name, unit, kind, signal.name, tuple(s[0] for s in smooth))]
    if kind == "position":
        smooth = [_smoothed(time, y, noise, slope=True) for time, y in series]
        if not _beyond(smooth):
            return found
        values = tuple(s[0] for s in smooth)
        found.append(Quantity(f"velocity of {signal.name}", per_second(unit), "velocity", signal.name, values))
    if found[-1].kind == "velocity":
        still = 3.0 * max(n for _, n in smooth if np.isfinite(n))  # or 1 % of the fast ones: it rests
        still = max(still, 0.01 * float(np.nanquantile(np.abs(np.concatenate(found[-1].values)), 0.95)))
        sign = tuple(np.where(np.isfinite(v), np.sign(v) * (np.abs(v) > still), np.nan) for v in found[-1].values)
        name = f"sign of {signal.name}" if kind == "velocity" else f"direction of {signal.name}"
        found.append(Quantity(name, "1", "direction", signal.name, sign))
    return found


def carriers(recordings: Sequence[Recording], seen: Sequence[Quantity]) -> tuple[Carrier, ...]:
    """Measured positions and angles, integrals of measured speeds, and time."""
    found = []
    for q in seen:
        if q.kind == "position":
            found.append((q.name, q.unit, True, q.values))
        elif q.kind == "velocity" and q.name == q.of:
            travelled = [
                cumulative_trapezoid(np.nan_to_num(v), r.time, initial=0.0)
                for r, v in zip(recordings, q.values, strict=True)
            ]
            found.append((q.name, "rad" if q.unit == "rad/s" else "m", False, travelled))
    found.append(("time", "s", False, [r.time - r.time[0] for r in recordings]))
    made = []
    for name, unit, absolute, values in found:
        turns = tuple(np.asarray(v) / (2 * np.pi if unit == "rad" else 1.0) for v in values)
        reach = max(float(np.nanmax(v) - np.nanmin(v)) for v in turns)
        high = 40.0 if unit == "rad" else 300.0 / reach
        if unit == "s":
            high = 0.4 / max(float(np.median(np.diff(r.time))) for r in recordings)
        low = PERIODS / reach
        if low < high:
            made.append(Carrier(name, unit, absolute, turns, low, high))
    return tuple(made)


def _smoothed(time: np.ndarray, y: np.ndarray, noise: float, slope: bool) -> tuple[np.ndarray, float]:
    """Value or slope of local lines through the neighbours of every sample, and the noise of it.

    The shortest window whose noise is CLEAN of the spread is taken.
    """
    best = np.full(len(y), np.nan), np.inf
    for width in (w for w in WINDOWS if w == 1 or w <= len(y) // 20):
        values, gain = local_lines(time, y, width, slope)
        best = values, noise * gain
        seen = values[np.isfinite(values)]
        if not len(seen) or best[1] <= CLEAN * np.std(seen):
            break
    return best


def local_lines(time: np.ndarray, y: np.ndarray, width: int, slope: bool) -> tuple[np.ndarray, float]:
    """Local line through ``width`` neighbours on either side, the sample itself left out: value (or slope) at it.

    Any time axis, nan in ``y`` allowed. Also the median standard deviation of it for unit noise in y.
    """
    n = len(y)
    sums = np.zeros((5, n))  # of 1, dt, dt^2, y, y dt
    for shift in (*range(-width, 0), *range(1, width + 1)):
        here = slice(max(0, -shift), min(n, n - shift))
        there = slice(max(0, shift), min(n, n + shift))
        if here.stop <= here.start:
            continue
        dt, value = time[there] - time[here], y[there]
        use = np.isfinite(value).astype(float)
        value = np.where(use > 0, value, 0.0)
        sums[:, here] += np.stack([use, use * dt, use * dt**2, value, value * dt])
    one, s_t, s_tt, s_y, s_ty = sums
    with np.errstate(divide="ignore", invalid="ignore"):
        spread = s_tt - s_t**2 / one
        rise = (s_ty - s_t * s_y / one) / spread
        level = s_y / one - rise * s_t / one
        gain = 1.0 / spread if slope else 1.0 / one + (s_t / one) ** 2 / spread
        good = (one >= 2) & (spread > 0)
    values = np.where(good, rise if slope else level, np.nan)
    return values, float(np.sqrt(np.median(gain[good]))) if good.any() else np.inf


def _changes(values: Sequence[np.ndarray]) -> bool:
    seen = np.concatenate(values)
    seen = seen[np.isfinite(seen)]
    return len(seen) > 1 and np.ptp(seen) > 1e-9 * np.abs(seen).max()


def _beyond(smooth: Sequence[tuple[np.ndarray, float]], least: float = 0.0) -> bool:
    """A measured quantity that moves by more than its noise; ``smooth`` are values and their noise per recording."""
    seen = np.concatenate([values for values, _ in smooth])
    seen = seen[np.isfinite(seen)]
    noise = max((n for _, n in smooth if np.isfinite(n)), default=np.inf)
    return len(seen) > 1 and float(np.std(seen)) > max(2.0 * noise, 3.0 * least)


def per_second(unit: str) -> str:
    """The unit of a rate."""
    above, _, below = unit.partition("/")
    return f"{above}/({below.strip('()')}.s)" if below and "sqrt" not in below else f"{unit}/s"


def bin_edges(quantity: Quantity, count: int = BINS) -> np.ndarray:
    """Edges (count+1,), half way between even ones and quantiles; one lies at zero when the sign changes."""
    if quantity.kind == "direction":
        return np.array([-1.5, -0.5, 0.5, 1.5])
    seen = np.concatenate(quantity.values)
    seen = seen[np.isfinite(seen)]
    low, high = float(seen.min()), float(seen.max())
    levels = np.linspace(0.0, 1.0, count + 1)
    if quantity.kind == "time":
        return low + (high - low) * levels
    edges = 0.5 * (low + (high - low) * levels + np.quantile(seen, levels))
    if low < 0.0 < high:
        edges[1 + int(np.argmin(np.abs(edges[1:-1])))] = 0.0
    return edges


def bins_of(quantity: Quantity, edges: np.ndarray) -> tuple[np.ndarray, ...]:
    """The bin of every sample, -1 where the quantity is unknown."""
    return tuple(np.where(np.isfinite(v), np.searchsorted(edges[1:-1], v, side="right"), -1) for v in quantity.values)


def finite(residuals: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Residuals with nan for what is not a number: a run that diverged says nothing about where."""
    return [np.where(np.abs(r) < DIVERGED, r, np.nan) for r in residuals]


def has_gap(residuals: Sequence[np.ndarray], j: int, noise: float) -> bool:
    """Whether output j is further off than its noise."""
    seen = np.concatenate([r[:, j] for r in residuals]) if residuals else np.empty(0)
    seen = seen[np.isfinite(seen)]
    return len(seen) > 1 and np.isfinite(noise) and float(np.mean(seen**2)) > GAP * noise**2


# -- correlated samples ------------------------------------------------------------------------------------------------
def autocorrelation(series: Sequence[np.ndarray]) -> np.ndarray:
    """Autocorrelation over several series with nan, lags 0.. up to the first that is not positive."""
    longest = max(len(s) for s in series)
    products, pairs = np.zeros(longest), np.zeros(longest)
    for s in series:
        seen = np.isfinite(s)
        products[: len(s)] += self_product(np.where(seen, s, 0.0))
        pairs[: len(s)] += self_product(seen.astype(float))
    if not products[0] > 0:
        return np.ones(1)
    rho = products / np.maximum(np.round(pairs), 1.0) / (products[0] / pairs[0])
    ends = np.flatnonzero((rho <= 0.0) | (pairs < 0.5))
    return np.minimum(rho[: ends[0]] if len(ends) else rho, 1.0)


def self_product(x: np.ndarray) -> np.ndarray:
    """``sum_i x_i x_{i+lag}`` for lag 0..n-1."""
    size = next_fast_len(2 * len(x), real=True)
    return irfft(np.abs(rfft(x, size)) ** 2, size)[: len(x)]


@dataclass(frozen=True, eq=False)
class Map:
    """Bin means of one residual over one quantity: means, standard errors, p-values (bins,); share of its square."""

    mean: np.ndarray
    error: np.ndarray
    p_value: np.ndarray
    share: float


class Binning:
    """The bins of one quantity over the samples where one residual is known: how pairs of samples share bins."""

    def __init__(self, labels: Sequence[np.ndarray], known: Sequence[np.ndarray], count: int):
        self.labels = [np.where(k, label, -1) for label, k in zip(labels, known, strict=True)]
        self.count = count
        longest = max(len(label) for label in labels)
        self.pairs = np.zeros((count, longest))
        for label in self.labels:
            for b in np.unique(label[label >= 0]):
                self.pairs[b, : len(label)] += self_product((label == b).astype(float))
        self.sizes = self.pairs[:, 0].round()

    def map(self, series: Sequence[np.ndarray], noise: float) -> Map:
        """Means of a residual (n,) per recording with their errors, never below those of white noise."""
        label, r = np.concatenate(self.labels), np.concatenate(series)
        here = (label >= 0) & np.isfinite(r)
        sizes = np.bincount(label[here], minlength=self.count)
        totals = np.bincount(label[here], r[here], minlength=self.count)
        mean = np.where(sizes > 0, totals / np.maximum(sizes, 1), np.nan)
        around = [
            np.where((b >= 0) & np.isfinite(s), s - mean[b], np.nan) for b, s in zip(self.labels, series, strict=True)
        ]
        rho = autocorrelation(around)
        pairs = sizes * rho[0] + 2.0 * self.pairs[:, 1 : len(rho)] @ rho[1:]
        independent = np.where(sizes > 0, sizes**2 / np.maximum(pairs, 1.0), 0.0)
        freedom = max(float(independent.sum() - np.sum(sizes > 0)), 0.5)
        with np.errstate(divide="ignore", invalid="ignore"):
            own = np.bincount(label[here], np.concatenate(around)[here] ** 2, minlength=self.count)
            variance = np.fmax(own / sizes, own.sum() / sizes.sum()) * (1.0 + np.sum(sizes > 0) / freedom)
            error = np.sqrt(variance / np.maximum(independent, 0.5))
            error = np.where(sizes > 0, np.fmax(error, noise / np.sqrt(sizes)), np.nan)
            statistic = np.abs(mean) / error
        sure = np.isfinite(statistic) & (independent > 1.5)
        p = np.where(sure, 2.0 * stdtr(freedom, -np.where(sure, statistic, 0.0)), 1.0)
        gained = np.nansum(sizes * np.maximum(mean**2 - error**2, 0.0))
        energy = float(np.sum(r[here] ** 2))
        return Map(mean, error, p, float(gained / energy) if energy > 0 else 0.0)


def holm(p_values: np.ndarray, level: float) -> np.ndarray:
    """Which of many tests hold together at ``level``."""
    order = np.argsort(p_values)
    holds = p_values[order] <= level / np.arange(len(p_values), 0, -1)
    last = len(holds) if holds.all() else int(np.argmin(holds))
    answer = np.zeros(len(p_values), dtype=bool)
    answer[order[:last]] = True
    return answer


# -- the maps ----------------------------------------------------------------------------------------------------------
def regions(flat: FlatModel, recordings: Sequence[Recording], before, after, noise: np.ndarray) -> tuple[Region, ...]:
    """Maps of every output with a gap over the few quantities that separate it best.

    before, after : residuals (n, ny) per recording, simulated minus measured, SI, nan where not measured; None: as
        before. noise : (ny,) SI.
    """
    before = finite(before)
    after = before if after is None else finite(after)
    gaps = [j for j in range(len(flat.outputs)) if has_gap(before, j, noise[j])]
    seen = quantities(flat, recordings, noise, before) if gaps else ()
    edges = [bin_edges(q) for q in seen]
    maps = _maps(seen, edges, gaps, before, after, noise)
    if not maps:
        return ()
    first, last = (dict(zip(maps, _together([m[k] for m in maps.values()]), strict=True)) for k in (0, 1))
    found = []
    for j in gaps:
        signal = flat.outputs[j]
        for i in _telling(seen, [maps[j, i][0].share * q.weight for i, q in enumerate(seen)]):
            one, two = maps[j, i]
            place = signal.name, signal.unit, seen[i].name, seen[i].unit, edges[i]
            found.append(Region(*place, one.mean, one.error, first[j, i], two.mean, two.error, last[j, i]))
    return tuple(found)


def _maps(seen, edges, gaps, before, after, noise) -> dict[tuple[int, int], tuple[Map, Map]]:
    """Before and after by output and quantity."""
    thin = [slice(None, None, 1 + len(r) // SAMPLES) for r in before]
    before, after = ([r[k] for r, k in zip(each, thin, strict=True)] for each in (before, after))
    labels = [[b[k] for b, k in zip(bins_of(q, e), thin, strict=True)] for q, e in zip(seen, edges, strict=True)]
    made, shared = {}, {}
    for j in gaps:
        known = [np.isfinite(r[:, j]) for r in before]
        pattern = b"".join(k.tobytes() for k in known)
        for i, label in enumerate(labels):
            if (i, pattern) not in shared:
                shared[i, pattern] = Binning(label, known, len(edges[i]) - 1)
            binning = shared[i, pattern]
            made[j, i] = tuple(binning.map([r[:, j] for r in each], noise[j]) for each in (before, after))
    return made


def _together(maps: Sequence[Map]) -> list[np.ndarray]:
    sizes = np.cumsum([len(m.p_value) for m in maps])[:-1]
    return np.split(holm(np.concatenate([m.p_value for m in maps]), 2.0 * ndtr(-SIGMAS)), sizes)


def _telling(seen: Sequence[Quantity], shares: Sequence[float]) -> list[int]:
    """The quantities that separate best, one of a kind first, without those that tell the same as a better one."""
    order = [int(i) for i in np.argsort(shares)[::-1]]
    first = [i for n, i in enumerate(order) if seen[i].kind not in {seen[k].kind for k in order[:n]}]
    chosen: list[int] = []
    for i in (*first, *order):
        telling = len(chosen) < 2 or shares[i] > FAINT * max(shares)
        if len(chosen) < KEPT and telling and all(abs(_correlation(seen[i], seen[k])) < ALIKE for k in chosen):
            chosen.append(i)
    return chosen


def _correlation(a: Quantity, b: Quantity) -> float:
    pair = np.stack([np.concatenate(a.values), np.concatenate(b.values)])
    pair = pair[:, np.isfinite(pair).all(axis=0)]
    alive = pair.shape[1] > 2 and np.all(np.ptp(pair, axis=1) > 0)
    return float(np.corrcoef(pair)[0, 1]) if alive else 0.0
