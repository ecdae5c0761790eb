"""modelDescription.xml of FMI 2.0."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from .type_definitions import type_definitions, type_names
from .unit_definitions import unit_definitions
from .variables import Variable

CAUSALITY = {
    "input": "input", "parameter": "parameter", "start": "parameter", "output": "output",
    "state": "local", "derivative": "local", "time": "independent",
}  # fmt: skip
ANNOTATION = "hydrotwin"
LOG_CATEGORIES = {
    "logEvents": "Events",
    "logStatusWarning": "Warnings, as of a learned block that leaves its training data",
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
    fmi: int = 2


def description_of_fmi2(header: Header, variables: Sequence[Variable]) -> str:
    """The XML text. The same arguments give the same bytes: there is no date in it."""
    root = ET.Element(
        "fmiModelDescription", {
            "fmiVersion": "2.0", "guid": header.guid, **root_attributes(header, variables),
            "numberOfEventIndicators": "0",
        },
    )  # fmt: skip
    for interface in header.interfaces:
        root.append(_interface(header, interface))
    root.extend(units_and_types(variables, 2))
    root.extend(categories_and_experiment(header))
    own = ET.SubElement(ET.SubElement(root, "VendorAnnotations"), "Tool", name=ANNOTATION)
    own.append(starts_annotation(variables, header))
    listed, types = ET.SubElement(root, "ModelVariables"), type_names(variables)
    for reference, variable in enumerate(variables):
        listed.append(_scalar_variable(reference, variable, header.sampled, types))
    root.append(_model_structure(variables))
    return as_text(root)


def as_text(root: ET.Element) -> str:
    """Indented XML with its declaration."""
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"


def categories_and_experiment(header: Header) -> list[ET.Element]:
    """``LogCategories`` and ``DefaultExperiment``, the same in both versions."""
    categories = ET.Element("LogCategories")
    for name, text in LOG_CATEGORIES.items():
        ET.SubElement(categories, "Category", name=name, description=text)
    experiment = {"startTime": "0.0", "stopTime": repr(header.stop_time), "stepSize": repr(header.step_size)}
    return [categories, ET.Element("DefaultExperiment", experiment | {"tolerance": repr(header.tolerance)})]


def root_attributes(header: Header, variables: Sequence[Variable]) -> dict[str, str]:
    """What both versions say of the model as a whole."""
    optional = {
        "description": header.description, "author": header.author, "version": header.version,
        "license": header.licence,
    }  # fmt: skip
    naming = "structured" if all(v.structured for v in variables) else "flat"
    return {
        "modelName": header.model, **{k: v for k, v in optional.items() if v},
        "generationTool": header.tool, "variableNamingConvention": naming,
    }  # fmt: skip


def _interface(header: Header, interface: str) -> ET.Element:
    """``ModelExchange`` or ``CoSimulation`` with what it can do."""
    if interface == "me":
        element = ET.Element("ModelExchange", modelIdentifier=header.identifier)
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


def starts_annotation(variables: Sequence[Variable], header: Header) -> ET.Element:
    """Which output measures what a start parameter sets: a reader can then start where a recording starts.

    ``output``: a run takes its first sample; ``measured``: a run of hydrotwin, and a restart anywhere, take it too.
    ``complete``: the start parameters determine the whole state, so that a reader can restart anywhere. ``period``:
    how often a sampled block moves [s].
    """
    sampled = {"period": repr(header.period)} if header.sampled else {}
    starts = ET.Element("Starts", complete="true" if header.restarts else "false", **sampled)
    for variable in variables:
        if variable.kind == "start":
            from_outputs = {"output": variable.measured_by, "measured": variable.restarts_from}
            told = {k: v for k, v in from_outputs.items() if v}
            ET.SubElement(starts, "Start", {"parameter": variable.name, **told})
    return starts


def units_and_types(variables: Sequence[Variable], fmi: int) -> list[ET.Element]:
    """``UnitDefinitions`` and, where a variable has a type, ``TypeDefinitions``."""
    types = type_definitions(variables, fmi)
    return [unit_definitions((v.unit, v.shown) for v in variables), *([] if types is None else [types])]


def _scalar_variable(reference: int, variable: Variable, sampled: bool, types: Mapping[str, str]) -> ET.Element:
    attributes = {"name": variable.name, "valueReference": str(reference)}
    if variable.description:
        attributes["description"] = variable.description
    element = ET.Element("ScalarVariable", attributes | roles(variable.kind, sampled))
    derivative = {} if variable.of is None else {"derivative": str(variable.of + 1)}
    ET.SubElement(element, "Real", real_attributes(variable, types) | derivative)
    return element


def roles(kind: str, sampled: bool) -> dict[str, str]:
    """Causality, variability and, where the standard's table wants it, initial."""
    found = {"causality": CAUSALITY[kind], "variability": _variability(kind, sampled)}
    if kind in ("parameter", "start"):
        found["initial"] = "exact"
    elif kind in ("output", "state", "derivative"):
        found["initial"] = "calculated"
    return found


def _variability(kind: str, sampled: bool) -> str:
    if kind in ("parameter", "start"):
        return {"parameter": "tunable", "start": "fixed"}[kind]
    return "discrete" if sampled and kind in ("output", "state") else "continuous"


def real_attributes(variable: Variable, types: Mapping[str, str]) -> dict[str, str]:
    """Type, unit, bounds, nominal and start value; importers that skip types find all but the quantity here."""
    typed = variable.unit in types and variable.kind != "time"
    attributes = ({"declaredType": types[variable.unit]} if typed else {}) | {"unit": variable.unit}
    if variable.shown != variable.unit:
        attributes["displayUnit"] = variable.shown
    if variable.difference:
        attributes["relativeQuantity"] = "true"
    low, high = variable.bounds
    if math.isfinite(low):
        attributes["min"] = repr(float(low))
    if math.isfinite(high):
        attributes["max"] = repr(float(high))
    if variable.nominal and math.isfinite(variable.nominal):
        attributes["nominal"] = repr(abs(float(variable.nominal)))
    if variable.start is not None:
        attributes["start"] = repr(float(variable.start))
    return attributes


def _model_structure(variables: Sequence[Variable]) -> ET.Element:
    """FMI 2 indices count from one. Discrete states have no entry in FMI 2."""
    element = ET.Element("ModelStructure")
    tags = {"output": "Outputs", "derivative": "Derivatives", "initial": "InitialUnknowns"}
    for what, rows in unknowns(variables).items():
        listed = ET.SubElement(element, tags[what]) if rows else None
        for index, known in rows:
            ET.SubElement(listed, "Unknown", index=str(index + 1), dependencies=" ".join(str(k + 1) for k in known))
    return element


def unknowns(variables: Sequence[Variable]) -> dict[str, list[tuple[int, tuple[int, ...]]]]:
    """Outputs, derivatives and initial unknowns as (value reference, value references of what it depends on)."""
    of_kind = {k: [i for i, v in enumerate(variables) if v.kind == k] for k in ("output", "state", "derivative")}
    continuous = of_kind["state"] if of_kind["derivative"] else []
    initial = [*of_kind["output"], *continuous, *of_kind["derivative"]]
    return {
        "output": [(i, variables[i].depends) for i in of_kind["output"]],
        "derivative": [(i, variables[i].depends) for i in of_kind["derivative"]],
        "initial": [(i, variables[i].starts_from) for i in initial],
    }
