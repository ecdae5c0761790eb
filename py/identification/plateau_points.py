"""One point of the friction curve from each plateau: the mean of the samples that agree, and how sure it is."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, fields

import numpy as np
from scipy.special import chdtrc, stdtrit

from hydrotwin.models.language.errors import DataError
from hydrotwin.records.noise import recorded_step

from .plateaus import STEADY, Stretch, alone, is_table, plateaus
from .stribeck_curve import Drift

FAR = 8.0  # standard deviations from the others of its plateau beyond which a sample is a fault
FAULTY = 0.25  # share of such samples from which on a plateau has no one force
JUMP = 5.0  # standard errors by which the halves of a plateau must differ to say that the force changes
ROUNDING = 1e-9  # of the largest force: what no sensor tells


@dataclass(frozen=True)
class Points:
    """Points (n,): mean time [s] from the start, velocity, force, their errors; slope of the force [N/s] within."""

    time: np.ndarray
    velocity: np.ndarray
    force: np.ndarray
    velocity_error: np.ndarray
    force_error: np.ndarray
    slope: np.ndarray
    slope_error: np.ndarray

    @classmethod
    def joined(cls, parts: Sequence[Points]) -> Points:
        """The points of several recordings."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))

    def drift(self) -> Drift | None:
        """The common drift that the plateaus show, each by itself; None where they show none, flat or not."""
        if len(self.time) < 2 or not np.isfinite(self.slope_error).all():
            return None
        weight = 1 / self.slope_error**2
        rate = float(weight @ self.slope / weight.sum())
        scatter, freedom = float(weight @ (self.slope - rate) ** 2), len(weight) - 1
        sigma = float(np.sqrt(max(scatter / freedom, 1.0) / weight.sum()))
        return Drift(self.time, rate, sigma, float(chdtrc(freedom, scatter)))


def points_of(record, velocity: str, force: str) -> tuple[Points, list[Stretch]]:
    """The points of one recording, and the stretches and samples that gave none. DataError without the columns."""
    for name in (velocity, force):
        if name not in record.signals:
            raise DataError(
                f"{record.name}: no column '{name}' (got {', '.join(record.signals)}). A friction test needs velocity "
                "and force. Name the columns: velocity=..., force=...."
            )
    v, F = np.asarray(record[velocity], dtype=float), np.asarray(record[force], dtype=float)
    keep = np.isfinite(v) & np.isfinite(F)
    time, v, F = np.asarray(record.time, dtype=float)[keep] - record.time[0], v[keep], F[keep]
    if is_table(time, v, plateaus(record.name, time, v)[0]):
        moving = v != 0
        none, unknown = np.zeros(moving.sum()), np.full(moving.sum(), np.nan)
        return Points(time[moving], v[moving], F[moving], none, unknown, unknown, unknown), []
    lone = alone(v)
    start = record.time[0]
    told = list(_told(record.name, time + start, v, lone, "the velocity of {} stands alone among its neighbours"))
    time, v, F = time[~lone], v[~lone], F[~lone]
    found, dropped = plateaus(record.name, time + start, v)
    points, faults = _Plateaus(record.name, time, v, F, found).points(start)
    return points, sorted([*told, *dropped, *faults], key=lambda stretch: stretch.start)


@dataclass(frozen=True)
class _Plateaus:
    """Samples (n,) of a recording, and the ranges of steady speed in it."""

    name: str
    time: np.ndarray
    v: np.ndarray
    F: np.ndarray
    found: list[slice]

    def points(self, start: float) -> tuple[Points, list[Stretch]]:
        """Points and what gave none; ``start`` [s] of the recording."""
        middles = [float(np.median(self.F[part])) for part in self.found]
        largest = max(map(abs, middles), default=0.0)
        floor = max(recorded_step(self.F) / np.sqrt(12), ROUNDING * largest, np.finfo(float).tiny)
        agreeing = [self._agreeing(part, floor, STEADY * largest) for part in self.found]
        lines = [self._line(part) for part in agreeing]
        rate = _common(np.array([slope for slope, _, _ in lines]))
        dropped, rows = [], []
        wildest = max(FAR * _median([spread for _, spread, _ in lines]), _median([*map(abs, middles)]))
        for whole, part, (slope, spread, reach) in zip(self.found, agreeing, lines, strict=True):
            most = max(STEADY * largest, JUMP * 2 * spread / np.sqrt(len(part)))
            reason = self._unsteady(whole, part, rate, most)
            if reason := reason or (f"the force scatters by {spread:.3g} N within it" if spread > wildest else ""):
                first, last, mean = self.time[whole.start], self.time[whole.stop - 1], float(self.v[whole].mean())
                dropped.append(Stretch(self.name, start + first, start + last, whole.stop - whole.start, mean, reason))
                continue
            at_fault = np.ones(len(self.v), dtype=bool)
            at_fault[: whole.start] = at_fault[whole.stop :] = at_fault[part] = False
            reason = f"the force of {{}} stands far from the others of its plateau, {self.F[part].mean():.4g} N"
            dropped += _told(self.name, self.time + start, self.v, at_fault, reason, self.F)
            rows.append((part, slope, spread, reach))
        return self._summed(rows, floor), dropped

    def _agreeing(self, part: slice, floor: float, least: float) -> np.ndarray:
        """Indices of the samples of a plateau whose force is near a line through the others."""
        time, F = self.time[part], self.F[part]
        residual = F - np.median(F)
        for _ in range(3):
            spread = max(1.4826 * float(np.median(np.abs(residual))), floor)
            near = np.abs(residual) <= max(FAR * spread, least)
            line = np.polynomial.Polynomial.fit(time[near], F[near], 1)
            residual = F - line(time)
            residual -= np.median(residual)
        return part.start + np.flatnonzero(near)

    def _line(self, part: np.ndarray) -> tuple[float, float, float]:
        """Slope [N/s] of the force, its standard deviation about the line [N], and the reach of time [s.sqrt(n)]."""
        t, F = self.time[part] - self.time[part].mean(), self.F[part]
        slope = float(t @ F / (t @ t))
        spread = np.sqrt(np.sum((F - F.mean() - slope * t) ** 2) / max(len(part) - 2, 1))
        return slope, float(spread), float(np.sqrt(t @ t))

    def _unsteady(self, whole: slice, part: np.ndarray, rate: float, most: float) -> str:
        """Why a plateau has no one force; "" if it has. ``rate`` [N/s] by which all drift."""
        samples, far = whole.stop - whole.start, whole.stop - whole.start - len(part)
        telling = part if far <= FAULTY * samples else np.arange(whole.start, whole.stop)
        F, half = self.F[telling] - rate * self.time[telling], len(telling) // 2
        change = abs(F[-half:].mean() - F[:half].mean())
        if change > most:
            return f"the force changes by {change:.3g} N within it"
        kept = far <= FAULTY * samples
        return "" if kept else f"the force keeps no one value: {far} of {samples} samples stand far from the others"

    def _summed(self, rows: list, floor: float) -> Points:
        parts = [part for part, *_ in rows]
        count = np.array([len(part) for part in parts])
        mean_t, mean_v, mean_F = (np.array([x[part].mean() for part in parts]) for x in (self.time, self.v, self.F))
        noise_v = _median([self.v[part].std() for part in parts])
        spread, reach = (np.array([row[k] for row in rows]) for k in (2, 3))
        noise_F = max(_median(spread), floor)
        error_v = np.hypot(noise_v / np.sqrt(count), _rounding_bias(self.v, parts))
        error_F = np.hypot(noise_F / np.sqrt(count), _rounding_bias(self.F, parts))
        slope = np.array([row[1] for row in rows])
        return Points(mean_t, mean_v, mean_F, error_v, error_F, slope, np.maximum(spread, noise_F) / reach)


def _median(values) -> float:
    return float(np.median(values)) if len(values) else 0.0


def _rounding_bias(values: np.ndarray, parts: list[np.ndarray]) -> np.ndarray:
    """Standard error of each mean that rounding leaves where the noise is too small to average it out.

    For noise of standard deviation s, rounding to a step q shifts a mean by up to exp(-2 (pi s/q)^2) of what it does
    without noise. Source: Widrow, Kollar, Quantization Noise (2008), chapter 4.
    """
    q = recorded_step(values)
    noise = np.array([max(float(values[part].var()) - q**2 / 12, 0.0) for part in parts])
    return q / np.sqrt(12) * np.exp(-2 * np.pi**2 * noise / q**2) if q else np.zeros(len(parts))


def _common(slopes: np.ndarray) -> float:
    """The slope [N/s] that most plateaus share; 0 where it is no more than their scatter."""
    if len(slopes) < 3:
        return 0.0
    middle = float(np.median(slopes))
    error = 1.2533 * 1.4826 * float(np.median(np.abs(slopes - middle))) / np.sqrt(len(slopes))
    return middle if abs(middle) > stdtrit(len(slopes) - 1, 0.999) * error else 0.0


def _told(name: str, time, v, wrong: np.ndarray, reason: str, shown=None) -> Iterator[Stretch]:
    """Samples that are wrong, those beside each other as one stretch; ``reason`` is given what they are."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], wrong, [False]]).astype(int)))
    for first, last in edges.reshape(-1, 2):
        values, unit = (v, "m/s") if shown is None else (shown, "N")
        low, high = values[first:last].min(), values[first:last].max()
        text = f"{low:.4g} {unit}" if low == high else f"{low:.4g} to {high:.4g} {unit}"
        mean = float(v[first:last].mean())
        start, end = float(time[first]), float(time[last - 1])
        yield Stretch(name, start, end, int(last - first), mean, reason.format(text), fault=True)
