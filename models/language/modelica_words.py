"""The small words of Modelica text: names, modifiers, descriptions."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from .modelica_expression import modelica_number
from .units import modelica_unit

WORDS = frozenset({
    "algorithm", "and", "annotation", "assert", "block", "break", "class", "connect", "connector", "constant",
    "constrainedby", "der", "discrete", "each", "else", "elseif", "elsewhen", "encapsulated", "end", "enumeration",
    "equation", "expandable", "extends", "external", "false", "final", "flow", "for", "function", "if", "import",
    "impure", "in", "initial", "inner", "input", "loop", "model", "not", "operator", "or", "outer", "output", "package",
    "parameter", "partial", "protected", "public", "pure", "record", "redeclare", "replaceable", "return", "stream",
    "then", "time", "true", "type", "when", "while", "within", "Real", "Integer", "Boolean", "String",
})  # fmt: skip


def identifier(name: str) -> str:
    """A name as Modelica takes it.

    >>> identifier("end"), identifier("rod_area"), identifier("3rd bench-run")
    ('end_', 'rod_area', '_3rd_bench_run')
    """
    return f"{name}_" if name in WORDS else re.sub(r"\W|^(?=\d)", "_", name, flags=re.ASCII)


def modelica_path(path: str) -> str:
    """A dotted path as a Modelica component reference."""
    return ".".join(identifier(part) for part in path.split("."))


def attributes_of(declared) -> dict[str, str]:
    """``unit, min, max, nominal`` as far as they say something."""
    found = {"unit": f'"{modelica_unit(declared.unit)}"'} if modelica_unit(declared.unit) else {}
    low, high = getattr(declared, "bounds", (-np.inf, np.inf))
    found |= {key: modelica_number(b) for key, b in (("min", low), ("max", high)) if np.isfinite(b)}
    if declared.nominal not in (None, 1.0):
        found["nominal"] = modelica_number(declared.nominal)
    return found


def modifier(attributes: Mapping[str, str]) -> str:
    """``(unit="m", min=0)``, nothing for nothing."""
    return f"({', '.join(f'{key}={value}' for key, value in attributes.items())})" if attributes else ""


def nested(changes: Mapping[str, str]) -> str:
    """Changes by path as one nested modifier: ``(cylinder(friction(viscous=700)))``."""
    if not changes:
        return ""
    groups: dict[str, dict[str, str]] = {}
    for path, change in changes.items():
        first, _, rest = path.partition(".")
        groups.setdefault(first, {})[rest] = change
    parts = [f"{identifier(first)}{inside.get('') or nested(inside)}" for first, inside in groups.items()]
    return f"({', '.join(parts)})"


def sentence_of(described) -> str:
    """First line of what a class says about itself."""
    return (type(described).__doc__ or "").strip().split("\n")[0].replace("``", "")


def quoted(text: str) -> str:
    """A description as it follows a declaration, nothing for no text."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"')
    return f' "{escaped}"' if text else ""


def indented(text: str) -> str:
    return "\n".join(f"  {line}" if line else line for line in text.split("\n"))
