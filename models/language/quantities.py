"""A number as people write it, with its unit or alone: the one way by which numbers get in.

Whoever asks for a number says what is `Wanted`. `in_unit` turns what is written into it, or says why that is none, what
it may mean, and what to write.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from numbers import Real

from .errors import DeclarationError, UnitError
from .units import Unit, convert, convert_difference, describe, display_units, is_difference, parse_unit

NUMBER = r"[-+\N{MINUS SIGN}]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][-+\N{MINUS SIGN}]?\d+)?"
_WRITTEN = re.compile(rf"\s*({NUMBER})(?:\s+|(?![\d.,]))(.*?)\s*", re.DOTALL)


@dataclass(frozen=True)
class Wanted:
    """What a number is asked for.

    name : what it is the value of, told in errors. unit : what the answer is in, SI or the own unit of a file.
    written_in : the unit in which it is declared or shown, where that is another one: a number alone may mean two then.
    difference : zeros of units do not count, as where it is declared in delta_degC. own : units that its file defines
    itself, by name: there these names mean what it says, whatever others call so.
    """

    name: str
    unit: str | Unit
    written_in: str = ""
    difference: bool = False
    own: Mapping[str, Unit] = field(default_factory=dict)

    def __post_init__(self):
        object.__setattr__(self, "difference", self.difference or is_difference(self.written_in))

    @property
    def target(self) -> Unit:
        return self.unit if isinstance(self.unit, Unit) else parse_unit(self.unit)


def wanted(quantity, owner: str = "", *, difference: bool = False) -> Wanted:
    """What a number for a declared quantity of a model (`Signal`, `ParameterValue`, ...) is asked for, in SI."""
    name = f"{owner}.{quantity.name}" if owner else quantity.name
    return Wanted(name, quantity.unit, quantity.written_in, difference)


def number_of(text: str) -> float:
    """A number as `NUMBER` finds it."""
    return float(text.replace("\N{MINUS SIGN}", "-"))


def apart(text: str) -> tuple[float, str] | None:
    """Number and unit of a text, "" where it stands alone; None where it begins with no number, or one too large.

    >>> apart("35 bar"), apart("-2.5e3"), apart("1500 1/min"), apart("fast")
    ((35.0, 'bar'), (-2500.0, ''), (1500.0, '1/min'), None)
    """
    found = _WRITTEN.fullmatch(text)
    if not found or not math.isfinite(number_of(found[1])):
        return None
    return number_of(found[1]), found[2]


def in_unit(given: float | str, asked: Wanted, example: str = "") -> float:
    """What is written, in the unit that is asked for. example : how its door writes a value, with ``{}`` for it.

    Raises DeclarationError for what is no finite number and for a number alone that may mean two, UnitError for a unit
    that is none, or of another quantity.

    >>> in_unit("30 degC", Wanted("oil", "K")), in_unit("30 degC", Wanted("rise", "K", difference=True))
    (303.15, 30.0)
    """
    found = (float(given), "") if _is_number(given) else apart(given) if isinstance(given, str) else None
    form = example or f"{asked.name.rpartition('.')[2]} = '{{}}'"
    unit = asked.written_in or usual(asked)
    if found is None or not math.isfinite(found[0]):
        raise DeclarationError(f"{asked.name}: '{given}' is no number. Write {form.replace('{}', _of(35, unit))}.")
    number, own = found
    if own:
        return in_target(number, own, asked)
    declared, other = _two_readings(asked)
    if _read_as(number, declared, asked) != _read_as(number, other, asked):
        raise DeclarationError(
            f"{asked.name}: declared in {asked.written_in}, so {_short(number)} alone may mean {asked.written_in} or "
            f"{other.text}. Give the unit: {form.replace('{}', _of(number, asked.written_in))}."
        )
    return number


def in_si(given, asked: Wanted) -> float:
    """A number of a program, which is in SI, or a text with its unit. Raises as `in_unit`."""
    return in_unit(given, asked) if isinstance(given, str) else in_unit(given, replace(asked, written_in=""))


def in_target(values, unit: str, asked: Wanted):
    """A number, or an array of them, that is in ``unit``, in the unit that is asked for. Raises UnitError."""
    target, known = asked.target, asked.own.get(unit)
    if known and (known.si, known.factor, known.offset) == (target.si, target.factor, target.offset):
        return values
    if known:
        values = known.factor * values + (0.0 if asked.difference else known.offset)
    turned = convert_difference if asked.difference else convert
    try:
        values = turned(values, known.si if known else unit, target.si)
    except UnitError as error:
        raise UnitError(f"{asked.name}: {_refused(error, unit, asked)}") from None
    return (values - (0.0 if asked.difference else target.offset)) / target.factor


def usual(asked: Wanted) -> str:
    """The unit in which a person writes it: as it is declared, else as workshops have it."""
    if asked.written_in or asked.own:
        return asked.written_in or asked.target.text
    return next(iter(display_units(asked.target.si)))


def _refused(error: UnitError, unit: str, asked: Wanted) -> str:
    """Why a unit is refused, with units of the quantity."""
    si = asked.target.si
    units = ", ".join(dict.fromkeys(u for u in (asked.written_in, asked.target.text, *display_units(si)) if u))
    if own := asked.own.get(unit):
        return f"'{unit}' is {describe(own.si)} by its definition there, not {describe(si)}. Write it in {units}."
    try:
        parse_unit(unit)
    except UnitError:
        return f"{error} It is in {units}."
    return str(error)


def _is_number(given: object) -> bool:
    return isinstance(given, Real) and not isinstance(given, bool)


def _two_readings(asked: Wanted) -> tuple[Unit, Unit]:
    """The units in which a number alone may be meant; twice the same where there is one."""
    target = asked.target
    if not asked.written_in:
        return target, target
    declared = asked.own.get(asked.written_in) or parse_unit(asked.written_in)
    return declared, parse_unit(target.si) if target.text == asked.written_in else target


def _read_as(number: float, unit: Unit, asked: Wanted) -> float:
    return unit.factor * number + (0.0 if asked.difference else unit.offset)


def _short(number: float) -> str:
    return f"{number:.15g}"


def _of(number: float, unit: str) -> str:
    return f"{_short(number)} {unit}" if unit[:1].isdigit() else f"{_short(number)}{unit}"
