"""Parameter sets in the SSV format of SSP: of an FMU, written in its own units, and read for it."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from fmpy.model_description import BaseUnit

from hydrotwin.models.language.errors import DataError, nearest
from hydrotwin.models.language.quantities import Wanted, in_target
from hydrotwin.models.language.units import Unit

from .foreign import Description
from .related import local, xml_of
from .ssp_text import Unit as Named
from .unit_meanings import Meaning, defined, is_difference, shown_in, unit_name, units_defined_in

WORDS = {"true": 1.0, "false": 0.0}


def own_unit(name: str, description: Description) -> Named | None:
    """The unit of a variable as its FMU names it; None where it has none, or one that is not understood."""
    variable = next(v for v in description.source.modelVariables if v.name == name)
    text = unit_name(variable)
    if not text or name in description.unknown_units:
        return None
    return Named(text, description.units[name], *description.scales[name])


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
            found[name] = in_own_unit(number, unit, name, where, description, units)
    return found


def _defined_in(root, where: str) -> Mapping[str, Unit]:
    """Units that the file defines itself, by name: what it says counts, and not what others call so."""
    found = {}
    for unit in (e for e in root.iter() if local(e.tag) == "Unit"):
        base = next((e for e in unit if local(e.tag) == "BaseUnit"), None)
        if base is not None:
            try:
                name = unit.get("name", "")
                found[name] = defined(name, BaseUnit(**base.attrib)).unit(name)
            except (TypeError, ValueError):
                raise DataError(f"{where}: the unit '{unit.get('name')}' is defined by no numbers.") from None
    return found


def _number(given: Mapping[str, str], name: str, where: str) -> float:
    text = given.get("value", "")
    try:
        return WORDS[text] if text in WORDS else float(text)
    except ValueError:
        raise DataError(f"{where}: '{name}' is no number (got '{text}'), and only numbers can be set.") from None


def asked_of(
    name: str, description: Description, where: str = "", units: Mapping[str, Unit] = MappingProxyType({})
) -> Wanted:
    """What a number for a variable is asked for, in the FMU's own unit.

    What the FMU calls its units are its units, whatever others call so; before it ``units`` count. A number alone may
    mean two where the FMU has the variable in another unit than SI, or shows it in another.
    """
    variable = next(v for v in description.source.modelVariables if v.name == name)
    (factor, offset), si = description.scales[name], description.units[name]
    text = unit_name(variable) or si
    target = Meaning(si, factor, offset).unit(text)
    own = {**units_defined_in(description.source), text: target, **units}
    shown = shown_in(variable)
    written_in = text if (factor, offset) != (1.0, 0.0) else shown if shown != text and shown in own else ""
    told = f"{where}: '{name}'" if where else name
    return Wanted(told, target, written_in, is_difference(variable), own)


def in_own_unit(value, unit: str, name: str, where: str, description: Description, units=MappingProxyType({})):
    """A number or an array that is in ``unit`` ("" for the FMU's own) in the unit of a variable. Raises UnitError."""
    return in_target(value, unit, asked_of(name, description, where, units)) if unit else value
