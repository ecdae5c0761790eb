"""A job like a refit: a model, a recording, free parameters, a start; and jobs that fail."""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from hydrotwin.models.language.errors import SolveError
from hydrotwin.models.language.flat import FlatModel
from hydrotwin.records import Record
from hydrotwin.simulation import simulate


@dataclass(frozen=True, eq=False)
class Fitting:
    """Which parameters of which model to fit to which recording, and from where."""

    flat: FlatModel
    time: np.ndarray
    force: np.ndarray
    position: np.ndarray
    start: Mapping[str, float]


def fitted(job: Fitting) -> dict:
    """The fitted values, and what is left."""
    names = list(job.start)
    pushed = Record(job.time, {"force": job.force}, {"force": "N"}, "pushed")

    def left(values):
        run = simulate(job.flat, pushed, parameters=dict(zip(names, values, strict=True)))
        return 1e3 * (run["position"] - job.position)

    first = np.array(list(job.start.values()))
    found = least_squares(left, first, x_scale=first, max_nfev=12)
    return {"values": dict(zip(names, found.x.tolist(), strict=True)), "left": found.fun, "note": None}


def refused(job) -> None:
    """Fail on a negative number."""
    if job < 0:
        raise SolveError("job: diverged. Try another start.")
    return job


def slept(seconds: float) -> float:
    """Take a while."""
    time.sleep(seconds)
    return seconds


def died(job) -> None:
    """End the process it runs in."""
    os._exit(3)


def one_thread(name: str) -> str | None:
    """What a worker's environment says."""
    return os.environ.get(name)
