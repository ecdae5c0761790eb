"""Recordings at one period as rows of a linear regression, folded so that every part can be held out of its own fit.

A fold keeps the triangular factor of its rows, never their normal equations: a least squares fit of any order, on any
folds, is one of a few columns of stacked factors, with the condition of the rows and not its square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from ..training_data import on_period

FOLDS = 4  # parts, each held out once
MANY = 3  # recordings, from which on the parts are whole recordings; of fewer, they are cut
PAST = 4  # most past values of an output
DELAYS = (0, 1, 2, 3, 4, 6, 9, 13, 19)  # periods that are tried before an input acts
COUNTS = (1, 2, 4, 8)  # samples of an input that are tried
REACH = 6  # of a recording's samples, one in this many at most may lie in the past of a row
JUDGED, BETWEEN = 2000, 3  # samples of a recording, and for each at the period, that are enough to judge a run by
CUTOFF = 1e-9  # of the largest singular value of scaled columns: what is smaller is taken as none


@dataclass(frozen=True)
class Scales:
    """Centres and spreads of inputs (nu,) and outputs (ny,), SI."""

    input_centre: np.ndarray
    input_scale: np.ndarray
    output_centre: np.ndarray
    output_scale: np.ndarray

    @classmethod
    def of(cls, records: Sequence[Record], inputs: Sequence[Signal], outputs: Sequence[Signal]) -> Scales:
        """Means and standard deviations over all samples; 1 for what never moves."""
        parts = [np.concatenate([r.array([s.name for s in part]) for r in records]) for part in (inputs, outputs)]
        moments = [(p.mean(axis=0), np.where(np.ptp(p, axis=0) > 0, p.std(axis=0), 1.0)) for p in parts]
        return cls(*moments[0], *moments[1])


@dataclass(frozen=True, eq=False)
class Sampled:
    """One recording, over `Scales`: time (n,), inputs (n, nu), outputs (n, ny) at the period, and as recorded (m,).

    Of what was recorded much denser than the period, every second, third, ... sample judges runs.
    """

    time: np.ndarray
    u: np.ndarray
    y: np.ndarray
    own_time: np.ndarray
    own_y: np.ndarray

    @classmethod
    def of(cls, record: Record, period: float, inputs, outputs, scales: Scales) -> Sampled:
        even = on_period(record, period, inputs)
        u, y = (r.array([s.name for s in part]) for r, part in ((even, inputs), (even, outputs)))
        thin = max(1, min(len(record) // JUDGED, len(record) // (BETWEEN * len(even))))
        own = record.array([s.name for s in outputs])[::thin]
        normal = [(part - scales.output_centre) / scales.output_scale for part in (y, own)]
        return cls(even.time, (u - scales.input_centre) / scales.input_scale, normal[0], record.time[::thin], normal[1])

    @cached_property
    def _places(self) -> tuple[np.ndarray, np.ndarray]:
        """For every recorded time up to the last sample, the sample before it and the share of a period after that."""
        own = self.own_time[: np.searchsorted(self.own_time, self.time[-1], side="right")]
        before = np.clip(np.searchsorted(self.time, own, side="right") - 1, 0, len(self.time) - 2)
        return before, (own - self.time[before]) / (self.time[before + 1] - self.time[before])

    def at_own_times(self, run: np.ndarray) -> np.ndarray:
        """What runs on the samples, (n, ...), at the recorded times up to the last sample."""
        if len(self.time) == len(self.own_time):
            return run
        before, share = self._places
        share = share.reshape(-1, *[1] * (run.ndim - 1))
        return run[before] * (1 - share) + run[before + 1] * share

    def miss(self, run: np.ndarray, output: int) -> np.ndarray:
        """What a run (n,) of an output is off by, at the recorded times up to its end."""
        found = self.at_own_times(run)
        return found - self.own_y[: len(found), output]


@dataclass(frozen=True, eq=False)
class Rows:
    """The rows of all recordings: 1; y[k-1] and past increments of every output; every input with its lags.

    The targets, the increments y[k] - y[k-1], are the last columns. Before a recording begins, all was as in its first
    sample, as a block takes it to be; rows that look there are run, not fitted. reach : the largest lag of an input.
    judges : how many recordings, the last ones, choose and are not fitted; then they alone are held out.
    """

    parts: Sequence[Sampled]
    reach: int
    judges: int = 0

    @classmethod
    def of(cls, parts: Sequence[Sampled], reach: int = 0, judges: int = 0) -> Rows:
        """With as long a past as the shortest recording allows, at least ``reach``."""
        shortest = min(len(p.u) for p in parts)
        return cls(parts, max(1, reach, min(shortest // REACH, DELAYS[-1] + COUNTS[-1] - 1)), judges)

    @property
    def past(self) -> int:
        """The most increments of an output that are looked at."""
        return min(PAST, self.reach)

    def output(self, j: int) -> int:
        """The column of y[k-1] of output ``j``; its increments follow."""
        return 1 + j * (self.past + 1)

    def input(self, i: int) -> int:
        """The column of u[k] of input ``i``; its lags follow."""
        return self.output(self.parts[0].y.shape[1]) + i * (self.reach + 1)

    def target(self, j: int) -> int:
        """The column of y[k] - y[k-1] of output ``j``."""
        return self.input(self.parts[0].u.shape[1]) + j

    @property
    def fitted(self) -> int:
        """How many rows a fit has, with one fold held out."""
        if self.judges:
            return sum(len(p.u) for p in self.parts[: -self.judges])
        return sum(len(p.u) for p in self.parts) * (self.count - 1) // self.count

    @cached_property
    def matrices(self) -> list[np.ndarray]:
        """The rows of every recording, (n, columns), by columns in memory."""
        return [self._matrix(p) for p in self.parts]

    def _matrix(self, part: Sampled) -> np.ndarray:
        n, outputs = part.y.shape
        y = np.vstack([part.y[:1], part.y])  # y[k-1] at k
        d = np.vstack([np.zeros((self.past + 1, outputs)), np.diff(part.y, axis=0)])
        u = np.vstack([np.repeat(part.u[:1], self.reach, axis=0), part.u])
        answer = np.empty((n, self.target(outputs)), order="F")
        answer[:, 0] = 1.0
        for j in range(outputs):
            answer[:, self.output(j)] = y[:n, j]
            for lag in range(1, self.past + 1):
                answer[:, self.output(j) + lag] = d[self.past - lag : self.past - lag + n, j]
            answer[:, self.target(j)] = d[self.past : self.past + n, j]
        for i in range(part.u.shape[1]):
            for lag in range(self.reach + 1):
                answer[:, self.input(i) + lag] = u[self.reach - lag : self.reach - lag + n, i]
        return answer

    @property
    def count(self) -> int:
        """How many folds there are."""
        if self.judges:
            return 2
        return min(FOLDS, len(self.parts)) if len(self.parts) >= MANY else FOLDS

    @property
    def held(self) -> Sequence[int]:
        """The folds that are held out in turn."""
        return (1,) if self.judges else range(self.count)

    @property
    def never(self) -> int | None:
        """The fold that no fit sees, not even the last."""
        return 1 if self.judges else None

    @cached_property
    def cuts(self) -> list[np.ndarray]:
        """Per recording, the rows at which its folds begin, and its end; of many recordings, each is in one fold."""
        edges, many = np.arange(self.count + 1), len(self.parts)
        if self.judges:
            own = [int(k >= many - self.judges) for k in range(many)]
        elif many >= MANY:
            own = [k * self.count // many for k in range(many)]
        else:
            return [len(m) * edges // self.count for m in self.matrices]
        return [np.where(edges > k, len(m), 0) for k, m in zip(own, self.matrices, strict=True)]

    @cached_property
    def folds(self) -> list[np.ndarray]:
        """The triangular factor of the rows of every fold, over all recordings."""
        known = max(self.past + 1, self.reach)
        return [
            _factor([m[max(c[k], known) : c[k + 1]] for m, c in zip(self.matrices, self.cuts, strict=True)])
            for k in range(self.count)
        ]

    @cached_property
    def factors(self) -> list[np.ndarray]:
        """The triangular factor of all folds but one, for every one of `held`."""
        return [_factor([f for n, f in enumerate(self.folds) if n != k]) for k in self.held]

    @cached_property
    def all(self) -> np.ndarray:
        """The triangular factor of all rows that may be fitted."""
        return _factor([f for n, f in enumerate(self.folds) if n != self.never])


def _factor(rows: Sequence[np.ndarray]) -> np.ndarray:
    return np.linalg.qr(np.concatenate(rows), mode="r")


def solved(factor: np.ndarray, columns: Sequence[int], target: np.ndarray) -> np.ndarray:
    """Least squares coefficients of ``columns`` for a target (columns of the factor combined), scaled columns."""
    A = factor[:, columns]
    scale = np.sqrt(np.einsum("ij,ij->j", A, A))
    scale[scale == 0] = 1.0
    return np.linalg.lstsq(A / scale, target, rcond=CUTOFF)[0] / scale
