"""Run one job on one FMU and leave the answer in the job's folder, named on the command line.

The job is ``job.json`` with arrays in ``input.npz``; the answer ``answer.json`` with arrays in ``output.npz``.
"""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description

from .master import Slave, run_steps
from .probing import Probing, run_probes
from .walk import free_run


def main(folder: Path):
    """Do the job in ``folder``."""
    job = json.loads((folder / "job.json").read_text(encoding="utf-8"))
    with np.load(folder / "input.npz", allow_pickle=False) as stored:
        arrays = dict(stored)
    description = read_model_description(job["path"], validate=False)
    unzipped = extract(job["path"], unzipdir=str(folder / "fmu"))
    found = {"run": _run, "restart": _restart, "probe": _probe}[job["task"]](job, arrays, description, unzipped, folder)
    np.savez(folder / "output.npz", **found)
    (folder / "answer.json").write_text(json.dumps({"done": True}), encoding="utf-8")


def _run(job, arrays, description, unzipped, folder) -> dict[str, np.ndarray]:
    return {"y": free_run(job, arrays["time"], arrays["u"], description, unzipped)}


def _restart(job, arrays, description, unzipped, folder) -> dict[str, np.ndarray]:
    """One step from every sample: states from a free run, those that were measured replaced by it."""
    time, u, measured = arrays["time"], arrays["u"], arrays["measured"]
    slave = Slave(description, unzipped)
    slave.initialise(time[0], None, job["starts"], dict(zip(job["inputs"], u[0], strict=True)))
    wanted = [*job["outputs"], *job["states"]]
    free = run_steps(slave, time, u, job["inputs"], wanted, job["linear"])
    found = free[:, : len(job["outputs"])].copy()
    starts = [f"{s.removeprefix('state.')}.start" for s in job["states"]]
    for k in range(len(time) - 1):
        values = dict(zip(starts, free[k, len(job["outputs"]) :], strict=True))
        seen = zip(job["measured_starts"], measured[k], strict=True)
        values |= {name: value for name, value in seen if np.isfinite(value)}
        slave.fmu.reset()
        slave.initialise(time[k], None, {**job["starts"], **values}, dict(zip(job["inputs"], u[k], strict=True)))
        found[k + 1] = run_steps(slave, time[k : k + 2], u[k : k + 2], job["inputs"], job["outputs"], job["linear"])[1]
    return {"y": found}


def _probe(job, arrays, description, unzipped, folder) -> dict[str, np.ndarray]:
    run_probes(job["plan"], set(job["spoilt"]), Probing(description, unzipped, job["path"]), folder / "rows.jsonl")
    return {}


def end_with_parent():
    """Wait for the pipe from the parent to close, and end then, with everything that was started here."""
    while os.read(0, 1024):  # not sys.stdin: a thread that holds it aborts the interpreter's end
        pass
    if os.name == "posix":
        os.killpg(0, signal.SIGKILL)
    os._exit(1)


if __name__ == "__main__":
    threading.Thread(target=end_with_parent, daemon=True).start()
    try:
        main(Path(sys.argv[1]))
    except Exception as failure:
        answer = {"done": False, "error": f"{type(failure).__name__}: {failure}"}
        (Path(sys.argv[1]) / "answer.json").write_text(json.dumps(answer), encoding="utf-8")
