"""Parameter sets in the SSV format of SSP: of an FMU, written in its own units, and read for it."""

from __future__ import annotations

from collections.abc import Mapping

from hydrotwin.models.language.errors import DataError, UnitError, nearest
from hydrotwin.models.language.units import convert

from .foreign import Description
from .related import local, xml_of
from .ssp_text import Unit
from .unit_meanings import unit_name

WORDS = {"true": 1.0, "false": 0.0}


def own_unit(name: str, description: Description) -> Unit | None:
    """The unit of a variable as its FMU names it; None where it has none, or one that is not understood."""
    variable = next(v for v in description.source.modelVariables if v.name == name)
    text = unit_name(variable)
    if not text or name in description.unknown_units:
        return None
    return Unit(text, description.units[name], *description.scales[name])


def parameters_of(content: bytes, where: str, description: Description) -> Mapping[str, float]:
    """Values of an SSV file, in the FMU's own units, by variable.

    Raises DataError for a file that is none, a variable that the FMU does not have, UnitError for a unit that does not
    fit.
    """
    root = xml_of(content, where)
    if local(root.tag) != "ParameterSet":
        raise DataError(f"{where}: no parameter set (its root is '{local(root.tag)}', not 'ParameterSet').")
    found = {}
    for parameter in (e for e in root.iter() if local(e.tag) == "Parameter"):
        name, value = parameter.get("name", ""), next(iter(parameter), None)
        if name not in description.scales:
            raise DataError(f"{where}: no variable '{name}' in the FMU. {nearest(name, description.scales)}")
        if value is not None:
            found[name] = _own_value(value.attrib, name, where, description)
    return found


def _own_value(given: Mapping[str, str], name: str, where: str, description: Description) -> float:
    text = given.get("value", "")
    try:
        value = WORDS[text] if text in WORDS else float(text)
    except ValueError:
        raise DataError(f"{where}: '{name}' is no number (got '{text}'), and only numbers can be set.") from None
    return in_own_unit(value, given.get("unit", ""), name, where, description)


def in_own_unit(value, unit: str, name: str, where: str, description: Description):
    """A number or an array that is in ``unit`` ("" for the FMU's own) in the unit of a variable. Raises UnitError."""
    variable = next(v for v in description.source.modelVariables if v.name == name)
    if not unit or unit == unit_name(variable):
        return value
    factor, offset = description.scales[name]
    try:
        return (convert(value, unit, description.units[name]) - offset) / factor
    except UnitError as error:
        raise UnitError(f"{where}: '{name}': {error}") from None
