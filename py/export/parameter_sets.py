"""Parameter sets in the SSV format of SSP: of an FMU, written in its own units, and read for it."""

from __future__ import annotations

from collections.abc import Mapping

from fmpy.model_description import BaseUnit

from hydrotwin.models.language.errors import DataError, UnitError, nearest
from hydrotwin.models.language.units import convert, convert_difference, describe, dimension

from .foreign import Description
from .related import local, xml_of
from .ssp_text import Unit
from .unit_meanings import Meaning, defined, is_difference, unit_name

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
    units = _defined_in(root, where)
    found = {}
    for parameter in (e for e in root.iter() if local(e.tag) == "Parameter"):
        name, value = parameter.get("name", ""), next(iter(parameter), None)
        if name not in description.scales:
            raise DataError(f"{where}: no variable '{name}' in the FMU. {nearest(name, description.scales)}")
        if value is not None:
            number, unit = _number(value.attrib, name, where), value.get("unit", "")
            if unit in units:
                found[name] = _converted(number, units[unit], name, where, description)
            else:
                found[name] = in_own_unit(number, unit, name, where, description)
    return found


def _defined_in(root, where: str) -> Mapping[str, Meaning]:
    """Units that the file defines itself, by name: what it says counts, and not what others call so."""
    found = {}
    for unit in (e for e in root.iter() if local(e.tag) == "Unit"):
        base = next((e for e in unit if local(e.tag) == "BaseUnit"), None)
        if base is not None:
            try:
                found[unit.get("name", "")] = defined(unit.get("name", ""), BaseUnit(**base.attrib))
            except (TypeError, ValueError):
                raise DataError(f"{where}: the unit '{unit.get('name')}' is defined by no numbers.") from None
    return found


def _number(given: Mapping[str, str], name: str, where: str) -> float:
    text = given.get("value", "")
    try:
        return WORDS[text] if text in WORDS else float(text)
    except ValueError:
        raise DataError(f"{where}: '{name}' is no number (got '{text}'), and only numbers can be set.") from None


def _converted(value: float, meaning: Meaning, name: str, where: str, description: Description) -> float:
    """A number in a unit that its file defines, in that of a variable."""
    factor, offset = description.scales[name]
    zero = 0.0 if _relative(name, description) else meaning.offset
    if dimension(meaning.si) != dimension(description.units[name]):
        got, needed = describe(meaning.si), describe(description.units[name])
        raise UnitError(f"{where}: '{name}': its unit is {got} by its definition there, and the FMU needs {needed}.")
    same = (meaning.factor, zero) == (factor, offset)
    return value if same else (meaning.factor * value + zero - offset) / factor


def _relative(name: str, description: Description) -> bool:
    return is_difference(next(v for v in description.source.modelVariables if v.name == name))


def in_own_unit(value, unit: str, name: str, where: str, description: Description):
    """A number or an array that is in ``unit`` ("" for the FMU's own) in the unit of a variable. Raises UnitError.

    What the FMU calls its unit is its unit, whatever others call so. Of a difference zeros of units do not count.
    """
    variable = next(v for v in description.source.modelVariables if v.name == name)
    if not unit or unit == unit_name(variable):
        return value
    factor, offset = description.scales[name]
    try:
        turned = convert_difference if is_difference(variable) else convert
        return (turned(value, unit, description.units[name]) - offset) / factor
    except UnitError as error:
        raise UnitError(f"{where}: '{name}': {error}" if where else f"'{name}': {error}") from None
