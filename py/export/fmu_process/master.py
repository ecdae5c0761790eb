"""A small master for one FMU of FMI 2 or 3, on top of FMPy. Numbers are in the FMU's own units."""

from __future__ import annotations

import contextlib
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from fmpy.model_description import ModelDescription, ScalarVariable
from fmpy.simulation import instantiate_fmu

DISCARDS = "logStatusDiscard"  # the standard's name of the category that says why a step was discarded
FLOATS = ("Real", "Float64", "Float32")


class Slave:
    """One Co-Simulation instance: FMI 2 and 3 seen through the same few calls; options: of `instantiate_fmu`."""

    def __init__(self, description: ModelDescription, folder: str, **options):
        self.description = description
        self.variables = {v.name: v for v in description.modelVariables}
        self.fmi3 = description.fmiVersion.startswith("3")
        self.fmu = instantiate_fmu(folder, description, fmi_type="CoSimulation", **options)
        if self.fmi3 and DISCARDS in {category.name for category in description.logCategories}:
            self.fmu.setDebugLogging(True, [DISCARDS])  # in FMI 3 only errors are told without being asked

    def initialise(self, start: float, stop: float | None, starts: Mapping[str, float], inputs: Mapping[str, float]):
        """From instantiated to ready for the first step."""
        early = {n: v for n, v in starts.items() if self.variables[n].variability != "constant"}
        if self.fmi3:
            self.write(early)
            self.fmu.enterInitializationMode(startTime=start, stopTime=stop)
        else:
            self.fmu.setupExperiment(startTime=start, stopTime=stop)
            self.write(early)
            self.fmu.enterInitializationMode()
        self.write(inputs)
        self.fmu.exitInitializationMode()

    def write(self, values: Mapping[str, float]):
        """Set variables by name."""
        for kind, names in self._by_type(values).items():
            setter = getattr(self.fmu, f"set{_setter(kind, self.fmi3)}")
            setter(self._references(names), [_as_type(kind, values[n]) for n in names])

    def read(self, names: Sequence[str]) -> list[float]:
        """Values by name, as numbers."""
        found = {}
        for kind, of_kind in self._by_type(names).items():
            values = getattr(self.fmu, f"get{_setter(kind, self.fmi3)}")(self._references(of_kind))
            found |= dict(zip(of_kind, values, strict=True))
        return [float(found[n]) for n in names]

    def write_slopes(self, slopes: Mapping[str, float]):
        """Tell the FMU how its inputs move during the next step (FMI 2)."""
        self.fmu.setRealInputDerivatives(self._references(slopes), [1] * len(slopes), list(slopes.values()))

    def step(self, time: float, size: float):
        """One communication step. RuntimeError when the FMU asks to end."""
        answer = self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=size)
        if self.fmi3 and answer[1]:
            raise RuntimeError(f"the FMU ended the simulation at t = {answer[3]:g} s")

    def close(self):
        """Terminate and free, also after a failure."""
        with contextlib.suppress(Exception):
            self.fmu.terminate()
        self.fmu.freeInstance()

    def _references(self, names) -> list[int]:
        return [self.variables[n].valueReference for n in names]

    def _by_type(self, names) -> dict[str, list[str]]:
        groups: dict[str, list[str]] = {}
        for name in names:
            groups.setdefault(self.variables[name].type, []).append(name)
        return groups


def inputs_of(description: ModelDescription) -> list[ScalarVariable]:
    """Inputs that hold a number."""
    words = ("String", "Binary", "Clock")
    return [v for v in description.modelVariables if v.causality == "input" and v.type not in words]


def outputs_of(description: ModelDescription) -> list[ScalarVariable]:
    """Real outputs, scalars."""
    return [
        v for v in description.modelVariables
        if v.causality == "output" and v.type in FLOATS and not getattr(v, "dimensions", None)
    ]  # fmt: skip


def abilities_of(unzipped: str, interface: str) -> set[str]:
    """What an interface's element declares as true; FMPy does not read all the names of FMI 3."""
    element = ET.parse(Path(unzipped) / "modelDescription.xml").getroot().find(interface)
    return {name for name, value in element.attrib.items() if value in ("true", "1")}


def run_steps(
    slave: Slave, time: np.ndarray, u: np.ndarray, inputs: Sequence[str], outputs: Sequence[str], linear: Sequence[str]
) -> np.ndarray:
    """Outputs (n, k) at ``time``; output k belongs to input k, as in `simulate`.

    Inputs are held over a step; those named in ``linear`` move towards the next sample where the FMU can follow,
    else they are held at their mean over the step.
    """
    follows = bool(slave.description.coSimulation.canInterpolateInputs) and not slave.fmi3
    found = np.empty((len(time), len(outputs)))
    for k in range(len(time)):
        slave.write(dict(zip(inputs, u[k], strict=True)))
        found[k] = slave.read(outputs)
        if k + 1 == len(time):
            break
        size = time[k + 1] - time[k]
        moving = {n: (u[k, j], u[k + 1, j]) for j, n in enumerate(inputs) if n in linear}
        if moving and follows:
            slave.write_slopes({n: (b - a) / size for n, (a, b) in moving.items()})
        elif moving:
            slave.write({n: 0.5 * (a + b) for n, (a, b) in moving.items()})
        slave.step(time[k], size)
    return found


def _setter(kind: str, fmi3: bool) -> str:
    return {"Enumeration": "Int64" if fmi3 else "Integer"}.get(kind, kind)


def _as_type(kind: str, value: float):
    if kind in FLOATS:
        return float(value)
    return bool(value) if kind == "Boolean" else int(value)
