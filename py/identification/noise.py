"""The weight of each output: one over its noise, estimated from the recordings or given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records.noise import channel_noise

from .problem import Recording

ACCURACY = 1e-5  # of the range of an output: two solvers of one equation agree no better
RANGE = (1.0, 99.0)  # percent of the samples between which an output ranges: spikes are no range


def output_noise(
    flat: FlatModel, measured: Sequence[Recording], given: Mapping[str, float] | None = None
) -> np.ndarray:
    """Noise of every output over all recordings, shape (ny,), SI; nan where nothing was measured.

    Values in ``given`` win. The estimate is the quadratic mean over the recordings, never below `floor`.
    Raises DataError for an output that never changes: it says nothing about its own noise.
    """
    given, names = dict(given or {}), [s.name for s in flat.outputs]
    for name, sigma in given.items():
        if name not in names:
            raise DeclarationError(f"identify: {flat.name} has no output '{name}'. {nearest(name, names)}")
        if not sigma > 0:
            raise DeclarationError(
                f"identify: the noise of '{name}' must be positive (got {sigma:g}). Leave it out to have it estimated."
            )
    columns = [[(r.time, r.y[:, j]) for r in measured if np.isfinite(r.y[:, j]).any()] for j in range(len(names))]
    noise, least = np.full(len(names), np.nan), floor(measured)
    for j, (name, column) in enumerate(zip(names, columns, strict=True)):
        if column:
            noise[j] = given[name] if name in given else max(_estimated(name, column), least[j])
    return noise


def floor(measured: Sequence[Recording]) -> np.ndarray:
    """What a model that lacks nothing leaves of every output (ny,) without any noise, SI; nan: nowhere measured.

    The accuracy of the runs, and the step in which the output was recorded.
    """
    return np.fmax(solver_error(measured), quanta(measured) / np.sqrt(12))


def quanta(measured: Sequence[Recording]) -> np.ndarray:
    """The coarsest step (ny,) in which any recording holds an output, SI; 0: none."""
    return np.max([r.steps for r in measured], axis=0)


def solver_error(measured: Sequence[Recording]) -> np.ndarray:
    """Error of a run in every output (ny,), SI; nan where nothing was measured."""
    columns = [c[np.isfinite(c)] for c in np.concatenate([r.y for r in measured]).T]
    return np.array([ACCURACY * _range(c) if len(c) else np.nan for c in columns])


def _range(values: np.ndarray) -> float:
    low, high = np.percentile(values, RANGE)
    return float(high - low) or float(np.ptp(values))


def weights(noise: np.ndarray) -> np.ndarray:
    """One over the noise, 0 for outputs nowhere measured. Shape (ny,)."""
    return np.where(np.isfinite(noise), 1.0 / np.where(np.isfinite(noise), noise, 1.0), 0.0)


def _estimated(name: str, columns: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    known = [(time[np.isfinite(y)], y[np.isfinite(y)]) for time, y in columns]
    if not np.ptp(np.concatenate([y for _, y in known])) > 0:
        raise DataError(
            f"identify: output '{name}' is constant in every recording (got {known[0][1][0]:g}). A constant does not "
            f"show its own noise. Give noise={{'{name}': ...}}, or name the outputs to fit without it."
        )
    return float(np.sqrt(np.mean([channel_noise(t, y).sigma ** 2 for t, y in known])))
