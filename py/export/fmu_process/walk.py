"""One free run of an FMU, whichever of its interfaces it goes through."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from fmpy.model_description import ModelDescription

from .exchange import Exchange, run_exchange
from .master import Slave, run_steps

WALKS = {"CoSimulation": (Slave, run_steps), "ModelExchange": (Exchange, run_exchange)}


def free_run(job: Mapping, time: np.ndarray, u: np.ndarray, description: ModelDescription, unzipped: str) -> np.ndarray:
    """Outputs (n, k) of a new instance at ``time`` under ``u`` (n, nu), in the FMU's own units."""
    kind, walk = WALKS[job["interface"]]
    instance = kind(description, unzipped)
    try:
        instance.initialise(time[0], None, job["starts"], dict(zip(job["inputs"], u[0], strict=True)))
        return walk(instance, time, u, job["inputs"], job["outputs"], job["linear"])
    finally:
        instance.close()
