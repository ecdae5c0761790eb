"""Run one FMU again and again: a job per line of standard input, the answer a line of standard output.

The job names its arrays' file in the folder named on the command line. What the FMU prints goes to standard error.
"""

from __future__ import annotations

import json
import os
import sys
import threading
import time
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description

from .__main__ import _model_exchange
from .master import Slave, run_steps

LOOK = 2.0  # s between looks at the parent


def main(folder: Path):
    """Answer jobs until standard input ends."""
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)
    description, unzipped = None, ""
    for line in sys.stdin:
        job = json.loads(line)
        try:
            if description is None:
                description = read_model_description(job["path"], validate=False)
                unzipped = extract(job["path"], unzipdir=str(folder / "fmu"))
            with np.load(folder / "input.npz", allow_pickle=False) as stored:
                found = _one_run(job, stored["time"], stored["u"], description, unzipped)
            np.save(folder / "output.npy", found, allow_pickle=False)
            answer = {"done": True}
        except Exception as failure:
            answer = {"done": False, "error": f"{type(failure).__name__}: {failure}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _end_with(parent: int):
    """Nobody waits for a run whose parent has gone, least of all for one that hangs."""
    while os.getppid() == parent:
        time.sleep(LOOK)
    os._exit(1)


def _one_run(job, times, u, description, unzipped) -> np.ndarray:
    """Outputs (n, k) of a run of a new instance."""
    if job["interface"] == "ModelExchange":
        return _model_exchange(job, times, u, description, unzipped)
    slave = Slave(description, unzipped)
    try:
        slave.initialise(times[0], None, job["starts"], dict(zip(job["inputs"], u[0], strict=True)))
        return run_steps(slave, times, u, job["inputs"], job["outputs"], job["linear"])
    finally:
        slave.close()


if __name__ == "__main__":
    main(Path(sys.argv[1]))
