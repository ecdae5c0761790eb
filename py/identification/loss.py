"""Loss: what a residual costs, in units of the noise.

    linear    rho(s) = s                    s = (r/c)^2
    soft_l1   rho(s) = 2 (sqrt(1 + s) - 1)
    huber     rho(s) = s for s <= 1, 2 sqrt(s) - 1 beyond

cost = c^2/2 sum rho. Source: B. Triggs et al., Bundle Adjustment, 2000 (also scipy.optimize.least_squares).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest

LOSSES = ("linear", "soft_l1", "huber")


@dataclass(frozen=True)
class Loss:
    """A loss and the size c (in noise sigmas) from which on a residual counts less."""

    kind: str = "linear"
    scale: float = 2.0

    def __post_init__(self):
        if self.kind not in LOSSES:
            raise DeclarationError(f"identify: no loss '{self.kind}'. {nearest(self.kind, LOSSES)}")
        if not self.scale > 0:
            raise DeclarationError(f"identify: the loss scale must be positive (got {self.scale}). 2 is usual.")

    def cost(self, r: np.ndarray) -> float:
        """Cost of residuals r (m,) in sigmas."""
        if self.kind == "linear":
            return 0.5 * float(r @ r)
        return 0.5 * self.scale**2 * float(self._rho((r / self.scale) ** 2)[0].sum())

    def linearised(self, r: np.ndarray, J: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residuals and Jacobian whose plain J^T r and J^T J are gradient and Gauss-Newton Hessian of the cost."""
        if self.kind == "linear":
            return r, J
        s = (r / self.scale) ** 2
        _, first, second = self._rho(s)
        curvature = np.sqrt(np.maximum(first + 2 * second * s, 1e-3 * first))
        return r * first / curvature, J * curvature[:, None]

    def _rho(self, s: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        if self.kind == "soft_l1":
            t = 1 + s
            return 2 * (np.sqrt(t) - 1), t**-0.5, -0.5 * t**-1.5
        beyond = s > 1
        safe = np.where(beyond, s, 1.0)
        return (
            np.where(beyond, 2 * np.sqrt(safe) - 1, s),
            np.where(beyond, safe**-0.5, 1.0),
            np.where(beyond, -0.5 * safe**-1.5, 0.0),
        )
