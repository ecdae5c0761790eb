"""The band of an output that integrates a Gaussian process of delayed inputs; CasADi and numpy.

    y[k+1] = y[k] + T f(z[k]),   f = mean + sum_r a_r g_r(z),   a_r ~ N(0, 1)
    q_r[k+1] = q_r[k] + T g_r(z[k])                    what y would move by if a_r were 1
    sd     = scale sqrt(|q|^2 + noise)

The directions g_r are those of the posterior that the training recordings show most. A model error is the same function
at every step: the sum over steps is taken before the square, so that what cancels cancels and what does not adds up.
Where the process is less certain than anywhere in training, what is more is a direction of its own.
Where a measured value is put in place of the state, q begins anew and the noise is that of one step.
"""

from __future__ import annotations

from collections.abc import Sequence

import casadi as ca
import numpy as np

from hydrotwin.models.language.flat import Signal, StateVariable

DIRECTIONS = 16  # of a process, at most; what they leave of the variance of training runs is put on them
ENOUGH = 0.999  # of the variance of training runs: no further direction is taken
HELD = 3  # states of an integrated output beside its directions: itself, what was expected, share of one step
LEAST = 1e-30  # under the root: keeps its derivative finite


def leading(root: np.ndarray, JJ: np.ndarray, most: int = DIRECTIONS) -> tuple[np.ndarray, float]:
    """Directions (P, R) of weights with covariance root root' that runs with J'J = JJ (P, P) show most; their share.

    They are enlarged by what those left out would have added on average.
    """
    shown, turned = np.linalg.eigh(root.T @ JJ @ root)
    shown, turned = np.maximum(shown[::-1], 0.0), turned[:, ::-1]
    share = np.cumsum(shown) / max(shown.sum(), 1e-300)
    count = min(int(np.searchsorted(share, ENOUGH)) + 1, most, len(shown))
    return root @ turned[:, :count] / np.sqrt(max(share[count - 1], 1e-12)), float(share[count - 1])


def band_states(output: Signal, directions: int) -> tuple[StateVariable, ...]:
    """The states beside the output: its prediction, whether that was one step, and the effect of every direction."""
    effects = [
        StateVariable(
            f"{output.name}.by_{r}", output.unit, f"effect of direction {r} of the model error", output.nominal
        )
        for r in range(1, directions + 1)
    ]
    return (
        StateVariable(f"{output.name}.expected", output.unit, "what the step before predicted", output.nominal),
        StateVariable(f"{output.name}.noise", "1", "share of one step in the noise: 1 after a measurement"),
        *effects,
    )


def advanced(y, y_next, held, effect):
    """The states after a step, [expected, share of one step, q], from ``held`` (2 + R, 1) and ``effect`` (R, 1)."""
    known = y != held[0]
    return ca.vertcat(y_next, known, ca.if_else(known, 0.0, 1.0) * held[2:, :] + effect)


def beyond(variance, inside: float):
    """The effect of leaving the training data: the root of the variance over the largest of the training rows."""
    return ca.sqrt(ca.fmax(variance - inside, LEAST))


def deviation(held, run, one):
    """Standard deviation of the measured value; run, one: (noise, scale) of a free run and of one step, numbers."""
    model, share = ca.sumsqr(held[2:, :]), held[1]
    parts = [scale**2 * (model + noise**2) for noise, scale in (run, one)]
    return ca.sqrt(ca.if_else(share > 0.5, parts[1], parts[0]) + LEAST)


def run_noise(runs: Sequence[np.ndarray], measured: Sequence[np.ndarray]) -> float:
    """RMS of what free runs over the training recordings leave of one output."""
    miss = np.concatenate([a - b for a, b in zip(runs, measured, strict=True)])
    return float(np.sqrt(np.mean(miss[np.isfinite(miss)] ** 2)))
