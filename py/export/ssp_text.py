"""The XML of an SSP archive, 1.0 or 2.0: system structure (SSD) and parameter values (SSV)."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from .unit_definitions import base_exponents

SSP = "http://ssp-standard.org/SSP1/SystemStructure"
SPACES = {"ssd": f"{SSP}Description", "ssc": f"{SSP}Common", "ssv": f"{SSP}ParameterValues"}
VERSIONS = ("1.0", "2.0")  # they share namespaces; 2.0 has a place for meta-data
NEWEST = VERSIONS[-1]
SIGMAS = 1.96  # half the width of a 95 % interval in standard deviations
PARAMETER_SET = "application/x-ssp-parameter-set"
FMU = "application/x-fmu-sharedlibrary"
SRMD, TOML = "application/x-srmd-meta-data", "application/toml"


@dataclass(frozen=True)
class Unit:
    """A unit by name: ``value in si = factor * value + offset``."""

    name: str
    si: str
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Connector:
    """kind : "input" or "output". type : "Real", "Integer" or "Boolean"; only a Real has a unit."""

    name: str
    kind: str
    type: str = "Real"
    unit: Unit | None = None


@dataclass(frozen=True)
class Component:
    """One FMU of the system; ``source`` is its path in the archive, ``record`` that of its record inside the FMU."""

    name: str
    source: str
    implementation: str
    description: str
    connectors: tuple[Connector, ...]
    record: str = ""


@dataclass(frozen=True)
class Connection:
    """From a connector to a connector; an element of None is the system itself."""

    start_element: str | None
    start: str
    end_element: str | None
    end: str


@dataclass(frozen=True)
class Parameter:
    """One value of a parameter set; without a unit it is in the FMU's own. sigma : its standard deviation."""

    name: str
    value: float
    unit: Unit | None = None
    sigma: float | None = None


def system_structure(
    title: str,
    tool: str,
    connectors: Sequence[Connector],
    components: Sequence[Component],
    connections: Sequence[Connection],
    bound: Sequence[str],
    experiment: tuple[float, float] | None,
    version: str = VERSIONS[0],
) -> str:
    """SystemStructure.ssd. bound : parameter sets that apply, by path. experiment : start and stop time [s]."""
    known = units_of(c for part in (connectors, *(c.connectors for c in components)) for c in part)
    root = _root("ssd:SystemStructureDescription", title, tool, version)
    system = ET.SubElement(root, "ssd:System", name="comparison", description=title)
    _put_connectors(system, connectors, known)
    if bound:
        bindings = ET.SubElement(system, "ssd:ParameterBindings")
        for source in bound:
            ET.SubElement(bindings, "ssd:ParameterBinding", type=PARAMETER_SET, source=source)
    elements = ET.SubElement(system, "ssd:Elements")
    for component in components:
        element = ET.SubElement(
            elements, "ssd:Component", name=component.name, type=FMU, source=component.source,
            implementation=component.implementation, description=component.description,
        )  # fmt: skip
        _put_connectors(element, component.connectors, known)
        if component.record and version == NEWEST:
            _put_meta_data(element, component.record, TOML, sourceBase="resource")
    if connections:
        wires = ET.SubElement(system, "ssd:Connections")
        for wire in connections:
            said = {
                "startElement": wire.start_element, "startConnector": wire.start,
                "endElement": wire.end_element, "endConnector": wire.end,
            }  # fmt: skip
            ET.SubElement(wires, "ssd:Connection", {k: v for k, v in said.items() if v is not None})
    _put_units(root, "ssd:Units", known.values())
    if experiment:
        start, stop = map(repr, experiment)
        ET.SubElement(root, "ssd:DefaultExperiment", startTime=start, stopTime=stop)
    return _text(root)


def parameter_set(
    name: str, tool: str, parameters: Sequence[Parameter], version: str = VERSIONS[0], meta_data: str = ""
) -> str:
    """A parameter set as SSV. meta_data : a file beside it that says where its values come from (SRMD); 2.0 alone.

    Where a value has a standard deviation, an annotation of hydrotwin has that and the interval of 95 %, in its unit:
    the standard has no place for either.
    """
    known = units_of(parameters)
    root = _root("ssv:ParameterSet", name, tool, version)
    listed = ET.SubElement(root, "ssv:Parameters")
    for parameter in parameters:
        element = ET.SubElement(listed, "ssv:Parameter", name=parameter.name)
        ET.SubElement(element, "ssv:Real", {"value": repr(parameter.value)} | _unit(parameter.unit, known))
        if parameter.sigma is not None:
            _put_interval(element, parameter)
    _put_units(root, "ssv:Units", known.values())
    if meta_data and version == NEWEST:
        _put_meta_data(root, meta_data, SRMD)
    return _text(root)


def _put_interval(element: ET.Element, parameter: Parameter):
    half = SIGMAS * parameter.sigma
    numbers = {"sigma": parameter.sigma, "low": parameter.value - half, "high": parameter.value + half}
    notes = ET.SubElement(ET.SubElement(element, "ssv:Annotations"), "ssc:Annotation", type="hydrotwin")
    ET.SubElement(notes, "Interval", {"confidence": "0.95"} | {key: repr(float(v)) for key, v in numbers.items()})


def _put_meta_data(element: ET.Element, source: str, kind: str, **more: str):
    ET.SubElement(element, "ssc:MetaData", {"kind": "quality", "type": kind, "source": source} | more)


def units_of(things: Iterable[Connector | Parameter]) -> Mapping[str, Unit]:
    """Units by name, sorted. One with roots has no whole exponents and cannot be listed: the FMU's own then holds."""
    found: dict[str, Unit] = {}
    for unit in (thing.unit for thing in things):
        if unit is not None and base_exponents(unit.si) is not None:
            found.setdefault(unit.name, unit)
    return dict(sorted(found.items()))


def _root(tag: str, name: str, tool: str, version: str) -> ET.Element:
    own = tag.partition(":")[0]
    spaces = {f"xmlns:{prefix}": SPACES[prefix] for prefix in (own, "ssc")}
    return ET.Element(tag, {**spaces, "version": version, "name": name, "generationTool": tool})


def _put_connectors(element: ET.Element, connectors: Sequence[Connector], known: Mapping[str, Unit]):
    if connectors:
        listed = ET.SubElement(element, "ssd:Connectors")
        for connector in connectors:
            entry = ET.SubElement(listed, "ssd:Connector", name=connector.name, kind=connector.kind)
            unit = _unit(connector.unit, known) if connector.type == "Real" else {}
            ET.SubElement(entry, f"ssc:{connector.type}", unit)


def _unit(unit: Unit | None, known: Mapping[str, Unit]) -> dict[str, str]:
    """The attribute; empty where another FMU has taken the name for something else."""
    return {"unit": unit.name} if unit is not None and known.get(unit.name) == unit else {}


def _put_units(root: ET.Element, tag: str, units: Iterable[Unit]):
    units = list(units)
    if units:
        listed = ET.SubElement(root, tag)
        for unit in units:
            exponents = {k: str(v) for k, v in base_exponents(unit.si).items() if v}
            factor = {"factor": repr(unit.factor)} if unit.factor != 1.0 else {}
            offset = {"offset": repr(unit.offset)} if unit.offset else {}
            element = ET.SubElement(listed, "ssc:Unit", name=unit.name)
            ET.SubElement(element, "ssc:BaseUnit", exponents | factor | offset)


def _text(root: ET.Element) -> str:
    ET.indent(root)
    return '<?xml version="1.0" encoding="UTF-8"?>\n' + ET.tostring(root, encoding="unicode") + "\n"
