"""Whether an output integrates its inputs: found from recordings, by running both forms on parts that are held out.

    level   y[k] = c + sum_i g_i(u[k-i])
    rate    y[k] = y[0] + T sum_(j<k) (c + sum_i g_i(u[j-i]))

g_i are piecewise linear, additive over inputs and lags, and both forms are fitted by linear least squares on what they
run to, so that noise of the sensor costs both alike. The unit of the output takes no part.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from hydrotwin.models.language.errors import DataError
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .steady_step import bent
from .training_data import choose_period, on_period

FOLDS = 4  # parts of every recording, each held out once
KINKS = (0.15, 0.35, 0.5, 0.65, 0.85)  # quantiles of the different values of an input, at which its g_i bend
LAGS = (0, 1, 2, 3, 5, 8, 13, 20)  # periods; where the kind of model does not say how far it looks back
CLEAR = 2.0  # times the error of the rate form, from which on that of the level form leaves no doubt
MOVES = 3.0  # ranges of the output, between one held input and another: less is no integral, where there is doubt
RIDGE = 1e-8  # of the mean information of a coefficient
MOST = 4000  # samples that both forms are fitted on, over all recordings


@dataclass(frozen=True)
class Integration:
    """How well each form of an output runs on parts it was not fitted on: RMS, SI.

    moves : by how many of its ranges the rate form would move over a recording, between one held input and another.
    """

    output: Signal
    level: float
    rate: float
    moves: float

    @property
    def found(self) -> bool:
        """Whether the output integrates: its rate runs better, and where not by much, keeps moving at held inputs.

        Differences of delayed inputs make a rate that integrates to a level, so that the rate form of what settles
        may run as well as the level form; but then it does not move at held inputs.
        """
        return self.rate < self.level and (self.clear or self.moves > MOVES)

    @property
    def clear(self) -> bool:
        """Whether the recordings tell the two forms apart."""
        return self.level > CLEAR * self.rate or self.rate > self.level

    def told(self) -> dict:
        """For the provenance."""
        return {"integrates": self.found, "clear": self.clear, "rate_form": self.rate, "level_form": self.level}


def one_form(verb: str, option: str, asked: bool | None, found: Sequence[Integration]) -> bool:
    """Whether a block of one form for all outputs learns their rates: as asked, else as found.

    Raises `DataError` where nothing is asked and the outputs are of both forms.
    """
    if asked is not None:
        return bool(asked)
    integrating, others = ([f.output.name for f in found if f.found is form] for form in (True, False))
    if integrating and others:
        raise DataError(
            f"{verb}: {', '.join(integrating)} integrates its inputs, {', '.join(others)} does not. A block has one "
            f"form for all its outputs. Learn one block for each kind of output, or say {option}=True or False."
        )
    return bool(integrating)


def told_forms(found: Sequence[Integration]) -> dict:
    """The findings by output, for the provenance."""
    return {f.output.name: f.told() for f in found}


def integration(
    records: Sequence[Record],
    inputs: Sequence[Signal],
    outputs: Sequence[Signal],
    *,
    period: float | None = None,
    lags: Sequence[int] = LAGS,
) -> list[Integration]:
    """For every output, the free-run errors of its level and of its rate on parts of the recordings held out in turn.

    Each form looks back as far as suits it best: slow ramps tell nothing of many delays, a dead time needs them.

    period : s between the samples that are looked at; None: `choose_period`. lags : how many of these the model that
    is to be learnt looks back.
    """
    period = max(period or choose_period(records), sum(r.duration for r in records) / MOST)
    even = [on_period(r, period, inputs) for r in records]
    u, y = ([r.array([s.name for s in part]) for r in even] for part in (inputs, outputs))
    level, rate, moves = np.array([_both_forms(u, y, period, lags[:n]) for n in sorted({1, 4, len(lags)})]).swapaxes(
        0, 1
    )
    best = rate.argmin(axis=0)
    return [
        Integration(s, float(level[:, j].min()), float(rate[best[j], j]), float(moves[best[j], j]))
        for j, s in enumerate(outputs)
    ]


def _both_forms(u: Sequence[np.ndarray], y: Sequence[np.ndarray], period: float, lags: Sequence[int]):
    """Errors of level and rate, and what the rate moves by at held inputs, (ny,) each, with these lags."""
    kinks, every = kinks_of(u), np.concatenate(u)
    parts = []
    for inputs, outputs in zip(u, y, strict=True):
        columns = _causes(inputs, kinks, lags)
        parts += parts_of(columns, np.cumsum(period * columns, axis=0) - period * columns, outputs)
    level, rate = ([_apart(parts, k, miss) for k in range(len(parts))] for miss in (_level_miss, _rate_miss))
    held = [_causes(row[None], kinks, lags)[0] for row in np.vstack([every.min(axis=0), kinks, every.max(axis=0)])]
    moved = np.ptp(np.array(held) @ rate_fit(parts), axis=0) * period * max(map(len, u))
    return _rms(level), _rms(rate), moved / np.maximum(np.ptp(np.concatenate(y), axis=0), 1e-300)


class Information(NamedTuple):
    """Rows^T rows (m, m), rows^T targets (m, ny) and the number of rows: all that least squares know of them."""

    gram: np.ndarray
    moments: np.ndarray
    count: int

    @classmethod
    def of(cls, rows: np.ndarray, targets: np.ndarray) -> Information:
        return cls(rows.T @ rows, rows.T @ targets, len(rows))


@dataclass(frozen=True, eq=False)
class Part:
    """A part of a recording: causes (n, m), their integral over time (n, m), outputs (n, ny)."""

    causes: np.ndarray
    integral: np.ndarray
    outputs: np.ndarray

    @cached_property
    def of_level(self) -> Information:
        return Information.of(self.causes, self.outputs)

    @cached_property
    def of_rate(self) -> Information:
        """From an unknown start."""
        return Information.of(_about_mean(self.integral), _about_mean(self.outputs))


def parts_of(causes: np.ndarray, integral: np.ndarray, outputs: np.ndarray) -> list[Part]:
    """A recording in parts, each of which can be held out."""
    folds = np.array_split(np.arange(len(causes)), FOLDS)
    return [Part(causes[k], integral[k], outputs[k]) for k in folds if len(k) > 1]


def kinks_of(u: Sequence[np.ndarray]) -> np.ndarray:
    """Where the curves of every input bend, (n, nu), from the inputs (n, nu) of all recordings."""
    return np.column_stack([np.quantile(np.unique(column), KINKS) for column in np.concatenate(u).T])


def rate_fit(parts: Sequence[Part]) -> np.ndarray:
    """Coefficients (m, ny) with which the integrals run to the outputs, from an unknown start in every part."""
    return _least_squares([p.of_rate for p in parts])


def cross_validated(parts: Sequence[Part]) -> tuple[np.ndarray, np.ndarray]:
    """RMS (ny,) of what the outputs move by in every part, and of what `rate_fit` of all others leaves of it."""
    return _rms([p.outputs - p.outputs[0] for p in parts]), _rms(
        [_apart(parts, k, _rate_miss) for k in range(len(parts))]
    )


def _apart(parts: Sequence[Part], k: int, miss: Callable) -> np.ndarray:
    return miss([p for n, p in enumerate(parts) if n != k], parts[k])


def _level_miss(others: Sequence[Part], own: Part) -> np.ndarray:
    return own.outputs - own.causes @ _least_squares([p.of_level for p in others])


def _rate_miss(others: Sequence[Part], own: Part) -> np.ndarray:
    return own.outputs - own.outputs[0] - (own.integral - own.integral[0]) @ rate_fit(others)


def _rms(misses: Sequence[np.ndarray]) -> np.ndarray:
    return np.sqrt(np.mean(np.concatenate(misses) ** 2, axis=0))


def _causes(u: np.ndarray, kinks: np.ndarray, lags: Sequence[int]) -> np.ndarray:
    """1, and u and max(u - kink, 0) of every input (n, nu) at every lag."""
    bent_ = np.column_stack(bent(list(u.T), kinks)[1:])
    late = [bent_[np.maximum(np.arange(len(u)) - lag, 0)] for lag in lags]
    return np.hstack([np.ones((len(u), 1)), *late])


def _about_mean(values: np.ndarray) -> np.ndarray:
    """A run from an unknown start."""
    return values - values.mean(axis=0)


def _least_squares(known: Sequence[Information]) -> np.ndarray:
    """Coefficients (m, ny); what is known of each part is summed, so that leaving one out costs no more than that."""
    gram, moments, count = (sum(parts) for parts in zip(*known, strict=True))
    scale = np.maximum(np.sqrt(np.diag(gram) / count), 1e-300)[:, None]
    gram = gram / scale / scale.T
    gram[np.diag_indices_from(gram)] += RIDGE * np.trace(gram) / len(gram)
    return np.linalg.solve(gram, moments / scale) / scale
