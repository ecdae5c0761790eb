"""Trajectories of Modelica tools (Dymola, OpenModelica) in MAT files: names, and where their values stand."""

from __future__ import annotations

import re

import numpy as np

from .mat_tree import Struct
from .rasters import Axis, Signal

_UNIT = re.compile(r"\[([^\]|]+)(?:\|[^\]]*)?\]\s*(?::#.*)?$")  # of a description: [Pa|bar], stored in Pa
_OVER_TIME = 2  # the data set of what changes; 1 holds parameters


def is_trajectory(tree: Struct) -> bool:
    return {"Aclass", "name", "dataInfo", "data_2"} <= set(tree)


def signals_of_trajectory(tree: Struct) -> list[Signal]:
    """What changes over time, in the unit that its description names; an alias is a signal too, maybe negated."""
    turned = "binTrans" in "".join(_texts(tree["Aclass"]))
    names, info, data = _texts(tree["name"], turned), tree["dataInfo"], tree["data_2"]
    described = _texts(tree["description"], turned) if "description" in tree else []
    if not turned:
        info, data = info.T, data.T
    axis = Axis(np.asarray(data[0], float))
    found = []
    for k, (name, place) in enumerate(zip(names, info.T, strict=True)):
        index = int(place[1])
        if int(place[0]) == _OVER_TIME and abs(index) != 1:
            unit = _UNIT.search(described[k]) if k < len(described) else None
            values = data[abs(index) - 1] if index > 0 else -data[abs(index) - 1]
            found.append(Signal(name, unit[1].strip() if unit else None, values, axis, name))
    return found


def _texts(node, turned: bool = False) -> list[str]:
    """The texts of a char matrix, one per row, or per column where it is turned."""
    rows = [node] if isinstance(node, str) else list(node)
    if turned:
        longest = max(map(len, rows), default=0)
        rows = ["".join(column) for column in zip(*(row.ljust(longest) for row in rows), strict=True)]
    return [row.replace("\x00", " ").strip() for row in rows]
