"""Trials: a fit under another assumption, and whether it explains most of what the first left beyond the noise."""

from __future__ import annotations

import numpy as np

from .descent import Task, descend, whole_runs
from .horizon import horizons
from .least_squares import Minimum, minimise
from .weighing import Weighed, broadly_weighed, misses, weighed_by_residual

FAR_MORE = 0.9  # of what is left beyond the noise: what another input between samples must explain
MOST_OF_IT = 0.5  # the same of free starts and loads, which are nothing that an effect would be taken for
AT_NOISE = 1.25  # times the noise: what a shift of an input, or all at once, must come down to
MOST = 25  # iterations of a trial
NEAR = 0.3  # samples between what is wanted and what is tried


def fitted(task: Task, found: Minimum, adaptable: np.ndarray) -> Weighed:
    """A fit from where another ended, under weights that suit it."""
    reached = minimise(whole_runs(task)[0], found.q, found.z, most=MOST, relative=1e-3)
    return weighed_by_residual(task, reached, adaptable, MOST)


def fitted_anew(task: Task, adaptable: np.ndarray) -> Weighed:
    """The same from the start of the task, as a search begins: for recordings that the first fit did not have."""
    broad, q = broadly_weighed(task, adaptable), task.free.scaled(task.free.start)
    lengths = horizons(task.flat, task.recordings, task.free.vector(q))
    reached = descend(broad, q, lengths, MOST, relative=1e-3, thorough=False)
    return weighed_by_residual(task, reached, adaptable, MOST)


def explains_most(before: Weighed, after: Weighed, share: float, at_noise: bool = False) -> bool:
    """Whether a trial leaves less than all but ``share`` of the rest, in no recording more, and only noise if asked."""
    was, now = (_beyond_noise(w) for w in (before, after))
    closed = 1 - now.sum() / was.sum()
    if closed < share or np.any(now > np.maximum(was, 0.1 * was.max())):
        return False
    return not at_noise or bool(np.all(misses(after.task, after.minimum) < AT_NOISE))


def _beyond_noise(w: Weighed) -> np.ndarray:
    """What is left of every recording beyond the noise, in units of it, squared. (recordings,)"""
    shooting, _ = whole_runs(w.task)
    left = []
    for i in range(len(w.task.recordings)):
        r = shooting.residuals(i, w.minimum.q, w.minimum.z[i])
        used = w.task.weights > 0
        with np.errstate(invalid="ignore"):
            r = r[:, used] / (w.task.weights[used] * w.task.noise[used])
        seen = np.isfinite(r)
        left.append(max(float((r[seen] ** 2).sum() - seen.sum()), 0.0))
    return np.array(left) + 1e-300
