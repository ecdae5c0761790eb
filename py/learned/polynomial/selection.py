"""Terms of a linear regression selected one after the other by what each explains beside those before it (FROLS).

Every column is made orthogonal to the ones chosen; the next is the one with the largest error reduction ratio

    ERR = (w't)^2 / (w'w t't)          w: the orthogonal rest of a column, t: the target

How many are worth it, one step ahead, the criteria of Akaike and Schwarz tell: n log(rss / n) + 2 k, and + k log n.
It works on the triangular factor of the columns, so that a step costs columns^2 whatever the number of rows.
Source: Chen, Billings, Luo, Int. J. Control 50 (1989) 1873-1896; Billings, Nonlinear System Identification (2013),
chapter 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

GONE = 1e-12  # of a column's own square: what is left of one that the chosen ones explain
EXPLAINED = 1e-14  # of the target's square: less is rounding


@dataclass(frozen=True)
class Selected:
    """Columns in the order of their choice; by number of terms, ERR, AIC and BIC of n rows.

    factors : least squares of the target on the first columns, one array for every number of them.
    """

    columns: list[int]
    ratios: list[float]
    aic: list[float]
    bic: list[float]
    factors: list[np.ndarray]

    @property
    def by_bic(self) -> int:
        """The number of terms with the least BIC."""
        return int(np.argmin(self.bic)) + 1 if self.bic else 0


def select(A: np.ndarray, target: np.ndarray, most: int) -> Selected:
    """At most ``most`` columns of A (n, m) for a target (n,), by ERR."""
    n = len(A)
    R = np.linalg.qr(np.column_stack([A, target]), mode="r")
    own, t = R[:, :-1].copy(), R[:, -1].copy()
    W, rest = own.copy(), t.copy()
    first, power = np.einsum("ij,ij->j", W, W), float(t @ t)
    found = Selected([], [], [], [], [])
    while len(found.columns) < min(most, A.shape[1]):
        square = np.einsum("ij,ij->j", W, W)
        free = square > GONE * np.maximum(first, 1e-300)
        free[found.columns] = False
        if not free.any() or rest @ rest <= EXPLAINED * power:
            break
        ratio = np.where(free, (W.T @ rest) ** 2 / np.where(free, square, 1.0), -1.0) / max(power, 1e-300)
        j = int(np.argmax(ratio))
        q = W[:, j] / np.sqrt(square[j])
        rest -= q * (q @ rest)
        W -= np.outer(q, q @ W)
        found.columns.append(j)
        found.ratios.append(float(ratio[j]))
        k, left = len(found.columns), n * np.log(max(float(rest @ rest), 1e-300) / n)
        found.aic.append(float(left + 2 * k))
        found.bic.append(float(left + k * np.log(n)))
        found.factors.append(np.linalg.lstsq(own[:, found.columns], t, rcond=None)[0])
    return found
