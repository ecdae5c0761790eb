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

from .walk import free_run

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
                found = free_run(job, stored["time"], stored["u"], description, unzipped)
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


if __name__ == "__main__":
    main(Path(sys.argv[1]))
