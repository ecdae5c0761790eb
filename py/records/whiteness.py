"""Is what is left noise? Size against the noise, and a Ljung-Box test for colour.

    Q = n (n + 2) sum_{l=1}^{m} rho_l^2 / (n - l)   ~   chi-square with m degrees of freedom when white

Source: G. Ljung & G. Box, Biometrika 1978.
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtrc

LAGS = 20
SIGNIFICANCE = 1e-3


def ljung_box(residual: np.ndarray) -> tuple[float, float]:
    """Correlation of neighbours and p-value of "white" for ``residual`` (n,), mean and nan taken out."""
    r = residual[np.isfinite(residual)]
    n = len(r)
    if n < 4 * LAGS or not np.ptp(r) > 0:
        return 0.0, 1.0
    r = r - r.mean()
    energy = float(r @ r)
    rho = np.array([float(r[:-lag] @ r[lag:]) / energy for lag in range(1, LAGS + 1)])
    statistic = n * (n + 2) * float(np.sum(rho**2 / (n - np.arange(1, LAGS + 1))))
    return float(rho[0]), float(chdtrc(LAGS, statistic))
