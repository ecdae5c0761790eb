"""Values that a user gives an FMU: parameters, start values, and inputs that no recording has."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from hydrotwin.models.language.errors import DeclarationError, nearest
from hydrotwin.models.language.flat import Signal
from hydrotwin.models.language.quantities import apart, in_unit
from hydrotwin.models.language.units import to_si
from hydrotwin.records import Record

from .fmu_process.master import is_scalar
from .foreign import Description, kind_of
from .parameter_sets import asked_of
from .unit_meanings import units_defined_in

AT_REST = "inputs at their start values"
LEFT_OUT = "outputs left out"
REDEFINED = "units as the FMU defines them"


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
    items = {"true": 1.0, "false": 0.0, **({t: n for n, t in whole.items.items()} if whole else {})}
    if isinstance(given, str) and given.strip() in items:
        own = float(items[given.strip()])
    elif isinstance(given, str) and whole and whole.items and apart(given) is None:
        raise DeclarationError(f"{name}: '{given}' is none of its items. {nearest(given, items)}")
    elif isinstance(given, str):
        own = in_unit(given, asked_of(name, description), f"{name}={{}}")
    else:
        factor, offset = description.scales[name]
        own = (float(given) - offset) / factor
    if whole:
        own = whole.rounded(np.array([own]), lambda _: f"{name}: {given} is no {whole.kind}, which it must be")[0]
    return float(own)


def constants_read(inputs: Sequence[Signal], description: Description, constants: Mapping[str, str]) -> list[str]:
    """Of constants of recordings, name -> number and unit, which all models share, those that the FMU would read
    otherwise, because it defines their unit itself: what was taken and what it would be, a sentence each."""
    own, said = units_defined_in(description.source), []
    for name in (s.name for s in inputs if s.name in constants):
        number, unit = apart(constants[name]) or (0.0, "")
        if unit not in own:
            continue
        taken, si = to_si(number, unit)
        other = own[unit].factor * number + own[unit].offset
        if own[unit].si != si or not np.isclose(other, taken, rtol=1e-9, atol=0.0):
            said.append(
                f"{name} = {constants[name]} is {taken:.9g} {si}: it is set for the recordings, which all models "
                f"share. By the {unit} that the FMU defines it would be {other:.9g} {own[unit].si}. Write it in {si}."
            )
    return said


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


def is_settable(variable) -> bool:
    """Whether a variable of an FMU takes a value before it starts."""
    return variable.causality in ("parameter", "input") or variable.initial in ("exact", "approx")


def check_settable(path, md, names) -> None:
    """An FMU may take a value for a calculated variable and ignore it without a word."""
    for variable in md.modelVariables:
        if variable.name in names and variable.causality == "structuralParameter":
            raise DeclarationError(
                f"{path}: '{variable.name}' is a structural parameter, which says how long arrays are, and hydrotwin "
                "leaves those as they are. Leave it out."
            )
        if variable.name in names and not is_settable(variable):
            choice = [v.name for v in md.modelVariables if v.causality == "parameter"]
            raise DeclarationError(
                f"{path}: variable '{variable.name}' cannot be set, the FMU calculates it. "
                f"Set a parameter or an initial value. {nearest(variable.name, choice)}"
            )
