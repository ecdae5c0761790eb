"""The next experiment: the input within the limits that sets the members of a class furthest apart.

    d_ab(t) = (y_b - y_a) / noise,   min over delta of ||d_ab + S_a delta||^2 + delta' H_a delta,   H_a = S_0' S_0

S_a are the sensitivities of member a to its free parameters and start states with the new input, S_0 those with the
present recordings: what a new fit of all recordings together would absorb is taken out before the members are compared.
Limits are those of the recordings: amplitude and rate of the input, and the range of every output.
Source: Atkinson & Fedorov, Biometrika 1975 (T-optimum design: discriminating between models).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np
import scipy.linalg

from hydrotwin.identification.drives import OUTSIDE, Candidate, candidates, leaves, seen_limits, span_of, varied
from hydrotwin.identification.problem import Recording
from hydrotwin.identification.start_states import StartStates
from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel, Signal
from hydrotwin.simulation import prepare

from ..answer.discovery import Experiment
from ..fits.job import Question

DIVERGED = 1e9  # times the noise
FINALISTS = 9  # inputs that the sensitivities are computed for
CLEAR = 3.0  # times the noise: two members are told apart
Member = tuple[str, FlatModel, Mapping[str, float], Mapping[str, float] | Sequence[Mapping[str, float]]]


def next_experiment(
    members: Sequence[Member], flat_inputs: Sequence[Signal], recordings: Sequence[Recording], question: Question
) -> Experiment | None:
    """The `Experiment` that sets the members furthest apart; None when no input does better than the recordings.

    members : label, model, free parameter values by path, start states by name (one set, or one per recording); all
        explain ``recordings`` equally well.
    """
    j = varied(flat_inputs, recordings)
    if j is None or len(members) < 2:
        return None
    limits = seen_limits(recordings, j)
    if not limits.amplitude > 0:
        return None
    runners = [_Member(*m, question) for m in members]
    now = _Now(runners, recordings)
    others = np.mean(np.concatenate([r.u for r in recordings]), axis=0)
    span = span_of(recordings)
    tried = []
    for candidate in candidates(limits, flat_inputs[j].unit):
        u = np.tile(others, (len(limits.time), 1))
        u[:, j] = candidate.values
        reached = (m.run(limits.time, u) for m in runners)
        runs = list(itertools.takewhile(lambda y: y is not None, reached))
        if len(runs) == len(runners):
            furthest = max(leaves(y, span) for y in runs)
            apart = _score([_rms((b - a) / question.noise)[0] for a, b in combinations(runs, 2)])
            tried.append((furthest, apart, candidate, u))
    inside = [row for row in tried if row[0] <= OUTSIDE] or sorted(tried, key=lambda row: row[0])[:3]
    judged = []
    for _, _, candidate, u in _finalists(inside):
        pairs = _projected(runners, now, limits.time, u, question.noise)
        if pairs is not None:
            judged.append((_score([p[0] for p in pairs]), candidate, pairs))
    if not judged:
        return None
    _, best, pairs = max(judged, key=lambda row: row[0])
    separation, before = (float(np.sqrt(np.mean(np.square(v)))) for v in ([p[0] for p in pairs], now.apart))
    if not separation > before:
        return None
    told = _sentence(best, [m.label for m in runners], pairs, now, flat_inputs[j].name)
    if not any(row[0] <= OUTSIDE for row in tried):
        told += "; outputs then leave the range seen so far, so watch the stops"
    signal = flat_inputs[j]
    return Experiment(signal.name, signal.unit, limits.time, best.values, best.kind, separation, before, told)


# -- members -----------------------------------------------------------------------------------------------------------
class _Member:
    """One member of the class, ready to run: outputs over any input, sensitivities to what a new fit would move."""

    def __init__(self, label: str, flat: FlatModel, values, states, question: Question):
        self.label, self.flat, self.question = label, flat, question
        self.per_recording = [dict(states)] if isinstance(states, Mapping) else [dict(s) for s in states] or [{}]
        self.p = flat.parameter_vector(values)
        self.free = tuple(p.name for p in flat.parameters if p.name in values)
        index = np.array([flat.index_of(n) for n in self.free], dtype=int)
        self.start = StartStates(flat, tuple(self.per_recording[0]), index)
        order = [s.name for s in flat.states]
        self.propagator = prepare(flat, free_parameters=self.free, free_states=order, step=question.step)
        scale = np.abs(self.p[index])
        nominal = np.array([flat.parameters[i].nominal for i in index])
        self.unit = np.concatenate([np.where(scale > 0, scale, np.abs(nominal)), self.start.nominal])

    def starts(self, recording: int = 0) -> np.ndarray:
        """Values of the given start states."""
        known = self.per_recording[min(recording, len(self.per_recording) - 1)]
        return np.array([known[n] for n in self.start.names])

    def run(self, time: np.ndarray, u: np.ndarray) -> np.ndarray | None:
        """Outputs (n, ny); None when the run diverges."""
        x0, _, _ = self.start(u[0], self.p, self.starts())
        try:
            return self.propagator.run(time, u, self.p, x0)[0]
        except SolveError:
            return None

    def sensitivities(self, time: np.ndarray, u: np.ndarray, recording: int = 0):
        """Outputs (n, ny) and derivatives (n, ny, k) to free parameters and start states, in their own units."""
        x0, by_p, by_z = self.start(u[0], self.p, self.starts(recording))
        shared = len(self.free)
        seeds = np.zeros((len(x0), shared + len(x0)))
        seeds[:, :shared] = by_p
        seeds[:, shared : shared + by_z.shape[1]] = by_z
        try:
            y, dy, _, _ = self.propagator.sensitivity(time, u, self.p, x0, seeds, with_states=False)
        except SolveError:
            return None
        dy = dy[:, :, : len(self.unit)] * self.unit
        with np.errstate(over="ignore", invalid="ignore"):
            squares = np.nansum(np.square(dy / self.question.noise[:, None]))  # of a run that all but diverges: inf
        return (y, dy) if np.isfinite(dy).all() and np.isfinite(squares) else None


class _Now:
    """The present recordings: how far apart the pairs are there, what both leave, what is known of their parameters."""

    def __init__(self, runners: Sequence[_Member], recordings: Sequence[Recording]):
        noise = runners[0].question.noise
        measured = [r.y / noise for r in recordings]
        outputs: list[list[np.ndarray]] = []
        self.information = []
        for m in runners:
            runs, known = [], np.zeros((len(m.free), len(m.free)))
            for i, r in enumerate(recordings):
                found = m.sensitivities(r.time, r.u, i)
                seen = np.isfinite(r.y) & np.isfinite(noise)
                if found is None:
                    runs.append(np.full(r.y.shape, np.nan))
                    continue
                y, dy = found
                runs.append(np.where(seen, y / noise, np.nan))
                known += _left_of(dy / noise[:, None], seen, len(m.free))
            outputs.append(runs)
            self.information.append(known)
        self.apart = [_apart(a, b) for a, b in combinations(outputs, 2)]
        self.left = [min(_apart(a, measured), _apart(b, measured)) for a, b in combinations(outputs, 2)]

    def words(self, pair: int) -> str:
        """How far a pair differs there, and whether that is less than what neither of the two explains."""
        apart, left = self.apart[pair], self.left[pair]
        hidden = f" beside {left:.2g} that neither explains" if left > apart >= CLEAR else ""
        return f"(now {apart:.2g}{hidden})"


def _apart(some: Sequence[np.ndarray], others: Sequence[np.ndarray]) -> float:
    """Root mean square difference over recordings of the output that differs most."""
    return _rms(np.concatenate([y - x for x, y in zip(some, others, strict=True)]))[0]


def _left_of(columns: np.ndarray, seen: np.ndarray, shared: int) -> np.ndarray:
    """Information on the parameters when the start states of the recording are free."""
    J = columns[seen]
    whole = J.T @ J
    cross, own = whole[:shared, shared:], whole[shared:, shared:]
    return whole[:shared, :shared] - cross @ scipy.linalg.pinvh(own) @ cross.T


def _projected(runners: Sequence[_Member], now: _Now, time, u, noise) -> list[tuple[float, int]] | None:
    """Largest difference of every pair over the outputs, and that output, after what a new fit would absorb.

    Of a pair the member that comes nearer to the other is fitted again: which of them is true is not known.
    """
    found = [m.sensitivities(time, u) for m in runners]
    if any(f is None for f in found):
        return None
    pairs = []
    used = np.isfinite(noise)
    for a, b in combinations(range(len(runners)), 2):
        d = ((found[b][0] - found[a][0]) / noise)[:, used]
        best = min(
            (_absorbed(d, found[k][1][:, used] / noise[used][:, None], now.information[k], runners[k]) for k in (a, b)),
            key=lambda left: float(np.sum(left**2)),
        )
        whole = np.full((len(time), len(noise)), np.nan)
        whole[:, used] = best
        pairs.append(_rms(whole))
    return pairs


def _absorbed(d: np.ndarray, columns: np.ndarray, information: np.ndarray, member: _Member) -> np.ndarray:
    """What is left of d (n, ny) when the member is fitted again to everything."""
    S = columns.reshape(-1, columns.shape[-1])
    prior = np.zeros((S.shape[1], S.shape[1]))
    prior[: len(member.free), : len(member.free)] = information
    normal = S.T @ S + prior
    shown = np.diag(normal)
    size = np.where(shown > 0, np.sqrt(np.maximum(shown, 0.0)), np.inf)  # what moves nothing stays where it is
    step = scipy.linalg.pinvh(normal / np.outer(size, size), rtol=1e-9) @ (S.T @ d.ravel() / size) / size
    return d - (S @ step).reshape(d.shape)


# -- choosing ----------------------------------------------------------------------------------------------------------
def _rms(difference: np.ndarray) -> tuple[float, int]:
    """Root mean square of the output that differs most, and which it is; a run that diverges counts as `DIVERGED`."""
    seen = np.isfinite(difference)
    known = np.where(seen, np.clip(difference, -DIVERGED, DIVERGED), 0.0)
    size = np.sqrt(np.sum(known**2, axis=0) / np.maximum(seen.sum(axis=0), 1))
    return float(size.max()), int(np.argmax(size))


def _score(pairs: Sequence[float]) -> float:
    """Every pair counts: one that is told apart easily must not hide another that is not."""
    return float(np.mean(np.log1p(np.square(pairs))))


def _finalists(rows: Sequence[tuple]) -> list[tuple]:
    """The best of every kind, then the best of the rest."""
    ranked = sorted(rows, key=lambda row: -row[1])
    first = list({row[2].kind: row for row in ranked[::-1]}.values())
    first = sorted(first, key=lambda row: -row[1])
    rest = [row for row in ranked if not any(row is f for f in first)]
    return [*first, *rest][:FINALISTS]


def _sentence(best: Candidate, labels, pairs, now: _Now, name: str) -> str:
    names = [f"{labels[a]} and {labels[b]}" for a, b in combinations(range(len(labels)), 2)]
    told = [
        f"{who} then differ by {pair[0]:.2g} times the noise {now.words(k)}"
        for k, (who, pair) in enumerate(zip(names, pairs, strict=True))
        if pair[0] >= CLEAR
    ]
    alike = [who for who, pair in zip(names, pairs, strict=True) if pair[0] < CLEAR]
    if not told:
        k = int(np.argmax([p[0] for p in pairs]))
        told, alike = [f"{names[k]} then differ by only {pairs[k][0]:.2g} times the noise {now.words(k)}"], []
    words = "; ".join(told[:3]) + (f"; {', '.join(alike[:3])} stay alike" if alike else "")
    return f"drive {name} with {best.words}: {words}"
