"""The weight of each output: one over its noise, estimated from the recordings or given."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.models.language.errors import DataError, DeclarationError, nearest
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records.noise import channel_noise

from .problem import Recording

SMALLEST_FRACTION = 1e-6  # of the spread: an exact simulation has no noise, but its integrator has errors


def output_noise(
    flat: FlatModel, measured: Sequence[Recording], given: Mapping[str, float] | None = None
) -> np.ndarray:
    """Noise of every output over all recordings, shape (ny,), SI; nan where nothing was measured.

    Values in ``given`` win. The estimate is the quadratic mean over the recordings.
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
    return np.array(
        [given.get(name, _estimated(name, column)) if column else np.nan
         for name, column in zip(names, columns, strict=True)]
    )  # fmt: skip


def weights(noise: np.ndarray) -> np.ndarray:
    """One over the noise, 0 for outputs nowhere measured. Shape (ny,)."""
    return np.where(np.isfinite(noise), 1.0 / np.where(np.isfinite(noise), noise, 1.0), 0.0)


def _estimated(name: str, columns: Sequence[tuple[np.ndarray, np.ndarray]]) -> float:
    known = [(time[np.isfinite(y)], y[np.isfinite(y)]) for time, y in columns]
    spread = float(np.std(np.concatenate([y for _, y in known])))
    if spread == 0.0:
        raise DataError(
            f"identify: output '{name}' is constant in every recording (got {known[0][1][0]:g}). A constant does not "
            f"show its own noise. Give noise={{'{name}': ...}}, or name the outputs to fit without it."
        )
    return max(float(np.sqrt(np.mean([channel_noise(t, y).sigma ** 2 for t, y in known]))), SMALLEST_FRACTION * spread)
