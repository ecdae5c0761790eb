"""Where the FMI standard says what `check_fmu` judges by: numbers and titles of sections of 2.0.5 and 3.0.2."""

from __future__ import annotations

EDITIONS = {2: "FMI 2.0.5", 3: "FMI 3.0.2"}

_DISTRIBUTION = {2: "2.3 FMU Distribution", 3: "2.5 FMU Distribution"}
_VARIABLES = {2: "2.2.7 ModelVariables", 3: "2.4.7 Model Variables"}
_STRUCTURE = {2: "2.2.8 ModelStructure", 3: "2.4.8 Model Structure"}
_UNITS = {2: "2.2.2 UnitDefinitions", 3: "2.4.3 Physical Units"}
_GETTING = {2: "2.1.7 Getting and Setting Variable Values", 3: "2.2.7.2 Getting and Setting Variable Values"}
_CACHING = {2: "3.2.1 Re-initialization of Caching", 3: "3.2.1 Continuous-Time Mode"}
SECTIONS = {
    "readable": {2: "2.2.1 Definition of an FMU", 3: "2.4.1 Model Description"},
    "schema": {2: "2.2 FMI Description Schema", 3: "2.4 FMI Description Schema"},
    "interfaces": {2: "3.3.1 ModelExchange, 4.3.1 CoSimulation", 3: "2.4.2 Attributes and Capability Flags"},
    "unit definitions": _UNITS,
    "type definitions": {2: "2.2.3 TypeDefinitions", 3: "2.4.4 Variable Types"},
    "other definitions": {2: "2.2.4 LogCategories, 2.2.6 VendorAnnotations", 3: "2.4 FMI Description Schema"},
    "variables": _VARIABLES,
    "sources": {2: "2.3 FMU Distribution", 3: "2.4.10 Build Configurations"},
    "terminals": {2: "2.3 FMU Distribution; FMI 3.0.2, 2.4.9 Terminals and Icons", 3: "2.4.9 Terminals and Icons"},
    "reading": _GETTING,
    "start values": _VARIABLES,
    "names": {2: "2.2.9 Variable Naming Conventions", 3: "2.4.7.5.1 Variable Naming Conventions"},
    "model structure": _STRUCTURE,
    "units": _UNITS,
    "files": _DISTRIBUTION,
    "platforms": _DISTRIBUTION,
    "loads": _DISTRIBUTION,
    "runs": {2: "2.1.3 Status Returned by Functions", 3: "2.2.4 Status Returned by Functions"},
    "reset": {2: "2.1.6 Initialization, Termination, and Resetting", 3: "2.3.1 FMU State Settable (fmi3Reset)"},
    "second instance": {2: "4.3.1 canBeInstantiatedOnlyOncePerProcess", 3: "2.4.2 canBeInstantiatedOnlyOncePerProcess"},
    "state": {2: "2.1.8 Getting and Setting the Complete FMU State", 3: "2.2.7.4 Getting and Setting the FMU State"},
    "intermediate update": {3: "4.2.2 Intermediate Update Mode"},
    "dependencies": _STRUCTURE,
    "directional derivatives": {2: "2.1.9 Getting Partial Derivatives", 3: "2.2.12 Getting Partial Derivatives"},
    "number of states": _STRUCTURE,
    "order of states": _STRUCTURE,
    "nominal values": {2: "3.2.2 Evaluation of Model Equations", 3: "2.3.1 FMU State Settable (nominals)"},
    "order of setting": _CACHING,
    "any order of calls": _CACHING,
}
"""Of each row that can fail: the section it rests on."""

NOT_ALLOWED = ("NaN input", "unknown value reference", "step before initialization")
"""What no importer may do: an FMU that lets it pass breaks no rule."""


def paragraph(row: str, version: str) -> str:
    """Edition, number and title of the section behind a row; "" where it rests on none."""
    major = int(version[0])
    title = SECTIONS.get(row, {}).get(major, "")
    return f"{EDITIONS[major]}, {title}" if title else ""
