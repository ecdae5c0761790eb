"""Units: what a unit string means, its SI form, and conversion between strings of one dimension.

A unit string is a product of symbols with exponents: ``m3/(s.Pa)``, ``rad/(s.V)``, ``m3/(s.sqrt(Pa))``, ``L/min``,
``%``, ``1``. A dot (or ``*``, ``·``, a space) multiplies; after a ``/`` a product needs brackets, as in Modelica.
"""

from __future__ import annotations

import re
import unicodedata
from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np

from .errors import UnitError, nearest

BASE_UNITS = ("m", "kg", "s", "A", "K", "mol", "cd")
_BASE_NAMES = ("length", "mass", "time", "current", "temperature", "substance", "luminosity")

# symbol -> (name known to pint, SI form). The SI form keeps derived units (Pa stays Pa) and angles (rad stays rad).
_SI_SYMBOLS = {
    "m": "meter", "kg": "kilogram", "s": "second", "A": "ampere", "K": "kelvin", "mol": "mole", "cd": "candela",
    "rad": "radian", "N": "newton", "Pa": "pascal", "J": "joule", "W": "watt", "V": "volt", "ohm": "ohm",
    "F": "farad", "H": "henry", "Hz": "hertz", "C": "coulomb", "T": "tesla", "Wb": "weber", "S": "siemens",
}  # fmt: skip
_PREFIXES = {
    "G": "giga", "M": "mega", "k": "kilo", "h": "hecto", "d": "deci", "c": "centi", "m": "milli", "u": "micro",
"μ": "micro", "n": "nano", "p": "pico",
}  # fmt: skip
_OTHER_SYMBOLS = {
    "g": ("gram", "kg"), "t": ("tonne", "kg"), "lb": ("pound", "kg"),
    "min": ("minute", "s"), "h": ("hour", "s"), "d": ("day", "s"),
    "in": ("inch", "m"), "ft": ("foot", "m"), "L": ("liter", "m3"), "l": ("liter", "m3"), "cc": ("cm**3", "m3"),
    "gal": ("gallon", "m3"), "lpm": ("liter/minute", "m3/s"), "LPM": ("liter/minute", "m3/s"),
    "gpm": ("gallon/minute", "m3/s"), "GPM": ("gallon/minute", "m3/s"),
    "bar": ("bar", "Pa"), "mbar": ("millibar", "Pa"), "psi": ("psi", "Pa"), "atm": ("atmosphere", "Pa"),
    "lbf": ("pound_force", "N"), "kgf": ("kilogram_force", "N"), "Nm": ("newton*meter", "N.m"),
    "P": ("poise", "Pa.s"), "cP": ("centipoise", "Pa.s"), "St": ("stokes", "m2/s"), "cSt": ("centistokes", "m2/s"),
    "deg": ("degree", "rad"), "°": ("degree", "rad"), "rev": ("turn", "rad"), "mdeg": ("millidegree", "rad"),
    "rpm": ("turn/minute", "rad/s"), "RPM": ("turn/minute", "rad/s"),
    "Wh": ("watt*hour", "J"), "Ah": ("ampere*hour", "C"), "eV": ("electron_volt", "J"), "hp": ("horsepower", "W"),
    "degC": ("kelvin", "K"), "°C": ("kelvin", "K"), "degF": ("degR", "K"), "°F": ("degR", "K"),
    "%": ("percent", "1"), "ppm": ("ppm", "1"), "‰": ("permille", "1"),
    "count": ("dimensionless", "1"), "counts": ("dimensionless", "1"),
    "Ω": ("ohm", "ohm"), "Ohm": ("ohm", "ohm"),
}  # fmt: skip
_TAKES_PREFIX = (
    "m", "g", "s", "A", "N", "Pa", "J", "W", "V", "ohm", "Ohm", "Ω", "F", "H", "Hz", "rad", "L", "l", "T", "Nm", "eV",
)  # fmt: skip
_ZERO_POINT = {"degC": 273.15, "°C": 273.15, "degF": 459.67 / 1.8, "°F": 459.67 / 1.8}  # K at 0 of a bare temperature

_DISPLAY = {
    "Pa": ("bar", "MPa", "kPa", "psi"), "rad": ("deg",), "rad/s": ("rpm", "deg/s"), "rad/s2": ("deg/s2",),
    "m": ("mm", "cm"), "m/s": ("mm/s",), "m/s2": ("m/s2",), "m2": ("mm2", "cm2"), "m3": ("L", "cm3"),
    "m3/s": ("L/min", "cm3/s"), "m3/rad": ("cm3/rev",), "N": ("kN",), "1": ("%",), "s": ("s", "ms"), "kg": ("kg", "t"),
    "W": ("kW",), "J": ("kJ",), "K": ("degC",), "Pa/s": ("bar/s",), "m3/(s.Pa)": ("L/(min.bar)",), "A": ("A", "mA"),
}  # fmt: skip

_TOKEN = re.compile(
    r"(?P<sqrt>sqrt\()|(?P<open>\()|(?P<close>\))|(?P<over>/)|(?P<power>\*\*|\^)|(?P<times>[.*·⋅ ])"
    r"|(?P<number>[-+]?\d+)|(?P<symbol>[A-Za-zμΩ°%‰]+)"
)


@dataclass(frozen=True)
class Unit:
    """A unit string understood: ``value_si = factor * value + offset`` in the unit ``si``, with base exponents."""

    text: str
    si: str
    factor: float
    offset: float
    dimension: tuple[Fraction, ...]


@cache
def parse_unit(unit: str) -> Unit:
    """Understand a unit string; the answer is cached.

    Raises `UnitError` naming the nearest known symbol when one is not known.

    >>> parse_unit("L/min").si
    'm3/s'
    """
    powers = _Reader(unit).read()
    factor, dimension = 1.0, (Fraction(0),) * 7
    si_powers: dict[str, Fraction] = {}
    for symbol, power in powers.items():
        scale, exponents, si_form = _symbol(symbol)
        factor *= scale ** (int(power) if power.denominator == 1 else float(power))
        dimension = tuple(d + power * e for d, e in zip(dimension, exponents, strict=True))
        for si_symbol, si_power in si_form.items():
            si_powers[si_symbol] = si_powers.get(si_symbol, Fraction(0)) + power * si_power
    offset = _ZERO_POINT.get(next(iter(powers)), 0.0) if list(powers.values()) == [1] else 0.0
    return Unit(unit, _write(si_powers), factor, offset, dimension)


def to_si(values, unit: str):
    """Values in SI and the SI unit: ``(values_si, si_unit)``. Arrays stay arrays, numbers become floats.

    >>> to_si(2.0, "bar")
    (200000.0, 'Pa')
    """
    known = parse_unit(unit)
    return _scaled(values, known.factor, known.offset), known.si


def from_si(values, unit: str):
    """Values given in SI, expressed in ``unit``.

    >>> from_si(200000.0, "bar")
    2.0
    """
    known = parse_unit(unit)
    values = np.asarray(values, dtype=float) if not np.isscalar(values) else float(values)
    return (values - known.offset) / known.factor


def convert(values, from_: str, to: str):
    """Values in ``from_`` expressed in ``to``; `UnitError` when the two are not of one dimension."""
    if not compatible(from_, to):
        raise UnitError(
            f"unit '{from_}': cannot become '{to}' (got {describe(from_)}, not {describe(to)}). {_way(from_)}"
        )
    if from_ == to:
        return _scaled(values, 1.0, 0.0)
    return from_si(to_si(values, from_)[0], to)


def si_unit(unit: str) -> str:
    """The SI form of a unit: bar -> Pa, rpm -> rad/s, cm3/rev -> m3/rad, % -> 1, m3/(s.sqrt(Pa)) -> itself."""
    return parse_unit(unit).si


def dimension(unit: str) -> tuple[Fraction, ...]:
    """Exponents of m, kg, s, A, K, mol, cd; angles and ratios are dimensionless.

    >>> [int(e) for e in dimension("N.s/m")]
    [0, 1, -1, 0, 0, 0, 0]
    """
    return parse_unit(unit).dimension


def compatible(a: str, b: str) -> bool:
    """Whether values in ``a`` can be expressed in ``b``.

    Same dimension; and cycles (Hz) never silently become angles (rad/s), which differ by 2 pi.
    """
    one, two = parse_unit(a), parse_unit(b)
    if one.dimension != two.dimension:
        return False
    return not ({"Hz", "rad"} == _cycle_symbols(one.si) | _cycle_symbols(two.si) and one.si != two.si)


def describe(unit: str) -> str:
    """The dimension of a unit in words: ``'mass length^-1 time^-2'``, or ``'dimensionless'``."""
    words = [
        name if power == 1 else f"{name}^{power}"
        for name, power in zip(_BASE_NAMES, dimension(unit), strict=True)
        if power
    ]
    return " ".join(words) or "dimensionless"


def display_units(unit: str) -> tuple[str, ...]:
    """Units a person reads this quantity in, best first: Pa -> bar, rad -> deg, m -> mm. Never empty."""
    si = si_unit(unit)
    return _DISPLAY.get(si, (si,))


def modelica_unit(unit: str) -> str:
    """The SI form in Modelica's unit grammar; ``""`` (unspecified) where that has no word for it.

    Modelica exponents are integers, so ``m3/(s.sqrt(Pa))`` has none.
    Source: Modelica Language Specification 3.6, chapter 19.
    """
    si = si_unit(unit)
    return "" if "sqrt" in si or "^" in si else re.sub(r"\bohm\b", "Ohm", re.sub(r"\bohm(?=\d)", "Ohm", si))


def known_symbols() -> tuple[str, ...]:
    """Every symbol a unit string may contain."""
    return tuple(_symbol_table())


def _scaled(values, factor: float, offset: float):
    if np.isscalar(values):
        return float(values) * factor + offset
    values = np.asarray(values, dtype=float)
    return values * factor + offset if offset else values * factor


def _cycle_symbols(si: str) -> set[str]:
    return set(re.findall(r"Hz|rad", si))


def _way(unit: str) -> str:
    if "Hz" in unit:
        return "A frequency in Hz is not an angular speed: write rad/s, rpm or rev/s."
    return f"Units of that dimension: {', '.join(dict.fromkeys((si_unit(unit), *display_units(unit))))}."


@cache
def _symbol_table() -> dict[str, tuple[str, str]]:
    table = {symbol: (name, symbol) for symbol, name in _SI_SYMBOLS.items()} | _OTHER_SYMBOLS
    for symbol in _TAKES_PREFIX:
        name, si_form = table[symbol]
        for prefix, word in _PREFIXES.items():
            table.setdefault(prefix + symbol, (word + name, si_form))
    return table


@cache
def _registry():
    import pint

    return pint.UnitRegistry(cache_folder=None)


@cache
def _symbol(symbol: str) -> tuple[float, tuple[Fraction, ...], dict[str, Fraction]]:
    """Factor to SI, base exponents and SI form of one symbol."""
    pint_name, si_form = _symbol_table()[symbol]
    quantity = _registry().Quantity(1.0, pint_name).to_base_units()
    exponents = {str(name): power for name, power in dict(quantity.unit_items()).items()}
    base = ("meter", "kilogram", "second", "ampere", "kelvin", "mole", "candela")
    dims = tuple(Fraction(exponents.get(name, 0)).limit_denominator(12) for name in base)
    powers = {symbol: Fraction(1)} if si_form == symbol else _Reader(si_form).read()
    return float(quantity.magnitude), dims, powers


def _write(powers: dict[str, Fraction]) -> str:
    """``{"m": 3, "s": -1, "Pa": -1/2}`` -> ``m3/(s.sqrt(Pa))``."""
    above = [_factor(s, p) for s, p in powers.items() if p > 0]
    below = [_factor(s, -p) for s, p in powers.items() if p < 0]
    top = ".".join(above) or "1"
    if not below:
        return top
    return f"{top}/{below[0]}" if len(below) == 1 else f"{top}/({'.'.join(below)})"


def _factor(symbol: str, power: Fraction) -> str:
    if power.denominator == 1:
        return symbol if power == 1 else f"{symbol}{power}"
    if power.denominator == 2:
        return f"sqrt({_factor(symbol, power * 2)})"
    return f"{symbol}^({power})"


class _Reader:
    """Recursive descent over one unit string."""

    def __init__(self, unit: str):
        self.unit = unit
        if not isinstance(unit, str):
            raise UnitError(f"unit: not text (got {unit!r}). Write a string such as 'bar' or 'm3/s', '1' for none.")
        plain = unicodedata.normalize("NFKC", unit).strip().replace("\N{MINUS SIGN}", "-")
        text = re.sub(r"\s*([/.*·⋅()])\s*", r"\1", plain) or "1"
        self.tokens = self._split("1" if text == "-" else text)
        self.place = 0

    def read(self) -> dict[str, Fraction]:
        powers = self._product()
        if self.place < len(self.tokens):
            self._fail(f"unexpected '{self.tokens[self.place][1]}'")
        return {symbol: power for symbol, power in powers.items() if power}

    def _split(self, text: str) -> list[tuple[str, str]]:
        tokens, at = [], 0
        while at < len(text):
            match = _TOKEN.match(text, at)
            if not match:
                self._fail(f"unexpected '{text[at]}'")
            tokens.append((match.lastgroup, match.group()))
            at = match.end()
        return tokens

    def _peek(self) -> str:
        return self.tokens[self.place][0] if self.place < len(self.tokens) else "end"

    def _next(self) -> tuple[str, str]:
        if self.place >= len(self.tokens):
            self._fail("it ends too early")
        self.place += 1
        return self.tokens[self.place - 1]

    def _product(self) -> dict[str, Fraction]:
        powers = self._operand()
        divided = False
        while self._peek() in ("times", "over"):
            sign = -1 if self._next()[0] == "over" else 1
            if divided and sign > 0:
                self._fail("a product after '/' is ambiguous")
            divided = divided or sign < 0
            for symbol, power in self._operand().items():
                powers[symbol] = powers.get(symbol, Fraction(0)) + sign * power
        return powers

    def _operand(self) -> dict[str, Fraction]:
        kind, text = self._next()
        if kind == "number" and text == "1":
            return {}
        if kind == "symbol":
            if text not in _symbol_table():
                whole = "" if text == self.unit else f" in '{self.unit}'"
                raise UnitError(f"unit '{text}'{whole}: not known. {nearest(text, _symbol_table())}")
            return {text: self._exponent()}
        if kind in ("open", "sqrt"):
            inner = self._product()
            if self._next()[0] != "close":
                self._fail("a bracket is not closed")
            power = (Fraction(1, 2) if kind == "sqrt" else Fraction(1)) * self._exponent()
            return {symbol: p * power for symbol, p in inner.items()}
        self._fail(f"unexpected '{text}'")

    def _exponent(self) -> Fraction:
        if self._peek() == "power":
            self._next()
            if self._peek() == "open":
                return self._fraction()
        elif self._peek() != "number":
            return Fraction(1)
        kind, text = self._next()
        if kind != "number":
            self._fail(f"'{text}' is not an exponent")
        return Fraction(int(text))

    def _fraction(self) -> Fraction:
        kinds = [self._next() for _ in range(5)]
        if [k for k, _ in kinds] != ["open", "number", "over", "number", "close"] or int(kinds[3][1]) == 0:
            self._fail("an exponent in brackets is a fraction such as ^(1/2)")
        return Fraction(int(kinds[1][1]), int(kinds[3][1]))

    def _fail(self, reason: str):
        raise UnitError(f"unit '{self.unit}': {reason}. Write a product such as 'm3/(s.Pa)', 'N.s/m' or '1'.")
