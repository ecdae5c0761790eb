"""modelDescription.xml of FMI 2.0."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from dataclasses import dataclass

from hydrotwin.models.language.units import display_units

from .unit_definitions import unit_definitions
from .variables import Variable

CAUSALITY = {
    "input": "input", "parameter": "parameter", "start": "parameter", "output": "output",
    "state": "local", "derivative": "local", "time": "independent",
}  # fmt: skip
LOG_CATEGORIES = {
    "logEvents": "Events",
    "logStatusDiscard": "Steps and values that were discarded",
    "logStatusError": "Errors",
}


@dataclass(frozen=True)
class Header:
    """What stands above the variables: names, the default experiment, the source files."""

    model: str
    identifier: str
    guid: str
    description: str
    tool: str
    sampled: bool
    stop_time: float
    step_size: float
    tolerance: float
    sources: tuple[str, ...]
    restarts: bool = False
    period: float = 0.0
    author: str = ""
    licence: str = ""
    version: str = ""
    interfaces: tuple[str, ...] = ("cs",)


def model_description(header: Header, variables: Sequence[Variable]) -> str:
    """The XML text. The same arguments give the same bytes: there is no date in it."""
    root = ET.Element("fmiModelDescription", _root_attributes(header, variables))
    for interface in header.interfaces:
        root.append(_interface(header, interface))
    root.append(unit_definitions(v.unit for v in variables))
    categories = ET.SubElement(root, "LogCategories")
    for name, text in LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=text)
    experiment = {"startTime": "0.0", "stopTime": repr(header.stop_time), "stepSize": repr(header.step_size)}
    ET.SubElement(root, "DefaultExperiment", experiment | {"tolerance": repr(header.tolerance)})
    root.append(_annotations(variables, header))
    listed = ET.SubElement(root, "ModelVariables")
    for reference, variable in enumerate(variables):
        listed.append(_scalar_variable(reference, variable, header.sampled))
    root.append(_model_structure(variables))
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def _root_attributes(header: Header, variables: Sequence[Variable]) -> dict[str, str]:
    optional = {
        "description": header.description, "author": header.author, "version": header.version,
        "license": header.licence,
    }  # fmt: skip
    naming = "structured" if all(v.structured for v in variables) else "flat"
    return {
        "fmiVersion": "2.0", "modelName": header.model, "guid": header.guid,
        **{k: v for k, v in optional.items() if v},
        "generationTool": header.tool, "variableNamingConvention": naming, "numberOfEventIndicators": "0",
    }  # fmt: skip


def _interface(header: Header, interface: str) -> ET.Element:
    """``ModelExchange`` or ``CoSimulation`` with what it can do."""
    if interface == "me":
        element = ET.Element(
            "ModelExchange", modelIdentifier=header.identifier, completedIntegratorStepNotNeeded="true",
        )  # fmt: skip
    else:
        element = ET.Element(
            "CoSimulation", modelIdentifier=header.identifier, canHandleVariableCommunicationStepSize="true",
            canInterpolateInputs="true", maxOutputDerivativeOrder="0",
        )  # fmt: skip
    for ability in ("canGetAndSetFMUstate", "canSerializeFMUstate", "providesDirectionalDerivative"):
        element.set(ability, "true")
    files = ET.SubElement(element, "SourceFiles")
    for name in header.sources:
        ET.SubElement(files, "File", name=name)
    return element


def _annotations(variables: Sequence[Variable], header: Header) -> ET.Element:
    """Which output measures what a start parameter sets: a reader can then start where a recording starts.

    ``complete``: the start parameters determine the whole state, so that a reader can restart anywhere. ``period``:
    how often a sampled block moves [s].
    """
    element = ET.Element("VendorAnnotations")
    tool = ET.SubElement(element, "Tool", name="hydrotwin")
    sampled = {"period": repr(header.period)} if header.sampled else {}
    starts = ET.SubElement(tool, "Starts", complete="true" if header.restarts else "false", **sampled)
    for variable in variables:
        if variable.kind == "start":
            measured = {"output": variable.measured_by} if variable.measured_by else {}
            ET.SubElement(starts, "Start", {"parameter": variable.name, **measured})
    return element


def _scalar_variable(reference: int, variable: Variable, sampled: bool) -> ET.Element:
    attributes = {"name": variable.name, "valueReference": str(reference)}
    if variable.description:
        attributes["description"] = variable.description
    attributes |= {"causality": CAUSALITY[variable.kind], "variability": _variability(variable.kind, sampled)}
    if variable.kind in ("parameter", "start"):
        attributes["initial"] = "exact"
    elif variable.kind in ("output", "state", "derivative"):
        attributes["initial"] = "calculated"
    element = ET.Element("ScalarVariable", attributes)
    ET.SubElement(element, "Real", _real_attributes(variable))
    return element


def _variability(kind: str, sampled: bool) -> str:
    if kind in ("parameter", "start"):
        return {"parameter": "tunable", "start": "fixed"}[kind]
    return "discrete" if sampled and kind in ("output", "state") else "continuous"


def _real_attributes(variable: Variable) -> dict[str, str]:
    attributes = {"unit": variable.unit}
    best = display_units(variable.unit)[0]
    if best != variable.unit:
        attributes["displayUnit"] = best
    low, high = variable.bounds
    if math.isfinite(low):
        attributes["min"] = repr(float(low))
    if math.isfinite(high):
        attributes["max"] = repr(float(high))
    if variable.nominal and math.isfinite(variable.nominal):
        attributes["nominal"] = repr(abs(float(variable.nominal)))
    if variable.start is not None:
        attributes["start"] = repr(float(variable.start))
    if variable.of is not None:
        attributes["derivative"] = str(variable.of + 1)
    return attributes


def _model_structure(variables: Sequence[Variable]) -> ET.Element:
    """FMI 2 indices count from one. Discrete states have no entry in FMI 2."""
    element = ET.Element("ModelStructure")
    of_kind = {k: [i for i, v in enumerate(variables) if v.kind == k] for k in ("output", "state", "derivative")}
    for tag, kind in (("Outputs", "output"), ("Derivatives", "derivative")):
        if of_kind[kind]:
            _unknowns(element, tag, of_kind[kind], [variables[i].depends for i in of_kind[kind]])
    continuous = of_kind["state"] if of_kind["derivative"] else []
    initial = [*of_kind["output"], *continuous, *of_kind["derivative"]]
    if initial:
        _unknowns(element, "InitialUnknowns", initial, [variables[i].starts_from for i in initial])
    return element


def _unknowns(parent: ET.Element, tag: str, indices: list[int], depends: list[tuple[int, ...]]):
    listed = ET.SubElement(parent, tag)
    for index, known in zip(indices, depends, strict=True):
        ET.SubElement(listed, "Unknown", index=str(index + 1), dependencies=" ".join(str(k + 1) for k in known))
