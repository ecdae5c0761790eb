"""modelDescription.xml and buildDescription.xml of FMI 3.0."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Mapping, Sequence

from .description import (
    ANNOTATION,
    Header,
    as_text,
    categories_and_experiment,
    real_attributes,
    roles,
    root_attributes,
    starts_annotation,
    units_and_types,
    unknowns,
)
from .type_definitions import type_names
from .variables import Variable

_ABILITIES = (
    "canGetAndSetFMUState", "canSerializeFMUState", "providesDirectionalDerivatives", "providesAdjointDerivatives",
)  # fmt: skip


def description_of_fmi3(header: Header, variables: Sequence[Variable]) -> str:
    """The XML text. All variables are Float64 and scalar, the place in the table is the value reference."""
    own = {"fmiVersion": "3.0", "instantiationToken": header.guid}
    root = ET.Element("fmiModelDescription", own | root_attributes(header, variables))
    for interface in header.interfaces:
        root.append(_interface(header, interface))
    root.extend(units_and_types(variables, 3))
    root.extend(categories_and_experiment(header))
    listed, types = ET.SubElement(root, "ModelVariables"), type_names(variables)
    for reference, variable in enumerate(variables):
        listed.append(_variable(reference, variable, header, types))
    root.append(_model_structure(variables))
    annotation = ET.SubElement(ET.SubElement(root, "Annotations"), "Annotation", type=ANNOTATION)
    annotation.append(starts_annotation(variables, header))
    return as_text(root)


def build_description(header: Header) -> str:
    """How to compile the sources: all of them, no definitions, no libraries but the C library's mathematics.

    From FMI 2.0.4 on this file of FMI 3.0 may lie in an FMU of FMI 2.0 too, beside the SourceFiles of its description.
    """
    root = ET.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ET.SubElement(root, "BuildConfiguration", modelIdentifier=header.identifier)
    files = ET.SubElement(configuration, "SourceFileSet", language="C99")
    for name in header.sources:
        ET.SubElement(files, "SourceFile", name=name)
    return as_text(root)


def _interface(header: Header, interface: str) -> ET.Element:
    """What is not named is false: no event mode in Co-Simulation, and no early return that nobody asked for."""
    if interface == "me":
        element = ET.Element("ModelExchange", modelIdentifier=header.identifier, needsCompletedIntegratorStep="true")
    else:
        element = ET.Element(
            "CoSimulation", modelIdentifier=header.identifier, canHandleVariableCommunicationStepSize="true",
            providesIntermediateUpdate="true", canReturnEarlyAfterIntermediateUpdate="true",
        )  # fmt: skip
    for ability in _ABILITIES:
        element.set(ability, "true")
    return element


def _variable(reference: int, variable: Variable, header: Header, types: Mapping[str, str]) -> ET.Element:
    attributes = {"name": variable.name, "valueReference": str(reference)}
    if variable.description:
        attributes["description"] = variable.description
    derivative = {} if variable.of is None else {"derivative": str(variable.of)}
    role, real = roles(variable.kind, header.sampled), real_attributes(variable, types)
    between = {"intermediateUpdate": "true"} if "cs" in header.interfaces and _is_intermediate(role) else {}
    return ET.Element("Float64", attributes | role | between | real | derivative)


def _is_intermediate(role: Mapping[str, str]) -> bool:
    """Inputs and outputs that are continuous, as in ht_between of the runtime; those of a sampled block are held."""
    return role["causality"] in ("input", "output") and role["variability"] == "continuous"


def _model_structure(variables: Sequence[Variable]) -> ET.Element:
    element = ET.Element("ModelStructure")
    tags = {"output": "Output", "derivative": "ContinuousStateDerivative", "initial": "InitialUnknown"}
    for what, rows in unknowns(variables).items():
        for reference, known in rows:
            attributes = {"valueReference": str(reference), "dependencies": " ".join(map(str, known))}
            ET.SubElement(element, tags[what], attributes)
    return element
