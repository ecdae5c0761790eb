"""What is left without a name: which seen quantities a residual follows, how, and how much of it that explains.

    r ~ c_0 + sum_k c_k f_k(q),   f: q, |q|, q^2, q|q|, sign q, cos(k angle + phase)     (sparse, term by term)
    r ~ sum_m a_m exp(-|q - z_m|^2 / 2 l^2)                                             (Gaussian process, m <= 100)

Terms and quantities are taken on the fit recordings and kept only while they explain more on the select recordings.
The sparse formula is told where it explains most of what the Gaussian process does; no description is a physical name.
Source: Pati, Rezaiifar, Krishnaprasad, Asilomar 1993 (orthogonal matching pursuit); Rasmussen & Williams, Gaussian
Processes for Machine Learning, 2006, 8.3.1 (subset of regressors).
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import scipy.linalg
from scipy.fft import next_fast_len, rfft

from hydrotwin.identification.problem import Recording
from hydrotwin.models.language.amounts import amount
from hydrotwin.models.language.flat import FlatModel

from ..answer.discovery import Unknown
from .regions import PERIODS, Carrier, Quantity, carriers, finite, has_gap, quantities

SAMPLES = 16_000  # looked at
KNOWN = 0.8  # share of the samples where a quantity must be known
EXPLAINED = 0.1  # share of the squared residual below which nothing explains it
WORTH = 0.01  # share that a term or quantity must add on the select recordings
WAVE = 0.05  # the same of a wave: it has a frequency and a phase to choose
TERMS = 4
ENOUGH = 0.95  # of what is not noise: nothing more is looked for
INDUCING = 100
TRAINED = 1000  # samples that the Gaussian process learns from
FOLLOWED = 3  # quantities of a Gaussian process
LENGTHS = (0.4, 1.2)  # in standard deviations of a quantity
PLAIN = 0.8  # of what the Gaussian process explains: a formula with this much is told
PARTS = 100_000  # windows of one recording, at most
WINDOW = 250  # samples over which an integrated speed keeps its phase
LATER = 0.8  # what a period in time counts against a period in something that moves


@dataclass(frozen=True, eq=False)
class Sample:
    """Samples of one residual (n,), the quantities (n, q), the angles of the carriers (n, c), windows of time (n,)."""

    r: np.ndarray
    seen: np.ndarray
    angles: np.ndarray
    window: np.ndarray


@dataclass(frozen=True, eq=False)
class Term:
    """One plain term: its values from the quantities, what it is written like, its unit, the quantity it follows."""

    symbol: str
    unit: str
    column: int
    shape: str

    def of(self, seen: np.ndarray) -> np.ndarray:
        q = seen[:, self.column]
        return {"q": q, "|q|": np.abs(q), "q^2": q**2, "q|q|": q * np.abs(q)}[self.shape]


@dataclass(frozen=True, eq=False)
class Wave:
    """A wave of ``frequency`` times per turn, metre or second of a carrier."""

    carrier: Carrier
    column: int
    frequency: float

    @property
    def words(self) -> str:
        if self.carrier.unit == "m":
            return f"{self.carrier.name} periodically (every {amount(1.0 / self.frequency, 'm')})"
        per = "a turn" if self.carrier.unit == "rad" else "a second"
        digits = 1 if self.frequency >= 1 else 3
        return f"{self.carrier.name} periodically ({self.frequency:.{digits}f} times {per})"

    def written(self, phase: float | None) -> str:
        k, unit = self.frequency * (1.0 if self.carrier.unit == "rad" else 2 * np.pi), self.carrier.unit
        angle = self.carrier.name if self.carrier.absolute or unit == "s" else f"integral({self.carrier.name})"
        per, late = "" if unit == "rad" else f"rad/{unit} ", "phase" if phase is None else f"{phase:.2f}"
        return f"cos({k:.4g} {per}{angle} + {late})"


@dataclass(frozen=True, eq=False)
class Description:
    """Coefficients of a constant, plain terms and waves; ``share`` explained on the select recordings."""

    terms: tuple[Term | Wave, ...] = ()
    coefficients: np.ndarray = field(default_factory=lambda: np.zeros(1))
    share: float = 0.0
    predicted: np.ndarray = field(default_factory=lambda: np.zeros(0))


def describe_unknown(
    flat: FlatModel,
    fit_recordings: Sequence[Recording],
    fit_residuals: Sequence[np.ndarray],
    select_recordings: Sequence[Recording],
    select_residuals: Sequence[np.ndarray],
    noise: np.ndarray,
) -> tuple[Unknown, ...]:
    """One `Unknown` for every output with a gap, largest gap over the noise first.

    residuals : (n, ny) per recording, simulated minus measured, SI, nan where not measured; noise : (ny,) SI. Without
        select recordings the second half of every fit recording takes their place.
    """
    both = [*fit_recordings, *select_recordings]
    left = [*finite(fit_residuals), *finite(select_residuals)]
    off = [j for j in range(len(flat.outputs)) if has_gap(left, j, noise[j])]
    if not off:
        return ()
    seen = [q for q in quantities(flat, both, noise) if np.mean(np.isfinite(np.concatenate(q.values))) > KNOWN]
    turning = carriers(both, seen)
    found = []
    for j in off:
        fit, select = _samples(both, left, j, seen, turning, len(fit_recordings))
        size = float(np.sqrt(np.mean(np.concatenate([fit.r, select.r]) ** 2))) / noise[j] if noise[j] > 0 else np.inf
        if min(len(fit.r), len(select.r)) >= 40:
            found.append((size, _described(flat.outputs[j], seen, turning, fit, select, noise[j])))
    return tuple(u for _, u in sorted(found, key=lambda row: -row[0]))


def _described(signal, seen, turning, fit: Sample, select: Sample, noise: float) -> Unknown:
    most = max(0.0, 1.0 - noise**2 / float(np.mean(select.r**2)))  # the rest is noise
    plain = sparse(seen, turning, fit, select, most)
    share, columns, predicted = smooth(fit, select) if plain.share < ENOUGH * most else (0.0, (), plain.predicted)
    if max(plain.share, share) < EXPLAINED:
        sentence = f"no recorded quantity explains what is left of {signal.name}: less than {EXPLAINED:.0%}"
        return Unknown(signal.name, signal.unit, (), max(plain.share, share, 0.0), sentence.replace("%", " %"))
    if plain.share >= PLAIN * share:
        followed = tuple(dict.fromkeys(_name(t, seen) for t in plain.terms))
        words = _joined(dict.fromkeys(_follows(t, seen) for t in plain.terms))
        told, formula, peak = plain.share, written(signal.unit, plain), plain.predicted
    else:
        followed = tuple(seen[k].name for k in columns)
        words, told, formula, peak = _joined(followed), share, "", predicted
    size = amount(float(np.quantile(np.abs(peak), 0.99)), signal.unit)
    how = f", following {words}" if words else " everywhere alike"
    sentence = f"{signal.name} is off by up to {size}{how}; this explains {100 * told:.0f} % of it"
    return Unknown(signal.name, signal.unit, followed, float(told), sentence, formula)


# -- samples -----------------------------------------------------------------------------------------------------------
def _samples(recordings, residuals, j, seen, turning: Sequence[Carrier], fits: int) -> tuple[Sample, Sample]:
    """Samples of output j on the fit and on the select recordings."""
    total = sum(len(r.time) for r in recordings)
    stride = max(1, -(-total // (2 * SAMPLES)))
    parts: tuple[list, list] = ([], [])
    for i, recording in enumerate(recordings):
        n = len(recording.time)
        columns = np.stack([q.values[i] for q in seen], axis=1)
        angles = np.stack([c.angle[i] for c in turning], axis=1) if turning else np.empty((n, 0))
        windows = i * PARTS + np.arange(n) // WINDOW
        here = np.isfinite(residuals[i][:, j]) & np.isfinite(columns).all(axis=1) & np.isfinite(angles).all(axis=1)
        here &= np.arange(n) % stride == 0
        late = np.arange(n) >= n // 2 if fits == len(recordings) else np.full(n, i >= fits)
        for part, side in zip(parts, (here & ~late, here & late), strict=True):
            part.append(Sample(residuals[i][side, j], columns[side], angles[side], windows[side]))
    return tuple(
        Sample(
            np.concatenate([p.r for p in part]),
            np.concatenate([p.seen for p in part]),
            np.concatenate([p.angles for p in part]),
            np.concatenate([p.window for p in part]),
        )
        for part in parts
    )


# -- waves -------------------------------------------------------------------------------------------------------------
def strongest(carrier: Carrier, angle: np.ndarray, r: np.ndarray, window: np.ndarray) -> tuple[float, float]:
    """Frequency of the strongest wave in r over a carrier, and the squared residual it takes away.

    The windows of one phase add their power.
    """
    parts = _windows(carrier, window)
    spans = [max(float(np.ptp(angle[p])), 1e-12) for p in parts]
    step = 1.0 / (4.0 * carrier.high)
    size = next_fast_len(int(2 * max(spans) / step) + 16, real=True)
    power = np.zeros(size // 2 + 1)
    for part in parts:
        cell = ((angle[part] - angle[part].min()) / step).astype(int)
        power += 2.0 / len(part) * np.abs(rfft(np.bincount(cell, r[part]), size)) ** 2
    frequency = np.arange(len(power)) / (size * step)
    low = max(carrier.low, 2 * PERIODS / np.median(spans))
    power[(frequency < low) | (frequency > carrier.high)] = 0.0
    if not power.any():
        return low, 0.0
    best = frequency[int(np.argmax(power))]
    near = np.maximum(best + np.linspace(-1.0, 1.0, 11) / (size * step), low)
    energy = [sum(_taken(2 * np.pi * f * angle[p], r[p]) for p in parts) for f in near]
    k = int(np.argmax(energy))
    return float(near[k]), float(energy[k]) - 2.0 * len(parts) * float(np.mean(r**2))


def _windows(carrier: Carrier, window: np.ndarray) -> list[np.ndarray]:
    """Samples over which a wave keeps its phase: all, a recording (time), or a window (an integrated speed)."""
    part = window * 0 if carrier.absolute else window // PARTS if carrier.unit == "s" else window
    return np.split(np.arange(len(part)), np.flatnonzero(np.diff(part)) + 1)


def _taken(phase: np.ndarray, r: np.ndarray) -> float:
    a, b = _amplitudes(phase, r)
    return float(a * (np.cos(phase) @ r) + b * (np.sin(phase) @ r))


def _amplitudes(phase: np.ndarray, r: np.ndarray) -> np.ndarray:
    """a, b of the least squares r ~ a cos + b sin."""
    c, s = np.cos(phase), np.sin(phase)
    normal = np.array([[c @ c, c @ s], [c @ s, s @ s]])
    return np.linalg.solve(normal + 1e-6 * len(r) * np.eye(2), [c @ r, s @ r])


def wave(t: Wave, angle: np.ndarray, r: np.ndarray, window: np.ndarray) -> list[np.ndarray]:
    """Columns of a wave: cosine and sine, or one cosine with the phase that r has in every window."""
    phase = 2 * np.pi * t.frequency * angle
    if t.carrier.absolute:
        return [np.cos(phase), np.sin(phase)]
    column = np.empty(len(r))
    for part in _windows(t.carrier, window):
        a, b = _amplitudes(phase[part], r[part])
        column[part] = np.cos(phase[part] - np.arctan2(b, a))
    return [column]


# -- sparse ------------------------------------------------------------------------------------------------------------
def library(seen: Sequence[Quantity]) -> list[Term]:
    """Plain terms of every quantity."""
    terms = []
    for k, q in enumerate(seen):
        values = np.concatenate(q.values)
        known = values[np.isfinite(values)]
        both = bool(known.min() < 0 < known.max())
        symbol, unit = _symbol(q), q.unit
        squared = unit if unit == "1" else f"({unit})^2" if "/" in unit or "." in unit else f"{unit}^2"
        terms.append(Term(symbol, unit, k, "q"))
        if q.kind in ("direction", "time"):
            continue
        terms.append(Term(f"{symbol}^2", squared, k, "q^2"))
        if both:
            terms.append(Term(f"|{symbol}|", unit, k, "|q|"))
            terms.append(Term(f"{symbol} |{symbol}|", squared, k, "q|q|"))
    return terms


def sparse(
    seen: Sequence[Quantity], turning: Sequence[Carrier], fit: Sample, select: Sample, most: float
) -> Description:
    """Terms one after the other while they explain more on the select recordings, where ``most`` is no noise."""
    known = library(seen)
    plain = np.stack([t.of(fit.seen) for t in known], axis=1) if known else np.empty((len(fit.r), 0))
    plain = plain - plain.mean(axis=0)
    size = np.linalg.norm(plain, axis=0)
    best = _solved((), fit, select)
    while len(best.terms) < TERMS and best.share < ENOUGH * most:
        left = fit.r - best.predicted
        options: list[tuple[float, Term | Wave]] = []
        with np.errstate(divide="ignore", invalid="ignore"):
            scores = np.nan_to_num((plain.T @ (left - left.mean())) ** 2 / size**2)
        options += [(float(scores[k]), known[k]) for k in np.argsort(scores)[::-1][:3]]
        for k, carrier in enumerate(turning):
            frequency, energy = strongest(carrier, fit.angles[:, k], left - left.mean(), fit.window)
            options.append((energy * (LATER if carrier.unit == "s" else 1.0), Wave(carrier, k, frequency)))
        options = [o for o in options if o[1] not in best.terms]
        tries = sorted(options, key=lambda o: -o[0])[:2]
        found = max((_solved((*best.terms, t), fit, select) for _, t in tries), key=lambda d: d.share, default=best)
        if found.share < best.share + (WAVE if isinstance(found.terms[-1], Wave) else WORTH):
            break
        best = found
    return best


def _solved(terms, fit: Sample, select: Sample) -> Description:
    """Least squares of the terms on the fit samples, judged on the select samples."""
    columns, others = _columns(terms, fit), _columns(terms, select)
    scale = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    normal = (columns / scale).T @ (columns / scale) + 1e-9 * np.eye(len(scale))
    coefficients = scipy.linalg.solve(normal, (columns / scale).T @ fit.r, assume_a="pos") / scale
    chance = sum(
        len(_windows(t.carrier, select.window)) for t in terms if isinstance(t, Wave) and not t.carrier.absolute
    )
    share = _share(select.r, others @ coefficients) - chance / len(select.r)
    return Description(tuple(terms), coefficients, share, columns @ coefficients)


def _columns(terms, sample: Sample) -> np.ndarray:
    """A constant, plain terms, and two columns per wave with a phase of its own, one where it is searched."""
    columns = [np.ones(len(sample.r))]
    for t in terms:
        if isinstance(t, Wave):
            columns += wave(t, sample.angles[:, t.column], sample.r - sample.r.mean(), sample.window)
        else:
            columns.append(t.of(sample.seen))
    return np.stack(columns, axis=1)


def _share(r: np.ndarray, predicted: np.ndarray) -> float:
    energy = float(r @ r)
    return 1.0 - float(np.sum((r - predicted) ** 2)) / energy if energy > 0 else 0.0


# -- smooth ------------------------------------------------------------------------------------------------------------
def smooth(fit: Sample, select: Sample) -> tuple[float, tuple[int, ...], np.ndarray]:
    """A Gaussian process over the few quantities that explain most: share on select, their columns, prediction."""
    centre, spread = fit.seen.mean(axis=0), np.maximum(fit.seen.std(axis=0), 1e-300)
    learn = _thinned(len(fit.r), TRAINED)
    judge = _thinned(len(select.r), TRAINED)
    X, r = (fit.seen[learn] - centre) / spread, fit.r[learn]
    V, s = np.clip((select.seen[judge] - centre) / spread, X.min(axis=0), X.max(axis=0)), select.r[judge]
    predicted = np.full(len(s), r.mean())
    share, chosen = _share(s, predicted), ()
    while len(chosen) < FOLLOWED:
        others = [k for k in range(X.shape[1]) if k not in chosen]
        better, guess, columns = _best_process(X, r, V, s, [(*chosen, k) for k in others])
        if better < share + WAVE and not chosen:  # a product shows in neither factor alone
            pair = _best_process(X[::2], r[::2], V[::2], s[::2], combinations(others, 2))[2]
            better, guess, columns = _best_process(X, r, V, s, [pair] if pair else [])
        if better < share + max(WORTH, 0.02):
            break
        share, chosen, predicted = better, columns, guess
    return share, chosen, predicted


def _best_process(X, r, V, s, sets) -> tuple[float, np.ndarray, tuple[int, ...]]:
    tries = [(*_process(X[:, c], r, V[:, c], s), c) for c in map(list, sets)]
    share, guess, columns = max(tries, key=lambda row: row[0], default=(-np.inf, np.zeros(len(s)), []))
    return share, guess, tuple(columns)


def _thinned(n: int, most: int) -> np.ndarray:
    return np.unique(np.linspace(0, n - 1, min(n, most)).astype(int))


def _process(X: np.ndarray, r: np.ndarray, V: np.ndarray, s: np.ndarray) -> tuple[float, np.ndarray]:
    """Best share on (V, s) over the lengths, and its prediction."""
    count = min(40 if X.shape[1] == 1 else INDUCING, len(X) // 4)
    Z = X[np.random.default_rng(0).choice(len(X), count, replace=False)]
    best = (-np.inf, np.zeros(len(s)))
    for length in LENGTHS:
        K, own, other = (_kernel(A, Z, length * np.sqrt(X.shape[1])) for A in (X, Z, V))
        system = K.T @ K + 0.3 * own + 1e-8 * len(X) * np.eye(count)
        weights = scipy.linalg.solve(system, K.T @ (r - r.mean()), assume_a="pos")
        guess = other @ weights + r.mean()
        share = _share(s, guess)
        if share > best[0]:
            best = (share, guess)
    return best


def _kernel(A: np.ndarray, B: np.ndarray, length: float) -> np.ndarray:
    apart = np.sum(A**2, axis=1)[:, None] + np.sum(B**2, axis=1) - 2.0 * A @ B.T
    return np.exp(-np.maximum(apart, 0.0) / (2.0 * length**2))


# -- words -------------------------------------------------------------------------------------------------------------
def _symbol(q: Quantity) -> str:
    if q.kind == "direction":
        return f"sign({q.of})" if q.name.startswith("sign") else f"sign(der({q.of}))"
    return f"der({q.of})" if q.name in (f"velocity of {q.of}", f"rate of {q.of}") else q.name.replace(" - ", "-")


def _name(term: Term | Wave, seen: Sequence[Quantity]) -> str:
    return term.carrier.name if isinstance(term, Wave) else seen[term.column].name


def _follows(term: Term | Wave, seen: Sequence[Quantity]) -> str:
    return term.words if isinstance(term, Wave) else seen[term.column].name


def _joined(words) -> str:
    words = list(words)
    return words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}" if words else ""


def written(unit: str, found: Description) -> str:
    """The formula in SI, each coefficient with its unit."""
    parts, rest = [f"{found.coefficients[0]:.3g} {unit}"], list(found.coefficients[1:])
    for t in found.terms:
        if isinstance(t, Wave):
            a, b = rest.pop(0), rest.pop(0) if t.carrier.absolute else 0.0
            phase = np.arctan2(-b, a) if t.carrier.absolute else None
            parts.append(f"{np.hypot(a, b):.3g} {unit} {t.written(phase)}")
        else:
            per = f"({t.unit})" if re.search(r"[/.](?!.*\)\^)", t.unit) else t.unit
            over = f" {unit}" if t.unit == "1" else "" if t.unit == unit else f" {unit}/{per}"
            parts.append(f"{rest.pop(0):.3g}{over} {t.symbol}")
    return " + ".join(parts).replace("+ -", "- ")
