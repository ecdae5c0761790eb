"""A small master for one FMU of FMI 2 or 3, on top of FMPy. Numbers are in the FMU's own units."""

from __future__ import annotations

import contextlib
import sys
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from fmpy.fmi1 import FMICallException
from fmpy.model_description import ModelDescription, ScalarVariable
from fmpy.simulation import instantiate_fmu

DISCARDS = "logStatusDiscard"  # the standard's name of the category that says why a step was discarded
FLOATS = ("Real", "Float64", "Float32")
ERROR, FATAL = 3, 4  # of the status that a function returns, in both versions
NO_NUMBERS = ("String", "Binary", "Clock")
LOOK = 1e-10  # of a communication step: the short step after which an output is read that follows a jump at once
SPACINGS = 64  # between neighbouring numbers at the present time: no step is shorter
WHOLE = 1e-6  # an Integer or Boolean may be this far from a whole number: recordings are rounded


class Instance:
    """One instance of one of the two interfaces, FMI 2 and 3 seen through the same few calls."""

    interface = ""

    def __init__(self, description: ModelDescription, folder: str, **options):
        """``options`` are those of FMPy's `instantiate_fmu`."""
        self.description = description
        self.variables = {v.name: v for v in description.modelVariables}
        self.fmi3 = description.fmiVersion.startswith("3")
        self.fmu = self._instance(folder, options)
        if self.fmi3 and DISCARDS in {category.name for category in description.logCategories}:
            self.fmu.setDebugLogging(True, [DISCARDS])  # in FMI 3 only errors are told without being asked

    def _instance(self, folder: str, options: dict):
        """FMPy's. RuntimeError where the FMU gives none."""
        try:
            return instantiate_fmu(folder, self.description, fmi_type=self.interface, **options)
        except FMICallException:
            raise
        except Exception as failure:
            raise RuntimeError(f"the FMU gives no instance ({failure})") from None

    def initialise(self, start: float, stop: float | None, starts: Mapping[str, float], inputs: Mapping[str, float]):
        """From instantiated to where initialization mode has ended."""
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
            setter = getattr(self.fmu, f"set{accessed_as(kind, self.fmi3)}")
            setter(self._references(names), [_as_type(kind, values[n]) for n in names])

    def read(self, names: Sequence[str]) -> list[float]:
        """Values by name, as numbers."""
        found = {}
        for kind, of_kind in self._by_type(names).items():
            values = getattr(self.fmu, f"get{accessed_as(kind, self.fmi3)}")(self._references(of_kind))
            found |= dict(zip(of_kind, values, strict=True))
        return [float(found[n]) for n in names]

    def close(self):
        """Terminate and free, as far as the standard allows it after the failure that is on its way, if any."""
        status = getattr(sys.exc_info()[1], "status", 0)
        if status < ERROR:
            with contextlib.suppress(Exception):
                self.fmu.terminate()
        if status != FATAL:
            self.fmu.freeInstance()

    def _references(self, names) -> list[int]:
        return [self.variables[n].valueReference for n in names]

    def _by_type(self, names) -> dict[str, list[str]]:
        groups: dict[str, list[str]] = {}
        for name in names:
            groups.setdefault(self.variables[name].type, []).append(name)
        return groups


def interpolates(description: ModelDescription) -> bool:
    """Whether a Co-Simulation can be told how its inputs move during a step: by their derivatives, in FMI 2."""
    return bool(description.coSimulation.canInterpolateInputs) and not description.fmiVersion.startswith("3")


class Slave(Instance):
    """One Co-Simulation instance."""

    interface = "CoSimulation"

    @property
    def interpolates(self) -> bool:
        """Whether it can be told how its inputs move during a step (FMI 2)."""
        return interpolates(self.description)

    @property
    def returns(self) -> bool:
        """Whether it can be brought back to where it was."""
        return bool(self.description.coSimulation.canGetAndSetFMUstate)

    def write_slopes(self, slopes: Mapping[str, float]):
        """Tell the FMU how its inputs move during the next step."""
        self.fmu.setRealInputDerivatives(self._references(slopes), [1] * len(slopes), list(slopes.values()))

    def step(self, time: float, size: float):
        """One communication step. RuntimeError when the FMU asks to end."""
        answer = self.fmu.doStep(currentCommunicationPoint=time, communicationStepSize=size)
        if self.fmi3 and answer[1]:
            raise RuntimeError(f"the FMU ended the simulation at t = {answer[3]:g} s")


def inputs_of(description: ModelDescription) -> list[ScalarVariable]:
    """Inputs that hold one number: real, integer, Boolean, enumeration."""
    return [v for v in _with_causality(description, "input") if is_scalar(v)]


def unfed_of(description: ModelDescription) -> list[ScalarVariable]:
    """Inputs that no column of numbers can feed: texts, binaries, clocks, arrays, and what belongs to a clock."""
    return [v for v in description.modelVariables if v.causality == "input" and not is_scalar(v)]


def outputs_of(description: ModelDescription) -> list[ScalarVariable]:
    """Outputs that hold one number: real, integer, Boolean, enumeration."""
    return [v for v in _with_causality(description, "output") if is_scalar(v)]


def is_scalar(variable: ScalarVariable) -> bool:
    """Whether a variable holds one number at any time, and not only when a clock ticks."""
    return variable.type not in NO_NUMBERS and not variable.dimensions and not variable.clocks


def _with_causality(description: ModelDescription, causality: str) -> list[ScalarVariable]:
    """In FMI 3 FMPy lists an alias as a variable of its own: the first name of a reference is the variable's."""
    found = [v for v in description.modelVariables if v.causality == causality and v.type not in NO_NUMBERS]
    if not description.fmiVersion.startswith("3"):
        return found
    return list({v.valueReference: v for v in reversed(found)}.values())[::-1]


def feeds_through(description: ModelDescription, outputs: Sequence[str], inputs: Sequence[str]) -> np.ndarray:
    """Which output follows which input at once (outputs, inputs), by the declared dependencies; unsaid: all."""
    declared = {u.variable.name: u.dependencies for u in description.outputs}
    known = [declared.get(name) for name in outputs]
    named = [None if d is None else {v.name for v in d} for d in known]
    through = [[d is None or name in d for name in inputs] for d in named]
    return np.array(through, bool).reshape(len(outputs), len(inputs))


def abilities_of(unzipped: str, interface: str) -> set[str]:
    """What an interface's element declares as true; FMPy does not read all the names of FMI 3."""
    element = ET.parse(Path(unzipped) / "modelDescription.xml").getroot().find(interface)
    return {name for name, value in element.attrib.items() if value in ("true", "1")}


def look_size(time: float, size: float) -> float:
    """A step from ``time`` that is as good as none, in an FMU that takes steps of ``size`` [s]."""
    return max(LOOK * size, SPACINGS * float(np.spacing(abs(time))))


def run_steps(
    slave: Slave, time: np.ndarray, u: np.ndarray, inputs: Sequence[str], outputs: Sequence[str], linear: Sequence[str]
) -> np.ndarray:
    """Outputs (n, k) at ``time`` of a slave that was initialised with the first row of ``u``; row k sees input k.

    In the one order that the standard allows (FMI 2.0.5 p. 109): inputs are set, a step is made, outputs are read, and
    nothing is read between setting and stepping. What is read so has seen the inputs before a sample. An output that
    follows an input at once would be one sample late beside a recording, whose rows hold what was there together: where
    such an input jumps, a step that is as good as none (1e-10 of the next) is made with the new value, those outputs
    are read after it, and the slave is brought back where it can be. Where it cannot be looked at: see `late_outputs`.

    Inputs are held over a step; those named in ``linear`` move towards the next sample where the FMU can be told how,
    else they are held at their mean over the step.
    """
    straight = np.array([name in linear for name in inputs], bool)
    through = feeds_through(slave.description, outputs, inputs) & may_look(slave.description)
    found, seen = np.empty((len(time), len(outputs))), u[0]
    found[0] = slave.read(outputs)
    for k in range(len(time)):
        last = k + 1 == len(time)
        size = time[k] - time[k - 1] if last else time[k + 1] - time[k]
        values, done = dict(zip(inputs, u[k], strict=True)), 0.0
        behind = np.flatnonzero((through & (seen != u[k])).any(axis=1))
        if len(behind):
            found[k, behind], done = _look(slave, time[k], size, values, [outputs[j] for j in behind])
        if last:
            break
        seen = _set_for_step(slave, values, u[k], u[k + 1], straight, size)
        slave.step(time[k] + done, size - done)
        found[k + 1] = slave.read(outputs)
    return found


def _look(slave: Slave, time: float, size: float, values: Mapping[str, float], names: Sequence[str]):
    """Outputs just after the inputs took ``values``, and how far the slave has gone on: 0.0 where it can be taken back.

    Where it cannot, the solver inside answers to the cut step within its own tolerance.
    """
    state = slave.fmu.getFMUState() if slave.returns else None
    slave.write(values)
    short = look_size(time, size)
    slave.step(time, short)
    found = slave.read(names)
    if state is None:
        return found, short
    slave.fmu.setFMUState(state)
    slave.fmu.freeFMUState(state)
    return found, 0.0


def _set_for_step(slave: Slave, values: dict, now: np.ndarray, after: np.ndarray, straight, size: float) -> np.ndarray:
    """Set the inputs of a step and return what they are at its end."""
    moving = straight & (now != after)
    if not slave.interpolates:
        mean = np.where(moving, 0.5 * (now + after), now)
        slave.write(dict(zip(values, mean, strict=True)))
        return mean
    slave.write(values)
    if moving.any():
        slave.write_slopes({n: (b - a) / size for n, a, b, m in zip(values, now, after, moving, strict=True) if m})
    return np.where(moving, after, now)


def may_look(description: ModelDescription) -> bool:
    """Whether a step more than the recording asks for does no harm.

    The FMU takes steps of any size, and is brought back, or has no discrete output that might count steps: none that
    does not say what it depends on.
    """
    slave = description.coSimulation
    if not slave.canHandleVariableCommunicationStepSize:
        return False
    said = {u.variable.name for u in description.outputs if u.dependencies is not None}
    outputs = [v for v in description.modelVariables if v.causality == "output" and v.name not in said]
    counts = any(v.type not in FLOATS or v.variability == "discrete" for v in outputs)
    return bool(slave.canGetAndSetFMUstate) or not counts


def late_outputs(description: ModelDescription, outputs: Sequence[str], inputs: Sequence[str]) -> list[str]:
    """Outputs that a run shows one sample late: they follow an input at once and the FMU cannot be looked at."""
    if description.coSimulation is None or may_look(description):
        return []
    through = feeds_through(description, outputs, inputs).any(axis=1)
    return [name for name, late in zip(outputs, through, strict=True) if late]


def accessed_as(kind: str, fmi3: bool) -> str:
    """The type in the names of the functions that get and set variables of a kind."""
    return {"Enumeration": "Int64" if fmi3 else "Integer"}.get(kind, kind)


def _as_type(kind: str, value: float | str):
    if kind == "String":
        return value
    if kind in FLOATS:
        return float(value)
    whole = round(float(value))
    if abs(value - whole) > WHOLE or (kind == "Boolean" and whole not in (0, 1)):
        raise ValueError(f"{value!r} is no {kind}")
    return bool(whole) if kind == "Boolean" else whole
