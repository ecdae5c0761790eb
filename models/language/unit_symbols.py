"""The symbols of units: which are known, with which prefixes, and what to write instead of those that are not."""

from __future__ import annotations

import re
from functools import cache

from .errors import nearest

# symbol -> (name known to pint, SI form, prefixes the field uses). The SI form keeps derived units (Pa stays Pa) and
# angles (rad stays rad). A prefix that nobody writes is not known: Grad is German for a degree, no gigaradian.
SYMBOLS = {
    "m": ("meter", "m", "k d c m u n"), "kg": ("kilogram", "kg", ""), "s": ("second", "s", "m u n"),
    "A": ("ampere", "A", "k m u n"), "K": ("kelvin", "K", "m"), "mol": ("mole", "mol", ""), "cd": ("candela", "cd", ""),
    "rad": ("radian", "rad", "m u n"), "N": ("newton", "N", "M k da m u"), "Pa": ("pascal", "Pa", "G M k h m u"),
    "J": ("joule", "J", "M k m u"), "W": ("watt", "W", "G M k m u"), "V": ("volt", "V", "M k m u n"),
    "ohm": ("ohm", "ohm", "G M k m u"), "Ohm": ("ohm", "ohm", "G M k m u"), "Ω": ("ohm", "ohm", "G M k m u"),
    "F": ("farad", "F", "m u n p"), "H": ("henry", "H", "m u n"), "Hz": ("hertz", "Hz", "G M k m"),
    "C": ("coulomb", "C", ""), "T": ("tesla", "T", "m u"), "Wb": ("weber", "Wb", "m"), "S": ("siemens", "S", "m u"),
    "g": ("gram", "kg", "m u"), "t": ("tonne", "kg", ""), "lb": ("pound", "kg", ""),
    "min": ("minute", "s", ""), "h": ("hour", "s", ""), "d": ("day", "s", ""),
    "in": ("inch", "m", ""), "ft": ("foot", "m", ""), "L": ("liter", "m3", "h d c m u"),
    "l": ("liter", "m3", "h d c m u"), "cc": ("cm**3", "m3", ""), "ccm": ("cm**3", "m3", ""),
    "gal": ("gallon", "m3", ""), "lpm": ("liter/minute", "m3/s", ""), "LPM": ("liter/minute", "m3/s", ""),
    "gpm": ("gallon/minute", "m3/s", ""), "GPM": ("gallon/minute", "m3/s", ""),
    "bar": ("bar", "Pa", "k m u"), "psi": ("psi", "Pa", "k"), "atm": ("atmosphere", "Pa", ""),
    "lbf": ("pound_force", "N", ""), "kgf": ("kilogram_force", "N", ""), "kp": ("kilogram_force", "N", ""),
    "Nm": ("newton*meter", "N.m", "M k da m u"), "Pas": ("pascal*second", "Pa.s", "m"),
    "P": ("poise", "Pa.s", ""), "cP": ("centipoise", "Pa.s", ""),
    "St": ("stokes", "m2/s", ""), "cSt": ("centistokes", "m2/s", ""),
    "deg": ("degree", "rad", "m"), "°": ("degree", "rad", ""), "rev": ("turn", "rad", ""), "U": ("turn", "rad", ""),
    "r": ("turn", "rad", ""), "tr": ("turn", "rad", ""), "turn": ("turn", "rad", ""), "Umdr": ("turn", "rad", ""),
    "rpm": ("turn/minute", "rad/s", "k"), "RPM": ("turn/minute", "rad/s", ""), "Upm": ("turn/minute", "rad/s", ""),
    "UPM": ("turn/minute", "rad/s", ""), "rps": ("turn/second", "rad/s", ""),
    "Wh": ("watt*hour", "J", "M k m"), "Ah": ("ampere*hour", "C", "m"), "eV": ("electron_volt", "J", "M k"),
    "hp": ("horsepower", "W", ""), "PS": ("metric_horsepower", "W", ""),
    "degC": ("kelvin", "K", ""), "°C": ("kelvin", "K", ""), "degF": ("degR", "K", ""), "°F": ("degR", "K", ""),
    "delta_degC": ("kelvin", "K", ""), "delta_degF": ("degR", "K", ""),  # differences, as pint writes them
    "%": ("percent", "1", ""), "ppm": ("ppm", "1", ""), "‰": ("permille", "1", ""),
    "count": ("dimensionless", "1", ""), "counts": ("dimensionless", "1", ""),
}  # fmt: skip
PREFIXES = {
    "G": "giga", "M": "mega", "k": "kilo", "h": "hecto", "da": "deca", "d": "deci", "c": "centi", "m": "milli",
    "u": "micro", "n": "nano", "p": "pico",
}  # fmt: skip
# what people write and no unit here is called, with the right word
MEANT = {
    "Grad": "deg", "grad": "deg", "gon": "deg (1 gon is 0.9 deg)", "degree": "deg", "degrees": "deg", "Deg": "deg",
    "sec": "s", "seconds": "s", "Sekunden": "s", "msec": "ms", "minutes": "min", "hour": "h", "hours": "h",
    "Nl": "L after converting norm litres to the real pressure", "Umin": "rpm", "revs": "rev", "turns": "turn",
    "celsius": "degC", "Celsius": "degC", "micron": "um", "Nmm": "N.mm", "Ncm": "N.cm", "percent": "%",
    "°K": "K", "degK": "K",
}  # fmt: skip
_PRESSURE = re.compile(r"([mk]?bar|[kM]Pa|psi)([ga])")  # over the ambient pressure, or over none


@cache
def symbol_table() -> dict[str, tuple[str, str]]:
    """Every symbol a unit string may contain -> (name known to pint, SI form)."""
    table = {symbol: (name, si_form) for symbol, (name, si_form, _) in SYMBOLS.items()}
    for symbol, (name, si_form, prefixes) in SYMBOLS.items():
        for prefix in prefixes.split():
            for spelling in ("u", "μ") if prefix == "u" else (prefix,):
                table.setdefault(spelling + symbol, (PREFIXES[prefix] + name, si_form))
    return table


def right_symbol(text: str) -> str:
    """What to write instead of an unknown symbol; where only the case is wrong, every unit that it may be.

    >>> right_symbol("MPA")
    "Upper and lower case matter: did you mean 'MPa' or 'mPa'?"
    """
    if text in MEANT:
        return f"Write {MEANT[text]}."
    if found := _PRESSURE.fullmatch(text):
        return f"Write {found[1]}{', and say in the name that it is gauge pressure' if found[2] == 'g' else ''}."
    same = [symbol for symbol in symbol_table() if symbol.lower() == text.lower()]
    if same:
        return f"Upper and lower case matter: did you mean {' or '.join(map(repr, same))}?"
    return nearest(text, symbol_table())
