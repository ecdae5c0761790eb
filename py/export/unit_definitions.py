"""Units in FMI: SI exponents and display units of every unit that is used."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable

from hydrotwin.models.language.units import BASE_UNITS, dimension, display_units, parse_unit


def unit_definitions(units: Iterable[tuple[str, str]]) -> ET.Element:
    """The ``UnitDefinitions`` element for FMI 2.0, sorted by name, of units and what variables are shown in.

    A unit with roots, such as m3/(s.sqrt(Pa)), has no integer exponents and is defined by its name alone.
    """
    element = ET.Element("UnitDefinitions")
    used = set(units)
    for unit in sorted({unit for unit, _ in used}):
        definition = ET.SubElement(element, "Unit", name=unit)
        exponents = base_exponents(unit)
        if exponents is not None:
            ET.SubElement(definition, "BaseUnit", {k: str(v) for k, v in exponents.items() if v})
        for shown in dict.fromkeys((*shown_units(unit), *sorted(s for u, s in used if u == unit and s != unit))):
            factor, offset = display_factor(unit, shown)
            attributes = {"name": shown, "factor": repr(factor)} | ({"offset": repr(offset)} if offset else {})
            ET.SubElement(definition, "DisplayUnit", attributes)
    return element


def base_exponents(unit: str) -> dict[str, int] | None:
    """Exponents of kg, m, s, A, K, mol, cd, rad; None when one is not whole.

    >>> base_exponents("rad/(s.V)")
    {'kg': -1, 'm': -2, 's': 2, 'A': 1, 'K': 0, 'mol': 0, 'cd': 0, 'rad': 1}
    """
    powers = dict(zip(BASE_UNITS, dimension(unit), strict=True)) | {"rad": _angle_exponent(unit)}
    if any(p.denominator != 1 for p in powers.values() if not isinstance(p, int)):
        return None
    return {k: int(powers[k]) for k in ("kg", "m", "s", "A", "K", "mol", "cd", "rad")}


def shown_units(unit: str) -> tuple[str, ...]:
    """Units a person would read this one in, itself left out."""
    return tuple(u for u in display_units(unit) if u != unit)


def display_factor(unit: str, shown: str) -> tuple[float, float]:
    """``display value = factor * value + offset``.

    >>> display_factor("Pa", "bar")
    (1e-05, 0.0)
    """
    from_, to = parse_unit(unit), parse_unit(shown)
    return _plain(from_.factor / to.factor), _plain((from_.offset - to.offset) / to.factor)


def _plain(number: float) -> float:
    """The short number that differs from this one by rounding only: 1000 for 999.9999999999998."""
    short = float(f"{number:.14g}")
    return short if abs(short - number) <= 4e-16 * abs(number) else number


def _angle_exponent(unit: str) -> int:
    """The power of rad in the SI form, which the dimension leaves out."""
    top, _, bottom = parse_unit(unit).si.partition("/")
    above, below = (sum(int(n or 1) for n in re.findall(r"\brad(\d*)", part)) for part in (top, bottom))
    return above - below
