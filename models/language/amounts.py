"""Amounts as a person reads them: a number in SI in the unit of workshops."""

from __future__ import annotations

from .units import display_units, from_si

FAST = 15.0  # rad/s from which a speed is read in rpm
SHOWN = ("Pa", "rad", "m", "m/s", "m2", "m3", "m3/s")  # SI units that nobody reads


def amount(value: float, unit: str, peak: float | None = None, digits: int = 3) -> str:
    """A value in SI in the unit a person reads: 2.1 bar, 12 mm/s, 0.4°."""
    shown = unit
    if unit == "rad/s":
        shown = "rpm" if abs(value if peak is None else peak) > FAST else "deg/s"
    elif unit in SHOWN:
        shown = display_units(unit)[0]
    number = float(from_si(float(value), shown)) if shown != unit else float(value)
    whole = digits == 3 and 999.5 <= abs(number) < 1e6
    told = f"{number:.0f}" if whole else f"{number:.{digits}g}"
    text = shown.replace("deg", "°")
    return told if text == "1" else f"{told}°" if text == "°" else f"{told} {text}"
