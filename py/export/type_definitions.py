"""Type definitions in FMI: one for each physical quantity, named as in Modelica.Units.SI."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Sequence

from .variables import Variable

QUANTITIES = {
    "Pa": "Pressure", "N": "Force", "N.m": "Torque", "kg": "Mass", "m": "Length", "m2": "Area", "m3": "Volume",
    "m/s": "Velocity", "m/s2": "Acceleration", "rad": "Angle", "rad/s": "AngularVelocity",
    "rad/s2": "AngularAcceleration", "m3/s": "VolumeFlowRate", "V": "ElectricPotential", "A": "ElectricCurrent",
    "s": "Time", "Hz": "Frequency", "W": "Power", "J": "Energy", "kg/m3": "Density",
    "N/m": "TranslationalSpringConstant", "N.s/m": "TranslationalDampingConstant",
}  # fmt: skip


def type_names(variables: Sequence[Variable]) -> dict[str, str]:
    """Unit -> name of its type, for the units that have a quantity; no variable has such a name."""
    taken = {v.name for v in variables}
    found = {}
    for unit in sorted({v.unit for v in variables if v.kind != "time"} & set(QUANTITIES)):
        name = QUANTITIES[unit]
        while name in taken:
            name += "_"
        found[unit] = name
    return found


def type_definitions(variables: Sequence[Variable], fmi: int) -> ET.Element | None:
    """The ``TypeDefinitions`` element of FMI 2.0 or 3.0, sorted by unit; None when no variable has a type."""
    names = type_names(variables)
    element = ET.Element("TypeDefinitions")
    for unit, name in names.items():
        attributes = type_attributes(unit, [v for v in variables if v.unit == unit and v.kind != "time"])
        if fmi == 3:
            ET.SubElement(element, "Float64Type", {"name": name} | attributes)
        else:
            ET.SubElement(ET.SubElement(element, "SimpleType", name=name), "Real", attributes)
    return element if names else None


def type_attributes(unit: str, variables: Sequence[Variable]) -> dict[str, str]:
    """Quantity, units, the bounds within which all these variables stay, and the nominal value that most of them have.

    A bound is there only when every variable has one: a variable without would inherit it.
    """
    attributes = {"quantity": QUANTITIES[unit], "unit": unit}
    best = {v.shown for v in variables}
    if len(best) == 1 and best != {unit}:
        attributes["displayUnit"] = best.pop()
    low, high = min(v.bounds[0] for v in variables), max(v.bounds[1] for v in variables)
    if math.isfinite(low):
        attributes["min"] = repr(float(low))
    if math.isfinite(high):
        attributes["max"] = repr(float(high))
    counts = Counter(abs(float(v.nominal)) for v in variables if v.nominal and math.isfinite(v.nominal))
    commonest = [n for n, count in counts.items() if count == max(counts.values())]
    if len(commonest) == 1:
        attributes["nominal"] = repr(commonest[0])
    return attributes
