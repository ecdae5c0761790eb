"""The front of error and size of a learned formula, as rows for a page."""

from __future__ import annotations

from hydrotwin.models.language.units import display_units, from_si
from hydrotwin.simulation import Block


def front_rows(block: Block) -> list[dict]:
    """What each formula costs and brings than which no other is both shorter and better, the shortest first.

    For every row ``output``, ``size`` (tokens), ``error`` (RMS where formulas were judged, in ``unit``), ``equation``,
    and ``chosen`` (whether the block is that one). Errors are those before the constants of several outputs were
    refitted together. Empty for a block that has no front.
    """
    units = {s.name: s.unit for s in block.outputs}
    rows = block.provenance.get("front", [])
    return [
        {
            "output": row["output"],
            "size": int(row["size"]),
            "error": _shown(row["error"], units[row["output"]]),
            "unit": _unit(units[row["output"]]),
            "equation": row["equation"],
            "chosen": bool(row.get("chosen", False)),
        }
        for row in rows
    ]


def _unit(unit: str) -> str:
    return unit if unit == "1" else display_units(unit)[0]


def _shown(error: float, unit: str) -> float:
    read = _unit(unit)
    return error if unit == "1" else float(from_si(float(error), read) - from_si(0.0, read))
