"""How far a prediction is from a measurement: the metrics of every table and figure of a comparison."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DataError


@dataclass(frozen=True)
class Errors:
    """Metrics of one error signal e = predicted - measured, in the unit of the signal.

    rmse        sqrt(mean(e^2))
    mae         mean(|e|).  This is Eq. 18 of the C-EHA paper, which calls it RMSE: its root is taken of each e_i^2
                before the sum, so Table 2 of that paper lists mean absolute errors.
    maximum     max(|e|)
    fit_percent 100 (1 - ||e|| / ||y - mean(y)||), the NRMSE fit; NaN for a measurement that does not move
    bias        mean(e)
    deviation   standard deviation of e
    lowest, highest  range of e
    samples     number of samples where both signals are finite
    """

    rmse: float
    mae: float
    maximum: float
    fit_percent: float
    bias: float
    deviation: float
    lowest: float
    highest: float
    samples: int


def errors_of(measured: np.ndarray, predicted: np.ndarray) -> Errors:
    """Metrics of ``predicted`` against ``measured``, both (n,). Samples where the measurement is NaN are left out.

    >>> errors_of(np.array([0.0, 2.0, 4.0]), np.array([0.0, 2.0, 1.0])).maximum
    3.0

    Raises DataError when nothing was measured, or when the prediction is not finite where something was, or so far off
    that no number holds its square.
    """
    measured, predicted = np.asarray(measured, float), np.asarray(predicted, float)
    known = np.isfinite(measured)
    if not known.any():
        raise DataError("the recording holds no finite sample. Leave this output out, or repair the column.")
    if not np.isfinite(predicted[known]).all():
        first = int(np.flatnonzero(known & ~np.isfinite(predicted))[0])
        raise DataError(
            f"the prediction is not finite (got {predicted[first]} at sample {first} of {len(predicted)}). "
            "It must be finite wherever something was measured. Try a smaller step or other start values."
        )
    y, e = measured[known], predicted[known] - measured[known]
    swing = float(np.linalg.norm(y - y.mean()))
    with np.errstate(over="ignore"):
        mean_square = float(np.mean(e**2))
    if not np.isfinite(mean_square):
        raise DataError(
            f"the errors are beyond numbers (got up to {np.abs(e).max():.3g}). Check the unit of the column, and "
            "whether the model diverges."
        )
    return Errors(
        rmse=float(np.sqrt(mean_square)),
        mae=float(np.mean(np.abs(e))),
        maximum=float(np.max(np.abs(e))),
        fit_percent=100.0 * (1.0 - float(np.linalg.norm(e)) / swing) if np.ptp(y) > 0.0 else float("nan"),
        bias=float(e.mean()),
        deviation=float(e.std()),
        lowest=float(e.min()),
        highest=float(e.max()),
        samples=int(known.sum()),
    )
