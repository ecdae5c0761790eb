"""Names and units of columns, out of the rows above the numbers.

Loggers write ``name [unit]``, ``name (unit)``, ``name / unit``, ``name in unit``, ``name_unit``, or a row of units.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from hydrotwin.models.language.errors import UnitError
from hydrotwin.models.language.units import parse_unit

# units that loggers write in words, lower case -> how they are written here ("grad" in lower case may be a gon)
WORDS = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "sekunden": "s", "sek": "s", "msec": "ms", "minutes": "min",
    "hours": "h", "std": "h", "volt": "V", "volts": "V", "ampere": "A", "amp": "A", "amps": "A", "bar": "bar",
    "mbar": "mbar", "pascal": "Pa", "newton": "N", "meter": "m", "metre": "m", "millimeter": "mm", "degree": "deg",
    "degrees": "deg", "celsius": "degC", "hertz": "Hz", "percent": "%", "prozent": "%", "inch": "in", "inches": "in",
    "bara": "bar", "psia": "psi", "umin": "rpm", "watt": "W", "kelvin": "K", "umdrehungen/min": "rpm",
}  # fmt: skip
_NO_UNIT = ("", "-", "--", "---", "none", "n/a", "unitless")  # what a row of units says of a pure number, or of nothing
_BESIDE = (
    re.compile(r"(?P<name>.*?\S)\s*\((?P<unit>[^()]*(?:\([^()]*\)[^()]*)*)\)", re.DOTALL),
    re.compile(r"(?P<name>.*?\S)\s+/\s*(?P<unit>\S+)", re.DOTALL),
    re.compile(r"(?P<name>.*?\S)\s+in\s+(?P<unit>\S+)", re.DOTALL),
)
_BEHIND = re.compile(r"(?P<name>.*[^_\W])_(?P<unit>[^\W_]+)")
_BRACKETS = re.compile(r"(.*?)\s*\[([^\]]*)\]\s*", re.DOTALL)


def split_header(text: str) -> tuple[str, str | None]:
    """``"arm_angle [rad]"`` -> ``("arm_angle", "rad")``; the unit is None where none is written.

    Brackets always hold a unit. Round ones, and what follows a slash or "in", do where they can be read as one.

    >>> split_header("Druck (bar)"), split_header("pressure (cap side)"), split_header("p / MPa")
    (('Druck', 'bar'), ('pressure (cap side)', None), ('p', 'MPa'))
    """
    text = text.strip().lstrip("\ufeff").strip()
    match = _BRACKETS.fullmatch(text)
    if match:
        return match[1].strip(), spelt(match[2].strip()) or None
    for form in _BESIDE:
        match = form.fullmatch(text)
        if match and (spelt(match["unit"].strip()) == "1" or is_unit(match["unit"])):
            return match["name"].strip(), spelt(match["unit"].strip())
    return text, None


def headings(names: Sequence[str], units: Sequence[str] | None = None) -> list[tuple[str, str | None]]:
    """``(name, unit)`` of every column; units: the cells of a row of units, where the file has one.

    ``name_unit`` is read as such where every name that has no unit yet ends so: it is the habit of the file then, and
    no part of a name.

    >>> headings(["time_s", "valve_A_bar"]), headings(["time_s", "valve_A", "state"])[1]
    ([('time', 's'), ('valve_A', 'bar')], ('valve_A', None))
    """
    found = [split_header(name) for name in names]
    for k, cell in enumerate(units or ()):
        if k < len(found) and found[k][1] is None and stripped(cell).lower() not in _NO_UNIT[:1]:
            found[k] = found[k][0], spelt(stripped(cell))
    bare = [k for k, (name, unit) in enumerate(found) if name and unit is None]
    behind = {k: match for k in bare if (match := _BEHIND.fullmatch(found[k][0])) and is_unit(match["unit"])}
    if bare and units is None and len(behind) == len(bare):
        for k, match in behind.items():
            found[k] = match["name"], match["unit"]
    return found


def is_unit(text: str) -> bool:
    """Whether a text, in brackets or bare, can be read as a unit."""
    try:
        parse_unit(spelt(stripped(text)))
    except (UnitError, OverflowError):
        return False
    return bool(stripped(text))


def is_units_row(cells: Sequence[str], mostly: bool = False) -> bool:
    """Whether a row above the numbers holds units: each cell is one, empty or a dash, and one says something.

    mostly : more than half of them, and at least two, will do.
    """
    said = [stripped(cell) for cell in cells if stripped(cell).lower() not in _NO_UNIT]
    units = sum(is_unit(cell) for cell in said)
    return bool(said) and (units == len(said) or (mostly and units >= 2 and 2 * units > len(said)))


def spelt(unit: str) -> str:
    """A unit as it is written here, where a file writes it in words.

    >>> spelt("Volts"), spelt("mm/sec"), spelt("Grad"), spelt("bar")
    ('V', 'mm/s', 'deg', 'bar')
    """
    if unit.lower() in ("--", "---", "none", "unitless"):
        return "1"
    words = re.split(r"([/.*])", unit) if unit.lower() not in WORDS else [unit]
    return "".join("deg" if word == "Grad" else WORDS.get(word.strip().lower(), word) for word in words)


def stripped(cell: str) -> str:
    """A cell of a row of units without its brackets."""
    cell = cell.strip().strip("\ufeff")
    match = re.fullmatch(r"\[(.*)\]|\((.*)\)|<(.*)>", cell)
    return next((g.strip() for g in match.groups() if g is not None), "") if match else cell
