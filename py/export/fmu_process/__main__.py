"""Run one job on one FMU and leave the answer in the job's folder, named on the command line.

The job is ``job.json`` with arrays in ``input.npz``; the answer ``answer.json`` with arrays in ``output.npz``.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description, simulate_fmu

from .exchange_probes import EXCHANGE_PROBES
from .gates import gates_for
from .master import Slave, run_steps
from .probes import PROBES, run_probes

PIECES = 8  # of a sample: FMPy's CVODES gives up after 500 steps from output to output, and what sticks takes more


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
    time, u = arrays["time"], arrays["u"]
    if job["interface"] == "ModelExchange":
        return {"y": _model_exchange(job, time, u, description, unzipped)}
    slave = Slave(description, unzipped)
    slave.initialise(time[0], None, job["starts"], dict(zip(job["inputs"], u[0], strict=True)))
    return {"y": run_steps(slave, time, u, job["inputs"], job["outputs"], job["linear"])}


def _model_exchange(job, time, u, description, unzipped) -> np.ndarray:
    """FMPy's CVODES; held inputs become steps by a doubled sample."""
    n, held = len(time), [name not in job["linear"] for name in job["inputs"]]
    doubled = np.repeat(np.arange(n), 2)[:-1] if any(held) else np.arange(n)
    at = time[np.minimum((np.arange(2 * n - 1) + 1) // 2, n - 1)] if any(held) else time
    values = u[doubled].copy()
    for j, hold in enumerate(held):
        if any(held) and not hold:
            values[:, j] = np.interp(at, time, u[:, j])
    kinds = [(name, np.float64) for name in job["inputs"]]
    signals = np.array([(t, *v) for t, v in zip(at, values, strict=True)], dtype=[("time", np.float64), *kinds])
    result = simulate_fmu(
        unzipped, validate=False, fmi_type="ModelExchange", model_description=description, start_time=time[0],
        stop_time=time[-1], output_interval=float(np.median(np.diff(time))) / PIECES, start_values=job["starts"],
        input=signals if job["inputs"] else None, output=job["outputs"], relative_tolerance=1e-11,
    )  # fmt: skip
    return np.column_stack([np.interp(time, result["time"], result[name]) for name in job["outputs"]])


def _restart(job, arrays, description, unzipped, folder) -> dict[str, np.ndarray]:
    """One step from every sample: states from a free run, the measured ones replaced by the measurement."""
    time, u, measured = arrays["time"], arrays["u"], arrays["measured"]
    slave = Slave(description, unzipped)
    first = dict(zip(job["inputs"], u[0], strict=True))
    slave.initialise(time[0], None, job["starts"], first)
    wanted = [*job["outputs"], *job["states"]]
    free = run_steps(slave, time, u, job["inputs"], wanted, job["linear"])
    found = free[:, : len(job["outputs"])].copy()
    starts = [f"{s.removeprefix('state.')}.start" for s in job["states"]]
    for k in range(len(time) - 1):
        values = dict(zip(starts, free[k, len(job["outputs"]) :], strict=True))
        values |= dict(zip(job["measured_starts"], measured[k], strict=True))
        slave.fmu.reset()
        slave.initialise(time[k], None, {**job["starts"], **values}, dict(zip(job["inputs"], u[k], strict=True)))
        found[k + 1] = run_steps(slave, time[k : k + 2], u[k : k + 2], job["inputs"], job["outputs"], job["linear"])[1]
    return {"y": found}


def _probe(job, arrays, description, unzipped, folder) -> dict[str, np.ndarray]:
    probes = {"CoSimulation": PROBES, "ModelExchange": EXCHANGE_PROBES, "gates": gates_for(job["path"])}
    run_probes(job["probes"], description, unzipped, folder / "rows.jsonl", probes[job["interface"]])
    return {}


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]))
    except Exception as failure:
        answer = {"done": False, "error": f"{type(failure).__name__}: {failure}"}
        (Path(sys.argv[1]) / "answer.json").write_text(json.dumps(answer), encoding="utf-8")
