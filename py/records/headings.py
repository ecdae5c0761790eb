"""Names and units of columns, out of the rows above the numbers.

Loggers write ``name [unit]``, ``name (unit)``, ``name / unit``, ``name in unit``, ``name_unit``, or a row of units.
"""

from __future__ import annotations

import re
from collections.abc import Sequence

from hydrotwin.models.language.errors import UnitError
from hydrotwin.models.language.units import parse_unit

from .clocks import called_time

# units that loggers write in words, lower case -> how they are written here ("grad" in lower case may be a gon)
WORDS = {
    "sec": "s", "secs": "s", "second": "s", "seconds": "s", "sekunden": "s", "sek": "s", "msec": "ms", "minutes": "min",
    "hours": "h", "std": "h", "volt": "V", "volts": "V", "ampere": "A", "amp": "A", "amps": "A", "bar": "bar",
    "mbar": "mbar", "pascal": "Pa", "newton": "N", "meter": "m", "metre": "m", "millimeter": "mm", "degree": "deg",
    "degrees": "deg", "celsius": "degC", "hertz": "Hz", "percent": "%", "prozent": "%", "inch": "in", "inches": "in",
    "bara": "bar", "psia": "psi", "umin": "rpm", "watt": "W", "kelvin": "K", "umdrehungen/min": "rpm",
    "dimensionless": "1", "sek.": "s", "sec.": "s", "vdc": "V",
}  # fmt: skip
MISSPELT = {
    "Mpa": "MPa", "MPA": "MPa", "KPa": "kPa", "Kpa": "kPa", "KPA": "kPa", "KHz": "kHz", "HZ": "Hz",
    "PSI": "psi", "Psi": "psi", "BAR": "bar", "KN": "kN", "Nmm": "N.mm", "KW": "kW", "Kg": "kg", "KG": "kg",
    "RPM": "rpm",
}  # fmt: skip
_NO_UNIT = ("", "-", "--", "---", "none", "n/a", "unitless")  # what a row of units says of a pure number, or of nothing
_BESIDE = (
    re.compile(r"(?P<name>.*?\S)\s*\((?P<unit>[^()]*(?:\([^()]*\)[^()]*)*)\)", re.DOTALL),
    re.compile(r"(?P<name>.*?\S)\s+/\s*(?P<unit>\S+)", re.DOTALL),
    re.compile(r"(?P<name>.*?\S)\s+in\s+(?P<unit>\S+)", re.DOTALL),
)
SURE = "s%°"  # single signs that are units wherever they stand behind a name
LABELS = ("min", "max", "in", "out", "h")  # of a quantity as likely as its unit; a time may be in min or h
QUOTIENTS = (
    "rad_s", "rad_s2", "deg_s", "deg_s2", "m_s", "m_s2", "mm_s", "mm_s2", "l_min", "L_min", "ml_min", "m3_h", "m3_s",
    "cm3_s", "kg_s", "kg_h", "bar_s", "1_min", "U_min", "rev_min",
)  # fmt: skip
LETTERS = "VNmKWJ"  # letters that are, where every column has a unit so; A, B, P, T, X, Y name ports
_CURRENT = re.compile(r"curr|strom|ampere|^[iI](?![a-z])", re.IGNORECASE)
_ELEMENT = r"(?!.*\S\[\d+(?:,\s*\d+)*\]\s*$)"  # x[1] is an element of an array
_BRACKETS = re.compile(_ELEMENT + r"(.*?)\s*\[([^\]]*)\]\s*", re.DOTALL)


def split_header(text: str) -> tuple[str, str | None]:
    """``"arm_angle [rad]"`` -> ``("arm_angle", "rad")``; the unit is None where none is written.

    Brackets hold a unit, but for ``x[1]``, an element of an array: a pure number is ``x [1]``. Round ones, and what
    follows a slash or "in", do where they can be read as one that is more than a letter: ``pump (A)`` may be a port.

    >>> split_header("Druck (bar)"), split_header("pressure (cap side)"), split_header("p / MPa"), split_header("p (A)")
    (('Druck', 'bar'), ('pressure (cap side)', None), ('p', 'MPa'), ('p (A)', None))
    """
    return _split(text, letters=False)


def _split(text: str, letters: bool) -> tuple[str, str | None]:
    """Name and unit; letters : whether a single letter behind a name may be a unit."""
    text = " ".join(text.strip().lstrip("\ufeff").split())
    match = _BRACKETS.fullmatch(text)
    if match:
        return match[1].strip(), spelt(match[2].strip()) or None
    for form in _BESIDE:
        match = form.fullmatch(text)
        if match and _may_be_unit(match["unit"].strip(), match["name"], letters):
            return match["name"].strip(), spelt(match["unit"].strip())
    return text, None


def _may_be_unit(unit: str, name: str, letters: bool) -> bool:
    """Whether what stands behind a name is a unit: no letter that is as likely a port or a quantity."""
    if unit in LABELS:
        return unit in ("min", "h") and called_time(name)
    if unit.isdigit() or re.fullmatch(r"[A-Za-z]+1", unit):  # a port; nobody writes the exponent 1
        return False
    if len(unit) == 1 and unit.isalpha() and unit not in SURE:
        if unit == "A":
            return bool(_CURRENT.search(name))
        return letters and unit in LETTERS and is_unit(unit)
    return is_unit(unit) or spelt(unit) == "1"


def headings(names: Sequence[str], units: Sequence[str] | None = None) -> list[tuple[str, str | None]]:
    """``(name, unit)`` of every column; units: the cells of a row of units, where the file has one.

    Where all columns have a unit behind their names, single letters are units too. ``name_unit`` is read as such where
    every name that has no unit yet ends so. Both are the habit of the file then, and no part of a name. With a row of
    units only brackets say more; where they say another unit both are told, for neither can be meant.

    >>> headings(["time_s", "valve_p_bar"]), headings(["time_s", "valve_A", "state"])[1]
    ([('time', 's'), ('valve_p', 'bar')], ('valve_A', None))
    >>> headings(["time [s]", "p [bar]"], ["s", "mbar"])[1]
    ('p', 'bar or mbar')
    """
    if units is not None:
        row = [spelt(stripped(cell)) for cell in units] + [""] * (len(names) - len(units))
        return [_beside_row(name, unit) for name, unit in zip(names, row, strict=True)]
    found = [_split(name, letters=True) for name in names]
    if any(unit is None for name, unit in found if name):
        found = [split_header(name) for name in names]
    bare = [k for k, (name, unit) in enumerate(found) if name and unit is None]
    behind = {k: match for k in bare if (match := _behind(found[k][0]))}
    if bare and len(behind) == len(bare):
        for k, (name, unit) in behind.items():
            found[k] = name, unit or None
    return found


def _beside_row(name: str, unit: str) -> tuple[str, str | None]:
    """A name and its unit out of the row of units."""
    match = _BRACKETS.fullmatch(name.strip())
    if not match:
        return " ".join(name.split()), unit or None
    return match[1].strip(), together(match[2].strip(), unit)


def together(one: str | None, other: str | None) -> str | None:
    """The unit that a column has in two places; both where they differ, for neither can be meant."""
    one, other = (spelt(unit) if unit else None for unit in (one, other))
    return f"{one} or {other}" if one and other and one != other else other or one


def _behind(name: str) -> tuple[str, str] | None:
    """Name and unit of ``name_unit``, where it ends in one; the unit is "" where it may be read in two ways.

    ``speed_rad_s`` is in rad/s, as are the other quotients that are usual. ``torque_N_m`` may be N.m, N/m or a
    torque_N in metres.
    """
    *first, last = name.split("_")
    quotient = f"{first[-1]}_{last}" if len(first) > 1 else ""
    if quotient in QUOTIENTS:
        return "_".join(first[:-1]), quotient.replace("_", "/")
    if not (first and first[0] and _may_be_unit(last, "_".join(first), letters=True)):
        return None
    before = first[-1] if len(first) > 1 else ""
    says_more = before and before not in LABELS and not before.isdigit() and (len(before) > 1 or before in "NmsWJ")
    return (name, "") if says_more and is_unit(before) else ("_".join(first), last)


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
    words = re.split(r"([/.*])", unit) if unit.lower() not in WORDS else [unit.lower()]
    words = [MISSPELT.get(word.strip(), word) for word in words]
    return "".join("deg" if word == "Grad" else WORDS.get(word.strip().lower(), word) for word in words)


def stripped(cell: str) -> str:
    """A cell of a row of units without its brackets."""
    cell = cell.strip().strip("\ufeff")
    match = re.fullmatch(r"\[(.*)\]|\((.*)\)|<(.*)>", cell)
    return next((g.strip() for g in match.groups() if g is not None), "") if match else cell
