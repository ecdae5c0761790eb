"""Child of fmu_speed.py: one FMU through FMPy, ``python _fmpy_loop.py JOB.json``; prints the CPU seconds.

Way "calls": FMPy's setReal, doStep and getReal in a bare loop. Way "simulate_fmu": FMPy's own simulation.
"""

import json
import sys
import time
from pathlib import Path

import numpy as np
from fmpy import extract, read_model_description, simulate_fmu
from fmpy.simulation import instantiate_fmu

job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
drive, step, names = np.load(job["drive"], allow_pickle=False), job["step"], job["outputs"]
description = read_model_description(job["path"], validate=False)
folder = extract(job["path"], unzipdir=job["folder"])
reference = {v.name: v.valueReference for v in description.modelVariables}


def calls():
    fmu = instantiate_fmu(folder, description, fmi_type="CoSimulation")
    fmu.setupExperiment(startTime=0.0)
    for name, value in job["starts"].items():
        fmu.setReal([reference[name]], [value])
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    into, out, found = [reference["command"]], [reference[n] for n in names], []
    begun = time.thread_time()
    for k, value in enumerate(drive.tolist()):
        fmu.setReal(into, [value])
        fmu.doStep(currentCommunicationPoint=k * step, communicationStepSize=step)
        found.append(fmu.getReal(out))
    spent = time.thread_time() - begun
    fmu.terminate()
    fmu.freeInstance()
    return spent, np.array(found)


def simulation():
    signal = np.array([(k * step, v) for k, v in enumerate(drive)], dtype=[("time", float), ("command", float)])
    begun = time.thread_time()
    result = simulate_fmu(
        folder, validate=False, model_description=description, fmi_type="CoSimulation", start_values=job["starts"],
        input=signal, output=names, output_interval=step, step_size=step, stop_time=len(drive) * step,
    )  # fmt: skip
    return time.thread_time() - begun, np.column_stack([result[n][1:] for n in names])


runs = [{"calls": calls, "simulate_fmu": simulation}[job["way"]]() for _ in range(job["rounds"])]
np.save(job["found"], runs[0][1])
print(min(spent for spent, _ in runs), flush=True)
