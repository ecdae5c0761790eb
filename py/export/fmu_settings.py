"""Values that a user gives an FMU: parameters, start values, and inputs that no recording has."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.records import Record

from .fmu_process.master import is_scalar
from .foreign import Description, kind_of
from .parameter_sets import in_own_unit
from .unit_meanings import unit_name

AT_REST = "inputs at their start values"
LEFT_OUT = "outputs left out"
REDEFINED = "units as the FMU defines them"
_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*(\S.*)?")


def own_value(name: str, given: float | str, description: Description):
    """What an FMU takes for a value that a user gives: a number in SI, or a text: "35 bar", true, the name of an item.

    A text without a unit is in SI, where the FMU has it in SI, too. Raises DeclarationError or UnitError where the
    variable cannot be that.
    """
    variable = next(v for v in description.source.modelVariables if v.name == name)
    if variable.type == "String" and not variable.dimensions:
        return str(given)
    if not is_scalar(variable):
        kind = kind_of(variable)
        raise DeclarationError(f"{name}: it is {kind}, and only single numbers and texts can be set. Leave it out.")
    whole = description.whole.get(name)
    number, unit = _number(name, given, {t: n for n, t in whole.items.items()} if whole else {})
    factor, offset = description.scales[name]
    if not unit and isinstance(given, str) and (factor, offset) != (1.0, 0.0):
        called, si = unit_name(variable), description.units[name]
        raise DeclarationError(
            f"{name}: declared in {called}, so {given} alone may mean {called} or {si}. "
            f"Give the unit: {name}={given}{called}."
        )
    own = np.array([in_own_unit(number, unit, name, "", description) if unit else (number - offset) / factor])
    if whole:
        own = whole.rounded(own, lambda _: f"{name}: {given} is no {whole.kind}, which it must be")
    return float(own[0])


def _number(name: str, given: float | str, items: Mapping[str, int]) -> tuple[float, str]:
    """Number and unit, "" where none is given."""
    if not isinstance(given, str):
        return float(given), ""
    words = {"true": 1.0, "false": 0.0, **items}
    if given.strip() in words:
        return float(words[given.strip()]), ""
    found = _NUMBER.fullmatch(given)
    if not found:
        known = nearest(given, items) if items else "Write a number in SI, or with its unit: 35bar."
        raise DeclarationError(f"{name}: '{given}' is no number. {known}")
    return float(found[1]), found[2] or ""


def unrecorded(inputs: Sequence[Signal], starts: Mapping[str, float], records: Sequence[Record]) -> list[Signal]:
    """Inputs that none of the records has and that have a start value."""
    return [s for s in inputs if s.name in starts and not any(s.name in r for r in records)]


def at_rest(signal: Signal, records: Sequence[Record], given: bool) -> str:
    """A sentence on an input that stays where it is for a whole run."""
    unit = "" if signal.unit == "1" else f" {signal.unit}"
    if given:
        return f"input {signal.name} is {signal.default:g}{unit} throughout, as you set it"
    near = nearest(signal.name, [name for r in records for name in r.names])
    hint = f". {near} Rename that column" if near.startswith("Did you mean") else ""
    return f"input {signal.name} is not recorded: its start value {signal.default:g}{unit} serves{hint}"
