"""Do the commands of what was held out repeat commands that were trained on?

    d(k) = sum_i |u_held[i] - u[k + i]|^2 / sum_i |u_held[i] - mean u_held|^2,    least over all places k of training

On a periodic recording every part is like every other: a block that has learnt one period by heart is as good on the
next, and what was held out tells nothing of other commands.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .held_out import Split

SAME = 0.05  # of the variance of a part's inputs: what is nearer to training is no other command. EMPS, four periods of
# one motion, is at 1e-4; recordings of the tanks, the bench, the C-EHA and the valve are at 0.4 and above


def repeats(split: Split, inputs: Sequence[str]) -> bool:
    """Whether every part held out repeats the inputs of some stretch that was trained on."""
    names = [n for n in inputs if any(np.ptp(r[n]) > 0 for r in split.fit)]
    if not names or not split.parts:
        return False
    trained = [r.array(names) for r in split.fit]
    centre, spread = (of(np.concatenate(trained), axis=0) for of in (np.mean, np.std))
    trained = [(u - centre) / spread for u in trained]
    return all(_apart((r.array(names) - centre) / spread, trained) < SAME for r in split.held_out)


def _apart(held: np.ndarray, trained: Sequence[np.ndarray]) -> float:
    """The least d(k) over the stretches of ``trained`` (n, nu); infinite where none is long enough or nothing moves."""
    from scipy.signal import fftconvolve  # takes most of a second, and most blocks are not learnt here

    m, moved = len(held), float(((held - held.mean(axis=0)) ** 2).sum())
    found = [np.inf]
    for u in (u for u in trained if len(u) >= m and moved > 0):
        both = sum(fftconvolve(u[:, j], held[::-1, j], "valid") for j in range(u.shape[1]))
        own = np.cumsum(np.concatenate([[0.0], (u**2).sum(axis=1)]))
        found.append(float((own[m:] - own[:-m] + (held**2).sum() - 2 * both).min()) / moved)
    return min(found)
