"""What the unit of an FMU's variable means in SI: by the FMU's own definition, else by its name."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace

from fmpy.model_description import BaseUnit, ModelDescription

from hydrotwin.models.language.errors import UnitError
from hydrotwin.models.language.units import Unit, parse_unit

ALIKE = 1e-4  # relative: factors nearer than that are one, written with few digits; offsets, of a kelvin or of one
NAMED = 3  # variables that a sentence names
WHOSE = "{whose}"  # where a sentence names them


@dataclass(frozen=True)
class Meaning:
    """``SI = factor * value + offset`` in the unit ``si``.

    guessed : nobody knows the unit. said : where name and definition of the unit do not agree, in words what each says
    and which counts, with `WHOSE`; "" where they agree.
    """

    si: str = "1"
    factor: float = 1.0
    offset: float = 0.0
    guessed: bool = False
    said: str = ""

    def unit(self, name: str) -> Unit:
        """The same as a unit of that name."""
        return Unit(name, self.si, self.factor, self.offset, ())


def unit_name(variable) -> str | None:
    """The unit of a variable, its own or its type's; None when there is none."""
    declared = getattr(variable, "declaredType", None)
    return variable.unit or (declared.unit if declared is not None else None)


def meaning_of(variable, md: ModelDescription, chosen: str | None) -> Meaning:
    """What the numbers of a variable stand for; chosen : the unit that a user says, in place of the FMU's.

    The definition of a unit counts, as FMI has it, and not what other people call so: "C" may be a temperature, "bar" a
    gauge pressure. One without factor and offset leaves it to the name, unless it is another quantity: many tools write
    exponents alone, by which a mV would be a volt. Of a relative quantity, a difference, the zero of the unit is left
    out. Raises UnitError for a chosen unit that is none.
    """
    text = chosen or unit_name(variable)
    if not text:
        return Meaning()
    known = _known(text, strict=bool(chosen))
    base = None if chosen else next((d.baseUnit for d in md.unitDefinitions if d.name == text), None)
    found = _by_definition(text, base, known) if base is not None else _by_name(known)
    return replace(found, offset=0.0) if is_difference(variable) else found


def defined(name: str, base: BaseUnit) -> Meaning:
    """What a unit stands for that a file defines itself, as `meaning_of` reads it."""
    return _by_definition(name, base, _known(name, strict=False))


def units_defined_in(md: ModelDescription) -> dict[str, Unit]:
    """The units that an FMU defines, those of display too, by name: within it these names mean what it says."""
    found = {}
    for unit in (d for d in md.unitDefinitions if d.baseUnit is not None):
        meaning = defined(unit.name, unit.baseUnit)
        found[unit.name] = meaning.unit(unit.name)
        for shown in unit.displayUnits or ():
            factor = meaning.factor / float(shown.factor)
            zero = meaning.offset - factor * float(shown.offset)
            own, usual = Unit(shown.name, meaning.si, factor, zero, ()), _known(shown.name, strict=False)
            found.setdefault(shown.name, usual if usual and _alike(own, usual) else own)
    return found


def _alike(own: Unit, usual: Unit) -> bool:
    near = _near(own.factor, usual.factor, abs(usual.factor))
    return own.si == usual.si and near and _near(own.offset, usual.offset, max(1.0, abs(usual.offset)))


def shown_in(variable) -> str:
    """The unit in which a variable is to be shown, its own or its type's; "" where none is said."""
    declared = getattr(variable, "declaredType", None)
    return getattr(variable, "displayUnit", None) or getattr(declared, "displayUnit", None) or ""


def redefined(meanings: Mapping[str, Meaning]) -> tuple[str, ...]:
    """In sentences, units that an FMU defines otherwise than their names are understood, with whose they are."""
    whose: dict[str, list[str]] = {}
    for name, meaning in meanings.items():
        if meaning.said:
            whose.setdefault(meaning.said, []).append(name)
    return tuple(said.replace(WHOSE, _some(names)) for said, names in whose.items())


def _some(names: Iterable[str]) -> str:
    names = list(names)
    more = f" and {len(names) - NAMED} more" if len(names) > NAMED else ""
    return f"{', '.join(names[:NAMED])}{more}"


def _known(text: str, strict: bool) -> Unit | None:
    try:
        return parse_unit(text)
    except UnitError:
        if strict:
            raise
        return None


def _by_name(known: Unit | None) -> Meaning:
    return Meaning(guessed=True) if known is None else Meaning(known.si, known.factor, known.offset)


def _by_definition(text: str, base: BaseUnit, known: Unit | None) -> Meaning:
    factor, offset, si = float(base.factor), float(base.offset), _si_text(base)
    own = Meaning(si, factor, offset)
    if known is None:
        return own
    bare, alike = (factor, offset) == (1.0, 0.0), parse_unit(si).dimension == known.dimension
    if bare and si == "1":  # what tools write that cannot say it
        return _by_name(known)
    same = alike and _near(offset, known.offset, max(1.0, abs(known.offset)))
    turns = 2 * math.pi if "rad" in known.si and not base.rad else 1.0  # a revolution may count as one
    if same and any(_near(factor * by, known.factor, abs(known.factor)) for by in (1.0, turns)):
        return _by_name(known)
    own = replace(own, si=known.si) if alike and ("rad" in known.si) == bool(base.rad) else own  # Pa for kg/(m.s2)
    counts, other = (_by_name(known), own) if bare and alike else (own, _by_name(known))
    which = ("name", "definition") if bare and alike else ("definition", "name")
    said = f"unit '{text}' ({WHOSE}) is {_words(counts)} by its {which[0]}, and {_words(other)} by its {which[1]}"
    return replace(counts, said=f"{said}: the {which[0]} counts")


def _near(one: float, other: float, size: float) -> bool:
    return abs(one - other) <= ALIKE * size


def _words(meaning: Meaning) -> str:
    zero = f" from {meaning.offset:g} {meaning.si} on" if meaning.offset else ""
    return f"{meaning.factor:g} {meaning.si}{zero}"


def is_difference(variable) -> bool:
    """Whether only differences of a variable say something: as it says itself, else as its type says."""
    own, declared = getattr(variable, "relativeQuantity", None), getattr(variable, "declaredType", None)
    return bool(getattr(declared, "relativeQuantity", False) if own is None else own)


def _si_text(base: BaseUnit) -> str:
    """``kg.m2/s3`` from exponents, in the unit grammar of this project."""
    powers = {n: int(getattr(base, n)) for n in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}
    above = [n if p == 1 else f"{n}{p}" for n, p in powers.items() if p > 0]
    below = [n if p == -1 else f"{n}{-p}" for n, p in powers.items() if p < 0]
    text = ".".join(above) or "1"
    return parse_unit(f"{text}/({'.'.join(below)})" if below else text).si
