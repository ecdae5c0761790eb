"""Samples that are no measurement: a few that stand alone, far from what all others say.

Squares follow such samples wherever they lead. They are looked for when a fit leaves more than noise, from a fit under
a robust loss, which follows the others; the fit without them is taken only if it leaves nothing but noise.
Source: P. Huber & E. Ronchetti, Robust Statistics, 2009, ch. 7; F. Hampel, J. Amer. Stat. Assoc. 1974 (the MAD).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.ndimage import median_filter

from hydrotwin.models.language.errors import SolveError

from .answer import explains
from .descent import Task, held_out_run, undecided, whole_runs
from .fit import Finding
from .least_squares import Minimum, minimise
from .loss import Loss
from .noise import weights
from .problem import Recording
from .search import Effort, search
from .weighing import runs_of

SUSPECT, FAR = 5.0, 8.0  # sigmas, as the median of what is left tells them: worth a second fit, and left out
TO_SIGMA = 1.4826  # the median of normal absolute values
MOST = 0.1  # of the samples of an output
ALONE = 5  # samples: what lasts longer is motion
NEARLY_ALL = 0.9  # of the squares of an output
AT_NOISE = 1.25  # times the noise: what an output may leave in a recording that took no part
ROBUST = Loss("soft_l1")
SHOWN = 3  # times, and recordings, that a sentence names


@dataclass(frozen=True)
class Strays:
    """Samples that stand alone.

    masks : (n, ny) by name of the recording. left_out : the answer is one without them. sentences : one per output.
    """

    masks: Mapping[str, np.ndarray] = field(default_factory=dict)
    left_out: bool = False
    sentences: tuple[str, ...] = ()

    def findings(self) -> list[Finding]:
        """What `identify` says of them, and the argument for whoever wants it otherwise."""
        otherwise = "With loss='linear' they stay" if self.left_out else "Or take loss='soft_l1'"
        return [Finding("outliers", (), f"identify: {s} {otherwise}.") for s in self.sentences]


def spared(
    task: Task,
    minima: list[Minimum],
    effort: Effort,
    adaptable: np.ndarray,
    enough: Callable[[Task, Minimum], bool] = explains,
) -> tuple[Task, list[Minimum], Strays]:
    """The search without samples that stand alone, where that explains the rest, else as it was; and those samples.

    ``effort``, ``adaptable`` : as in `search`. enough : whether a minimum leaves nothing but noise.
    """
    if enough(task, minima[0]) or not any(m.any() for m in outlying(task, minima[0], SUSPECT)):
        return task, minima, Strays()
    plain = dataclasses.replace(task, weights=weights(task.noise))
    try:
        robust = dataclasses.replace(plain, loss=ROBUST)
        led = minimise(whole_runs(undecided(robust))[0], minima[0].q, minima[0].z, most=effort.iterations)
        masks = outlying(robust, led, FAR)
        if not any(m.any() for m in masks):
            return task, minima, Strays()
        again, found = search(without(plain, masks), effort, adaptable)
    except SolveError:
        return task, minima, Strays()
    if enough(again, found[0]):
        return again, found, strays(task, masks, left_out=True)
    return task, minima, strays(task, _ruling(robust, led, masks), left_out=False)


def with_others(task: Task, found: Minimum, known: Strays, recordings: Sequence[Recording]) -> Strays:
    """Samples that stand alone: those known, and in recordings that took no part, where the rest is at the noise."""
    robust, masks = dataclasses.replace(task, loss=ROBUST), [known.masks.get(r.name) for r in task.recordings]
    masks = [np.zeros(r.y.shape, bool) if m is None else m for r, m in zip(task.recordings, masks, strict=True)]
    for recording in recordings:
        mask = alone(task, recording, _held_out(robust, found, recording), FAR)
        if mask.any():
            left = _held_out(task, found, _unmeasured(recording, mask))
            mask &= (left is not None) and _size(left) < AT_NOISE * task.noise * task.weights
        masks.append(mask)
    return strays(dataclasses.replace(task, recordings=(*task.recordings, *recordings)), masks, left_out=True)


def _held_out(task: Task, found: Minimum, recording: Recording) -> np.ndarray | None:
    shooting, z = held_out_run(task, found.q, recording)
    return shooting.residuals(0, found.q, z[0])


def _size(left: np.ndarray) -> np.ndarray:
    """Root mean square (ny,) of residuals; 0 where nothing is known."""
    return np.sqrt(np.ma.masked_invalid(left**2).mean(axis=0)).filled(0.0)


def _ruling(task: Task, found: Minimum, masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Those samples that make nearly all of what is left of their output in a recording."""
    ruling = []
    for mask, run in zip(masks, runs_of(task, found), strict=True):
        squares = np.nan_to_num(np.square(run)) if run is not None else np.zeros(mask.shape)
        ruling.append(mask & ((squares * mask).sum(axis=0) > NEARLY_ALL * squares.sum(axis=0)))
    return ruling


def outlying(task: Task, found: Minimum, far: float) -> list[np.ndarray]:
    """Per recording, samples (n, ny) ``far`` from what the others leave, where they are few and alone."""
    pairs = zip(task.recordings, runs_of(task, found), strict=True)
    return [alone(task, recording, run, far) for recording, run in pairs]


def alone(task: Task, recording: Recording, run: np.ndarray | None, far: float) -> np.ndarray:
    """The same of one recording and its weighted residuals (n, ny), None where it diverged."""
    mask = np.zeros(recording.y.shape, dtype=bool)
    for j in np.flatnonzero((task.weights > 0) & (run is not None)):
        mask[:, j] = _alone(run[:, j], far, task.noise[j] * task.weights[j])
    return mask


def _alone(left: np.ndarray, far: float, noise: float) -> np.ndarray:
    """Which residuals (n,) are far from the others, or none where they are many or stand together."""
    known = np.isfinite(left)
    sigma = max(TO_SIGMA * float(np.median(np.abs(left[known]))), noise) if known.any() else np.inf
    away = np.abs(np.where(known, left, 0.0)) > far * sigma
    edges = np.flatnonzero(np.diff(np.concatenate([[False], away, [False]]).astype(int)))
    longest = np.max(edges[1::2] - edges[::2], initial=0)
    return away & (longest <= ALONE) & (away.sum() <= MOST * known.sum())


def spikes(column: np.ndarray) -> np.ndarray:
    """Which samples (n,) of a signal that moves stand alone: many of its steps from the median of their neighbours."""
    step = TO_SIGMA * float(np.median(np.abs(np.diff(column)))) if len(column) > 1 else 0.0
    return _alone(column - median_filter(column, 2 * ALONE + 1, mode="nearest"), FAR, step)


def without(task: Task, masks: Sequence[np.ndarray]) -> Task:
    """The task as if those samples had not been measured."""
    pairs = zip(task.recordings, masks, strict=True)
    return dataclasses.replace(task, recordings=tuple(_unmeasured(r, m) for r, m in pairs))


def _unmeasured(recording: Recording, mask: np.ndarray) -> Recording:
    return dataclasses.replace(recording, y=np.where(mask, np.nan, recording.y))


def strays(task: Task, masks: Sequence[np.ndarray], left_out: bool) -> Strays:
    """These samples of the recordings of a task, how many, where, and what became of them in a sentence per output."""
    sentences = []
    for j, signal in enumerate(task.flat.outputs):
        where = [(r, np.flatnonzero(m[:, j])) for r, m in zip(task.recordings, masks, strict=True) if m[:, j].any()]
        if not where:
            continue
        shown = [f"{len(k)} in {r.name} (at {_times(r.time[k])} from its start)" for r, k in where[:SHOWN]]
        rest = sum(len(k) for _, k in where[SHOWN:])
        places = ", ".join([*shown, f"and {rest} in {len(where) - SHOWN} more"] if rest else shown)
        became = (
            "They were left out: without them nothing but noise is left. Look at the sensor."
            if left_out
            else "They rule the squares. Put nan where nothing was measured."
        )
        sentences.append(f"samples of {signal.name} stand alone, far from all others: {places}. {became}")
    named = zip((r.name for r in task.recordings), masks, strict=True)
    masks = {n: m for n, m in named if m.any()}
    return Strays(masks, left_out and bool(masks), tuple(sentences))


def _times(times: np.ndarray) -> str:
    return ", ".join(f"{t:.6g} s" for t in times[:SHOWN]) + (", ..." if len(times) > SHOWN else "")
