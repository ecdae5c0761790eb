"""terminalsAndIcons/terminalsAndIcons.xml of FMI 3.0: one bus with all inputs and outputs, and where the icon is."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Sequence

from .description import as_text
from .variables import Variable

_SQUARE = {"x1": "-100", "y1": "-100", "x2": "100", "y2": "100"}


def terminals_and_icons(variables: Sequence[Variable]) -> str:
    """The XML text. Members of the bus have the names of their variables: equal names are to be connected."""
    root = ET.Element("fmiTerminalsAndIcons", fmiVersion="3.0")
    drawn = ET.SubElement(root, "GraphicalRepresentation")
    ET.SubElement(drawn, "CoordinateSystem", _SQUARE | {"suggestedScalingFactorTo_mm": "0.1"})
    ET.SubElement(drawn, "Icon", _SQUARE)
    members = [v.name for v in variables if v.kind in ("input", "output")]
    if members:
        bus = ET.SubElement(
            ET.SubElement(root, "Terminals"), "Terminal", name=_free("signals", variables), matchingRule="bus",
            description="all inputs and outputs",
        )  # fmt: skip
        for name in members:
            ET.SubElement(bus, "TerminalMemberVariable", variableName=name, memberName=name, variableKind="signal")
    return as_text(root)


def _free(name: str, variables: Sequence[Variable]) -> str:
    taken = {v.name for v in variables}
    while name in taken:
        name += "_"
    return name
