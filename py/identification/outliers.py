"""Samples that are no measurement: a few that stand alone, far from what all others say.

Squares follow such samples wherever they lead. They are looked for when a fit leaves more than noise, from a fit under
a robust loss, which follows the others; the fit without them is taken only if it leaves nothing but noise.
Source: P. Huber & E. Ronchetti, Robust Statistics, 2009, ch. 7; F. Hampel, J. Amer. Stat. Assoc. 1974 (the MAD).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from hydrotwin.models.language.errors import SolveError

from .answer import explains
from .descent import Task, undecided, whole_runs
from .fit import Finding
from .least_squares import Minimum, minimise
from .loss import Loss
from .noise import weights
from .search import Effort, search
from .weighing import runs_of

SUSPECT, FAR = 5.0, 8.0  # sigmas, as the median of what is left tells them: worth a second fit, and left out
TO_SIGMA = 1.4826  # the median of normal absolute values
MOST = 0.1  # of the samples of an output
ALONE = 5  # samples: what lasts longer is motion
NEARLY_ALL = 0.9  # of the squares of an output
ROBUST = Loss("soft_l1")
SHOWN = 3  # times that a sentence names


def spared(
    task: Task, minima: list[Minimum], effort: Effort, adaptable: np.ndarray
) -> tuple[Task, list[Minimum], list[Finding]]:
    """The search without samples that stand alone, where that explains the rest; as it was otherwise. And what is said.

    ``effort``, ``adaptable`` : as in `search`.
    """
    if explains(task, minima[0]) or not any(m.any() for m in outlying(task, minima[0], SUSPECT)):
        return task, minima, []
    plain = dataclasses.replace(task, weights=weights(task.noise))
    try:
        robust = dataclasses.replace(plain, loss=ROBUST)
        led = minimise(whole_runs(undecided(robust))[0], minima[0].q, minima[0].z, most=effort.iterations)
        masks = outlying(robust, led, FAR)
        if not any(m.any() for m in masks):
            return task, minima, []
        again, found = search(without(plain, masks), effort, adaptable)
    except SolveError:
        return task, minima, []
    if explains(again, found[0]):
        return again, found, told(task, masks, left_out=True)
    return task, minima, told(task, _ruling(robust, led, masks), left_out=False)


def _ruling(task: Task, found: Minimum, masks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Those samples that make nearly all of what is left of their output in a recording."""
    ruling = []
    for mask, run in zip(masks, runs_of(task, found), strict=True):
        squares = np.nan_to_num(np.square(run)) if run is not None else np.zeros(mask.shape)
        ruling.append(mask & ((squares * mask).sum(axis=0) > NEARLY_ALL * squares.sum(axis=0)))
    return ruling


def outlying(task: Task, found: Minimum, far: float) -> list[np.ndarray]:
    """Per recording, samples (n, ny) ``far`` from what the others leave, where they are few and alone."""
    masks = []
    for recording, run in zip(task.recordings, runs_of(task, found), strict=True):
        mask = np.zeros(recording.y.shape, dtype=bool)
        for j in np.flatnonzero((task.weights > 0) & (run is not None)):
            mask[:, j] = _alone(run[:, j], far, task.noise[j] * task.weights[j])
        masks.append(mask)
    return masks


def _alone(left: np.ndarray, far: float, noise: float) -> np.ndarray:
    """Which residuals (n,) are far from the others, or none where they are many or stand together."""
    known = np.isfinite(left)
    sigma = max(TO_SIGMA * float(np.median(np.abs(left[known]))), noise) if known.any() else np.inf
    away = np.abs(np.where(known, left, 0.0)) > far * sigma
    edges = np.flatnonzero(np.diff(np.concatenate([[False], away, [False]]).astype(int)))
    longest = np.max(edges[1::2] - edges[::2], initial=0)
    return away & (longest <= ALONE) & (away.sum() <= MOST * known.sum())


def without(task: Task, masks: Sequence[np.ndarray]) -> Task:
    """The task as if those samples had not been measured."""
    pairs = zip(task.recordings, masks, strict=True)
    cleaned = tuple(dataclasses.replace(r, y=np.where(m, np.nan, r.y)) for r, m in pairs)
    return dataclasses.replace(task, recordings=cleaned)


def told(task: Task, masks: Sequence[np.ndarray], left_out: bool) -> list[Finding]:
    """One sentence per output with such samples: how many, where, and what became of them."""
    findings = []
    for j, signal in enumerate(task.flat.outputs):
        where = [(r, np.flatnonzero(m[:, j])) for r, m in zip(task.recordings, masks, strict=True) if m[:, j].any()]
        if not where:
            continue
        places = ", ".join(f"{len(k)} in {r.name} (at {_times(r.time[k])} from its start)" for r, k in where)
        became = (
            "They were left out: without them nothing but noise is left. Look at the sensor; loss='linear' keeps them."
            if left_out
            else "They rule the squares. Put nan where nothing was measured, or take loss='soft_l1'."
        )
        findings.append(Finding("outliers", (), (
            f"identify: samples of {signal.name} stand alone, far from all others: {places}. {became}"
        )))  # fmt: skip
    return findings


def _times(times: np.ndarray) -> str:
    return ", ".join(f"{t:.6g} s" for t in times[:SHOWN]) + (", ..." if len(times) > SHOWN else "")
