"""What is defined before the variables: interfaces, units, types, log categories, annotations, experiment."""

from __future__ import annotations

import re
from collections.abc import Iterable

from lxml import etree

from .declared import FLOATS, Declared, number
from .findings import Findings, twice

C_NAME = re.compile(r"[A-Za-z_]\w*", re.ASCII)
TRUE = ("true", "1")
NEEDS = {
    "canSerializeFMUstate": "canGetAndSetFMUstate",
    "canSerializeFMUState": "canGetAndSetFMUState",
    "canReturnEarlyAfterIntermediateUpdate": "providesIntermediateUpdate",
}
"""A capability -> the one that it must come with."""
NAMED = ("UnitDefinitions/Unit", "UnitDefinitions/Unit/DisplayUnit", "TypeDefinitions/*", "TypeDefinitions/*/Item",
         "LogCategories/Category")  # fmt: skip
"""What has a name that FMI 3 does not let be empty; those of variables are in the row "names"."""


def interfaces_row(declared: Declared) -> Findings:
    """The elements of Co-Simulation, Model Exchange and Scheduled Execution."""
    found = Findings()
    if not declared.interfaces:
        found.breaks("", ["it offers no interface: Model Exchange, Co-Simulation or Scheduled Execution"])
    named = [
        f"'{i}' of {e.tag}" for e in declared.interfaces if not C_NAME.fullmatch(i := e.get("modelIdentifier", ""))
    ]
    found.breaks("a modelIdentifier that is no name in C", named)
    for element in declared.interfaces:
        alone = [f"{a} without {b}" for a, b in NEEDS.items() if element.get(a) in TRUE and element.get(b) not in TRUE]
        found.breaks(f"capabilities of {element.tag} that exclude each other", alone)
    slave = declared.root.find("CoSimulation")
    if declared.fmi3 and slave is not None and slave.get("hasEventMode") not in TRUE:
        clocks = [str(v) for v in declared.variables if v.kind == "Clock"]
        found.breaks("Co-Simulation with clocks must have hasEventMode", clocks)
    return found


def units_row(declared: Declared) -> Findings:
    """Units and display units."""
    found = Findings()
    units = declared.root.findall("UnitDefinitions/Unit")
    found.breaks("units that are defined more than once", _quoted(twice(u.get("name", "") for u in units)))
    for unit in units:
        shown = unit.findall("DisplayUnit")
        again = twice(d.get("name", "") for d in shown)
        found.breaks(f"display units of '{unit.get('name')}' that are defined more than once", _quoted(again))
        both = [d for d in shown if d.get("inverse") in TRUE and number(d.get("offset", "0"))]
        found.breaks("display units with inverse and an offset", _quoted(d.get("name", "") for d in both))
    return found


def types_row(declared: Declared) -> Findings:
    """Types, and the items of enumerations."""
    found = Findings()
    elements = [e for e in declared.root.iterfind("TypeDefinitions/*") if isinstance(e.tag, str)]
    names = [e.get("name", "") for e in elements]
    found.breaks("types that are defined more than once", _quoted(twice(names)))
    both = set(names) & set(declared.names)
    found.breaks("names of types that are names of variables as well", _quoted(n for n in names if n in both))
    for name, (kind, element) in declared.types.items():
        items = element.findall("Item")
        for key in ("name", "value"):
            again = twice(i.get(key, "").strip() for i in items)
            found.breaks(f"items of '{name}' with the same {key}", _quoted(again))
        found.breaks(f"type '{name}' (line {element.sourceline})", attribute_faults(declared, element, kind))
        nominal = number(element.get("nominal"))
        if declared.fmi3 and nominal is not None and not nominal > 0.0:  # no rule but for states
            found.notes("", [f"the nominal value {nominal:g} of type '{name}' is not above zero"])
    return found


def attribute_faults(declared: Declared, element: etree._Element, kind: str, get=None) -> list[str]:
    """What is wrong with bounds, nominal value and units of a type, or with those that a variable ends up with.

    ``get`` looks an attribute up, ``element.get`` where it is not given. What only the declared type says is the
    type's fault, so at least one of two bounds must be the element's own.
    """
    get, faults = get or element.get, []
    low, high = number(get("min")), number(get("max"))
    own = element.get("min") is not None or element.get("max") is not None
    if own and low is not None and high is not None and low > high:
        faults.append(f"min {get('min')} is above max {get('max')}")
    nominal = number(element.get("nominal"))
    if not declared.fmi3 and nominal is not None and not nominal > 0.0:
        faults.append(f"nominal {element.get('nominal')} is not above zero")
    if kind in FLOATS:
        faults += _unit_faults(declared, element, get)
    return faults


def _unit_faults(declared: Declared, element: etree._Element, get) -> list[str]:
    """A unit must be defined; a display unit needs a unit, and in FMI 3 a definition."""
    unit, shown = get("unit"), get("displayUnit")
    if unit is not None and unit not in declared.units:
        return [f"unit '{unit}' is not defined"] if element.get("unit") is not None else []
    if element.get("displayUnit") is None and element.get("unit") is None:
        return []
    if shown is not None and unit is None:
        return [f"display unit '{shown}' without a unit"]
    if declared.fmi3 and shown is not None and not is_shown(declared, unit, shown):
        return [f"display unit '{shown}' of '{unit}' is not defined"]
    return []


def is_shown(declared: Declared, unit: str, shown: str) -> bool:
    """Whether a unit has that display unit, or is it."""
    return shown == unit or any(d.get("name") == shown for d in declared.units[unit].iterfind("DisplayUnit"))


def lists_row(declared: Declared) -> Findings:
    """Log categories and annotations have names of their own; the experiment makes sense."""
    found = Findings()
    for place, what in (("LogCategories/Category", "log categories"), ("VendorAnnotations/Tool", "annotations")):
        again = twice(e.get("name", "") for e in declared.root.iterfind(place))
        found.breaks(f"{what} with the same name", _quoted(again))
    if declared.fmi3:
        named = (e for place in NAMED for e in declared.root.iterfind(place) if e.get("name", "").strip() == "")
        found.breaks("names that are empty", [f"{e.tag} (line {e.sourceline})" for e in named])
    experiment = declared.root.find("DefaultExperiment")
    if experiment is not None:
        start, stop, step, tolerance = (
            number(experiment.get(a)) for a in ("startTime", "stopTime", "stepSize", "tolerance")
        )
        if stop is not None and stop < (start or 0.0):
            found.notes("", [f"the default experiment stops at {stop:g} s, before it starts"])
        odd = [f"{n} {x:g}" for n, x in (("stepSize", step), ("tolerance", tolerance)) if x is not None and not x > 0.0]
        found.notes("the default experiment has values that are not above zero", odd)
    return found


def _quoted(names: Iterable[str]) -> list[str]:
    return [f"'{name}'" for name in names]
