"""A linear state space over scales, its free run and the derivatives of that run; in numpy.

    x[k+1] = A x[k] + B u[k]              x[0] = (I - A)^-1 B u[0] + x0:  settled at the first input, and x0
    w[k]   = C x[k] + D u[k] + e
    y[k]   = w[k]                         an output that settles
    y[k]   = y[0] + sum_(i<k) w[i]        one that integrates, exactly; over 1 <= i <= k where inputs act at once

Derivatives run through the eigenvectors of A: with A = V diag(l) V^-1 what x_j does through A_ij is a sum of filters of
first order of x_j, whatever i. Source: Ljung, System Identification (1999), section 4.3 and 10.1 (output error).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

STABLE = 1.0 - 1e-6  # the largest eigenvalue of A


@dataclass(frozen=True)
class Form:
    """Which outputs integrate; whether inputs act at once; delay of all inputs, in periods."""

    rates: tuple[bool, ...]
    direct: bool
    delay: int

    @property
    def fed(self) -> np.ndarray:
        """Which outputs have a D."""
        return np.array(self.rates) | self.direct


@dataclass(frozen=True, eq=False)
class StateSpace:
    """A (n, n), B (n, nu), C (ny, n), D (ny, nu), e (ny,) of a form."""

    form: Form
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    e: np.ndarray

    @property
    def order(self) -> int:
        """States of A."""
        return len(self.A)

    @property
    def stable(self) -> bool:
        """Whether every eigenvalue of A lies inside the unit circle."""
        return bool(np.isfinite(self.A).all()) and float(np.abs(np.linalg.eigvals(self.A)).max()) < STABLE

    @property
    def parameters(self) -> np.ndarray:
        """All that is fitted, in one vector."""
        return np.concatenate([self.A.ravel(), self.B.ravel(), self.C.ravel(), self.D[self.form.fed].ravel(), self.e])

    def with_parameters(self, values: np.ndarray) -> StateSpace:
        """The same form with other numbers."""
        (n, nu), ny, fed = self.B.shape, len(self.C), self.form.fed
        sizes = [n * n, n * nu, ny * n, int(fed.sum()) * nu]
        A, B, C, D_fed, e = np.split(values, np.cumsum(sizes))
        D = np.zeros((ny, nu))
        D[fed] = D_fed.reshape(-1, nu)
        return replace(self, A=A.reshape(n, n), B=B.reshape(n, nu), C=C.reshape(ny, n), D=D, e=e)

    def settled(self, u: np.ndarray) -> np.ndarray:
        """The state (n,) at held inputs (nu,)."""
        return np.linalg.solve(np.eye(self.order) - self.A, self.B @ u)

    def states(self, u: np.ndarray, x0: np.ndarray | None = None) -> np.ndarray:
        """(n_samples, n) from settled at the first input, and x0."""
        first = self.settled(u[0]) + (0 if x0 is None else x0)
        return scanned(self.A, np.vstack([first, u[:-1] @ self.B.T]))

    def run(self, u: np.ndarray, y_first: np.ndarray, x0: np.ndarray | None = None) -> np.ndarray:
        """Outputs (n_samples, ny) from inputs that are late already, (n_samples, nu)."""
        w = self.states(u, x0) @ self.C.T + u @ self.D.T + self.e
        return self.summed(w) + np.where(self.form.rates, y_first, 0.0)

    def summed(self, w: np.ndarray) -> np.ndarray:
        """From w (n_samples, ny, ...) to outputs, those that integrate from 0."""
        y = np.array(w)
        for j in np.flatnonzero(self.form.rates):
            steps = w[1:, j] if self.form.direct else w[:-1, j]
            y[0, j], y[1:, j] = 0.0, np.cumsum(steps, axis=0)
        return y

    def derivatives(self, u: np.ndarray, x0: np.ndarray | None, all_of_it: bool = True) -> np.ndarray:
        """(n_samples, ny, p) of outputs by `parameters` (without A and C unless ``all_of_it``), then by x0."""
        x, n, nu = self.states(u, x0), self.order, u.shape[1]
        moving = np.hstack([x, u]) if all_of_it else u
        before = np.concatenate([self.settled(u[0]), u[0]]) if all_of_it else u[0]
        through, starting = self._through(moving, before)
        ny, m = len(self.C), moving.shape[1]
        through = through.reshape(ny, n, len(u), m).transpose(2, 0, 1, 3)
        A = through[..., : m - nu].reshape(len(u), ny, -1)
        B = through[..., m - nu :].reshape(len(u), ny, -1)
        outputs = np.eye(ny)
        C = np.einsum("oq,kj->koqj", outputs, x).reshape(len(u), ny, -1)[..., : ny * n * all_of_it]
        D = np.einsum("oq,kj->koqj", outputs[:, self.form.fed], u).reshape(len(u), ny, -1)
        e = np.broadcast_to(outputs, (len(u), ny, ny))
        return self.summed(np.concatenate([A, B, C, D, e, starting], axis=2))

    def _through(self, moving: np.ndarray, before: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """C (q - A)^-1 e_i s for all i and signals s (n_samples, m), held at ``before`` until then; C A^k e_i."""
        from scipy.signal import lfilter

        values, V = np.linalg.eig(self.A)
        kept = values.imag >= 0
        weight = np.where(values.imag > 0, 2.0, 1.0)[kept]
        modes = (self.C @ V)[:, :, None] * np.linalg.inv(V)[None]  # (ny, modes, n)
        modes = modes[:, kept] * weight[:, None]
        filtered = np.empty((int(kept.sum()), *moving.shape), dtype=complex)
        for p, pole in enumerate(values[kept]):
            first = before / (1 - pole)
            filtered[p, 0] = first
            filtered[p, 1:] = lfilter([1.0], [1.0, -pole], moving[:-1], axis=0, zi=(pole * first)[None])[0]
        flat = modes.transpose(0, 2, 1).reshape(-1, int(kept.sum()))
        powers = values[kept] ** np.arange(len(moving))[:, None]
        starting = np.einsum("opi,kp->koi", modes, powers).real
        filtered = filtered.reshape(len(filtered), -1)
        return flat.real @ filtered.real - flat.imag @ filtered.imag, starting


def scanned(A: np.ndarray, v: np.ndarray) -> np.ndarray:
    """x[k] = A x[k-1] + v[k], (n_samples, n), in log2(n_samples) products."""
    x, shift, power = np.array(v), 1, A.T
    while shift < len(x) and np.abs(power).max() > 1e-18:
        x[shift:] = x[shift:] + x[:-shift] @ power
        shift, power = 2 * shift, power @ power
    return x
